//! The path of a plan: from the ego's pose smoothly onto the followed centerline.

use planagent_world::EgoState;
use planagent_world::geometry::{GeometryError, Point, Polyline, Pose, wrap_angle};

/// Time in which a lateral offset of one lane width decays, seconds; a smaller offset decays in
/// proportionally less.
const LANE_CHANGE_S: f64 = 3.5;
/// Time in which the smallest offset decays, seconds.
const SETTLE_S: f64 = 1.2;
/// A typical lane width, meters.
const LANE_WIDTH: f64 = 3.5;
/// Minimum length of the decay, meters, so that a slow ego does not have to turn on the spot.
const MIN_DECAY: f64 = 8.0;
/// The same for a large offset, as a multiple of it. A whole lane in 8 m is a curve of 3 m radius,
/// which the tracker cannot follow.
const MIN_DECAY_OF_OFFSET: f64 = 3.5;
/// Maximum curvature that the decay of a slope may need, 1/m: that of one lane's offset in the
/// shortest decay.
/// Why: docs/decisions/118-path-of-a-turned-ego.md.
const MAX_CURVATURE: f64 = OFFSET_BEND / (MIN_DECAY_OF_OFFSET * MIN_DECAY_OF_OFFSET * LANE_WIDTH);
/// Largest |d''|·L²/d(0) of the quintic of an offset, and largest |d''|·L/d'(0) of that of a slope.
const OFFSET_BEND: f64 = 5.77;
const SLOPE_BEND: f64 = 3.94;
/// Lateral acceleration that a path accepts to end its decay where an earlier path does, m/s².
/// Why: docs/decisions/124-lane-changes-go-on.md.
const MAX_LATERAL_ACCEL: f64 = 2.5;
/// Lateral accelerations of lane changes past what stands near, the gentlest first, m/s²: within
/// nuPlan's bound of comfort.
/// Why: docs/decisions/148-swerve-or-wait.md.
pub(super) const SWERVES: [f64; 4] = [2.5, 3.0, 3.5, 4.0];
/// Distance between the vertices of the path, meters.
const SPACING: f64 = 1.0;
/// Maximum slope (tangent of the heading error) at the start of the path: beyond it the ego does
/// not follow the lane.
const MAX_SLOPE: f64 = 0.7;

/// How quickly a path comes onto its line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Pace {
    /// As a lane change in free traffic.
    Usual,
    /// With this lateral acceleration, m/s².
    Swerve(f64),
}

/// A path onto a centerline.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Approach {
    /// The path of the rear axle.
    pub(super) path: Polyline,
    /// Where it has come onto the line.
    pub(super) settled: Point,
}

/// The path of the rear axle from the ego's present pose to `beside` meters to the left of
/// `centerline`, then along it for `length` meters.
///
/// In the centerline's frame the distance d(s) from that line is a quintic. It starts with the
/// ego's distance and slope and without curvature, and has d = d' = d'' = 0 at the end of the
/// decay. A plan after another one for the same lane is on the line where that one is (`settled`),
/// as far as comfort allows: otherwise each planning call would put the end of a lane change off.
///
/// # Errors
/// When the ego's pose is not finite.
pub(super) fn onto_centerline(
    ego: &EgoState,
    centerline: &Polyline,
    (beside, length): (f64, f64),
    (settled, pace): (Option<Point>, Pace),
) -> Result<Approach, GeometryError> {
    let rear = ego.rear_axle;
    let foot = centerline.project(rear.position());
    let offset = foot.lateral - beside;
    let slope = wrap_angle(rear.heading - centerline.smooth_pose_at(foot.s).heading)
        .tan()
        .clamp(-MAX_SLOPE, MAX_SLOPE);
    let seconds = SETTLE_S + (LANE_CHANGE_S - SETTLE_S) * (offset.abs() / LANE_WIDTH).min(1.0);
    let shortest = MIN_DECAY
        .max(MIN_DECAY_OF_OFFSET * offset.abs())
        .max(decay_of_slope(offset, slope));
    let at_lateral =
        |accel: f64| ego.speed() * SETTLE_S.max((OFFSET_BEND * offset.abs() / accel).sqrt());
    let (usual, quickest) = match pace {
        Pace::Usual => (ego.speed() * seconds, at_lateral(MAX_LATERAL_ACCEL)),
        Pace::Swerve(accel) => (at_lateral(accel), at_lateral(accel)),
    };
    let usual = usual.max(shortest);
    let decay = settled.map_or(usual, |settled| {
        let rest = centerline.project(settled).s - foot.s;
        usual.min(rest.max(quickest).max(shortest))
    });
    let settled = centerline.point_at(foot.s + decay);
    let lateral = quintic(offset, slope, decay);
    let end = (foot.s + length).min(centerline.length());
    let count = ((end - foot.s) / SPACING).ceil().max(1.0) as usize;
    let points = (1..=count).map(|i| {
        let s = (foot.s + i as f64 * SPACING).min(end);
        centerline
            .smooth_pose_at(s)
            .to_map(Point::new(0.0, beside + lateral(s - foot.s)))
    });
    let path = Polyline::new(std::iter::once(rear.position()).chain(points));
    // An ego at the very end of its centerline continues straight ahead.
    Ok(Approach {
        path: path.or_else(|_| straight_ahead(rear, length))?,
        settled,
    })
}

/// A straight line from a pose.
fn straight_ahead(from: Pose, length: f64) -> Result<Polyline, GeometryError> {
    Polyline::new([
        from.position(),
        from.translated(length.max(SPACING), 0.0).position(),
    ])
}

/// The shortest decay of a slope that needs no more than [`MAX_CURVATURE`]. A slope away from the
/// line bends the path as its offset does, and their curvatures add up.
fn decay_of_slope(offset: f64, slope: f64) -> f64 {
    let bend = SLOPE_BEND * slope.abs();
    let offset_bend = if offset * slope > 0.0 {
        OFFSET_BEND * offset.abs()
    } else {
        0.0
    };
    (bend + (bend * bend + 4.0 * MAX_CURVATURE * offset_bend).sqrt()) / (2.0 * MAX_CURVATURE)
}

/// d(s) with d(0) = offset, d'(0) = slope, d''(0) = 0 and d = d' = d'' = 0 at `length`; 0 beyond.
fn quintic(offset: f64, slope: f64, length: f64) -> impl Fn(f64) -> f64 {
    let slope = slope * length;
    move |s: f64| {
        let u = s / length;
        if u >= 1.0 {
            return 0.0;
        }
        let u3 = u * u * u;
        offset * (1.0 - 10.0 * u3 + 15.0 * u3 * u - 6.0 * u3 * u * u)
            + slope * (u - 6.0 * u3 + 8.0 * u3 * u - 3.0 * u3 * u * u)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use planagent_world::geometry::Vector;

    fn ego(x: f64, y: f64, heading: f64, speed: f64) -> EgoState {
        EgoState::from_log(
            0,
            Pose::new(x, y, heading),
            Vector::new(speed, 0.0),
            Vector::zeros(),
        )
    }

    fn road() -> Polyline {
        Polyline::new((0..=300).map(|i| Point::new(f64::from(i), 0.0))).unwrap()
    }

    fn path(ego: &EgoState, beside: f64, length: f64) -> Polyline {
        onto_centerline(ego, &road(), (beside, length), (None, Pace::Usual))
            .unwrap()
            .path
    }

    #[test]
    fn a_lane_change_that_is_planned_again_ends_where_it_would_have_ended() {
        let speed = 10.0;
        let first = onto_centerline(
            &ego(0.0, 3.5, 0.0, speed),
            &road(),
            (0.0, 100.0),
            (None, Pace::Usual),
        )
        .unwrap();
        let replanned = |settles: bool| {
            let (mut approach, mut x) = (first.clone(), 0.0);
            for _ in 0..6 {
                x += 0.5 * speed;
                let pose = approach
                    .path
                    .pose_at(approach.path.project(Point::new(x, 0.0)).s);
                let settled = settles.then_some(approach.settled);
                approach = onto_centerline(
                    &ego(pose.x, pose.y, pose.heading, speed),
                    &road(),
                    (0.0, 100.0),
                    (settled, Pace::Usual),
                )
                .unwrap();
            }
            approach.settled.x
        };
        assert!((first.settled.x - 35.0).abs() < 1.0, "{}", first.settled.x);
        assert!(
            replanned(false) > first.settled.x + 5.0,
            "{}",
            replanned(false)
        );
        assert!(
            replanned(true) < first.settled.x + 8.0 && replanned(true) < replanned(false),
            "{}",
            replanned(true)
        );
    }

    #[test]
    fn starts_at_the_ego_and_ends_on_the_centerline() {
        let path = path(&ego(10.0, -3.5, 0.05, 10.0), 0.0, 100.0);
        assert!((path.start() - Point::new(10.0, -3.5)).norm() < 1e-12);
        assert!((path.heading_at(0.0) - 0.05).abs() < 0.02);
        assert!(path.project(Point::new(60.0, 0.0)).distance < 1e-9);
        assert!((path.end().x - 110.0).abs() < 1.0);
    }

    #[test]
    fn a_path_beside_the_centerline_stays_beside_it() {
        let path = path(&ego(10.0, 0.0, 0.0, 10.0), 1.0, 100.0);
        assert!((path.start() - Point::new(10.0, 0.0)).norm() < 1e-12);
        assert!(
            (path.project(Point::new(60.0, 0.0)).distance - 1.0).abs() < 1e-9 && path.end().y > 0.9
        );
    }

    #[test]
    fn the_offset_decays_without_overshoot_from_parallel() {
        let path = path(&ego(0.0, 3.5, 0.0, 8.0), 0.0, 80.0);
        assert!(
            path.vertices()
                .windows(2)
                .all(|w| w[1].y <= w[0].y + 1e-9 && w[1].y >= -1e-9)
        );
    }

    #[test]
    fn a_lane_change_stays_within_comfortable_curvature() {
        let speed = 10.0;
        let path = path(&ego(0.0, 3.5, 0.0, speed), 0.0, 80.0);
        let lateral_accel = (0..60)
            .map(|i| path.curvature_at(f64::from(i)).abs() * speed * speed)
            .fold(0.0, f64::max);
        assert!(lateral_accel < 2.5, "{lateral_accel}");
    }

    #[test]
    fn a_slow_ego_that_drives_away_from_the_line_turns_no_sharper_than_in_a_lane_change() {
        let sharpest = |heading: f64, y: f64| {
            let path = path(&ego(0.0, y, heading, 3.2), 0.0, 80.0);
            (0..80)
                .map(|i| path.curvature_at(f64::from(i) * 0.5).abs())
                .fold(0.0, f64::max)
        };
        let lane_change = sharpest(0.0, -3.5);
        for (heading, y) in [
            (-0.45, -3.5),
            (-0.45, -1.0),
            (0.45, 3.5),
            (0.45, -1.0),
            (-0.6, 0.0),
        ] {
            let turn = sharpest(heading, y);
            assert!(
                turn < 1.3 * lane_change,
                "{heading} {y}: {turn} of {lane_change}"
            );
        }
    }

    #[test]
    fn the_end_of_the_road_is_not_the_end_of_the_path() {
        let path = path(&ego(300.0, 0.0, 0.0, 10.0), 0.0, 50.0);
        assert!(path.length() >= 1.0);
    }
}
