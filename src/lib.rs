//! `PlanAgent` on device: a driving agent that plans with a multimodal language model, in one offline process on the CPU.
//!
//! A recorded or generated drive comes in; a driven trajectory with nuPlan scores, a transcript of every thought and a
//! latency record of every model call come out. The stages, in the order in which the data passes them:
//!
//! 1. [`scenario`] opens a drive: map, logged agents, traffic lights, route, expert.
//! 2. [`environment`] turns a [`world::SceneView`] into the two prompts of the paper: the BEV map and the lane-graph text.
//! 3. [`mllm`] runs a multimodal language model on the CPU.
//! 4. [`reasoning`] asks it three rounds and parses the planner code that it writes.
//! 5. [`reflection`] rolls that planner out, scores it by [`pdm`]'s measure, and accepts it or asks to rethink.
//! 6. [`planner`] is the one trait the simulator knows; `PlanAgent` and the baselines implement it.
//! 7. [`simulation`] closes the loop at 10 Hz.
//! 8. [`metrics`] scores the driven trajectory with nuPlan's closed-loop metrics.
//! 9. [`experiment`] drives many loops: simulation runs, datasets, model evaluation.
//! 10. [`report`] writes tables and files.
//!
//! Below them lie [`geometry`], [`world`] (the vocabulary) and [`dynamics`]; above them [`cli`]. A module uses only what
//! stands below it; `ARCHITECTURE.md` gives the order and `tests/architecture.rs` enforces it.

/// The command line of the `planagent` program.
#[doc(hidden)]
pub mod cli;

#[cfg(not(feature = "internals"))]
mod dynamics;
#[cfg(not(feature = "internals"))]
mod environment;
#[cfg(not(feature = "internals"))]
mod experiment;
#[cfg(not(feature = "internals"))]
mod geometry;
#[cfg(not(feature = "internals"))]
mod metrics;
#[cfg(not(feature = "internals"))]
mod mllm;
#[cfg(not(feature = "internals"))]
mod pdm;
#[cfg(not(feature = "internals"))]
mod planner;
#[cfg(not(feature = "internals"))]
mod reasoning;
#[cfg(not(feature = "internals"))]
mod reflection;
#[cfg(not(feature = "internals"))]
mod report;
#[cfg(not(feature = "internals"))]
mod scenario;
#[cfg(not(feature = "internals"))]
mod simulation;
#[cfg(not(feature = "internals"))]
mod world;

#[cfg(feature = "internals")]
#[doc(hidden)]
pub mod dynamics;
#[cfg(feature = "internals")]
#[doc(hidden)]
pub mod environment;
#[cfg(feature = "internals")]
#[doc(hidden)]
pub mod experiment;
#[cfg(feature = "internals")]
#[doc(hidden)]
pub mod geometry;
#[cfg(feature = "internals")]
#[doc(hidden)]
pub mod metrics;
#[cfg(feature = "internals")]
#[doc(hidden)]
pub mod mllm;
#[cfg(feature = "internals")]
#[doc(hidden)]
pub mod pdm;
#[cfg(feature = "internals")]
#[doc(hidden)]
pub mod planner;
#[cfg(feature = "internals")]
#[doc(hidden)]
pub mod reasoning;
#[cfg(feature = "internals")]
#[doc(hidden)]
pub mod reflection;
#[cfg(feature = "internals")]
#[doc(hidden)]
pub mod report;
#[cfg(feature = "internals")]
#[doc(hidden)]
pub mod scenario;
#[cfg(feature = "internals")]
#[doc(hidden)]
pub mod simulation;
#[cfg(feature = "internals")]
#[doc(hidden)]
pub mod world;

/// All stages, for the tests and benches of this package. No promise of stability holds here.
#[cfg(feature = "internals")]
#[doc(hidden)]
pub mod internals {
    pub use crate::{
        cli, dynamics, environment, experiment, geometry, metrics, mllm, pdm, planner, reasoning, reflection, report,
        scenario, simulation, world,
    };
}

// Unit tests look for outside data, and say what they skip, as the integration tests do.
#[cfg(test)]
#[path = "../tests/outside.rs"]
mod outside;
