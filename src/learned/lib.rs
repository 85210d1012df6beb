//! Learned planners: each computes what its authors' program computes, from a checkpoint of theirs
//! or ours, without Python.
//!
//! A model is a folder: its features, its network under the names of its checkpoint, its planner.
//! The layers that networks share are in `blocks`; candidate paths that planners share are in
//! `lattice`. [`Checkpoint`] opens the files, and `prediction` makes a trajectory of a network's
//! poses.

mod blocks;
mod checkpoint;
pub mod dtpp;
mod frame;
pub mod gameformer;
pub mod gc_pgp;
pub mod lattice;
mod past;
pub mod pdm_open;
pub mod plantf;
mod prediction;
pub mod raster_model;
mod slot;
pub mod urban_driver;

pub use blocks::{Mismatch, Probe, Weights};
pub use checkpoint::{Checkpoint, CheckpointError};
pub use prediction::trajectory;

use planagent_agent::planner::PlannerError;
use planagent_agent::planner_registry::PlannerEntry;

/// The learned planners.
pub fn entries() -> impl Iterator<Item = PlannerEntry> {
    [
        pdm_open::entry(),
        pdm_open::hybrid_entry(),
        plantf::entry(),
        urban_driver::entry(),
    ]
    .into_iter()
    .chain(raster_model::entries())
    .chain([gc_pgp::entry()])
    .chain(gameformer::entries())
    .chain(dtpp::entries())
}

fn network_failed(source: candle_core::Error) -> PlannerError {
    PlannerError::Failed {
        doing: "running the network",
        source: Box::new(source),
    }
}
