//! Stage 2, the paper's Environment Transformation: a [`planagent_world::SceneView`] becomes the
//! two prompts of the paper, the BEV map (global) and the lane-graph text (local). For training and
//! evaluation it also becomes the true answers to what the first round asks about them.
//!
//! - [`bev`]: the image, ego-centered, heading up.
//! - [`lane_graph`]: the node under the ego, its eight neighbors, who is on them, and the
//!   centerlines to follow.
//! - [`text`]: the lane graph in words, in two prompt sets.
//! - [`facts`]: what is true of the scene, as choices.
//! - [`occupancy`]: which cells of the image's area objects touch.
//! - [`coordinates`]: the texts of other language-model planners, to compare with.

pub(crate) mod choice;

pub mod bev;
pub mod coordinates;
pub mod facts;
pub mod lane_graph;
pub mod occupancy;
pub mod text;

#[cfg(test)]
mod sketch;

pub use bev::{BevError, BevView};
pub use choice::UnknownChoice;
pub use facts::SceneFacts;
pub use lane_graph::GraphedScene;
pub use lane_graph::{
    AgentName, CenterlineName, DEFAULT_NODE_LENGTH, LaneGraph, LaneGraphError, NodePlace,
};
pub use occupancy::OccupancyGrid;
pub use text::{Description, TextForm};
