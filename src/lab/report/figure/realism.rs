//! Two sets of scenes: percentiles of each feature, a row for each.

use super::svg::{Anchor, Picture, Scale, color};
use crate::realism::{Distribution, SceneComparison};
use planagent_runs::report::fixed;

/// Width of the picture, pixels; so are all lengths below.
const WIDTH: f64 = 760.0;
/// Columns: names, then the percentiles between their extremes.
const NAMES: f64 = 220.0;
const LEFT: f64 = 290.0;
const RIGHT: f64 = 690.0;
/// Rows.
const TOP: f64 = 88.0;
const ROW: f64 = 30.0;

/// The figure as SVG; `names` are those of the sets.
pub fn realism_figure(comparison: &SceneComparison, names: [&str; 2]) -> String {
    let mut picture = Picture::new(WIDTH);
    let title = "Features of scenes in two sets";
    picture.text([12.0, 24.0], Anchor::Start, "head", title);
    for (series, (name, scenes)) in names.iter().zip(&comparison.scenes).enumerate() {
        let [x, y] = [12.0, 46.0 + 18.0 * series as f64];
        picture.line(&[[x, y - 4.0], [x + 24.0, y - 4.0]], color(series), false);
        picture.text(
            [x + 32.0, y],
            Anchor::Start,
            "faint",
            &format!("{name}, {} scenes", scenes.len()),
        );
    }
    for (place, one) in comparison.features.iter().enumerate() {
        let y = TOP + ROW * (place as f64 + 0.5);
        let name = match one.feature.unit {
            "" => one.feature.name.to_owned(),
            unit => format!("{}, {unit}", one.feature.name),
        };
        picture.text([NAMES, y + 4.0], Anchor::End, "", &name);
        let ends = || {
            [one.a, one.b]
                .into_iter()
                .flatten()
                .flat_map(|set| [set.percentiles[0], set.percentiles[4]])
        };
        let (low, high) = (
            ends().fold(f64::INFINITY, f64::min),
            ends().fold(f64::NEG_INFINITY, f64::max),
        );
        if !low.is_finite() {
            continue;
        }
        // Each row has a scale of its own, because features have different units.
        let scale = Scale::for_values(ends(), [LEFT, RIGHT]);
        let decimals = usize::from(high.abs().max(low.abs()) < 20.0);
        picture.text(
            [LEFT - 8.0, y + 4.0],
            Anchor::End,
            "faint",
            &fixed(scale.low(), decimals.max(scale.decimals())),
        );
        picture.text(
            [RIGHT + 8.0, y + 4.0],
            Anchor::Start,
            "faint",
            &fixed(scale.high(), decimals.max(scale.decimals())),
        );
        for (series, set) in [one.a, one.b].into_iter().enumerate() {
            if let Some(set) = set {
                row(
                    &mut picture,
                    scale,
                    y + 9.0 * series as f64 - 4.5,
                    &set,
                    color(series),
                );
            }
        }
    }
    let bottom = TOP + ROW * comparison.features.len() as f64;
    let legend = "line: 10th to 90th percentile; bar: 25th to 75th; point: median; each row from its own lowest to its highest value";
    picture.text([12.0, bottom + 24.0], Anchor::Start, "faint", legend);
    picture.finish(bottom + 40.0, title)
}

fn row(picture: &mut Picture, scale: Scale, y: f64, set: &Distribution, color: &str) {
    let [p10, p25, p50, p75, p90] = set.percentiles.map(|value| scale.at(value));
    picture.line(&[[p10, y], [p90, y]], color, false);
    picture.bar([p25, y - 3.0], [(p75 - p25).max(1.0), 6.0], color);
    picture.point([p50, y], color, false);
}
