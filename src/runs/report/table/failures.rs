//! The failed simulations of a run; equal failures are one line.

use crate::report::simulation_row::SimulationRow;
use crate::report::visible::visible_line;
use crate::worker::run::SimulationRecord;

/// Further simulations of a group that its line names.
const MAX_NAMED: usize = 3;

/// A line for each kind of failure: the first simulation with its error, and how many more failed
/// in the same way. Two errors are of one kind if they differ in numbers and in the scenario's name
/// alone.
pub fn failures(rows: &[SimulationRow]) -> Vec<String> {
    let mut groups: Vec<(String, Vec<(&SimulationRow, &str)>)> = Vec::new();
    for row in rows {
        let Some(error) = &row.error else { continue };
        let error = without_scenario(error, &row.scenario);
        let kind = kind_of(error, &row.scenario);
        match groups.iter_mut().find(|(known, _)| *known == kind) {
            Some((_, group)) => group.push((row, error)),
            None => groups.push((kind, vec![(row, error)])),
        }
    }
    groups.iter().map(|(_, group)| line(group)).collect()
}

/// A failed simulation.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Failure {
    /// Its scenario, planner, challenge and error.
    pub(crate) line: String,
    /// Equal for failures that [`failures`] groups.
    pub(crate) kind: String,
}

impl Failure {
    /// The failure of a simulation that failed.
    pub(crate) fn from_record(record: &SimulationRecord) -> Option<Self> {
        let error = record.outcome.as_ref().err()?;
        let error = without_scenario(error, &record.scenario);
        Some(Self {
            line: format!(
                "{} ({}, {}): {error}",
                visible_line(&record.scenario),
                record.planner,
                record.challenge
            ),
            kind: kind_of(error, &record.scenario),
        })
    }
}

/// An error without the scenario at its beginning: the error of a file begins with its path, which
/// names the scenario too.
fn without_scenario<'a>(error: &'a str, scenario: &str) -> &'a str {
    error
        .strip_prefix(scenario)
        .and_then(|rest| rest.strip_prefix(": "))
        .unwrap_or(error)
}

/// An error without the name of its scenario and without numbers.
fn kind_of(error: &str, scenario: &str) -> String {
    let error = if scenario.is_empty() {
        error.to_owned()
    } else {
        error.replace(scenario, "SCENARIO")
    };
    let mut kind = String::new();
    for character in error.chars() {
        if !character.is_ascii_digit() {
            kind.push(character);
        } else if !kind.ends_with('0') {
            kind.push('0');
        }
    }
    kind
}

fn line(group: &[(&SimulationRow, &str)]) -> String {
    let name = |row: &SimulationRow| {
        format!(
            "{} ({}, {})",
            visible_line(&row.scenario),
            row.planner,
            row.challenge
        )
    };
    let Some(((first, error), others)) = group.split_first() else {
        return String::new();
    };
    let own = format!("{}: {error}", name(first));
    if others.is_empty() {
        return own;
    }
    // A broken model fails everywhere, and a thousand names would bury the cause.
    let named: Vec<String> = others
        .iter()
        .take(MAX_NAMED)
        .map(|(row, _)| name(row))
        .collect();
    let rest = others.len() - named.len();
    let rest = if rest > 0 {
        format!(" and {rest} more")
    } else {
        String::new()
    };
    format!(
        "{own}\n  in the same way failed {} more: {}{rest}",
        others.len(),
        named.join(", ")
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use planagent_agent::simulation::Challenge;

    fn row(scenario: &str, planner: &str, error: Option<&str>) -> SimulationRow {
        SimulationRow {
            scenario: scenario.to_owned(),
            planner: planner.to_owned(),
            error: error.map(str::to_owned),
            ..SimulationRow::example("changing_lane", 0, planner, Challenge::NonReactive, None)
        }
    }

    #[test]
    fn equal_failures_are_one_line() {
        let planner = |scenario: &str, iteration: usize| {
            let error = format!(
                "planner mine failed at iteration {iteration} of scenario {scenario}: states[{iteration}].x is NaN"
            );
            row(scenario, "mine", Some(&error))
        };
        let mut rows: Vec<SimulationRow> = (0..6)
            .map(|i| planner(&format!("generated/changing_lane/{i}"), i * 7))
            .collect();
        rows.push(row("b.db", "idm", Some("b.db: this is no nuPlan log")));
        rows.push(row("c", "idm", None));
        let lines = failures(&rows);
        assert_eq!(lines.len(), 2, "{lines:?}");
        assert!(
            lines[0].contains("at iteration 0 of")
                && lines[0]
                    .contains("\n  in the same way failed 5 more: generated/changing_lane/1")
                && lines[0].ends_with("and 2 more"),
            "{lines:?}"
        );
        assert!(
            lines[1].starts_with("b.db (idm, ") && lines[1].ends_with("): this is no nuPlan log"),
            "{lines:?}"
        );
    }

    #[test]
    fn different_failures_stay_apart() {
        let rows = [
            row("a", "idm", Some("x is NaN")),
            row("a", "idm", Some("y is NaN")),
        ];
        assert_eq!(failures(&rows).len(), 2);
        assert_eq!(failures(&[]), Vec::<String>::new());
    }
}
