//! The table of two runs on their common scenes.

use super::terminal::LineWidth;
use super::{Table, short, signed};
use crate::report::number::fixed;
use crate::report::paired::{ComparedScene, ComparedScores, PlannerPair, RunComparison};

/// Scenes in each of the lists of the largest changes.
const MAX_SCENES: usize = 5;

/// The scores, if asked for by scenario type, the scenes with the largest changes, and what the
/// columns mean. `first` and `second` are names of the runs.
pub fn comparison_table(
    comparison: &RunComparison,
    [first, second]: [&str; 2],
    by_type: bool,
    width: LineWidth,
) -> String {
    let names = [format!("A = {first}"), format!("B = {second}")];
    let names = names.iter().flat_map(|name| width.name(name));
    let mut parts = vec![
        names.collect::<Vec<_>>().join("\n"),
        scores(&comparison.scores, width),
    ];
    if by_type {
        parts.push(types(&comparison.scenario_types, width));
    }
    let (lost, gained) = comparison.largest(MAX_SCENES);
    for (heading, scenes) in [("largest losses", lost), ("largest gains", gained)] {
        if !scenes.is_empty() {
            parts.push(format!("{heading}\n{}", changes(&scenes, width)));
        }
    }
    parts.push(notes(comparison, width));
    parts.join("\n\n")
}

const SCORES: [&str; 4] = ["A", "B", "B - A", "95 % interval"];

fn scores(all: &[ComparedScores], width: LineWidth) -> String {
    let rows = all.iter().map(|one| {
        let name = [planners(&one.planners), short(one.challenge).to_owned()];
        name.into_iter()
            .chain([one.difference.pairs.to_string()])
            .chain(cells(one))
            .collect()
    });
    Table::new(["planner", "", "scenes"].into_iter().chain(SCORES), 2, rows).fitted(width)
}

fn types(all: &[ComparedScores], width: LineWidth) -> String {
    let rows = all.iter().map(|one| {
        let kind = one.scenario_type.clone().unwrap_or_default();
        let name = [
            kind,
            format!(" {}", planners(&one.planners)),
            short(one.challenge).to_owned(),
        ];
        name.into_iter()
            .chain([one.difference.pairs.to_string()])
            .chain(cells(one))
            .collect()
    });
    Table::new(
        ["type", " planner", "", "scenes"].into_iter().chain(SCORES),
        3,
        rows,
    )
    .fitted_below_names(width)
}

fn cells(one: &ComparedScores) -> [String; 4] {
    let difference = one.difference;
    [
        fixed(one.first, 2),
        fixed(one.second, 2),
        signed(difference.mean),
        difference.interval(signed),
    ]
}

fn changes(scenes: &[&ComparedScene], width: LineWidth) -> String {
    let rows = scenes.iter().map(|scene| {
        let name = [
            scene.scenario.clone(),
            format!(" {}", planners(&scene.planners)),
            short(scene.challenge).to_owned(),
        ];
        let scores = [
            fixed(scene.first, 2),
            fixed(scene.second, 2),
            signed(scene.difference()),
        ];
        name.into_iter().chain(scores).collect()
    });
    Table::new(["scenario", " planner", "", "A", "B", "B - A"], 3, rows).fitted_below_names(width)
}

fn planners(pair: &PlannerPair) -> String {
    if pair.first == pair.second {
        pair.first.clone()
    } else {
        format!("{} / {}", pair.first, pair.second)
    }
}

/// What the columns mean, and what else differs.
fn notes(comparison: &RunComparison, width: LineWidth) -> String {
    let bootstrap = comparison.bootstrap;
    let mut text = width.wrapped(&format!(
        "Scores are nuPlan's x 100, and interPlan's for scenarios of its kinds, on the scenes that both runs completed. The {} % interval is a percentile bootstrap over \
         scenes ({} resamples, seed {}).",
        fixed(bootstrap.level * 100.0, 0),
        bootstrap.resamples,
        bootstrap.seed
    ));
    if comparison.unpaired > 0 {
        text.extend(width.wrapped(&format!(
            "{} simulations have no completed counterpart in the other run and do not count.",
            comparison.unpaired
        )));
    }
    if !comparison.differences.is_empty() {
        text.push("B differs from A in:".to_owned());
        let lines = comparison.differences.iter();
        text.extend(lines.flat_map(|line| width.name(&format!("  {line}"))));
    }
    text.join("\n")
}
