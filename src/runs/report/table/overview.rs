//! Mean scores of the planners, over all scenarios and by scenario type.

use super::terminal::{GAP, LineWidth, broken};
use super::{Table, measurements, or_dash, percent, short};
use crate::report::summary::{Aggregate, Summary};
use crate::report::timing::PlannerTiming;
use planagent_agent::simulation::Challenge;
use planagent_score::metrics::distinct;

/// A row for each planner: its mean scores, the mean time of a step, the median time of a planning
/// call, its simulations.
///
/// There is no median of a step: most steps of a planner with a model do not call it.
pub(super) fn planners(summary: &Summary, timings: &[PlannerTiming], width: LineWidth) -> String {
    let challenges = distinct(summary.aggregates.iter().map(|row| row.challenge));
    let call = has_calls(timings).then_some("ms/call p50");
    // Only where it happened: most runs need no such column.
    let without_plan = is_without_plan(summary).then_some("no plan");
    let scores = challenges.iter().map(|&challenge| short(challenge));
    let headers = ["planner"]
        .into_iter()
        .chain(scores)
        .chain(["ms/step"])
        .chain(call)
        .chain(["simulations", "failed"])
        .chain(without_plan);
    let planners = distinct(summary.aggregates.iter().map(|row| row.planner.as_str()));
    let timing = |planner: &str| timings.iter().find(|timing| timing.planner == planner);
    let steps: Vec<_> = planners
        .iter()
        .map(|planner| timing(planner)?.mean_iteration_ms)
        .collect();
    let calls: Vec<_> = planners
        .iter()
        .map(|planner| Some(timing(planner)?.planning_call_ms?.p50))
        .collect();
    let times = measurements(&steps).into_iter().zip(measurements(&calls));
    let rows = planners
        .into_iter()
        .zip(times)
        .map(|(planner, (step, call_time))| {
            let own = || {
                summary
                    .aggregates
                    .iter()
                    .filter(|row| row.planner == planner)
            };
            let score = |challenge| {
                own()
                    .find(|row| row.challenge == challenge)
                    .and_then(|row| row.score)
            };
            let call = call.map(|_| call_time);
            let simulations: usize = own().map(|row| row.scenarios + row.failed).sum();
            let failed: usize = own().map(|row| row.failed).sum();
            let scores = challenges
                .iter()
                .map(|&challenge| or_dash(score(challenge), percent));
            let planless = || own().map(|row| row.without_plan).sum();
            let counts = [simulations, failed].into_iter();
            let counts = counts.chain(without_plan.map(|_| planless()));
            [planner.to_owned()]
                .into_iter()
                .chain(scores)
                .chain([step])
                .chain(call)
                .chain(counts.map(|count: usize| count.to_string()))
                .collect()
        });
    Table::new(headers, 1, rows).fitted(width)
}

fn has_calls(timings: &[PlannerTiming]) -> bool {
    timings
        .iter()
        .any(|timing| timing.planning_call_ms.is_some())
}

/// Whether some simulation has planning calls of which none gave a plan.
fn is_without_plan(summary: &Summary) -> bool {
    summary.aggregates.iter().any(|row| row.without_plan > 0)
}

/// What the columns of both tables mean, without those of scores.
pub(super) fn meanings(
    summary: &Summary,
    timings: &[PlannerTiming],
    has_types: bool,
) -> Vec<String> {
    let calls = has_calls(timings).then_some("ms/call p50 = median time of a planning call");
    let types = has_types.then_some("n = scenarios of the type");
    let without_plan =
        is_without_plan(summary).then_some("no plan = simulations without a plan of a call");
    let steps = Some("ms/step = mean time of a step of 0.1 s");
    let text_alone = summary
        .model
        .as_ref()
        .filter(|model| model.image_size.is_none())
        .map(|model| format!("{} = a model that reads text alone: no BEV map", model.name));
    [steps, calls, types, without_plan]
        .into_iter()
        .flatten()
        .map(str::to_owned)
        .chain(text_alone)
        .collect()
}

/// Columns of the number of scenarios, and of a score.
const COUNT: usize = 4;
const SCORE: usize = 6;

/// The scores of the planners by scenario type; planners that the width does not hold follow in
/// tables below.
pub(super) fn scenario_types(summary: &Summary, width: LineWidth) -> String {
    let rows = &summary.scenario_types;
    let types = distinct(rows.iter().filter_map(|row| row.scenario_type.as_deref()));
    if types.len() < 2 {
        return String::new();
    }
    let challenges = distinct(rows.iter().map(|row| row.challenge));
    let planners = distinct(rows.iter().map(|row| row.planner.as_str()));
    // A longer name is broken within its head.
    let widest = width.columns().saturating_sub(COUNT + 2 * GAP);
    let name = planners
        .iter()
        .map(|name| name.chars().count())
        .max()
        .unwrap_or(0)
        .clamp(SCORE, widest)
        + GAP;
    let group = name + (challenges.len() - 1) * (SCORE + GAP);
    let beside = (width.columns().saturating_sub(COUNT + GAP) / group).max(1);
    let tables = planners
        .chunks(beside)
        .map(|planners| type_table(rows, &types, planners, &challenges, widest));
    tables
        .map(|table| table.fitted_below_names(width))
        .collect::<Vec<_>>()
        .join("\n\n")
}

fn type_table(
    rows: &[Aggregate],
    types: &[&str],
    planners: &[&str],
    challenges: &[Challenge],
    widest: usize,
) -> Table {
    let columns: Vec<(&str, Challenge)> = planners
        .iter()
        .flat_map(|&planner| {
            challenges
                .iter()
                .map(move |&challenge| (planner, challenge))
        })
        .collect();
    let lines_of_names = planners
        .iter()
        .map(|planner| broken(planner, widest).len())
        .max()
        .unwrap_or(1);
    let header = |&(planner, challenge): &(&str, Challenge)| {
        let planner = if challenges.first() == Some(&challenge) {
            planner
        } else {
            ""
        };
        let mut lines = vec![String::new(); lines_of_names];
        lines.extend(broken(planner, widest));
        // Names end in the same line, however many lines they have.
        let lines = lines.split_off(lines.len() - lines_of_names);
        format!("{}\n{}", lines.join("\n"), short(challenge))
    };
    let n = format!("{}{:>COUNT$}", "\n".repeat(lines_of_names), "n");
    let headers = ["type".to_owned(), n]
        .into_iter()
        .chain(columns.iter().map(header));
    let cells = types.iter().map(|&name| {
        let own = || {
            rows.iter()
                .filter(|row| row.scenario_type.as_deref() == Some(name))
        };
        let count = own()
            .map(|row| row.scenarios + row.failed)
            .max()
            .unwrap_or(0);
        let scores = columns.iter().map(|&(planner, challenge)| {
            let row = own().find(|row| row.planner == planner && row.challenge == challenge);
            or_dash(row.and_then(|row| row.score), percent)
        });
        [name.to_owned(), count.to_string()]
            .into_iter()
            .chain(scores)
            .collect()
    });
    Table::new(headers, 1, cells)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::Quantiles;
    use std::slice;

    const CHALLENGES: [Challenge; 2] = Challenge::CLOSED_LOOP;

    fn row(
        planner: &str,
        challenge: Challenge,
        scenario_type: Option<&str>,
        score: Option<f64>,
    ) -> Aggregate {
        let failed = usize::from(score.is_none());
        Aggregate {
            planner: planner.to_owned(),
            challenge,
            scenario_type: scenario_type.map(str::to_owned),
            scenarios: 10 - failed,
            failed,
            without_plan: 0,
            score,
        }
    }

    fn summary(planners: &[&str]) -> Summary {
        let longest = "starting_straight_traffic_light_intersection_traversal";
        let mut summary = Summary::new(0, None, &[], &[]);
        for planner in planners {
            for (i, challenge) in CHALLENGES.into_iter().enumerate() {
                let score = Some(0.9 - i as f64 / 10.0);
                summary
                    .aggregates
                    .push(row(planner, challenge, None, score));
                summary
                    .scenario_types
                    .push(row(planner, challenge, Some("changing_lane"), None));
                summary
                    .scenario_types
                    .push(row(planner, challenge, Some(longest), Some(1.0)));
            }
        }
        summary
    }

    fn words(line: &str) -> Vec<&str> {
        line.split_whitespace().collect()
    }

    #[test]
    fn a_planner_has_a_row_with_its_scores_and_its_time() {
        let idm = timing("idm", 0.25, None);
        let text = planners(
            &summary(&["idm", "pdm-closed"]),
            slice::from_ref(&idm),
            LineWidth::PIPE,
        );
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(
            words(lines[0]),
            ["planner", "NR", "R", "ms/step", "simulations", "failed"]
        );
        assert_eq!(
            words(lines[1]),
            ["idm", "90.00", "80.00", "0.25", "20", "0"]
        );
        assert_eq!(
            words(lines[2]),
            ["pdm-closed", "90.00", "80.00", "-", "20", "0"]
        );

        let agent = timing(
            "plan-agent",
            2.341,
            Some(Quantiles {
                p50: 34.12,
                p95: 90.0,
            }),
        );
        let text = planners(
            &summary(&["plan-agent", "idm"]),
            &[agent, idm],
            LineWidth::PIPE,
        );
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(
            words(lines[0]),
            [
                "planner",
                "NR",
                "R",
                "ms/step",
                "ms/call",
                "p50",
                "simulations",
                "failed"
            ]
        );
        assert_eq!(
            words(lines[1]),
            ["plan-agent", "90.00", "80.00", "2.34", "34", "20", "0"]
        );
        assert_eq!(
            words(lines[2]),
            ["idm", "90.00", "80.00", "0.25", "-", "20", "0"]
        );
        assert!(
            lines.iter().all(|line| line.chars().count() <= 80),
            "{text}"
        );
    }

    fn timing(planner: &str, mean_ms: f64, call: Option<Quantiles>) -> PlannerTiming {
        PlannerTiming {
            planner: planner.to_owned(),
            iterations: 298,
            mean_iteration_ms: Some(mean_ms),
            iteration_ms: Some(Quantiles {
                p50: mean_ms / 2.0,
                p95: mean_ms * 2.0,
            }),
            planning_calls: call.map_or(0, |_| 16),
            planning_call_ms: call,
        }
    }

    #[test]
    fn types_fit_the_width_and_further_planners_follow_below() {
        console::set_colors_enabled(false);
        let six = [
            "plan-agent",
            "log-replay",
            "idm",
            "simple",
            "pdm-closed",
            "a-planner-of-the-future",
        ];
        let text = scenario_types(&summary(&six), LineWidth::PIPE);
        assert!(
            text.lines().all(|line| line.chars().count() <= 80),
            "{text}"
        );
        let blocks: Vec<&str> = text.split("\n\n").collect();
        assert_eq!(blocks.len(), 3, "{text}");
        let lines: Vec<&str> = blocks[0].lines().collect();
        assert_eq!(
            (lines[0], words(lines[1])),
            ("type", vec!["plan-agent", "log-replay"])
        );
        assert_eq!(words(lines[2]), ["n", "NR", "R", "NR", "R"]);
        assert_eq!(
            (lines[3], words(lines[4])),
            ("changing_lane", vec!["10", "-", "-", "-", "-"])
        );
        assert_eq!(
            words(lines[6]),
            ["10", "100.00", "100.00", "100.00", "100.00"]
        );
        assert_eq!(
            scenario_types(&Summary::new(0, None, &[], &[]), LineWidth::PIPE),
            "",
            "one type is all there is"
        );
    }
}
