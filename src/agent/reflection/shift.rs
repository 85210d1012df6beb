//! How far a plan keeps from the middle of its lane to pass what stands at the edge.

use crate::environment::lane_graph::{MAX_SHIFT, STANDING, swing};
use planagent_world::geometry::{Corridor, Point, Polyline, Pose};
use planagent_world::{LanePath, PACIFICA, SceneView, TrackedObject};

/// Distance from what stands, meters.
/// Why: docs/decisions/111-shift.md.
const MARGIN: f64 = 0.3;
/// Time ahead in which objects matter, seconds: Reflection's horizon.
/// Why: docs/decisions/111-shift.md.
const REACH_S: f64 = 4.0;
/// Minimum distance ahead in which they do, meters: a slow ego needs it to move over.
const MIN_REACH: f64 = 20.0;
/// Length of lane before and behind an object that must have room, meters.
const AROUND: f64 = 3.0;
/// Distance between tested places and shifts, meters.
const STATION_STEP: f64 = 1.0;
/// Distance between tested shifts, meters.
const SHIFT_STEP: f64 = 0.05;
/// Steps of time in which agents beside the lane are followed, seconds.
const TIME_STEP: f64 = 0.5;

/// The place of an object in the frame of a centerline, meters; lateral positions are positive to
/// the left.
#[derive(Debug, Clone, Copy)]
struct Edge {
    from_s: f64,
    to_s: f64,
    /// The lateral position of its side that faces the line, nearer by what a corner of the ego
    /// swings out in a bend.
    lateral: f64,
    /// Whether it stands to the left.
    left: bool,
}

/// The lateral position of the path in its lane, meters, positive to the left: 0, or what leaves
/// [`MARGIN`] beside the objects that stand at one edge of the lane, as far as the lane has room.
/// Where the lane has too little, the ego may reach over its border, while nobody else needs that
/// place. 0 where the ego would touch the objects all the same.
pub(super) fn shift(scene: &SceneView<'_>, lanes: &LanePath) -> f64 {
    let half = PACIFICA.width / 2.0;
    let edges = edges(scene, lanes);
    let right = edges
        .iter()
        .filter(|edge| !edge.left)
        .map(|edge| edge.lateral + half + MARGIN);
    let left = edges
        .iter()
        .filter(|edge| edge.left)
        .map(|edge| edge.lateral - half - MARGIN);
    let (least, most) = (
        right.fold(f64::NEG_INFINITY, f64::max),
        left.fold(f64::INFINITY, f64::min),
    );
    // Between objects on both sides the path keeps the same distance from both.
    let wanted = if least > most {
        f64::midpoint(least, most)
    } else {
        0.0f64.clamp(least, most)
    };
    let steps = (wanted.abs() / SHIFT_STEP).ceil() as usize;
    let shifts = (1..=steps)
        .rev()
        .map(|step| wanted * step as f64 / steps as f64);
    let is_clear = |&shift: &f64| {
        edges.iter().all(|edge| {
            if edge.left {
                shift + half < edge.lateral
            } else {
                shift - half > edge.lateral
            }
        })
    };
    let in_lane = |point| {
        lanes
            .lanes
            .iter()
            .any(|&lane| scene.map[lane].polygon.contains(point))
    };
    let on_road = |point| scene.map.is_drivable(point);
    let within = shifts
        .clone()
        .find(|&shift| has_room(lanes, &edges, shift, in_lane))
        .filter(is_clear);
    let beyond = || {
        shifts
            .clone()
            .find(|&shift| has_room(lanes, &edges, shift, on_road))
            .filter(is_clear)
    };
    let is_free = |&shift: &f64| !is_needed(scene, lanes, &edges, shift);
    within.or_else(|| beyond().filter(is_free)).unwrap_or(0.0)
}

/// The objects that stand ahead within reach, without those under the ego.
fn edges(scene: &SceneView<'_>, lanes: &LanePath) -> Vec<Edge> {
    let here = lanes.centerline.project(scene.ego.rear_axle.position()).s;
    let reach = here + PACIFICA.front_length + (scene.ego.speed() * REACH_S).max(MIN_REACH);
    let footprint = scene.ego.footprint();
    let stands =
        |object: &&TrackedObject| object.speed() < STANDING && !object.shape.overlaps(&footprint);
    let near = scene.objects.iter().filter(stands).filter_map(|object| {
        let left = lanes
            .centerline
            .project(object.shape.center.position())
            .lateral
            > 0.0;
        let corners = object
            .shape
            .corners()
            .map(|corner| lanes.centerline.project(corner));
        let (along, across) = (
            corners.map(|corner| corner.s),
            corners.map(|corner| corner.lateral),
        );
        let least = |values: [f64; 4]| values.into_iter().fold(f64::INFINITY, f64::min);
        let most = |values: [f64; 4]| values.into_iter().fold(f64::NEG_INFINITY, f64::max);
        let (from_s, to_s) = (least(along), most(along));
        let swing = swing(&lanes.centerline, (from_s, to_s), left);
        let lateral = if left {
            least(across) - swing
        } else {
            most(across) + swing
        };
        (to_s > here && from_s < reach).then_some(Edge {
            from_s,
            to_s,
            lateral,
            left,
        })
    });
    let near: Vec<Edge> = near.collect();
    // What blocks the lane is followed, not passed, and hides what stands behind it.
    let first = near
        .iter()
        .filter(|edge| edge.blocks())
        .map(|edge| edge.from_s)
        .fold(f64::INFINITY, f64::min);
    near.into_iter()
        .filter(|edge| !edge.blocks() && edge.from_s < first)
        .collect()
}

impl Edge {
    /// Whether no shift leads past it.
    fn blocks(&self) -> bool {
        let inner = if self.left {
            -self.lateral
        } else {
            self.lateral
        };
        inner + PACIFICA.width / 2.0 > MAX_SHIFT
    }
}

/// Whether the outer side of the shifted ego stays `inside` beside every object that it is shifted
/// for.
fn has_room(lanes: &LanePath, edges: &[Edge], shift: f64, inside: impl Fn(Point) -> bool) -> bool {
    let outer = shift + shift.signum() * PACIFICA.width / 2.0;
    let is_near = |edge: &&Edge| {
        edge.left != (shift > 0.0) && edge.lateral.abs() < PACIFICA.width / 2.0 + MARGIN
    };
    edges.iter().filter(is_near).all(|edge| {
        let count = ((edge.to_s - edge.from_s + 2.0 * AROUND) / STATION_STEP).ceil() as usize;
        let stations = (0..=count).map(|i| edge.from_s - AROUND + i as f64 * STATION_STEP);
        let within = stations.filter(|s| (0.0..=lanes.centerline.length()).contains(s));
        within
            .into_iter()
            .all(|s| inside(lanes.centerline.frenet_to_map(s, outer)))
    })
}

/// Whether an agent of another lane comes into the way of the shifted ego within [`REACH_S`], at
/// its present velocity. An ego that is beside the objects already goes on.
fn is_needed(scene: &SceneView<'_>, lanes: &LanePath, edges: &[Edge], shift: f64) -> bool {
    let line = &lanes.centerline;
    let front = line.project(PACIFICA.front_of(scene.ego.rear_axle)).s;
    let first = edges
        .iter()
        .map(|edge| edge.from_s)
        .fold(f64::INFINITY, f64::min);
    let last = edges
        .iter()
        .map(|edge| edge.to_s)
        .fold(f64::NEG_INFINITY, f64::max);
    // Beside the objects there is no way back into the lane.
    if first <= front {
        return false;
    }
    let (from, to) = (front - PACIFICA.length(), last + AROUND);
    let stations =
        (0..=((to - from) / STATION_STEP).ceil() as usize).map(|i| from + i as f64 * STATION_STEP);
    let Ok(path) = Polyline::new(stations.map(|s| line.frenet_to_map(s, shift))) else {
        return true;
    };
    let corridor = Corridor::new(path, PACIFICA.width / 2.0 + MARGIN);
    let in_lane = |point: Point| {
        lanes
            .lanes
            .iter()
            .any(|&lane| scene.map[lane].polygon.contains(point))
    };
    let comes = |object: &TrackedObject| {
        let mut times = (0..=(REACH_S / TIME_STEP) as usize).map(|i| i as f64 * TIME_STEP);
        let center = object.shape.center;
        times.any(|t| {
            let pose = Pose::at(center.position() + object.velocity * t, center.heading);
            corridor.meets_box(&object.shape.moved_to(pose))
        })
    };
    let others = scene
        .objects
        .iter()
        .filter(|object| object.kind.is_agent() && object.speed() >= STANDING);
    others
        .filter(|object| !in_lane(object.shape.center.position()))
        .any(comes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use planagent_world::geometry::{OrientedBox, Pose, Vector};
    use planagent_world::{LaneId, ObjectKind, Scene, TrackToken};

    /// A car of 4.5 m by 2 m that stands at (`x`, `y`).
    fn car(x: f64, y: f64) -> TrackedObject {
        TrackedObject {
            token: TrackToken((x * 100.0 + y.abs()) as u32),
            kind: ObjectKind::Vehicle,
            shape: OrientedBox::new(Pose::new(x, y, 0.0), 4.5, 2.0),
            velocity: Vector::zeros(),
        }
    }

    /// The shift on a lane of 4 m to the east, with an ego of 10 m/s at its start.
    fn shift_past(objects: impl IntoIterator<Item = TrackedObject>) -> f64 {
        let lane = Scene::builder()
            .lane_width(4.0)
            .lane([[-20.0, 0.0], [200.0, 0.0]]);
        let scene = lane
            .ego([0.0, 0.0], 0.0, 10.0)
            .objects(objects)
            .build()
            .unwrap();
        let lanes = LanePath::from_lanes(&scene.map, vec![LaneId(0)]).unwrap();
        shift(&scene.view(), &lanes)
    }

    fn is(found: f64, wanted: f64) -> bool {
        (found - wanted).abs() < 1e-9
    }

    #[test]
    fn a_path_keeps_away_from_a_parked_car_as_far_as_the_lane_has_room() {
        let half = PACIFICA.width / 2.0;
        // The car's left side is 1.4 m to the right of the line; its own half width and 0.3 m need
        // a little more.
        assert!(is(shift_past([car(30.0, -2.4)]), half + MARGIN - 1.4));
        assert!(is(shift_past([car(30.0, 2.4)]), 1.4 - half - MARGIN));
        assert!(
            is(shift_past([car(30.0, -3.0)]), 0.0),
            "it is far enough away"
        );
        assert!(is(shift_past([car(-10.0, -2.4)]), 0.0), "it is behind");
        assert!(
            is(shift_past([car(90.0, -2.4)]), 0.0),
            "it is farther than 4 s"
        );
        let moving = TrackedObject {
            velocity: Vector::new(5.0, 0.0),
            ..car(30.0, -2.4)
        };
        assert!(is(shift_past([moving]), 0.0), "it moves");
        // The lane has 2 m beside the line: the ego may shift by 2 m less its half width.
        let tight = shift_past([car(30.0, -1.6)]);
        assert!(tight > 0.7 && tight <= 2.0 - half, "{tight}");
    }

    /// The same with a lane of 4 m against the ego's direction to the left.
    fn beside_oncoming_lane(ego_y: f64, objects: impl IntoIterator<Item = TrackedObject>) -> f64 {
        let road = Scene::builder()
            .lane_width(4.0)
            .lane([[-20.0, 0.0], [200.0, 0.0]])
            .lane([[200.0, 4.0], [-20.0, 4.0]]);
        let scene = road
            .ego([0.0, ego_y], 0.0, 10.0)
            .objects(objects)
            .build()
            .unwrap();
        let lanes = LanePath::from_lanes(&scene.map, vec![LaneId(0)]).unwrap();
        shift(&scene.view(), &lanes)
    }

    #[test]
    fn the_ego_reaches_over_the_border_of_a_lane_that_is_too_narrow_while_nobody_comes_there() {
        // The car's left side is 0.2 m to the right of the line; inside the lane the ego would
        // touch it.
        let wide = PACIFICA.width / 2.0 + MARGIN - 0.2;
        assert!(is(shift_past([car(30.0, -1.2)]), 0.0), "no road is there");
        assert!(is(beside_oncoming_lane(0.0, [car(30.0, -1.2)]), wide));
        let moving = |x: f64, y: f64, speed: f64| TrackedObject {
            velocity: Vector::new(speed, 0.0),
            ..car(x, y)
        };
        assert!(
            is(
                beside_oncoming_lane(0.0, [car(30.0, -1.2), moving(60.0, 3.0, -10.0)]),
                0.0
            ),
            "one comes"
        );
        assert!(
            is(
                beside_oncoming_lane(0.0, [car(30.0, -1.2), moving(-20.0, 3.0, 15.0)]),
                0.0
            ),
            "one overtakes"
        );
        assert!(
            is(
                beside_oncoming_lane(0.0, [car(30.0, -1.2), moving(-10.0, 3.0, -10.0)]),
                wide
            ),
            "one has passed"
        );
        assert!(
            is(
                beside_oncoming_lane(0.0, [car(30.0, -1.2), moving(25.0, 0.0, 8.0)]),
                wide
            ),
            "one drives before it"
        );
        assert!(
            is(
                beside_oncoming_lane(wide, [car(2.0, -1.2), moving(30.0, 3.0, -10.0)]),
                wide
            ),
            "it is beside it"
        );
    }

    #[test]
    fn what_blocks_the_lane_is_no_reason_to_shift() {
        assert!(is(shift_past([car(30.0, -0.5)]), 0.0));
        let half = PACIFICA.width / 2.0;
        assert!(
            is(
                shift_past([car(20.0, -2.4), car(30.0, 0.0)]),
                half + MARGIN - 1.4
            ),
            "the first is passed"
        );
        assert!(
            is(shift_past([car(30.0, -2.4), car(20.0, 0.0)]), 0.0),
            "the lane is blocked before"
        );
    }

    #[test]
    fn between_two_cars_the_path_keeps_the_same_distance_from_both() {
        assert!(
            is(shift_past([car(30.0, -2.2), car(34.0, 2.4)]), -0.1 + 0.2),
            "1.2 m to the right, 1.4 m to the left"
        );
    }
}
