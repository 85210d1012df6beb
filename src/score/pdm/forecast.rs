//! The forecast of all objects at constant speed and direction (`tuplan_garage`
//! `pdm_observation.py`, `pdm_object_manager.py`).

use crate::metrics::in_collision;
use planagent_world::geometry::{Bounds, OrientedBox, Point, Pose, Vector, wrap_angle};
use planagent_world::{
    EgoState, LaneId, LaneMap, ObjectKind, STEP_S, TrackToken, TrackedObject, TrafficLights,
};
use std::collections::BTreeSet;
use std::f64::consts::FRAC_PI_2;

/// Objects farther than this from the ego's center are ignored, meters.
pub const MAX_DISTANCE: f64 = 50.0;
/// Steps of 0.1 s that share one occupancy map: its resolution is 0.2 s.
pub(crate) const RESOLUTION_STEPS: usize = 2;

/// A slower vehicle or bicycle keeps its direction, m/s.
/// Why: docs/decisions/119-forecast-along-lanes.md.
const MIN_LANE_SPEED: f64 = 2.0;
/// Largest angle between an object's motion and the lane that it drives along, radians.
const MAX_LANE_ANGLE: f64 = 0.35;
/// Time over which the curvature of a lane is taken, seconds.
/// Why: docs/decisions/119-forecast-along-lanes.md.
const LANE_PREVIEW_S: f64 = 2.0;
/// Distance between the headings of a lane, meters.
const LANE_STEP: f64 = 2.0;
/// Largest curvature of a forecast, 1/m.
const MAX_LANE_CURVATURE: f64 = 0.2;
/// How many of the nearest objects of each kind are kept, in the order of the occupancy map.
const CAPS: [(Sort, usize); 4] = [
    (Sort::Static, 50),
    (Sort::Vehicle, 50),
    (Sort::Pedestrian, 25),
    (Sort::Bicycle, 10),
];

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Sort {
    Static,
    Vehicle,
    Pedestrian,
    Bicycle,
}

impl Sort {
    fn from_kind(kind: ObjectKind) -> Self {
        match kind {
            ObjectKind::Vehicle => Self::Vehicle,
            ObjectKind::Pedestrian => Self::Pedestrian,
            ObjectKind::Bicycle => Self::Bicycle,
            ObjectKind::TrafficCone
            | ObjectKind::Barrier
            | ObjectKind::CzoneSign
            | ObjectKind::GenericObject => Self::Static,
        }
    }
}

/// The objects that the ego has touched. They are ignored from then on, so this lives as long as
/// the planner.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Collided {
    /// Tracks.
    pub tracks: BTreeSet<TrackToken>,
    /// Connectors behind whose red light the ego already stood when it was first seen.
    pub red_lights: BTreeSet<LaneId>,
}

/// An object that keeps its speed, and its direction or the curvature of its lane.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ForecastObject {
    /// The object now.
    pub track: TrackedObject,
    /// Forecast velocity in the map frame, m/s: along the axis of the box; zero for static objects.
    pub velocity: Vector,
    /// Curvature of its way, to the left of the velocity, 1/m; zero in PDM-Closed's forecast.
    pub(super) curvature: f64,
    /// Acceleration along its way until it stands, m/s²; zero in PDM-Closed's forecast.
    acceleration: f64,
    /// Half the diagonal of the box, meters.
    pub(super) radius: f64,
}

impl ForecastObject {
    fn new(track: &TrackedObject) -> Self {
        let speed = if track.kind.is_agent() {
            track.speed()
        } else {
            0.0
        };
        let heading = track.shape.center.heading;
        let backwards =
            wrap_angle(heading - track.velocity.y.atan2(track.velocity.x)).abs() >= FRAC_PI_2;
        let along = track.shape.center.direction() * speed;
        let velocity = if backwards { -along } else { along };
        Self {
            track: *track,
            velocity,
            curvature: 0.0,
            acceleration: 0.0,
            radius: track.shape.diagonal() / 2.0,
        }
    }

    /// Seconds at its present speed that lead as far as it drives in a number of steps of 0.1 s, at
    /// the forecast's resolution: odd steps show the even step before.
    #[inline]
    fn seconds(&self, step: usize) -> f64 {
        let time = (step / RESOLUTION_STEPS * RESOLUTION_STEPS) as f64 * STEP_S;
        if self.acceleration == 0.0 {
            return time;
        }
        let speed = self.velocity.norm();
        let stands_s = if self.acceleration < 0.0 {
            speed / -self.acceleration
        } else {
            f64::INFINITY
        };
        let drives_s = time.min(stands_s);
        drives_s + self.acceleration * drives_s.powi(2) / (2.0 * speed)
    }

    /// The angle by which the way has turned after a number of steps, radians.
    #[inline]
    fn turned(&self, step: usize) -> f64 {
        if self.curvature == 0.0 {
            0.0
        } else {
            self.curvature * self.velocity.norm() * self.seconds(step)
        }
    }

    /// The center after a number of steps of 0.1 s.
    #[inline]
    pub(super) fn center_at(&self, step: usize) -> Point {
        let moved = self.velocity * self.seconds(step);
        let half = self.turned(step) / 2.0;
        if half == 0.0 {
            return self.track.shape.center.position() + moved;
        }
        // The chord of the arc.
        let (sin, cos) = half.sin_cos();
        let chord = moved * (sin / half);
        self.track.shape.center.position()
            + Vector::new(chord.x * cos - chord.y * sin, chord.x * sin + chord.y * cos)
    }

    /// Bounds of the centers between two steps.
    pub(super) fn bounds_between(&self, first: usize, last: usize) -> Bounds {
        let ends = [self.center_at(first), self.center_at(last)];
        if self.curvature == 0.0 {
            return Bounds::around(&ends);
        }
        // An arc keeps within half its length of the middle of its chord.
        let half_length = self.velocity.norm() * (self.seconds(last) - self.seconds(first)) / 2.0;
        Bounds::square(
            Point::from((ends[0].coords + ends[1].coords) / 2.0),
            half_length,
        )
    }

    /// The box after a number of steps of 0.1 s.
    pub fn shape_at(&self, step: usize) -> OrientedBox {
        let heading = wrap_angle(self.track.shape.center.heading + self.turned(step));
        self.track
            .shape
            .moved_to(Pose::at(self.center_at(step), heading))
    }

    /// The object after a number of steps; its velocity is the observed one.
    pub(crate) fn track_at(&self, step: usize) -> TrackedObject {
        TrackedObject {
            shape: self.shape_at(step),
            ..self.track
        }
    }
}

/// The forecast of one instant.
#[derive(Debug, Clone, PartialEq)]
pub struct Forecast {
    objects: Vec<ForecastObject>,
    red_lights: Vec<LaneId>,
}

impl Forecast {
    /// Forecasts the near objects: at most 50 static objects, 50 vehicles, 25 pedestrians and 10
    /// bicycles, the nearest ones within [`MAX_DISTANCE`], and the connectors of the route that
    /// show red. What the ego touches now is added to `collided` and left out from now on.
    pub fn new(
        map: &LaneMap,
        route_lanes: &BTreeSet<LaneId>,
        ego: &EgoState,
        objects: &[TrackedObject],
        lights: &TrafficLights,
        collided: &mut Collided,
    ) -> Self {
        let footprint = ego.footprint();
        let center = footprint.center.position();
        let mut kept: Vec<ForecastObject> = Vec::new();
        for (sort, cap) in CAPS {
            let seen = objects
                .iter()
                .filter(|o| Sort::from_kind(o.kind) == sort && !collided.tracks.contains(&o.token));
            kept.extend(
                nearest(seen, center, cap)
                    .into_iter()
                    .map(ForecastObject::new),
            );
        }
        // After the caps, as upstream: what the ego touches has taken the place of a farther
        // object.
        let touched = kept
            .iter()
            .map(|o| o.track)
            .filter(|o| in_collision(&footprint, &o.shape));
        collided.tracks.extend(touched.map(|o| o.token));
        kept.retain(|o| !collided.tracks.contains(&o.track.token));

        let mut red_lights: Vec<LaneId> =
            lights.red().filter(|id| route_lanes.contains(id)).collect();
        collided.red_lights.extend(
            red_lights
                .iter()
                .filter(|&&id| map[id].polygon.holds_box(&footprint)),
        );
        red_lights.retain(|id| !collided.red_lights.contains(id));
        Self {
            objects: kept,
            red_lights,
        }
    }

    /// The same, but vehicles and bicycles that drive along a lane keep its curvature.
    #[must_use]
    pub fn along_lanes(mut self, map: &LaneMap) -> Self {
        for object in &mut self.objects {
            object.curvature = lane_curvature(map, object).unwrap_or(0.0);
        }
        self
    }

    /// The same, but moving vehicles and bicycles that `which` selects accelerate along their way,
    /// m/s²; those that brake stop.
    #[must_use]
    pub fn accelerated(
        mut self,
        acceleration: f64,
        which: impl Fn(&ForecastObject) -> bool,
    ) -> Self {
        for object in &mut self.objects {
            let drives = matches!(object.track.kind, ObjectKind::Vehicle | ObjectKind::Bicycle)
                && object.velocity != Vector::zeros();
            if drives && which(object) {
                object.acceleration = acceleration;
            }
        }
        self
    }

    /// The objects: static ones, vehicles, pedestrians, bicycles, each kind by distance.
    pub fn objects(&self) -> &[ForecastObject] {
        &self.objects
    }

    /// Connectors of the route that show red; their polygons block the path for the whole forecast.
    /// The scorer ignores them.
    pub fn red_lights(&self) -> &[LaneId] {
        &self.red_lights
    }
}

/// The mean curvature of the lane that an object drives along, over the next [`LANE_PREVIEW_S`].
fn lane_curvature(map: &LaneMap, object: &ForecastObject) -> Option<f64> {
    let speed = object.velocity.norm();
    if speed < MIN_LANE_SPEED
        || !matches!(object.track.kind, ObjectKind::Vehicle | ObjectKind::Bicycle)
    {
        return None;
    }
    let (center, heading) = (
        object.track.shape.center,
        object.velocity.y.atan2(object.velocity.x),
    );
    let along = |id: LaneId| {
        let s = map[id].centerline.project(center.position()).s;
        let off = wrap_angle(heading - map[id].centerline.smooth_pose_at(s).heading).abs();
        (off <= MAX_LANE_ANGLE).then_some((id, s, off))
    };
    let lanes = map.lanes_at(center.position());
    let (mut lane, from, _) = lanes
        .into_iter()
        .filter_map(along)
        .min_by(|a, b| a.2.total_cmp(&b.2))?;
    let start = map[lane].centerline.smooth_pose_at(from).heading;
    let (mut s, mut left, mut driven, mut turned, mut last) =
        (from, speed * LANE_PREVIEW_S, 0.0, 0.0, start);
    loop {
        let centerline = &map[lane].centerline;
        // Headings between are followed, so that more than half a turn counts as such.
        while left > 0.0 && s < centerline.length() {
            let step = LANE_STEP.min(left).min(centerline.length() - s);
            (s, left, driven) = (s + step, left - step, driven + step);
            let heading = centerline.smooth_pose_at(s).heading;
            (turned, last) = (turned + wrap_angle(heading - last), heading);
        }
        let [next] = map[lane].outgoing[..] else {
            break;
        };
        if left <= 0.0 {
            break;
        }
        (lane, s) = (next, 0.0);
    }
    (driven > LANE_STEP).then(|| (turned / driven).clamp(-MAX_LANE_CURVATURE, MAX_LANE_CURVATURE))
}

/// The nearest objects within reach, by distance; equal distances keep their order.
fn nearest<'a>(
    objects: impl Iterator<Item = &'a TrackedObject>,
    center: Point,
    cap: usize,
) -> Vec<&'a TrackedObject> {
    let distance = |o: &TrackedObject| (o.shape.center.position() - center).norm();
    let mut near: Vec<(f64, &TrackedObject)> = objects
        .map(|o| (distance(o), o))
        .filter(|&(d, _)| d <= MAX_DISTANCE)
        .collect();
    near.sort_by(|a, b| a.0.total_cmp(&b.0));
    near.truncate(cap);
    near.into_iter().map(|(_, o)| o).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bounds_hold_the_way_between_odd_steps_too() {
        let pose = Pose::new(0.0, 0.0, 0.0);
        let track = TrackedObject {
            token: TrackToken(1),
            kind: ObjectKind::Vehicle,
            shape: OrientedBox::new(pose, 4.0, 2.0),
            velocity: Vector::new(10.0, 0.0),
        };
        for (curvature, acceleration) in [
            (0.0, 0.0),
            (0.001, 0.0),
            (0.1, 0.0),
            (0.1, -9.0),
            (0.1, 2.0),
        ] {
            let object = ForecastObject {
                curvature,
                acceleration,
                ..ForecastObject::new(&track)
            };
            for first in 0..12 {
                let bounds = object.bounds_between(first, first + 9).grown(1e-9);
                for step in first..=first + 9 {
                    assert!(
                        bounds.contains(object.center_at(step)),
                        "{curvature} {acceleration}: {first} {step}"
                    );
                }
            }
        }
    }
}
