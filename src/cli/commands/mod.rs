//! One file or folder a subcommand.

pub(super) mod dataset;
pub(super) mod plan;
pub(super) mod scenarios;
pub(super) mod simulate;
