//! The world that is driven in: the vocabulary here, shapes in [`geometry`], motion models in
//! [`dynamics`].
//!
//! The vocabulary of driving, with nuPlan's names: the ego and its vehicle, the objects around it,
//! the lane map, traffic lights, trajectories, history, and the [`SceneView`], which is all that a
//! planner sees at one instant.
//!
//! Plain data only. Time is in integer microseconds, space in local meters of the map frame.

pub mod dynamics;
mod ego;
pub mod geometry;
mod history;
mod interaction;
mod map;
mod map_builder;
mod map_query;
mod object;
mod path;
mod scene;
mod scene_builder;
mod signal;
mod trajectory;

pub use ego::{EgoState, PACIFICA, VehicleParameters};
pub use history::{HISTORY_SAMPLES, History, HistorySample};
pub use interaction::{
    CrossingActor, DriverBehavior, Goal, Interaction, InteractionKind, WALKER_SIZE,
};
pub use map::{
    BASELINE_SPACING, Lane, LaneAreas, LaneId, LaneKind, LaneMap, MapError, MapParts, Neighbor,
    Roadblock, RoadblockId, StopLine, StopLineId,
};
pub use map_builder::MapBuilder;
pub use object::{ObjectKind, TrackToken, TrackedObject};
pub use path::LanePath;
pub use scene::{Route, SceneView};
pub use scene_builder::{Scene, SceneBuilder, SceneError};
pub use signal::{SignalStatus, TrafficLights};
pub use trajectory::{Trajectory, TrajectoryError, TrajectoryState};

/// Microseconds in a second.
pub const MICROS_PER_SECOND: f64 = 1e6;
/// Length of a simulation step, microseconds: nuPlan's 10 Hz.
pub const STEP_US: i64 = 100_000;
/// Length of a simulation step, seconds.
pub const STEP_S: f64 = 0.1;

// Unit tests of other crates include the test road, which names this crate as they do.
#[cfg(test)]
extern crate self as planagent_world;
