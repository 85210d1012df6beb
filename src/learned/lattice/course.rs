//! A smooth path: natural cubic splines over the length of its chords.

use planagent_world::geometry::{Point, Pose, wrap_angle};

/// Distance between two rows, meters.
pub(crate) const ROW: f64 = 0.1;
/// Maximum number of rows.
pub(crate) const MAX_ROWS: usize = 1200;
/// One point in this many carries the spline.
const STRIDE: usize = 10;

/// Rows of a path, 0.1 m apart: x, y (meters), heading (radians), curvature (1 per meter).
pub type Course = Vec<[f64; 4]>;

/// The points of a path that carry its spline.
pub(crate) fn every_tenth(path: &[Point]) -> Vec<Point> {
    path.iter().step_by(STRIDE).copied().collect()
}

/// The course through points; `None` for fewer than two, and where two that follow each other
/// coincide.
pub fn course(points: &[Point]) -> Option<Course> {
    let mut lengths = vec![0.0];
    for pair in points.windows(2) {
        let chord = (pair[1] - pair[0]).norm();
        // The splines divide by the chords.
        if chord <= 0.0 {
            return None;
        }
        lengths.push(
            lengths
                .last()
                .copied()
                .expect("the lengths begin with zero")
                + chord,
        );
    }
    let column = |axis: usize| points.iter().map(|point| point[axis]).collect::<Vec<f64>>();
    let (x, y) = (
        Spline::new(&lengths, &column(0))?,
        Spline::new(&lengths, &column(1))?,
    );
    let end = lengths
        .last()
        .copied()
        .expect("the lengths begin with zero");
    let mut rows = Vec::with_capacity((end / ROW) as usize + 1);
    for s in (0..)
        .map(|i: u32| f64::from(i) * ROW)
        .take_while(|&s| s < end)
    {
        let piece = lengths
            .partition_point(|&length| length <= s)
            .clamp(1, lengths.len() - 1)
            - 1;
        let ([x, dx, ddx], [y, dy, ddy]) = (
            x.at(piece, s - lengths[piece]),
            y.at(piece, s - lengths[piece]),
        );
        let curvature = (ddy * dx - ddx * dy) / (dx * dx + dy * dy).powf(1.5);
        rows.push([x, y, dy.atan2(dx), curvature]);
    }
    Some(rows)
}

/// A course in the frame of the ego, at most 120 m long.
pub(crate) fn relative_course(course: &[[f64; 4]], ego: Pose) -> Course {
    let local = |&[x, y, heading, curvature]: &[f64; 4]| {
        let place = ego.to_local(Point::new(x, y));
        [
            place.x,
            place.y,
            wrap_angle(heading - ego.heading),
            curvature,
        ]
    };
    course.iter().take(MAX_ROWS).map(local).collect()
}

/// Pieces a + b·u + c·u² + d·u³.
struct Spline {
    pieces: Vec<[f64; 4]>,
}

impl Spline {
    /// A natural cubic spline; `None` for fewer than two knots.
    fn new(knots: &[f64], values: &[f64]) -> Option<Self> {
        let (count, steps) = (
            values.len(),
            knots
                .windows(2)
                .map(|pair| pair[1] - pair[0])
                .collect::<Vec<f64>>(),
        );
        if count < 2 {
            return None;
        }
        let slope = |i: usize| (values[i + 1] - values[i]) / steps[i];
        // Half the second derivatives, by elimination down and up a band of three.
        let mut c = vec![0.0; count];
        let (mut upper, mut right) = (vec![0.0; count], vec![0.0; count]);
        for i in 1..count - 1 {
            let pivot = 2.0 * (steps[i - 1] + steps[i]) - steps[i - 1] * upper[i - 1];
            upper[i] = steps[i] / pivot;
            right[i] = (3.0 * (slope(i) - slope(i - 1)) - steps[i - 1] * right[i - 1]) / pivot;
        }
        for i in (1..count - 1).rev() {
            c[i] = right[i] - upper[i] * c[i + 1];
        }
        let piece = |i: usize| {
            let d = (c[i + 1] - c[i]) / (3.0 * steps[i]);
            [
                values[i],
                slope(i) - steps[i] / 3.0 * (2.0 * c[i] + c[i + 1]),
                c[i],
                d,
            ]
        };
        Some(Self {
            pieces: (0..count - 1).map(piece).collect(),
        })
    }

    /// Value and two derivatives.
    fn at(&self, piece: usize, u: f64) -> [f64; 3] {
        let [a, b, c, d] = self
            .pieces
            .get(piece)
            .copied()
            .expect("the piece is one of the spline");
        [
            a + u * (b + u * (c + u * d)),
            b + u * (2.0 * c + 3.0 * d * u),
            2.0 * c + 6.0 * d * u,
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// `spline_course` of the vectors' `gameformer/planner_cases.json`.
    #[test]
    fn the_course_is_that_of_the_original() {
        let points = [
            [0.0, 0.0],
            [2.5, 0.2],
            [5.1, 0.9],
            [7.4, 1.2],
            [10.0, 1.0],
            [12.6, 0.3],
        ]
        .map(Point::from);
        let rows = course(&points).unwrap();
        assert_eq!(rows.len(), 129);
        for (found, expected) in rows[1].iter().zip([0.100_660_550_464, 0.002_621_644_379_5]) {
            assert!(
                (found - expected).abs() < 1e-9,
                "{found} instead of {expected}"
            );
        }
        assert!(course(&[points[0], points[0]]).is_none() && course(&points[..1]).is_none());
    }
}
