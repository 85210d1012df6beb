//! One file a subcommand.

pub mod dataset;
pub mod plan;
pub mod scenarios;
pub mod simulate;
