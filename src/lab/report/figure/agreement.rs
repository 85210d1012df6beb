//! Scores here over reported ones: a panel for each benchmark and challenge, a point for each
//! planner.

use super::panel;
use super::svg::{Anchor, Picture, Scale, color};
use crate::report::{Agreement, StudyResults};

/// Width of the picture, pixels; so are all lengths below.
const WIDTH: f64 = 880.0;
/// Room for the ticks at the left, and between the panels.
const LEFT: f64 = 50.0;
const GAP: f64 = 70.0;
/// Top of the first row of panels, and the height of each.
const TOP: f64 = 70.0;
const HEIGHT: f64 = 260.0;
/// Between two rows of panels.
const BELOW: f64 = 80.0;

/// None without reported scores.
pub(super) fn draw(results: &StudyResults) -> Option<String> {
    let panels: Vec<(&str, &Agreement)> = results
        .suites
        .iter()
        .flat_map(|suite| {
            suite
                .agreement
                .iter()
                .map(move |agreement| (suite.name.as_str(), agreement))
        })
        .collect();
    if panels.is_empty() {
        return None;
    }
    let title = "nuPlan's score x 100: here (upward) and reported (to the right)";
    let mut picture = Picture::new(WIDTH);
    picture.text([12.0, 24.0], Anchor::Start, "head", title);
    let width = (WIDTH - LEFT - GAP) / 2.0 - 12.0;
    for (place, (suite, agreement)) in panels.iter().enumerate() {
        let left = LEFT + (width + GAP) * (place % 2) as f64;
        let top = TOP + (HEIGHT + BELOW) * (place / 2) as f64;
        let tau = agreement
            .kendall
            .map_or_else(String::new, |kendall| format!(", tau {:.2}", kendall.tau));
        let suites = format!("{suite} and {}", agreement.benchmark.name());
        picture.text([left, top - 28.0], Anchor::Start, "", &suites);
        picture.text(
            [left, top - 12.0],
            Anchor::Start,
            "",
            &format!("{}{tau}", panel(agreement.challenge)),
        );
        let across = Scale::for_values(
            agreement.planners.iter().map(|one| one.reported),
            [left, left + width],
        );
        let upward = Scale::for_values(
            agreement.planners.iter().map(|one| one.score),
            [top + HEIGHT, top],
        );
        picture.columns(across, top, top + HEIGHT);
        picture.rows(upward, left, left + width);
        for one in &agreement.planners {
            let (x, y) = (across.at(one.reported), upward.at(one.score));
            picture.point([x, y], color(0), false);
            // Names go to the inner side of their point, so that they stay in the panel.
            let (anchor, x) = if x > left + width / 2.0 {
                (Anchor::End, x - 8.0)
            } else {
                (Anchor::Start, x + 8.0)
            };
            picture.text([x, y + 4.0], anchor, "faint", &one.name);
        }
    }
    let rows = panels.len().div_ceil(2) as f64;
    Some(picture.finish(TOP + (HEIGHT + BELOW) * rows, title))
}
