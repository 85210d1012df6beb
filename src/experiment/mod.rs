//! Stage 9: many simulations in parallel, the studies behind the paper's tables, datasets, benches, and token counts.

pub mod bench;
pub mod dataset;
pub mod interactive;
mod oracle;
pub mod panic_guard;
pub mod rank_correlation;
pub mod realism;
pub mod run;
mod shuffled_bev;
pub mod split;
pub mod statistics;
mod stoppable;
pub mod study;
pub mod suite;
pub mod tokens;
pub mod twins;

pub use stoppable::StopSwitch;
