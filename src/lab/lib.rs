//! The lab: studies, cards of models, datasets, text twins, realism, tokens and the bench of planning
//! calls, with their results.

#[allow(missing_docs, reason = "the root names little of it")]
pub mod bench;
#[allow(missing_docs, reason = "the root names little of it")]
pub mod card;
#[allow(missing_docs, reason = "the root names little of it")]
pub mod dataset;
#[allow(missing_docs, reason = "the root names little of it")]
pub mod memory;
mod rank_correlation;
#[allow(missing_docs, reason = "the root names little of it")]
pub mod realism;
#[allow(missing_docs, reason = "the root names little of it")]
pub mod report;
#[allow(missing_docs, reason = "the root names little of it")]
pub mod study;
#[allow(missing_docs, reason = "the root names little of it")]
pub mod study_runs;
#[allow(missing_docs, reason = "the root names little of it")]
pub mod tokens;
#[allow(missing_docs, reason = "the root names little of it")]
pub mod twins;
