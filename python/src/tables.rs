//! Scenarios from plain tables: the ego, the agents and the lanes of any source.

use crate::errors::{Failure, Outcome};
use crate::scenario::Scenario;
use crate::trajectory::numbers;
use crate::work::quick;
use planagent::planning::HistorySample;
use planagent::road::{LaneId, LaneMap, MapBuilder, OrientedBox, Point, Pose, Route, Vector};
use planagent::traffic::{
    Frame, ObjectKind, SignalStatus, TrackToken, TrackedObject, TrafficLights,
};
use planagent::{EgoState, Scenario as Opened};
use planagent_runs::worker::run::with_causes;
use pyo3::prelude::*;
use std::collections::BTreeMap;
use std::sync::Arc;

/// A lane; its place in the list is its number.
#[derive(FromPyObject)]
#[pyo3(from_item_all)]
pub(crate) struct LaneRow {
    /// Packed x, y in driving direction.
    centerline: Vec<u8>,
    width: f64,
    speed_limit: Option<f64>,
    connector: bool,
    /// Number of the lane to its left.
    left: Option<usize>,
    /// Whether a traffic light governs it.
    light: bool,
}

/// An object at one frame: its track, its kind by number, then x, y, heading, length, width, vx,
/// vy.
pub(crate) type ObjectRow = (u32, u8, [f64; 7]);
/// A light at one frame: the number of its lane, and its color.
pub(crate) type LightRow = (usize, String);

/// Numbers of a state of the ego in its table: x, y, heading of the rear axle, forward and lateral
/// speed and acceleration.
const EGO: usize = 7;

fn kind(number: u8) -> Outcome<ObjectKind> {
    Ok(match number {
        0 => ObjectKind::Vehicle,
        1 => ObjectKind::Pedestrian,
        2 => ObjectKind::Bicycle,
        3 => ObjectKind::TrafficCone,
        4 => ObjectKind::Barrier,
        5 => ObjectKind::CzoneSign,
        6 => ObjectKind::GenericObject,
        other => return Err(Failure::argument(format!("{other} is no kind of object"))),
    })
}

fn status(color: &str) -> Outcome<SignalStatus> {
    Ok(match color {
        "green" => SignalStatus::Green,
        "yellow" => SignalStatus::Yellow,
        "red" => SignalStatus::Red,
        "unknown" => SignalStatus::Unknown,
        other => {
            return Err(Failure::argument(format!(
                "'{other}' is no light; lights are green, yellow, red and unknown"
            )));
        }
    })
}

fn invalid(error: &dyn std::error::Error) -> Failure {
    Failure::new("ScenarioError", with_causes(error))
}

fn map(lanes: &[LaneRow]) -> Outcome<LaneMap> {
    let mut builder = MapBuilder::default();
    for (number, lane) in lanes.iter().enumerate() {
        let numbers = numbers(&lane.centerline)?;
        let (pairs, _) = numbers.as_chunks::<2>();
        let points = pairs.iter().map(|&[x, y]| Point::new(x, y));
        let added = if lane.connector {
            builder.connector(points, lane.width)
        } else {
            builder.lane(points, lane.width, lane.speed_limit)
        };
        added.map_err(|error| {
            Failure::new(
                "ScenarioError",
                format!("lane {number}: {}", with_causes(&error)),
            )
        })?;
    }
    for group in abreast(lanes)? {
        builder.abreast(&group);
    }
    builder.connect_touching();
    for (number, lane) in lanes.iter().enumerate().filter(|(_, lane)| lane.light) {
        builder.stop_line(LaneId(number as u32), lane.width);
    }
    builder.finish().map_err(|error| invalid(&error))
}

/// The lanes side by side, each group from left to right.
fn abreast(lanes: &[LaneRow]) -> Outcome<Vec<Vec<LaneId>>> {
    let mut right_of: BTreeMap<usize, usize> = BTreeMap::new();
    for (number, lane) in lanes.iter().enumerate() {
        let Some(left) = lane.left else { continue };
        if left >= lanes.len() || left == number || right_of.insert(left, number).is_some() {
            let text = format!("lane {number} cannot lie to the right of lane {left}");
            return Err(Failure::new("ScenarioError", text));
        }
    }
    let leftmost = (0..lanes.len())
        .filter(|number| lanes[*number].left.is_none() && right_of.contains_key(number));
    let groups: Vec<Vec<LaneId>> = leftmost
        .map(|first| std::iter::successors(Some(first), |lane| right_of.get(lane).copied()))
        .map(|group| group.map(|number| LaneId(number as u32)).collect())
        .collect();
    let grouped: usize = groups.iter().map(Vec::len).sum();
    if grouped != right_of.len() + groups.len() {
        return Err(Failure::new(
            "ScenarioError",
            "some lanes lie to the left of each other in a circle",
        ));
    }
    Ok(groups)
}

/// The roadblocks of named lanes, else of the lanes under the recorded ego.
fn route(map: &LaneMap, named: Option<&[usize]>, ego: &[EgoState]) -> Outcome<Route> {
    let lanes: Vec<LaneId> = match named {
        Some(lanes) => {
            if let Some(unknown) = lanes.iter().find(|&&lane| lane >= map.lanes().len()) {
                return Err(Failure::argument(format!(
                    "the route names lane {unknown}, which the map lacks"
                )));
            }
            lanes.iter().map(|&lane| LaneId(lane as u32)).collect()
        }
        None => ego
            .iter()
            .filter_map(|ego| map.best_fit(&map.lanes_at(ego.center().position()), ego.center()))
            .collect(),
    };
    let mut roadblocks = Vec::new();
    for lane in lanes {
        let block = map[lane].roadblock;
        if !roadblocks.contains(&block) {
            roadblocks.push(block);
        }
    }
    if roadblocks.is_empty() {
        return Err(Failure::new(
            "ScenarioError",
            "the ego is on no lane; name the route's lanes",
        ));
    }
    Ok(Route {
        roadblocks,
        goal: ego.last().map(EgoState::center),
        goal_lane: None,
    })
}

pub(crate) fn object((token, number, values): &ObjectRow) -> Outcome<TrackedObject> {
    let [x, y, heading, length, width, vx, vy] = *values;
    if !values.iter().all(|value| value.is_finite()) || length <= 0.0 || width <= 0.0 {
        let text = format!("an agent of track {token} has a value that is not finite, or no size");
        return Err(Failure::new("ScenarioError", text));
    }
    let shape = OrientedBox::new(Pose { x, y, heading }, length, width);
    Ok(TrackedObject {
        token: TrackToken(*token),
        kind: kind(*number)?,
        shape,
        velocity: Vector::new(vx, vy),
    })
}

/// A scenario of lanes, ego states (times in µs, packed numbers), and the objects and lights of
/// each frame. Iteration 0 is the frame `start`.
#[pyfunction]
#[pyo3(signature = (names, lanes, times_us, ego, objects, lights, start, route_lanes=None))]
#[allow(clippy::too_many_arguments, reason = "a table each")]
pub(crate) fn scenario_of_tables(
    py: Python<'_>,
    names: (String, String),
    lanes: Vec<LaneRow>,
    times_us: Vec<i64>,
    ego: Vec<u8>,
    objects: Vec<Vec<ObjectRow>>,
    lights: Vec<Vec<LightRow>>,
    start: usize,
    route_lanes: Option<Vec<usize>>,
) -> PyResult<Scenario> {
    quick(py, || {
        let map = map(&lanes)?;
        let numbers = numbers(&ego)?;
        let (rows, _) = numbers.as_chunks::<EGO>();
        let frames = times_us.len();
        if [rows.len(), objects.len(), lights.len()] != [frames; 3] || start + 2 > frames {
            let text = format!(
                "{frames} frames with iteration 0 at frame {start}; a simulation needs at least 2"
            );
            return Err(Failure::new("ScenarioError", text));
        }
        let states: Vec<EgoState> = times_us
            .iter()
            .zip(rows)
            .map(|(&time_us, &[x, y, heading, vx, vy, ax, ay])| {
                EgoState::from_log(
                    time_us,
                    Pose { x, y, heading },
                    Vector::new(vx, vy),
                    Vector::new(ax, ay),
                )
            })
            .collect();
        if !numbers.iter().all(|number| number.is_finite()) {
            return Err(Failure::new(
                "ScenarioError",
                "a state of the ego has a NaN or infinite value",
            ));
        }
        let route = route(
            &map,
            route_lanes.as_deref(),
            states.get(start..).unwrap_or_default(),
        )?;
        let mut all = Vec::with_capacity(frames);
        for ((ego, objects), lights) in states.into_iter().zip(&objects).zip(&lights) {
            let objects = objects
                .iter()
                .map(object)
                .collect::<Outcome<Vec<TrackedObject>>>()?;
            let light = |(lane, color): &LightRow| match map.lanes().get(*lane) {
                Some(lane) => Ok((lane.id, status(color)?)),
                None => Err(Failure::argument(format!(
                    "a light names lane {lane}, which the map lacks"
                ))),
            };
            let lights: TrafficLights = lights.iter().map(light).collect::<Outcome<_>>()?;
            let sample = HistorySample {
                ego,
                objects: objects.into(),
            };
            all.push(Frame {
                ego: sample.ego,
                objects: sample.objects,
                lights: Arc::new(lights),
            });
        }
        let (id, scenario_type) = names;
        let opened = Opened {
            interaction: None,
            log_name: id.clone(),
            id,
            scenario_type,
            map: Arc::new(map),
            route,
            frames: all,
            start,
            future: Vec::new(),
        };
        Ok(Scenario::new(opened, None))
    })
}
