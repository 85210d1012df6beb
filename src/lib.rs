//! `PlanAgent` on device: a driving agent that plans with a multimodal language model, in one offline process on the CPU.
//!
//! A recorded or generated drive comes in; a driven trajectory with nuPlan scores, a transcript of every thought and a
//! latency record of every model call come out. The stages, in the order in which the data passes them:
//!
//! 1. [`scenario`] opens a drive: map, logged agents, traffic lights, route, expert.
//! 2. [`environment`] turns a [`world::Scene`] into the two prompts of the paper: the BEV map and the lane-graph text.
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

pub mod cli;
pub mod dynamics;
pub mod environment;
pub mod experiment;
pub mod geometry;
pub mod metrics;
pub mod mllm;
pub mod pdm;
pub mod planner;
pub mod reasoning;
pub mod reflection;
pub mod report;
pub mod scenario;
pub mod simulation;
pub mod world;

// Unit tests look for outside data, and say what they skip, as the integration tests do.
#[cfg(test)]
#[path = "../tests/outside.rs"]
mod outside;
