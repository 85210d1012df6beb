//! Commands of other programs among the planners.

use super::{PlannerEntry, PlannerNeeds, PlannerRegistry};
use crate::planner::{ExecCommand, ExecError};
use std::time::Duration;

impl PlannerRegistry {
    /// The registry with a command beside its planners; an answer to a step may take `timeout`.
    ///
    /// # Errors
    /// When another planner has its name.
    pub fn with_command(self, command: &ExecCommand, timeout: Duration) -> Result<Self, ExecError> {
        if self.find(command.name.as_str()).is_ok() {
            return Err(ExecError::Taken(command.name.to_string()));
        }
        let started = command.clone();
        let needs = PlannerNeeds::Nothing;
        Ok(self.with(PlannerEntry::new(
            command.name,
            "a command",
            needs,
            move |_| Ok(started.planner(timeout)),
        )))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::planner::DEFAULT_EXEC_TIMEOUT;

    #[test]
    fn a_command_takes_no_name_of_another_planner() {
        let with = |word: &str| {
            let command = ExecCommand::parse(word).unwrap().unwrap();
            PlannerRegistry::default().with_command(&command, DEFAULT_EXEC_TIMEOUT)
        };
        assert_eq!(
            with("idm=exec:x").unwrap_err(),
            ExecError::Taken("idm".to_owned())
        );
        assert!(with("mine=exec:x").unwrap().find("mine").is_ok());
    }
}
