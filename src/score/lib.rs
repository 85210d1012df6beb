//! How good a drive is: nuPlan's metrics of a simulation, and PDM-Closed's score of a proposal.

pub mod metrics;
pub mod pdm;
