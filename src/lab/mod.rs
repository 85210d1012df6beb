//! The lab: studies, datasets, text twins, realism, tokens and the bench of planning calls, with their results.

pub mod bench;
pub mod dataset;
pub mod experiments;
pub mod rank_correlation;
pub mod realism;
pub mod report;
pub mod study;
pub mod tokens;
pub mod twins;
