//! Scores over a quantity in which the variants differ; the paper's scores are dashed lines.

use super::panel;
use super::svg::{Anchor, Picture, Scale, color};
use crate::report::{StudyResults, SuiteResults};
use crate::study::Study;
use planagent_agent::simulation::Challenge;

/// Size of the picture and edges of the plot in it, pixels.
const WIDTH: f64 = 640.0;
const HEIGHT: f64 = 400.0;
const LEFT: f64 = 60.0;
const RIGHT: f64 = 610.0;
const TOP: f64 = 44.0;
const BOTTOM: f64 = 300.0;

/// A curve through the variants that have a value.
struct Curve {
    name: String,
    color: &'static str,
    paper: bool,
    points: Vec<[f64; 2]>,
}

pub(super) fn draw(
    study: &Study,
    results: &StudyResults,
    suite: &SuiteResults,
    axis: &str,
) -> String {
    let curves = curves(study, suite);
    let all = || curves.iter().flat_map(|curve| &curve.points);
    // One scale for our scores and the paper's, so that they can be compared.
    let across = Scale::for_values(all().map(|point| point[0]), [LEFT, RIGHT]);
    let up = Scale::for_values(all().map(|point| point[1]), [BOTTOM, TOP]);
    let mut picture = Picture::new(WIDTH);
    let title = format!("{}: {}, {} scenes", results.title, suite.name, suite.scenes);
    picture.text([12.0, 24.0], Anchor::Start, "head", &title);
    picture.rows(up, LEFT, RIGHT);
    picture.columns(across, BOTTOM, BOTTOM + 4.0);
    picture.text(
        [f64::midpoint(LEFT, RIGHT), BOTTOM + 38.0],
        Anchor::Middle,
        "",
        axis,
    );
    for (place, curve) in curves.iter().enumerate() {
        let points: Vec<[f64; 2]> = curve
            .points
            .iter()
            .map(|[x, y]| [across.at(*x), up.at(*y)])
            .collect();
        picture.line(&points, curve.color, curve.paper);
        for point in points {
            picture.point(point, curve.color, curve.paper);
        }
        let [x, y] = [
            LEFT + 280.0 * (place % 2) as f64,
            BOTTOM + 64.0 + 20.0 * (place / 2) as f64,
        ];
        picture.point([x, y - 4.0], curve.color, curve.paper);
        picture.text([x + 12.0, y], Anchor::Start, "faint", &curve.name);
    }
    picture.finish(HEIGHT, &title)
}

/// Our curve and the paper's for each challenge.
fn curves(study: &Study, suite: &SuiteResults) -> Vec<Curve> {
    let mut curves = Vec::new();
    for (series, challenge) in Challenge::CLOSED_LOOP.into_iter().enumerate() {
        for paper in [false, true] {
            let value = |place: usize| {
                let result = suite
                    .variants
                    .get(place)?
                    .challenges
                    .iter()
                    .find(|result| result.challenge == challenge)?;
                if paper { result.paper } else { result.score }
            };
            let variants = study.variants.iter().enumerate();
            let points: Vec<[f64; 2]> = variants
                .filter_map(|(place, v)| Some([v.x?, value(place)?]))
                .collect();
            // The paper has no scores for some studies; its curve then needs no place in the
            // legend.
            if points.is_empty() {
                continue;
            }
            let source = match suite.benchmark {
                Some(benchmark) if paper => format!(", the paper on {}", benchmark.name()),
                _ => String::new(),
            };
            let name = format!("{}{source}", panel(challenge));
            curves.push(Curve {
                name,
                color: color(series),
                paper,
                points,
            });
        }
    }
    curves
}
