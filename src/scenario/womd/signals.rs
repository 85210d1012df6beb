//! Traffic lights and stop lines.
//!
//! * A light names the lane that it controls: the one behind its stop point, which makes that lane a connector. Should the stop
//!   point stand at the far end of a lane, the light governs the connectors that the lane leads to.
//! * Arrow and plain states are read alike: stop is red, caution yellow, go green. A flashing light regulates like a sign, not like
//!   a light: it is unknown to nuPlan, as are states that were not observed.
//! * A connector that a light ever governs has traffic lights at every step; at a step without a state its light is unknown.
//! * A stop line lies across the beginning of the governed connectors; those that begin at one place share it.

use super::features::MapFeatures;
use super::outline::DEFAULT_HALF;
use super::proto::{DynamicMapState, SignalState, TrafficSignalLaneState};
use crate::geometry::{OrientedBox, Point, Pose, Vector};
use crate::world::{LaneId, LaneKind, LaneMap, SignalStatus, StopLine, TrafficLights};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// Places of the lanes that have a light at their beginning at any step.
pub(super) fn governed_lanes(map: &MapFeatures, steps: &[DynamicMapState], origin: Vector) -> BTreeSet<usize> {
    let places: BTreeMap<i64, usize> = map.lanes.iter().enumerate().map(|(i, lane)| (lane.id, i)).collect();
    let lights = steps.iter().flat_map(|step| &step.lane_states);
    let governed = lights.filter_map(|light| {
        let &place = places.get(&light.lane)?;
        let line = &map.lanes[place].trace.line;
        (!stands_at_end(light, line.start(), line.end(), origin)).then_some(place)
    });
    governed.collect()
}

fn stands_at_end(light: &TrafficSignalLaneState, start: Point, end: Point, origin: Vector) -> bool {
    light.stop_point.as_ref().is_some_and(|stop| {
        let stop = Point::new(stop.x - origin.x, stop.y - origin.y);
        (stop - end).norm() < (stop - start).norm()
    })
}

/// The lights of every step, by connector.
pub(super) fn lights(
    map: &LaneMap,
    steps: &[DynamicMapState],
    count: usize,
    origin: Vector,
) -> Vec<Arc<TrafficLights>> {
    let observed: Vec<Vec<(LaneId, SignalStatus)>> = (0..count)
        .map(|step| {
            let states = steps.get(step).into_iter().flat_map(|step| &step.lane_states);
            states
                .flat_map(|light| connectors_of(map, light, origin).into_iter().map(|id| (id, status(light))))
                .collect()
        })
        .collect();
    let ever: BTreeSet<LaneId> = observed.iter().flatten().map(|&(id, _)| id).collect();
    let unknown = ever.iter().map(|&id| (id, SignalStatus::Unknown));
    observed.iter().map(|now| Arc::new(unknown.clone().chain(now.iter().copied()).collect())).collect()
}

/// The connectors that a light governs.
fn connectors_of(map: &LaneMap, light: &TrafficSignalLaneState, origin: Vector) -> Vec<LaneId> {
    let Some(id) = map.lane_by_source(light.lane) else { return Vec::new() };
    let lane = &map[id];
    if lane.kind == LaneKind::Connector {
        return vec![id];
    }
    if stands_at_end(light, lane.centerline.start(), lane.centerline.end(), origin) {
        return lane.outgoing.iter().copied().filter(|&next| map[next].is_connector()).collect();
    }
    Vec::new()
}

fn status(light: &TrafficSignalLaneState) -> SignalStatus {
    match SignalState::try_from(light.state) {
        Ok(SignalState::Go | SignalState::ArrowGo) => SignalStatus::Green,
        Ok(SignalState::Caution | SignalState::ArrowCaution) => SignalStatus::Yellow,
        Ok(SignalState::Stop | SignalState::ArrowStop) => SignalStatus::Red,
        Ok(SignalState::Unknown | SignalState::FlashingStop | SignalState::FlashingCaution) | Err(_) => {
            SignalStatus::Unknown
        }
    }
}

/// Stop lines of all lights and stop signs. `lit` are the connectors that a light governs.
pub(super) fn stop_lines(map: &MapFeatures, connector: &[bool], lit: &BTreeSet<usize>) -> Vec<StopLine> {
    let signed = map.signs.iter().flat_map(|sign| &sign.lanes).copied();
    let wanted: BTreeSet<(bool, usize)> =
        lit.iter().map(|&lane| (false, lane)).chain(signed.map(|lane| (true, lane))).collect();
    let mut lines: Vec<(Pose, StopLine)> = Vec::new();
    for (stop_sign, lane) in wanted.into_iter().filter(|&(_, lane)| connector[lane]) {
        let at = map.lanes[lane].trace.line.pose_at(0.0);
        match lines.iter_mut().find(|(pose, line)| line.stop_sign == stop_sign && same_place(*pose, at)) {
            Some((_, line)) => line.lanes.push(LaneId(lane as u32)),
            None => lines.push((at, StopLine { polygon: across(at), lanes: vec![LaneId(lane as u32)], stop_sign })),
        }
    }
    lines.into_iter().map(|(_, line)| line).collect()
}

fn same_place(a: Pose, b: Pose) -> bool {
    /// Metres.
    const SAME: f64 = 0.5;
    a.distance(&b) < SAME
}

/// A thin polygon across the lane.
fn across(at: Pose) -> crate::geometry::Polygon {
    /// Thickness of a painted stop line, metres.
    const THICKNESS: f64 = 0.5;
    OrientedBox::new(at, THICKNESS, 2.0 * DEFAULT_HALF).to_polygon()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrows_read_like_plain_lights_and_flashing_ones_are_unknown() {
        let shown =
            |state: SignalState| status(&TrafficSignalLaneState { lane: 1, state: state as i32, stop_point: None });
        assert_eq!(shown(SignalState::ArrowGo), SignalStatus::Green);
        assert_eq!(shown(SignalState::Caution), SignalStatus::Yellow);
        assert_eq!(shown(SignalState::ArrowStop), SignalStatus::Red);
        assert_eq!(shown(SignalState::FlashingStop), SignalStatus::Unknown);
        let strange = TrafficSignalLaneState { lane: 1, state: 99, stop_point: None };
        assert_eq!(status(&strange), SignalStatus::Unknown);
    }
}
