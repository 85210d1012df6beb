//! The paper's main table, over all scenarios and by scenario type.

use super::{percent_or_dash, plain, short};
use crate::report::summary::{Aggregate, Summary, distinct};
use crate::report::timing::PlannerTiming;
use crate::simulation::Challenge;
use console::style;

/// A row a planner: its mean scores, the mean time of a step and, where a planner calls a model, the median time of a call, how
/// many drives it made. No quantile of a step: most steps of a planner with a model do not call it.
pub(super) fn planners(summary: &Summary, timings: &[PlannerTiming]) -> String {
    let challenges = distinct(summary.aggregates.iter().map(|row| row.challenge));
    let head = ["planner"].into_iter().chain(challenges.iter().map(|&c| short(c)));
    let calls = timings.iter().any(|timing| timing.planning_call_ms.is_some());
    let call = calls.then_some("ms/call p50");
    let header = head.chain(["ms/step"]).chain(call).chain(["simulations", "failed"]);
    let header: Vec<String> = header.map(str::to_owned).collect();
    let planners = distinct(summary.aggregates.iter().map(|row| row.planner.as_str()));
    let rows = planners.into_iter().map(|planner| {
        let own = || summary.aggregates.iter().filter(|row| row.planner == planner);
        let score = |challenge| own().find(|row| row.challenge == challenge).and_then(|row| row.score);
        let timing = timings.iter().find(|timing| timing.planner == planner);
        let ms = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), milliseconds);
        let simulations: usize = own().map(|row| row.scenarios + row.failed).sum();
        let failed: usize = own().map(|row| row.failed).sum();
        let scores = challenges.iter().map(|&challenge| percent_or_dash(score(challenge)));
        let step = ms(timing.and_then(|timing| timing.mean_iteration_ms));
        let call = calls.then(|| ms(timing.and_then(|timing| timing.planning_call_ms).map(|call| call.p50)));
        let counts = [simulations.to_string(), failed.to_string()];
        [planner.to_owned()].into_iter().chain(scores).chain([step]).chain(call).chain(counts).collect()
    });
    plain(&header, rows.collect(), 1)
}

/// Three figures at most.
fn milliseconds(ms: f64) -> String {
    match ms {
        ms if ms < 0.1 => format!("{ms:.4}"),
        ms if ms < 10.0 => format!("{ms:.2}"),
        ms if ms < 100.0 => format!("{ms:.1}"),
        ms => format!("{ms:.0}"),
    }
}

/// Columns that a score takes: `100.00` and a gap.
const SCORE: usize = 7;
/// Columns before the scores.
const COUNT: usize = 6;

/// Two lines a scenario type: its name, then how many scenarios and each planner's scores. As many planners side by side
/// as the width holds, the others below.
pub(super) fn scenario_types(summary: &Summary, width: u16) -> String {
    let rows = &summary.scenario_types;
    let types = distinct(rows.iter().filter_map(|row| row.scenario_type.as_deref()));
    if types.len() < 2 {
        return String::new();
    }
    let challenges = distinct(rows.iter().map(|row| row.challenge));
    let planners = distinct(rows.iter().map(|row| row.planner.as_str()));
    let longest = planners.iter().map(|name| name.chars().count() + 2).max().unwrap_or(0);
    let group = (challenges.len() * SCORE).max(longest);
    let beside = (usize::from(width).saturating_sub(COUNT) / group).max(1);
    let blocks = planners.chunks(beside).map(|planners| block(rows, &types, planners, &challenges, group));
    blocks.collect::<Vec<_>>().join("\n\n")
}

fn block(rows: &[Aggregate], types: &[&str], planners: &[&str], challenges: &[Challenge], group: usize) -> String {
    let cells = |of: &dyn Fn(&str, Challenge) -> String| -> String {
        let scores = |planner: &str| -> Vec<String> {
            challenges.iter().map(|&challenge| format!("{:>SCORE$}", of(planner, challenge))).collect()
        };
        let groups = planners.iter().map(|planner| format!("{:>group$}", scores(planner).concat()));
        groups.collect::<Vec<_>>().concat()
    };
    let names = planners.iter().map(|planner| format!("{planner:>group$}")).collect::<Vec<_>>().concat();
    let mut lines = vec![
        format!("{:<COUNT$}{names}", "type"),
        format!("{:>COUNT$}{}", "n", cells(&|_, challenge| short(challenge).to_owned())),
    ];
    for name in types {
        let of_type = || rows.iter().filter(|row| row.scenario_type.as_deref() == Some(*name));
        let n = of_type().map(|row| row.scenarios + row.failed).max().unwrap_or(0);
        let score = |planner: &str, challenge| {
            of_type().find(|row| row.planner == planner && row.challenge == challenge).and_then(|row| row.score)
        };
        lines.push(style(name).bold().to_string());
        lines.push(format!("{n:>COUNT$}{}", cells(&|planner, challenge| percent_or_dash(score(planner, challenge)))));
    }
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::timing::Quantiles;
    use std::slice;

    const CHALLENGES: [Challenge; 2] = Challenge::CLOSED_LOOP;

    fn row(planner: &str, challenge: Challenge, scenario_type: Option<&str>, score: Option<f64>) -> Aggregate {
        let failed = usize::from(score.is_none());
        Aggregate {
            planner: planner.to_owned(),
            challenge,
            scenario_type: scenario_type.map(str::to_owned),
            scenarios: 10 - failed,
            failed,
            score,
        }
    }

    fn summary(planners: &[&str]) -> Summary {
        let longest = "starting_straight_traffic_light_intersection_traversal";
        let mut summary = Summary::new(0, None, &[], &[]);
        for planner in planners {
            for (i, challenge) in CHALLENGES.into_iter().enumerate() {
                let score = Some(0.9 - i as f64 / 10.0);
                summary.aggregates.push(row(planner, challenge, None, score));
                summary.scenario_types.push(row(planner, challenge, Some("changing_lane"), None));
                summary.scenario_types.push(row(planner, challenge, Some(longest), Some(1.0)));
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
        let text = planners(&summary(&["idm", "pdm-closed"]), slice::from_ref(&idm));
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(words(lines[0]), ["planner", "NR", "R", "ms/step", "simulations", "failed"]);
        assert_eq!(words(lines[1]), ["idm", "90.00", "80.00", "0.25", "20", "0"]);
        assert_eq!(words(lines[2]), ["pdm-closed", "90.00", "80.00", "-", "20", "0"]);

        let agent = timing("plan-agent", 2.341, Some(Quantiles { p50: 34.12, p95: 90.0 }));
        let text = planners(&summary(&["plan-agent", "idm"]), &[agent, idm]);
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(words(lines[0]), ["planner", "NR", "R", "ms/step", "ms/call", "p50", "simulations", "failed"]);
        assert_eq!(words(lines[1]), ["plan-agent", "90.00", "80.00", "2.34", "34.1", "20", "0"]);
        assert_eq!(words(lines[2]), ["idm", "90.00", "80.00", "0.25", "-", "20", "0"]);
        assert!(lines.iter().all(|line| line.chars().count() <= 80), "{text}");
    }

    fn timing(planner: &str, mean_ms: f64, call: Option<Quantiles>) -> PlannerTiming {
        PlannerTiming {
            planner: planner.to_owned(),
            iterations: 298,
            mean_iteration_ms: Some(mean_ms),
            iteration_ms: Some(Quantiles { p50: mean_ms / 2.0, p95: mean_ms * 2.0 }),
            planning_calls: call.map_or(0, |_| 16),
            planning_call_ms: call,
        }
    }

    #[test]
    fn types_stay_within_the_width_and_planners_that_do_not_fit_stand_below() {
        console::set_colors_enabled(false);
        let six = ["plan-agent", "log-replay", "idm", "simple", "pdm-closed", "a-planner-of-the-future"];
        let text = scenario_types(&summary(&six), 80);
        assert!(text.lines().all(|line| line.chars().count() <= 80), "{text}");
        let blocks: Vec<&str> = text.split("\n\n").collect();
        assert_eq!(blocks.len(), 3, "{text}");
        let lines: Vec<&str> = blocks[0].lines().collect();
        assert_eq!(words(lines[0]), ["type", "plan-agent", "log-replay"]);
        assert_eq!(words(lines[1]), ["n", "NR", "R", "NR", "R"]);
        assert_eq!((lines[2], words(lines[3])), ("changing_lane", vec!["10", "-", "-", "-", "-"]));
        assert_eq!(words(lines[5]), ["10", "100.00", "100.00", "100.00", "100.00"]);
        assert_eq!(scenario_types(&Summary::new(0, None, &[], &[]), 80), "", "one type is all there is");
    }
}
