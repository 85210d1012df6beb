//! DTPP (Huang et al. 2024; `MCZhi/DTPP`): the network, and the tree of trajectories that it
//! scores.

mod network;
mod paths;
mod planner;
mod scorer;
mod speed_profile;
mod tree;

pub use network::{Dtpp, DtppConfig, DtppOutputs};
pub use paths::{CostedPath, costed_paths, paths};
pub(crate) use planner::entries;
pub use speed_profile::{NoTrajectory, Step, first_stage, profile, second_stage};
pub use tree::{ScoredTree, TreeError, scored_tree};
