//! Stage 9: what drives many loops. Simulation runs; the paper's tables; label search and datasets; what a planning call costs;
//! what descriptions of scenes take.

pub mod bench;
pub mod dataset;
pub mod panic_guard;
pub mod run;
mod shuffled_bev;
pub mod split;
pub mod statistics;
pub mod study;
pub mod suite;
pub mod tokens;
