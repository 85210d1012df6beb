//! An estimate of the speed limit where the map has none.

use super::{Centerline, GraphAgent, Heading};
use planagent_world::LaneMap;

/// Usual limits of city roads by lanes of a direction, m/s: 25, 30 and 35 mph. Ours.
const BY_LANES: [f64; 3] = [11.2, 13.4, 15.6];
/// Limits that signs show, m/s: 25 to 65 mph.
const SIGNS: [f64; 7] = [11.2, 13.4, 15.6, 17.9, 20.1, 24.6, 29.1];
/// Traffic moves this much faster than the limit, as a share.
const ABOVE_LIMIT: f64 = 0.1;

/// What a sign would say, m/s: the usual limit of a road with `lanes` lanes, or more where the
/// traffic is faster.
pub(super) fn estimate(
    map: &LaneMap,
    ego_lane: &Centerline,
    ego_speed: f64,
    agents: &[GraphAgent],
) -> f64 {
    let place = ego_lane
        .path
        .starts
        .partition_point(|&start| start <= ego_lane.ego_s)
        .saturating_sub(1);
    let lanes = ego_lane
        .path
        .lanes
        .get(place)
        .map_or(1, |&lane| map[map[lane].roadblock].lanes.len());
    let usual = BY_LANES[lanes.clamp(1, BY_LANES.len()) - 1];
    let along = agents
        .iter()
        .filter(|agent| agent.heading == Heading::Along)
        .map(|agent| agent.speed);
    let traffic = along.fold(ego_speed, f64::max) / (1.0 + ABOVE_LIMIT);
    let seen = SIGNS
        .into_iter()
        .find(|sign| *sign >= traffic)
        .unwrap_or(SIGNS[SIGNS.len() - 1]);
    usual.max(seen)
}
