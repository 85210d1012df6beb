//! GameFormer (Huang et al. 2023; `MCZhi/GameFormer-Planner`): the network, its reference path and
//! the refinement along it.

mod decoder;
mod encoder;
mod features;
mod network;
mod occupancy;
mod plan;
mod planner;
mod reference_path;
mod refinement;

pub(crate) use encoder::EncodedScene;
pub use encoder::SceneInputs;
pub(crate) use encoder::{Block, HEADS, SceneEncoder};
pub use features::ActorFeatures;
pub use network::{GameFormer, GameFormerConfig, GameFormerOutputs};
pub use occupancy::{CELLS, Occupancy, PredictedAgent, STEPS, occupancy};
pub(crate) use planner::entries;
pub use planner::{placed, refinement};
pub use reference_path::{PathCost, ReferencePath, costed_paths, reference_path};
pub use refinement::Refinement;
