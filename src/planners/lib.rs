//! The one registry of all planners, for runs, the command line and the library.

use planagent_agent::planner::PlannerRegistry;

/// All planners, the learned ones among them.
pub fn all_planners() -> PlannerRegistry {
    let registry = PlannerRegistry::default();
    #[cfg(feature = "learned")]
    let registry = planagent_learned::entries().fold(registry, PlannerRegistry::with);
    registry
}
