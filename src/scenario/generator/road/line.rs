//! Reference lines of roads and the curves that connect lanes across a junction.

use planagent_world::geometry::{Point, Pose, wrap_angle};

/// Maximum turn between two samples of a line, radians. Chords stay within 0.01 rad of the tangent.
const TURN_PER_SAMPLE: f64 = 0.02;
/// Maximum distance between two samples of a straight line, meters.
const SAMPLE_SPACING: f64 = 10.0;
/// Maximum distance between two samples of a bend, meters.
const BEND_SPACING: f64 = 2.0;
/// Step of the integration along a line, meters.
const INTEGRATION_STEP: f64 = 0.25;
/// Length over which the curvature of a road builds up, meters.
const RAMP: f64 = 18.0;

/// A piece of a line with linear curvature: a clothoid, or an arc or straight line if both ends are
/// equal.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Piece {
    /// Meters.
    pub(crate) length: f64,
    /// Curvature at its start, 1/m, positive to the left.
    pub(crate) from: f64,
    /// Curvature at its end, 1/m.
    pub(crate) to: f64,
}

pub(crate) fn straight(length: f64) -> Vec<Piece> {
    vec![Piece {
        length,
        from: 0.0,
        to: 0.0,
    }]
}

/// A bend between two straight pieces, with clothoid ramps; straight if there is no room for it.
pub(crate) fn bend(lead: f64, length: f64, curvature: f64, tail: f64) -> Vec<Piece> {
    if length <= 2.0 * RAMP || curvature == 0.0 {
        return straight(lead + length + tail);
    }
    let parts = [
        (lead, 0.0, 0.0),
        (RAMP, 0.0, curvature),
        (length - 2.0 * RAMP, curvature, curvature),
        (RAMP, curvature, 0.0),
        (tail, 0.0, 0.0),
    ];
    parts
        .into_iter()
        .filter(|p| p.0 > 0.0)
        .map(|(length, from, to)| Piece { length, from, to })
        .collect()
}

/// Samples of the line from `start` through the pieces, with exact tangents.
pub(crate) fn trace(start: Pose, pieces: &[Piece]) -> Vec<Pose> {
    let mut line = vec![start];
    let mut pose = start;
    let (mut since, mut turned) = (0.0, 0.0f64);
    for piece in pieces {
        let steps = (piece.length / INTEGRATION_STEP).ceil().max(1.0) as usize;
        let step = piece.length / steps as f64;
        for i in 0..steps {
            let share = (i as f64 + 0.5) / steps as f64;
            let turn = (piece.from + (piece.to - piece.from) * share) * step;
            let spacing = if turned + turn == 0.0 {
                SAMPLE_SPACING
            } else {
                BEND_SPACING
            };
            // Samples are spaced by turn as well as by length: a vertex that bends too much would
            // show as a corner.
            if since > 0.0
                && (since + step > spacing + 1e-9 || (turned + turn).abs() > TURN_PER_SAMPLE)
            {
                line.push(pose);
                (since, turned) = (0.0, 0.0);
            }
            let middle = pose.heading + turn / 2.0;
            pose = Pose::new(
                pose.x + step * middle.cos(),
                pose.y + step * middle.sin(),
                wrap_angle(pose.heading + turn),
            );
            since += step;
            turned += turn;
        }
    }
    if since > 0.0 {
        line.push(pose);
    }
    line
}

/// The line moved sideways by `lateral` meters (positive to the left), exact at every sample.
pub(crate) fn shifted(line: &[Pose], lateral: f64) -> Vec<Point> {
    line.iter()
        .map(|pose| pose.to_map(Point::new(0.0, lateral)))
        .collect()
}

/// The arc from `start` with this radius (positive: to the left) through `angle` radians.
pub(crate) fn arc(start: Pose, radius: f64, angle: f64) -> Vec<Pose> {
    let count = (angle.abs() / TURN_PER_SAMPLE).ceil().max(1.0) as usize;
    let center = start.to_map(Point::new(0.0, radius));
    (0..=count)
        .map(|i| {
            let heading = start.heading + angle * radius.signum() * i as f64 / count as f64;
            Pose::at(
                Pose::at(center, heading).to_map(Point::new(0.0, -radius)),
                wrap_angle(heading),
            )
        })
        .collect()
}

/// A smooth line between two poses without curvature at its ends: a quintic Bézier curve. Its inner
/// control points lie on the two tangents, at two and four fifths of the distance to their
/// intersection.
pub(crate) fn connection(from: Pose, to: Pose) -> Vec<Pose> {
    /// Share of the leg between neighboring control points.
    const SHARE: f64 = 0.4;
    let chord = to.position() - from.position();
    let (u, w) = (from.direction(), to.direction());
    let cross = u.perp(&w);
    let (leg_in, leg_out) = if cross.abs() > 0.2 {
        (chord.perp(&w) / cross, chord.perp(&u) / cross)
    } else {
        (chord.norm() / 2.0, chord.norm() / 2.0)
    };
    // Tangents that do not meet ahead of both ends give an S-shaped line over half the chord each.
    let (leg_in, leg_out) = if leg_in > 0.5 && leg_out > 0.5 {
        (leg_in, leg_out)
    } else {
        (chord.norm() / 2.0, chord.norm() / 2.0)
    };
    let (a, b) = (SHARE * leg_in, SHARE * leg_out);
    let control = [
        from.position(),
        from.position() + u * a,
        from.position() + u * (2.0 * a),
        to.position() - w * (2.0 * b),
        to.position() - w * b,
        to.position(),
    ];
    let turn = wrap_angle(to.heading - from.heading).abs();
    // The maximum curvature, in the middle, is about twice the mean.
    let count = ((2.0 * turn / TURN_PER_SAMPLE)
        .max(chord.norm() / 2.0)
        .ceil() as usize)
        .clamp(4, 160);
    (0..=count)
        .map(|i| {
            let t = i as f64 / count as f64;
            let (point, tangent) = quintic(&control, t);
            let heading = if i == 0 {
                from.heading
            } else if i == count {
                to.heading
            } else {
                tangent.y.atan2(tangent.x)
            };
            Pose::at(point, heading)
        })
        .collect()
}

/// Point and tangent of a quintic Bézier curve.
fn quintic(control: &[Point; 6], t: f64) -> (Point, nalgebra::Vector2<f64>) {
    let r = 1.0 - t;
    let position = [
        r.powi(5),
        5.0 * t * r.powi(4),
        10.0 * t.powi(2) * r.powi(3),
        10.0 * t.powi(3) * r.powi(2),
        5.0 * t.powi(4) * r,
        t.powi(5),
    ];
    let slope = [
        r.powi(4),
        4.0 * t * r.powi(3),
        6.0 * t.powi(2) * r.powi(2),
        4.0 * t.powi(3) * r,
        t.powi(4),
    ];
    let point = control
        .iter()
        .zip(position)
        .map(|(c, k)| c.coords * k)
        .sum::<nalgebra::Vector2<f64>>();
    let tangent = control
        .windows(2)
        .zip(slope)
        .map(|(w, k)| (w[1] - w[0]) * (5.0 * k))
        .sum();
    (Point::from(point), tangent)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::FRAC_PI_2;

    #[test]
    fn a_bend_turns_by_its_curvature_and_starts_where_it_should() {
        let line = trace(Pose::default(), &bend(30.0, 100.0, 0.01, 30.0));
        let end = line[line.len() - 1];
        // Two ramps of 18 m count half: (64 + 18) m of full curvature.
        assert!((end.heading - 0.82).abs() < 1e-9);
        let chords: Vec<f64> = line
            .windows(2)
            .map(|w| wrap_angle((w[1].y - w[0].y).atan2(w[1].x - w[0].x) - w[0].heading).abs())
            .collect();
        assert!(chords.iter().all(|&c| c < 0.012));
    }

    #[test]
    fn a_connection_meets_both_poses_and_cuts_the_corner() {
        let line = connection(Pose::default(), Pose::new(12.0, 12.0, FRAC_PI_2));
        assert!(line[0].distance(&Pose::default()) < 1e-12);
        assert!(line[line.len() - 1].distance(&Pose::new(12.0, 12.0, 0.0)) < 1e-9);
        assert!(
            line.windows(2)
                .all(|w| wrap_angle(w[1].heading - w[0].heading).abs() < 0.05)
        );
        let across = connection(Pose::default(), Pose::new(20.0, 3.0, 0.0));
        assert!(across.iter().all(|p| p.y > -1e-9 && p.y < 3.0 + 1e-9));
    }

    #[test]
    fn an_arc_ends_on_its_circle() {
        let quarter = arc(Pose::default(), 10.0, FRAC_PI_2);
        assert!(quarter[quarter.len() - 1].distance(&Pose::new(10.0, 10.0, 0.0)) < 1e-9);
        let right = arc(Pose::default(), -10.0, FRAC_PI_2);
        assert!(right[right.len() - 1].distance(&Pose::new(10.0, -10.0, 0.0)) < 1e-9);
    }
}
