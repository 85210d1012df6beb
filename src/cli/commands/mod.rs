//! One file or folder a subcommand.

pub(super) mod ask;
pub(super) mod bench;
pub(super) mod card;
pub(super) mod compare;
pub(super) mod completions;
pub(super) mod config;
pub(super) mod dataset;
pub(super) mod memory;
pub(super) mod merge;
pub(super) mod models;
pub(super) mod plan;
pub(super) mod render;
pub(super) mod report;
pub(super) mod scenarios;
pub(super) mod serve;
pub(super) mod simulate;
pub(super) mod study;
pub(super) mod trial;
