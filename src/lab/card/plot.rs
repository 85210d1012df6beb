//! The plot of a calibration: each code's probability and regret, and the means of the bins.

use super::calibration::Calibration;
use crate::report::figure::svg::{Anchor, Picture, Scale, color};

/// Size of the picture and edges of the plot in it, pixels.
const WIDTH: f64 = 640.0;
const HEIGHT: f64 = 380.0;
const LEFT: f64 = 60.0;
const RIGHT: f64 = 610.0;
const TOP: f64 = 44.0;
const BOTTOM: f64 = 300.0;

pub(super) fn draw(calibration: &Calibration) -> String {
    let points = &calibration.points;
    let across = Scale::for_values(
        points.iter().map(|point| point.probability).chain([0.0]),
        [LEFT, RIGHT],
    );
    let regrets = points.iter().map(|point| point.regret);
    let up = Scale::for_values(regrets.chain([0.0]), [BOTTOM, TOP]);
    let title = "Regret of the code over the probability that the model gave it";
    let mut picture = Picture::new(WIDTH);
    picture.text([12.0, 24.0], Anchor::Start, "head", title);
    picture.rows(up, LEFT, RIGHT);
    picture.columns(across, BOTTOM, BOTTOM + 4.0);
    let middle = f64::midpoint(LEFT, RIGHT);
    picture.text(
        [middle, BOTTOM + 38.0],
        Anchor::Middle,
        "",
        "probability of the code",
    );
    // The bins come last, above the codes that they sum up.
    for point in points {
        let place = [across.at(point.probability), up.at(point.regret)];
        picture.point(place, color(1), true);
    }
    for bin in &calibration.bins {
        let Some(regret) = bin.regret else { continue };
        let x = across.at(bin.mean_probability);
        let ends = [[x, up.at(regret.low)], [x, up.at(regret.high)]];
        picture.line(&ends, color(0), false);
        picture.point([x, up.at(regret.mean)], color(0), false);
    }
    let legend = BOTTOM + 64.0;
    picture.point([LEFT, legend - 4.0], color(1), true);
    picture.text([LEFT + 12.0, legend], Anchor::Start, "faint", "a code");
    picture.point([LEFT + 100.0, legend - 4.0], color(0), false);
    let of_bin = "mean of a bin, with its 95 % interval";
    picture.text([LEFT + 112.0, legend], Anchor::Start, "faint", of_bin);
    picture.finish(HEIGHT, title)
}
