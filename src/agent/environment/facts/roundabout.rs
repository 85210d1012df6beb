//! Roundabout detection: a short, round cycle in the graph of lanes.

use super::View;
use planagent_world::geometry::{Point, Polygon};
use planagent_world::{LaneId, LaneMap};
use std::collections::{BTreeMap, VecDeque};

/// A longer cycle of lanes is a block of streets, meters.
pub(crate) const ROUNDABOUT_LENGTH: f64 = 250.0;
/// A cycle must enclose at least this share of the area of a circle of the same length: an ellipse
/// of 3:2 has 0.94, a rounded block of streets 0.85, two lanes joined by U-turns far less.
pub(crate) const ROUNDNESS: f64 = 0.9;
/// Only cycles with a part at most this far behind the ego's center count, meters: the ego's
/// length.
const BEHIND: f64 = 5.0;

/// Whether a roundabout is in view, ahead of the ego or under it.
pub(super) fn ahead(map: &LaneMap, view: View) -> bool {
    let shown = |p: &Point| view.holds(*p) && view.center.to_local(*p).x >= -BEHIND;
    let reach = super::VIEW_METERS * std::f64::consts::FRAC_1_SQRT_2;
    let lanes = map.lanes_near(view.center.position(), reach);
    lanes
        .into_iter()
        .filter(|&lane| map[lane].centerline.vertices().iter().any(shown))
        .filter_map(|lane| shortest_cycle(map, lane))
        .any(|cycle| is_round(map, &cycle))
}

/// The shortest path from the end of a lane back to its start, that lane included, if shorter than
/// [`ROUNDABOUT_LENGTH`].
fn shortest_cycle(map: &LaneMap, lane: LaneId) -> Option<Vec<LaneId>> {
    let length = |id: LaneId| map[id].centerline.length();
    // Length round so far, and the lane before, for each lane that was reached from the end of
    // `lane`.
    let mut reached: BTreeMap<LaneId, (f64, LaneId)> = BTreeMap::new();
    let mut queue = VecDeque::from([(lane, length(lane))]);
    while let Some((at, covered)) = queue.pop_front() {
        for &next in &map[at].outgoing {
            let total = if next == lane {
                covered
            } else {
                covered + length(next)
            };
            let better = reached.get(&next).is_none_or(|&(known, _)| total < known);
            if total < ROUNDABOUT_LENGTH && better {
                reached.insert(next, (total, at));
                if next != lane {
                    queue.push_back((next, total));
                }
            }
        }
    }
    let mut cycle = vec![lane];
    let (_, mut at) = *reached.get(&lane)?;
    while at != lane {
        cycle.push(at);
        at = reached.get(&at)?.1;
    }
    cycle.reverse();
    Some(cycle)
}

fn is_round(map: &LaneMap, cycle: &[LaneId]) -> bool {
    let length: f64 = cycle
        .iter()
        .map(|&lane| map[lane].centerline.length())
        .sum();
    let ring = cycle
        .iter()
        .flat_map(|&lane| map[lane].centerline.vertices().iter().copied());
    let area = Polygon::new(ring).map_or(0.0, |ring| ring.area());
    4.0 * std::f64::consts::PI * area >= ROUNDNESS * length * length
}
