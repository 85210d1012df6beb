//! The one registry of all planners, for runs, the command line and the library.

use planagent_agent::planner_registry::PlannerRegistry;

/// All planners, the controls and the learned ones among them.
pub fn all_planners() -> PlannerRegistry {
    let entries = planagent_controls::entries().chain(planagent_language_agents::entries());
    #[cfg(feature = "learned")]
    let entries = entries.chain(planagent_learned::entries());
    entries.fold(PlannerRegistry::default(), PlannerRegistry::with)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    #[test]
    fn names_are_different_and_fit_into_file_names() {
        let registry = all_planners();
        let names: Vec<&str> = registry
            .entries()
            .iter()
            .map(|entry| entry.name.as_str())
            .collect();
        let own =
            PlannerRegistry::default().entries().len() + planagent_controls::entries().count();
        let own = own + planagent_language_agents::entries().count();
        #[cfg(feature = "learned")]
        let own = own + planagent_learned::entries().count();
        assert_eq!(
            names.iter().collect::<BTreeSet<_>>().len(),
            own,
            "no entry replaces another"
        );
        let fits = |name: &&str| name.chars().all(|c| c.is_ascii_lowercase() || c == '-');
        assert!(names.iter().all(fits), "{names:?}");
    }
}
