//! The features of a scene.

use super::agents::AgentFigures;
use super::roads::RoadFigures;
use serde::Serialize;

/// A number that a scene has or lacks.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Feature {
    /// In JSON.
    pub key: &'static str,
    /// In tables.
    pub name: &'static str,
    /// Empty for numbers of objects.
    pub unit: &'static str,
}

type Value = fn(&RoadFigures, &AgentFigures) -> Option<f64>;

const fn feature(
    key: &'static str,
    name: &'static str,
    unit: &'static str,
    value: Value,
) -> (Feature, Value) {
    (Feature { key, name, unit }, value)
}

/// Roads first. Agents are means over the instants.
pub(super) const FEATURES: &[(Feature, Value)] = &[
    feature("lane_width", "lane width", "m", |roads, _| roads.lane_width),
    feature(
        "lane_width_spread",
        "spread of lane widths",
        "m",
        |roads, _| roads.lane_width_spread,
    ),
    feature("curvature", "curvature of lanes", "1/km", |roads, _| {
        roads.curvature
    }),
    feature(
        "junction_angle",
        "turns off 90 degrees",
        "deg",
        |roads, _| roads.junction_angle,
    ),
    feature("unknown_limits", "lanes without limit", "%", |roads, _| {
        roads.unknown_limits
    }),
    feature(
        "vertex_spacing",
        "spacing of lane lines",
        "m",
        |roads, _| roads.vertex_spacing,
    ),
    feature("vehicles", "vehicles in lanes", "", |_, agents| {
        agents.vehicles
    }),
    feature("gap", "gap between vehicles", "m", |_, agents| agents.gap),
    feature("ego_speed", "speed of the ego", "m/s", |_, agents| {
        agents.ego_speed
    }),
    feature(
        "vehicle_speed",
        "speed of moving vehicles",
        "m/s",
        |_, agents| agents.vehicle_speed,
    ),
    feature("ego_standing", "time the ego stands", "%", |_, agents| {
        agents.ego_standing
    }),
    feature(
        "vehicles_standing",
        "time vehicles stand",
        "%",
        |_, agents| agents.vehicles_standing,
    ),
    feature("oncoming", "oncoming vehicles", "", |_, agents| {
        agents.oncoming
    }),
    feature("crossing", "crossing vehicles", "", |_, agents| {
        agents.crossing
    }),
    feature("parked", "parked vehicles", "", |_, agents| agents.parked),
    feature("pedestrians", "pedestrians", "", |_, agents| {
        agents.pedestrians
    }),
    feature("cyclists", "cyclists", "", |_, agents| agents.cyclists),
    feature(
        "heading_deviation",
        "heading off the lane",
        "deg",
        |_, agents| agents.heading_deviation,
    ),
    feature("lane_offset", "offset in the lane", "m", |_, agents| {
        agents.lane_offset
    }),
    feature("box_length", "length of vehicles", "m", |_, agents| {
        agents.length
    }),
    feature(
        "box_length_spread",
        "spread of lengths",
        "m",
        |_, agents| agents.length_spread,
    ),
    feature("box_width", "width of vehicles", "m", |_, agents| {
        agents.width
    }),
    feature("box_width_spread", "spread of widths", "m", |_, agents| {
        agents.width_spread
    }),
];
