//! Features of the agents near the ego.

use super::distribution::{REACH, mean, spread};
use planagent_scenario::{Frame, Scenario};
use planagent_world::geometry::{OrientedBox, wrap_angle};
use planagent_world::{LaneKind, LaneMap, ObjectKind, TrackToken, TrackedObject};
use std::collections::BTreeMap;
use std::f64::consts::{FRAC_PI_4, PI};

/// Iterations that are looked at: one a second over seven seconds.
const INSTANTS: [usize; 8] = [0, 10, 20, 30, 40, 50, 60, 70];
/// Below this speed a vehicle stands, m/s. Recorded boxes shake.
const STANDS: f64 = 0.3;
/// Above this speed a vehicle has a course, m/s.
const MOVES: f64 = 2.0;
/// Reach of a gap ahead, meters, and to the side.
const AHEAD: f64 = 40.0;
const ASIDE: f64 = 1.5;

#[derive(Debug, Clone, Default)]
pub(super) struct AgentFigures {
    /// Vehicles whose center is in a lane.
    pub(super) vehicles: Option<f64>,
    /// To the next vehicle in the same direction, meters.
    pub(super) gap: Option<f64>,
    /// m/s.
    pub(super) ego_speed: Option<f64>,
    /// Mean of those that move, m/s.
    pub(super) vehicle_speed: Option<f64>,
    /// Share of the instants, percent.
    pub(super) ego_standing: Option<f64>,
    /// Share of vehicles in lanes and instants, percent.
    pub(super) vehicles_standing: Option<f64>,
    /// Moving vehicles against the ego's direction.
    pub(super) oncoming: Option<f64>,
    /// Moving vehicles across the ego's direction.
    pub(super) crossing: Option<f64>,
    /// Standing vehicles beside the lanes.
    pub(super) parked: Option<f64>,
    pub(super) pedestrians: Option<f64>,
    pub(super) cyclists: Option<f64>,
    /// Of moving vehicles, degrees.
    pub(super) heading_deviation: Option<f64>,
    /// Of moving vehicles, meters.
    pub(super) lane_offset: Option<f64>,
    /// Meters.
    pub(super) length: Option<f64>,
    /// Meters.
    pub(super) length_spread: Option<f64>,
    /// Meters.
    pub(super) width: Option<f64>,
    /// Meters.
    pub(super) width_spread: Option<f64>,
}

/// One instant.
#[derive(Debug, Default)]
struct Seen {
    vehicles: f64,
    standing: f64,
    oncoming: f64,
    crossing: f64,
    parked: f64,
    pedestrians: f64,
    cyclists: f64,
    gaps: Vec<f64>,
    speeds: Vec<f64>,
    deviations: Vec<f64>,
    offsets: Vec<f64>,
}

pub(super) fn figures(scenario: &Scenario) -> AgentFigures {
    let frames: Vec<&Frame> = INSTANTS
        .iter()
        .filter_map(|&iteration| scenario.frame(iteration))
        .collect();
    let seen: Vec<Seen> = frames
        .iter()
        .map(|frame| Seen::in_frame(frame, &scenario.map))
        .collect();
    // By token: a vehicle counts once among the sizes, however many instants show it.
    let mut boxes: BTreeMap<TrackToken, OrientedBox> = BTreeMap::new();
    for frame in &frames {
        boxes.extend(near(frame, ObjectKind::Vehicle).map(|object| (object.token, object.shape)));
    }
    let lengths: Vec<f64> = boxes.values().map(|shape| shape.length).collect();
    let widths: Vec<f64> = boxes.values().map(|shape| shape.width).collect();
    let in_lanes: f64 = seen.iter().map(|one| one.vehicles).sum();
    let standing: f64 = seen.iter().map(|one| one.standing).sum();
    let all = |list: fn(&Seen) -> &Vec<f64>| mean(seen.iter().flat_map(list).copied());
    let number = |count: fn(&Seen) -> f64| mean(seen.iter().map(count));
    AgentFigures {
        vehicles: number(|one| one.vehicles),
        gap: all(|one| &one.gaps),
        ego_speed: mean(frames.iter().map(|frame| frame.ego.speed())),
        vehicle_speed: all(|one| &one.speeds),
        ego_standing: mean(frames.iter().map(|frame| {
            if frame.ego.speed() < STANDS {
                100.0
            } else {
                0.0
            }
        })),
        vehicles_standing: (in_lanes > 0.0).then(|| 100.0 * standing / in_lanes),
        oncoming: number(|one| one.oncoming),
        crossing: number(|one| one.crossing),
        parked: number(|one| one.parked),
        pedestrians: number(|one| one.pedestrians),
        cyclists: number(|one| one.cyclists),
        heading_deviation: all(|one| &one.deviations),
        lane_offset: all(|one| &one.offsets),
        length: mean(lengths.iter().copied()),
        length_spread: spread(&lengths),
        width: mean(widths.iter().copied()),
        width_spread: spread(&widths),
    }
}

/// The objects of a kind near the ego.
fn near(frame: &Frame, kind: ObjectKind) -> impl Iterator<Item = &TrackedObject> {
    let ego = frame.ego.center().position();
    let is_near =
        move |object: &&TrackedObject| (object.shape.center.position() - ego).norm() <= REACH;
    frame
        .objects
        .iter()
        .filter(move |object| object.kind == kind)
        .filter(is_near)
}

impl Seen {
    fn in_frame(frame: &Frame, map: &LaneMap) -> Self {
        let number = |kind| near(frame, kind).count() as f64;
        let mut seen = Self {
            pedestrians: number(ObjectKind::Pedestrian),
            cyclists: number(ObjectKind::Bicycle),
            ..Self::default()
        };
        let heading = frame.ego.center().heading;
        let own = frame.ego.footprint();
        for vehicle in near(frame, ObjectKind::Vehicle) {
            let center = vehicle.shape.center;
            let in_lane = !map.lanes_at(center.position()).is_empty();
            let stands = vehicle.speed() < STANDS;
            if in_lane {
                seen.vehicles += 1.0;
                seen.standing += f64::from(u8::from(stands));
                let others = frame
                    .objects
                    .iter()
                    .filter(|other| other.kind == ObjectKind::Vehicle);
                let others = others
                    .filter(|other| other.token != vehicle.token)
                    .map(|other| other.shape);
                seen.gaps
                    .extend(gap_ahead(&vehicle.shape, others.chain([own])));
            } else if stands {
                seen.parked += 1.0;
            }
            if vehicle.speed() < MOVES {
                continue;
            }
            seen.speeds.push(vehicle.speed());
            let turned = wrap_angle(center.heading - heading).abs();
            if turned > PI - FRAC_PI_4 {
                seen.oncoming += 1.0;
            } else if turned > FRAC_PI_4 {
                seen.crossing += 1.0;
            }
            // Drivers cut the corners of connectors, whose lines are drawn.
            let lane = map.best_fit(
                &map.lanes_of_kind_at(center.position(), LaneKind::Lane),
                center,
            );
            if let Some(lane) = lane.map(|lane| &map[lane]) {
                let place = lane.centerline.project(center.position());
                let along = wrap_angle(center.heading - lane.centerline.heading_at(place.s)).abs();
                if along < FRAC_PI_4 {
                    seen.deviations.push(along.to_degrees());
                    seen.offsets.push(place.lateral.abs());
                }
            }
        }
        let others = near(frame, ObjectKind::Vehicle).map(|other| other.shape);
        seen.gaps.extend(gap_ahead(&own, others));
        seen
    }
}

/// Distance to the nearest box ahead in the same direction, meters.
fn gap_ahead(own: &OrientedBox, others: impl Iterator<Item = OrientedBox>) -> Option<f64> {
    let gaps = others.filter_map(|other| {
        let local = own.center.to_local(other.center.position());
        let along = wrap_angle(other.center.heading - own.center.heading).abs() < FRAC_PI_4;
        let gap = local.x - f64::midpoint(own.length, other.length);
        (along && local.x > 0.0 && local.y.abs() < ASIDE && gap < AHEAD).then_some(gap.max(0.0))
    });
    gaps.reduce(f64::min)
}
