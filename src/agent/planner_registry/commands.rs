//! Commands of other programs among the planners.

use super::{PlannerEntry, PlannerNeeds, PlannerRegistry};
use crate::planner::{ExecCommand, ExecError, StopSwitch};
use std::time::Duration;

impl PlannerRegistry {
    /// The registry with a command beside its planners; an answer to a step may take `timeout`.
    ///
    /// # Errors
    /// When another planner has its name.
    pub fn with_command(self, command: &ExecCommand, timeout: Duration) -> Result<Self, ExecError> {
        self.with_stoppable_command(command, timeout, None)
    }

    /// As [`PlannerRegistry::with_command`]; the command is waited for until `stop`.
    ///
    /// # Errors
    /// When another planner has its name.
    #[doc(hidden)]
    pub fn with_stoppable_command(
        self,
        command: &ExecCommand,
        timeout: Duration,
        stop: Option<&StopSwitch>,
    ) -> Result<Self, ExecError> {
        if self.find(command.name.as_str()).is_ok() {
            return Err(ExecError::Taken(command.name.to_string()));
        }
        let (started, stop) = (command.clone(), stop.cloned());
        let needs = PlannerNeeds::Nothing;
        Ok(self.with(PlannerEntry::new(
            command.name,
            "a command",
            needs,
            move |_| Ok(started.planner(timeout, stop.as_ref())),
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
