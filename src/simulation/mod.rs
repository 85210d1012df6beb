//! Stage 7: the closed loop at 10 Hz. A [`Planner`](crate::planner::Planner) drives a
//! [`Scenario`](crate::scenario::Scenario); what happened comes out as a [`SimulationLog`].
//!
//! One iteration k, as in the nuPlan devkit: the planner sees the history up to k and the logged lights of k and gives a
//! trajectory; the sample of k is saved; the two-stage controller moves the ego to k+1 in the log's own time; the traffic
//! moves to k+1 while it still sees the ego at k.

mod closed_loop;
mod controller;
mod error;
mod observation;
mod run;

#[cfg(test)]
mod tests;

pub use closed_loop::ClosedLoop;
pub use error::SimulationError;
pub use observation::{Challenge, UnknownChallenge};
pub use run::{Progress, SimulationLog, simulate, simulate_with_progress};
