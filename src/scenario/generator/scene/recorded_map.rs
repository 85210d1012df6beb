//! The map of a wide scenario as a recording would have it.

use crate::generator::rng::SeededRng;
use planagent_world::geometry::Polyline;
use planagent_world::{BASELINE_SPACING, Lane, LaneMap, MapError};
use std::f64::consts::PI;

/// What a recording changes.
struct Changes {
    /// Minimum distance between two vertices of a centerline, but for the last ones, meters.
    min_spacing: f64,
    /// Share of maps without limits; of a further 6 % some are missing.
    without_limits: f64,
    /// How far centerlines of lanes lie beside where they were driven, meters at most.
    max_wobble: Option<f64>,
}

const WIDE: Changes = Changes {
    min_spacing: 0.47,
    without_limits: 0.85,
    max_wobble: None,
};

const WIDER: Changes = Changes {
    min_spacing: 0.486,
    without_limits: 0.92,
    max_wobble: Some(0.45),
};

/// Even vertices, limits that are mostly unknown, and, in still wider ranges, lines that are not
/// exact.
pub(crate) fn as_recorded(map: &LaneMap, rng: &mut SeededRng) -> Result<LaneMap, MapError> {
    let changes = if rng.is_wider() { WIDER } else { WIDE };
    let all = rng.unit();
    let spacing = rng.uniform(changes.min_spacing, BASELINE_SPACING);
    let wobble = changes.max_wobble.map_or(0.0, |most| most * rng.unit());
    let mut parts = map.parts().clone();
    for lane in &mut parts.lanes {
        let unknown = all < changes.without_limits || (all > 0.94 && rng.bool(0.5));
        lane.speed_limit = lane.speed_limit.filter(|_| !unknown);
        let before = lane.centerline.length();
        lane.centerline = if wobble > 0.0 && !lane.is_connector() {
            wobbling(lane, spacing, wobble, rng)
        } else {
            lane.centerline.resampled(spacing)
        };
        keep_neighbors(lane, before);
    }
    LaneMap::new(parts)
}

/// Lets neighbors along a lane to its former end reach its present one.
fn keep_neighbors(lane: &mut Lane, before: f64) {
    let whole = lane.centerline.length();
    for neighbor in lane
        .left
        .iter_mut()
        .chain(&mut lane.right)
        .filter(|neighbor| neighbor.to_s >= before)
    {
        neighbor.to_s = whole;
    }
}

/// A lane's centerline with vertices every `spacing` meters. It swings by up to `wobble` meters
/// between its ends, which stay, so that lanes still meet.
fn wobbling(lane: &Lane, spacing: f64, wobble: f64, rng: &mut SeededRng) -> Polyline {
    let line = &lane.centerline;
    let whole = line.length();
    let frequency = 2.0 * PI / rng.uniform(35.0, 100.0);
    let phase = rng.uniform(0.0, 2.0 * PI);
    let aside = |s: f64| wobble * (PI * s / whole).sin().powi(2) * (frequency * s + phase).sin();
    let points = (0..=(whole / spacing).floor() as usize)
        .map(|i| i as f64 * spacing)
        .map(|s| line.frenet_to_map(s, aside(s)))
        .chain(std::iter::once(line.end()));
    // Its ends are those of a line, so this fails for no line; a lane is never lost.
    Polyline::new(points).unwrap_or_else(|_| line.clone())
}
