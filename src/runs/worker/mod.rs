//! Stage 9: many simulations in parallel, the studies behind the paper's tables, datasets, benches,
//! and token counts.

pub mod interactive;
pub mod panic_guard;
pub mod run;
pub mod seeds;
mod shuffled_bev;
pub mod split;
pub mod statistics;
mod stoppable;
pub mod suite;

pub use stoppable::StopSwitch;
