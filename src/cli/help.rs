//! Help texts that name what the registries hold.

use super::args::ALL_EXPERIMENTS;
use crate::experiment::study;
use crate::experiment::suite::Suite;
use crate::planner::{PlannerName, PlannerRegistry};
use crate::runner::{TOKENS, build_commit};
use crate::scenario::{DataRoots, Readers};
use std::sync::LazyLock;

/// Version of the program, with the commit of the build.
pub(super) fn version() -> &'static str {
    static VERSION: LazyLock<String> = LazyLock::new(|| {
        let version = env!("CARGO_PKG_VERSION");
        build_commit().map_or_else(|| version.to_owned(), |commit| format!("{version} ({commit})"))
    });
    &VERSION
}

pub(super) fn planners() -> String {
    let registry = PlannerRegistry::default();
    let names: Vec<&str> = registry.entries().iter().map(|entry| entry.name.as_str()).collect();
    format!("Planners, separated by commas: {} [default: {}]", names.join(", "), PlannerName::PLAN_AGENT)
}

pub(super) fn splits() -> String {
    let suite = |suite: Suite| {
        let specs = suite.specs();
        let types = specs.chunk_by(|a, b| a.scenario_type == b.scenario_type).count();
        format!("{} ({types} types x {})", suite.name, specs.len() / types.max(1))
    };
    let known = Readers::new(&DataRoots::default()).splits().into_iter().map(str::to_owned);
    let names: Vec<String> = known.chain(Suite::ALL.map(suite)).collect();
    format!("List of scenarios: {}; or a nuPlan scenario filter FILE.yaml", names.join(", "))
}

pub(super) fn experiments() -> String {
    let names: Vec<&str> = study::names().chain([TOKENS]).collect();
    format!("{}; {ALL_EXPERIMENTS} for all of these; or the path of a study FILE.toml", names.join(", "))
}
