//! The forecast of all objects at constant speed and direction (`tuplan_garage` `pdm_observation.py`,
//! `pdm_object_manager.py`).

use crate::geometry::{OrientedBox, Point, Pose, Vector, wrap_angle};
use crate::metrics::in_collision;
use crate::world::{EgoState, LaneId, LaneMap, ObjectKind, STEP_S, TrackToken, TrackedObject, TrafficLights};
use std::collections::BTreeSet;
use std::f64::consts::FRAC_PI_2;

/// Objects farther than this from the ego's center are ignored, meters.
pub const MAX_DISTANCE: f64 = 50.0;
/// Steps of 0.1 s that share one occupancy map: its resolution is 0.2 s.
pub const RESOLUTION_STEPS: usize = 2;

/// How many of the nearest objects of each kind are kept, in the order of the occupancy map.
const CAPS: [(Sort, usize); 4] = [(Sort::Static, 50), (Sort::Vehicle, 50), (Sort::Pedestrian, 25), (Sort::Bicycle, 10)];

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Sort {
    Static,
    Vehicle,
    Pedestrian,
    Bicycle,
}

impl Sort {
    fn of(kind: ObjectKind) -> Self {
        match kind {
            ObjectKind::Vehicle => Self::Vehicle,
            ObjectKind::Pedestrian => Self::Pedestrian,
            ObjectKind::Bicycle => Self::Bicycle,
            ObjectKind::TrafficCone | ObjectKind::Barrier | ObjectKind::CzoneSign | ObjectKind::GenericObject => {
                Self::Static
            }
        }
    }
}

/// The objects that the ego has touched. They are ignored from then on, so this lives as long as the planner.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Collided {
    /// Tracks.
    pub tracks: BTreeSet<TrackToken>,
    /// Connectors behind whose red light the ego already stood when it was first seen.
    pub red_lights: BTreeSet<LaneId>,
}

/// An object that keeps its speed and direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ForecastObject {
    /// The object now.
    pub track: TrackedObject,
    /// Forecast velocity in the map frame, m/s: along the axis of the box; zero for static objects.
    pub velocity: Vector,
    /// Half the diagonal of the box, meters.
    pub(super) radius: f64,
}

impl ForecastObject {
    fn new(track: &TrackedObject) -> Self {
        let speed = if track.kind.is_agent() { track.speed() } else { 0.0 };
        let heading = track.shape.center.heading;
        let backwards = wrap_angle(heading - track.velocity.y.atan2(track.velocity.x)).abs() >= FRAC_PI_2;
        let along = track.shape.center.direction() * speed;
        Self { track: *track, velocity: if backwards { -along } else { along }, radius: track.shape.diagonal() / 2.0 }
    }

    /// The center after a number of steps of 0.1 s, at the forecast's resolution: odd steps show the even step before.
    #[inline]
    pub(super) fn center_at(&self, step: usize) -> Point {
        let seconds = (step / RESOLUTION_STEPS * RESOLUTION_STEPS) as f64 * STEP_S;
        self.track.shape.center.position() + self.velocity * seconds
    }

    /// The box after a number of steps of 0.1 s, at the forecast's resolution: odd steps show the even step before.
    pub fn shape_at(&self, step: usize) -> OrientedBox {
        self.track.shape.moved_to(Pose::at(self.center_at(step), self.track.shape.center.heading))
    }

    /// The object after a number of steps; its velocity is the observed one.
    pub fn track_at(&self, step: usize) -> TrackedObject {
        TrackedObject { shape: self.shape_at(step), ..self.track }
    }
}

/// The forecast of one instant.
#[derive(Debug, Clone, PartialEq)]
pub struct Forecast {
    objects: Vec<ForecastObject>,
    red_lights: Vec<LaneId>,
}

impl Forecast {
    /// Forecasts the near objects: at most 50 static objects, 50 vehicles, 25 pedestrians and 10 bicycles, the nearest ones
    /// within [`MAX_DISTANCE`], and the connectors of the route that show red. What the ego touches now is added to
    /// `collided` and left out from now on.
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
            let seen = objects.iter().filter(|o| Sort::of(o.kind) == sort && !collided.tracks.contains(&o.token));
            kept.extend(nearest(seen, center, cap).into_iter().map(ForecastObject::new));
        }
        let touched = kept.iter().map(|o| o.track).filter(|o| in_collision(&footprint, &o.shape));
        collided.tracks.extend(touched.map(|o| o.token));
        kept.retain(|o| !collided.tracks.contains(&o.track.token));

        let mut red_lights: Vec<LaneId> = lights.red().filter(|id| route_lanes.contains(id)).collect();
        collided.red_lights.extend(red_lights.iter().filter(|&&id| map[id].polygon.holds_box(&footprint)));
        red_lights.retain(|id| !collided.red_lights.contains(id));
        Self { objects: kept, red_lights }
    }

    /// The objects: static ones, vehicles, pedestrians, bicycles, each kind by distance.
    pub fn objects(&self) -> &[ForecastObject] {
        &self.objects
    }

    /// Connectors of the route that show red; their polygons block the path for the whole forecast. The scorer
    /// ignores them.
    pub fn red_lights(&self) -> &[LaneId] {
        &self.red_lights
    }
}

/// The nearest objects within reach, by distance; equal distances keep their order.
fn nearest<'a>(objects: impl Iterator<Item = &'a TrackedObject>, center: Point, cap: usize) -> Vec<&'a TrackedObject> {
    let distance = |o: &TrackedObject| (o.shape.center.position() - center).norm();
    let mut near: Vec<(f64, &TrackedObject)> =
        objects.map(|o| (distance(o), o)).filter(|&(d, _)| d <= MAX_DISTANCE).collect();
    near.sort_by(|a, b| a.0.total_cmp(&b.0));
    near.truncate(cap);
    near.into_iter().map(|(_, o)| o).collect()
}
