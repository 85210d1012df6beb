//! Paths from the ego onto a lane.

use super::route::Candidate;
use planagent_world::geometry::{Point, Pose};

/// Vertices of a candidate at which paths may reach it, and how many vertices it then has at least.
const TARGETS: [(usize, usize); 4] = [(20, 22), (40, 42), (60, 62), (80, 82)];
/// Share of the chord between an end of a Bezier curve and its control point.
const CONTROL: f64 = 3.0;

/// The paths from the ego onto a candidate, one a target. As upstream, each path goes on along the
/// path before it, so that later ones lose a vertex behind their target.
pub fn bent(ego: Pose, candidate: &Candidate) -> Vec<Vec<Point>> {
    let count = candidate.vertices.len();
    let mut targets: Vec<usize> = TARGETS
        .iter()
        .filter(|&&(_, least)| count >= least)
        .map(|&(target, _)| target)
        .collect();
    if targets.is_empty() {
        targets.push(1);
    }
    let mut line: Vec<Point> = candidate.vertices.iter().map(Pose::position).collect();
    let mut paths = Vec::with_capacity(targets.len());
    for target in targets {
        let mut path = bezier(ego, candidate.vertices[target], target);
        path.extend(line.iter().skip(target + 1));
        paths.push(path.clone());
        line = path;
    }
    paths
}

/// Points of the cubic Bezier curve between two poses, both ends included where there are several.
fn bezier(from: Pose, to: Pose, count: usize) -> Vec<Point> {
    let reach = (to.position() - from.position()).norm() / CONTROL;
    let control = [
        from.position(),
        from.position() + reach * from.direction(),
        to.position() - reach * to.direction(),
        to.position(),
    ];
    let point = |i: usize| {
        let t = if count > 1 {
            i as f64 / (count - 1) as f64
        } else {
            0.0
        };
        let u = 1.0 - t;
        let shares = [u * u * u, 3.0 * t * u * u, 3.0 * t * t * u, t * t * t];
        let sum = |axis: usize| {
            control
                .iter()
                .zip(shares)
                .map(|(point, share)| point[axis] * share)
                .sum()
        };
        Point::new(sum(0), sum(1))
    };
    (0..count).map(point).collect()
}

/// The largest curvature of a path, 1 per meter, by repeated central differences (numpy's
/// `gradient`). `None` for fewer than two points and where points coincide, as upstream no such
/// path is chosen.
pub fn curvature(path: &[Point]) -> Option<f64> {
    if path.len() < 2 {
        return None;
    }
    let column = |axis: usize| path.iter().map(|point| point[axis]).collect::<Vec<f64>>();
    let (dx, dy) = (gradient(&column(0)), gradient(&column(1)));
    let (ddx, ddy) = (gradient(&dx), gradient(&dy));
    let at = |i: usize| {
        (dx[i] * ddy[i] - ddx[i] * dy[i]).abs() / (dx[i] * dx[i] + dy[i] * dy[i]).powf(1.5)
    };
    let values: Vec<f64> = (0..path.len()).map(at).collect();
    if values.iter().all(|value| value.is_finite()) {
        values.into_iter().reduce(f64::max)
    } else {
        None
    }
}

fn gradient(values: &[f64]) -> Vec<f64> {
    let last = values.len() - 1;
    let at = |i: usize| match i {
        0 => values[1] - values[0],
        i if i == last => values[last] - values[last - 1],
        i => (values[i + 1] - values[i - 1]) / 2.0,
    };
    (0..values.len()).map(at).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `bezier` and `path_curvature` of the vectors' `gameformer/planner_cases.json`.
    #[test]
    fn curves_and_curvatures_are_those_of_the_original() {
        let path = bezier(Pose::new(1.0, 2.0, 0.3), Pose::new(11.0, 4.5, 0.1), 20);
        for (point, expected) in path.iter().zip([
            [1.0, 2.0],
            [1.518_434_073_109, 2.161_237_842_840],
            [2.037_230_093_888, 2.323_764_419_112],
        ]) {
            assert!(
                (point - Point::from(expected)).norm() < 1e-9,
                "{point} instead of {expected:?}"
            );
        }
        let bend = [
            [0.0, 0.0],
            [1.0, 0.0],
            [2.0, 0.1],
            [3.0, 0.4],
            [4.0, 1.0],
            [4.7, 2.0],
        ]
        .map(Point::from);
        assert!((curvature(&bend).unwrap() - 0.253_100_875_137).abs() < 1e-11);
        assert_eq!(curvature(&[Point::origin(); 3]), None);
    }
}
