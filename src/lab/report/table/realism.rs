//! The table of two sets of scenes.

use crate::realism::{Distribution, FOLDS, SceneComparison};
use planagent_runs::report::table::{LineWidth, Table, or_dash, signed};
use planagent_runs::report::{fixed, visible_line};

/// Mean and standard deviation of each feature in both sets, and what tells them apart. `names` are
/// those of the sets.
pub fn realism_table(comparison: &SceneComparison, names: [&str; 2], width: LineWidth) -> String {
    let [a, b] = &comparison.scenes;
    let counts = [a.len(), b.len()];
    let heads = ["A", "B"].iter().zip(names).zip(counts);
    let heads: Vec<String> = heads
        .flat_map(|((side, name), count)| {
            let name = visible_line(name);
            width.name(&format!("{side} = {name}, {count} scenes"))
        })
        .collect();
    let rows = comparison.features.iter().map(|one| {
        let name = match one.feature.unit {
            "" => one.feature.name.to_owned(),
            unit => format!("{}, {unit}", one.feature.name),
        };
        let [a, b] = cells([one.a, one.b]);
        vec![
            name,
            a,
            b,
            or_dash(one.difference, signed),
            or_dash(one.coefficient, signed),
        ]
    });
    let table = Table::new(["feature", "A", "B", "A - B", "weight"], 1, rows).fitted(width);
    [heads.join("\n"), table, notes(comparison, width)].join("\n\n")
}

/// Mean and standard deviation, with equal decimals on both sides.
fn cells(sets: [Option<Distribution>; 2]) -> [String; 2] {
    let sizes = sets
        .iter()
        .flatten()
        .map(|set| set.mean.abs().max(set.deviation));
    let decimals = match sizes.fold(0.0, f64::max) {
        size if size >= 20.0 => 0,
        size if size >= 2.0 => 1,
        _ => 2,
    };
    sets.map(|set| {
        or_dash(set, |set| {
            format!(
                "{} ({})",
                fixed(set.mean, decimals),
                fixed(set.deviation, decimals)
            )
        })
    })
}

fn notes(comparison: &SceneComparison, width: LineWidth) -> String {
    let told = comparison.classifier.as_ref().map_or_else(
        || format!("Fewer than {FOLDS} recordings on a side: no classifier."),
        |found| {
            format!(
                "A classifier tells A from B in {} % of cases (95 % interval {} to {}; A {}, B {}; 50 is chance).",
                fixed(found.mean * 100.0, 1),
                fixed(found.low * 100.0, 1),
                fixed(found.high * 100.0, 1),
                fixed(found.of_a * 100.0, 1),
                fixed(found.of_b * 100.0, 1),
            )
        },
    );
    let meaning = format!(
        "Means over scenes, standard deviations in parentheses. A - B: difference of means in standard deviations of all scenes. \
         Classifier: logistic regression, {FOLDS}-fold cross-validation; weight: its coefficient by standard deviation, positive \
         for A. The interval is a bootstrap over recordings."
    );
    [width.wrapped(&told), width.wrapped(&meaning)]
        .map(|lines| lines.join("\n"))
        .join("\n\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_fits_every_terminal() {
        let comparison = SceneComparison::from_sets(Vec::new(), Vec::new());
        let long =
            "a/folder/of/recordings/with/a/name/that/is/longer/than/a/terminal/of/80/columns";
        for columns in [60, 80, 100, 160] {
            let text = realism_table(&comparison, ["A", long], LineWidth::terminal(columns));
            let fits = |line: &str| line.chars().count() <= usize::from(columns);
            assert!(text.lines().all(fits), "wider than {columns}: {text}");
        }
    }
}
