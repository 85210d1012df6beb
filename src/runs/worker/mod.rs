//! Stage 9: many simulations in parallel, the studies behind the paper's tables, datasets, benches,
//! and token counts.

mod failed_call;
pub mod interactive;
pub mod panic_guard;
pub mod run;
pub mod seeds;
mod shuffled_bev;
pub mod split;
pub mod statistics;
mod stoppable;
pub mod suite;

pub use failed_call::{FailedCall, FailedCallListener};
pub use planagent_agent::planner::StopSwitch;
