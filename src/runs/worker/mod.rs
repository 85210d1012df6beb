//! Stage 9: many simulations in parallel, the studies behind the paper's tables, datasets, benches,
//! and token counts.

pub mod interactive;
mod oracle;
pub mod panic_guard;
pub mod run;
pub mod search;
pub mod seeds;
mod shuffled_bev;
pub mod split;
pub mod statistics;
mod stoppable;
pub mod suite;

pub use planagent_agent::planner::StopSwitch;
