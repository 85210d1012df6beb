//! Runs of many simulations: [`worker`] simulates, [`report`] keeps and shows the records,
//! [`runner`] starts, resumes and merges.

#[allow(missing_docs, reason = "the root names little of it")]
pub mod report;
#[allow(missing_docs, reason = "the root names little of it")]
pub mod runner;
#[allow(missing_docs, reason = "the root names little of it")]
pub mod worker;
