//! Facts of the objects: lead vehicle, pedestrian, obstacle, occupied lanes.

use super::{Ahead, LeadSpeed, SideLane, VehicleCount, View};
use crate::environment::lane_graph::{
    CenterlineName, GraphedScene, Heading, LaneGraph, LaneRelation, Window,
};
use planagent_world::geometry::Pose;
use planagent_world::{ObjectKind, PACIFICA, TrackedObject};

/// Slower is stopped, m/s.
pub const STOPPED: f64 = 0.5;
/// A lead vehicle slower than the ego by at most this has the same speed, m/s.
pub const SAME_SPEED: f64 = 1.0;
/// Half width of the pedestrian corridor beyond the ego's sides, meters.
pub const CORRIDOR_MARGIN: f64 = 2.0;
/// A lane beside is occupied by an object nearer than this to the ego's bumpers, meters.
pub const SIDE_GAP: f64 = 8.0;
/// An oncoming vehicle farther beside the path than this does not count, meters: two lanes.
pub const ONCOMING_ASIDE: f64 = 7.0;
/// Centers are searched this far beyond the last distance that counts, meters: half a long vehicle.
const LONG_VEHICLE: f64 = 12.0;

pub(super) struct Traffic {
    pub(super) lead_distance: Ahead,
    pub(super) lead_speed: LeadSpeed,
    pub(super) pedestrian: Ahead,
    pub(super) blocked: Ahead,
    pub(super) left_lane: SideLane,
    pub(super) right_lane: SideLane,
    pub(super) vehicle_count: VehicleCount,
    pub(super) crossing_vehicle: Ahead,
    pub(super) oncoming_vehicle: Ahead,
    pub(super) person_on_path: Ahead,
}

pub(super) fn seen(seen: GraphedScene<'_>, view: View) -> Traffic {
    let GraphedScene { scene, graph } = seen;
    let objects: Vec<&TrackedObject> = scene
        .objects
        .iter()
        .filter(|object| view.shows(&object.shape))
        .collect();
    let half_length = PACIFICA.length() / 2.0;
    let window = Window::new(
        graph.ego_lane(),
        half_length,
        half_length + Ahead::FAR + LONG_VEHICLE,
    );
    let ahead: Vec<(&TrackedObject, LaneRelation)> = objects
        .iter()
        .filter_map(|&object| Some((object, window.as_ref()?.project(object)?)))
        .filter(|(_, relation)| relation.offset > 0.0)
        .collect();
    // Every fact is the nearest object of some sort on the path, so one closure serves all.
    let nearest = |counts: &dyn Fn(&TrackedObject, &LaneRelation) -> bool| {
        let counted = ahead
            .iter()
            .filter(|(object, relation)| counts(object, relation))
            .map(|(_, relation)| relation);
        counted
            .min_by(|a, b| a.gap.total_cmp(&b.gap))
            .filter(|relation| relation.gap <= Ahead::FAR)
    };
    let lead = nearest(&|object, relation| {
        let drives = matches!(object.kind, ObjectKind::Vehicle | ObjectKind::Bicycle);
        drives && relation.blocks_path && relation.heading == Heading::Along
    });
    let pedestrian = nearest(&|object, relation| {
        let in_corridor = relation.lateral.abs() <= PACIFICA.width / 2.0 + CORRIDOR_MARGIN;
        object.kind == ObjectKind::Pedestrian && in_corridor
    });
    let blocked = nearest(&|object, relation| {
        let stands = !object.kind.is_agent()
            || (object.kind == ObjectKind::Vehicle && object.speed() < STOPPED);
        stands && relation.blocks_path
    });
    let drives =
        |object: &TrackedObject| matches!(object.kind, ObjectKind::Vehicle | ObjectKind::Bicycle);
    let crossing = nearest(&|object, relation| {
        let approaches = || {
            window
                .as_ref()
                .is_some_and(|window| approaches(window, object, relation))
        };
        drives(object)
            && relation.heading == Heading::Crossing
            && (relation.blocks_path || approaches())
    });
    let oncoming = nearest(&|object, relation| {
        drives(object)
            && relation.heading == Heading::Oncoming
            && relation.lateral.abs() <= ONCOMING_ASIDE
    });
    let person =
        nearest(&|object, relation| object.kind == ObjectKind::Pedestrian && relation.blocks_path);
    let vehicles = scene
        .objects
        .iter()
        .filter(|object| object.kind == ObjectKind::Vehicle);
    let side_lane = |name| side_lane(graph, name, &objects);
    Traffic {
        lead_distance: Ahead::from_distance(lead.map(|lead| lead.gap)),
        lead_speed: lead.map_or(LeadSpeed::None, |lead| {
            LeadSpeed::from_speeds(lead.along_speed, graph.ego_speed)
        }),
        pedestrian: Ahead::from_distance(pedestrian.map(|relation| relation.gap)),
        blocked: Ahead::from_distance(blocked.map(|relation| relation.gap)),
        left_lane: side_lane(CenterlineName::LeftLane),
        right_lane: side_lane(CenterlineName::RightLane),
        vehicle_count: VehicleCount::from_count(
            vehicles
                .filter(|v| view.holds(v.shape.center.position()))
                .count(),
        ),
        crossing_vehicle: Ahead::from_distance(crossing.map(|relation| relation.gap)),
        oncoming_vehicle: Ahead::from_distance(oncoming.map(|relation| relation.gap)),
        person_on_path: Ahead::from_distance(person.map(|relation| relation.gap)),
    }
}

/// Whether an object comes nearer to the line, or passes over it, in the next instant.
fn approaches(window: &Window, object: &TrackedObject, relation: &LaneRelation) -> bool {
    /// Seconds.
    const SOON: f64 = 0.2;
    let center = object.shape.center;
    let moved = Pose::at(center.position() + object.velocity * SOON, center.heading);
    let later = window.project(&TrackedObject {
        shape: object.shape.moved_to(moved),
        ..*object
    });
    later.is_some_and(|later| {
        later.lateral.abs() < relation.lateral.abs()
            || later.lateral.signum() != relation.lateral.signum()
    })
}

fn side_lane(graph: &LaneGraph, name: CenterlineName, objects: &[&TrackedObject]) -> SideLane {
    let Some(centerline) = graph.centerline(name) else {
        return SideLane::None;
    };
    let reach = PACIFICA.length() / 2.0 + SIDE_GAP + LONG_VEHICLE;
    let window = Window::new(centerline, reach, reach);
    let occupied = objects
        .iter()
        .filter_map(|object| window.as_ref()?.project(object))
        .any(|relation| (relation.on_lane || relation.blocks_path) && relation.gap < SIDE_GAP);
    if occupied {
        SideLane::Occupied
    } else {
        SideLane::Free
    }
}
