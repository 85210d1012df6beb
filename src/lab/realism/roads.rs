//! Features of the roads around the start.

use super::distribution::{REACH, mean, spread};
use planagent_scenario::Scenario;
use planagent_world::geometry::wrap_angle;
use planagent_world::{Lane, LaneKind};

/// Distance over which a lane's heading change counts, meters. Sources differ in their vertices,
/// not at this scale.
const STEP: f64 = 5.0;
/// Heading changes between which a connector is a turn, degrees.
const TURNS: [f64; 2] = [30.0, 150.0];
/// Shorter pieces have no meaningful width, meters.
const MIN_LENGTH: f64 = 5.0;

#[derive(Debug, Clone, Copy, Default)]
pub(super) struct RoadFigures {
    /// Area by length of a lane, meters.
    pub(super) lane_width: Option<f64>,
    /// Meters.
    pub(super) lane_width_spread: Option<f64>,
    /// Absolute heading change by length of lanes, 1/km.
    pub(super) curvature: Option<f64>,
    /// Absolute difference of turning connectors from a right angle, degrees.
    pub(super) junction_angle: Option<f64>,
    /// Share of lanes, percent.
    pub(super) unknown_limits: Option<f64>,
    /// Length of a centerline by its edges, meters.
    pub(super) vertex_spacing: Option<f64>,
}

pub(super) fn figures(scenario: &Scenario) -> RoadFigures {
    let Some(start) = scenario.frame(0) else {
        return RoadFigures::default();
    };
    let near = scenario
        .map
        .lanes_near(start.ego.center().position(), REACH);
    let near: Vec<&Lane> = near.into_iter().map(|lane| &scenario.map[lane]).collect();
    let (lanes, connectors): (Vec<&Lane>, Vec<&Lane>) =
        near.iter().partition(|lane| lane.kind == LaneKind::Lane);
    // Area over length is no width where a lane is hardly longer than wide.
    let long: Vec<&&Lane> = lanes
        .iter()
        .filter(|lane| lane.centerline.length() >= MIN_LENGTH)
        .collect();
    let widths: Vec<f64> = long
        .iter()
        .map(|lane| lane.polygon.area() / lane.centerline.length())
        .collect();
    let length: f64 = long.iter().map(|lane| lane.centerline.length()).sum();
    let turned: f64 = long.iter().map(|lane| turned(lane)).sum();
    let turns = connectors.iter().map(|lane| turn(lane).abs().to_degrees());
    let edges: usize = near
        .iter()
        .map(|lane| lane.centerline.vertices().len() - 1)
        .sum();
    let whole: f64 = near.iter().map(|lane| lane.centerline.length()).sum();
    RoadFigures {
        lane_width: mean(widths.iter().copied()),
        lane_width_spread: spread(&widths),
        curvature: (length > 0.0).then(|| 1000.0 * turned / length),
        junction_angle: mean(
            turns
                .filter(|turn| (TURNS[0]..TURNS[1]).contains(turn))
                .map(|turn| (turn - 90.0).abs()),
        ),
        unknown_limits: mean(lanes.iter().map(|lane| {
            if lane.speed_limit.is_none() {
                100.0
            } else {
                0.0
            }
        })),
        vertex_spacing: (edges > 0).then(|| whole / edges as f64),
    }
}

/// Sum of the absolute heading changes along a lane, radians.
fn turned(lane: &Lane) -> f64 {
    let line = &lane.centerline;
    let steps = (line.length() / STEP).floor() as usize;
    let headings: Vec<f64> = (0..=steps)
        .map(|step| line.heading_at(step as f64 * STEP))
        .collect();
    headings
        .windows(2)
        .map(|pair| wrap_angle(pair[1] - pair[0]).abs())
        .sum()
}

/// Heading change from the start of a lane to its end, radians.
fn turn(lane: &Lane) -> f64 {
    wrap_angle(
        lane.centerline.heading_at(lane.centerline.length()) - lane.centerline.heading_at(0.0),
    )
}
