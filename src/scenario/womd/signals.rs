//! Traffic lights and stop lines.
//!
//! * A light names the lane behind its stop point, which makes that lane a connector. If the stop
//!   point is at the end of the lane, the light governs the connectors that the lane leads to.
//! * Arrow and plain states are equal: stop is red, caution yellow, go green. Flashing lights
//!   regulate like a sign, so their state is unknown, as are states that were not observed.
//! * A connector with a light at any step has a light at all steps, unknown where it has no state.
//! * A stop line lies across the start of the governed connectors. Connectors that start at one
//!   place share it.

use super::features::MapFeatures;
use super::outline::DEFAULT_HALF;
use super::proto::{DynamicMapState, SignalState, TrafficSignalLaneState};
use planagent_world::geometry::{OrientedBox, Point, Pose, Vector};
use planagent_world::{LaneId, LaneKind, LaneMap, SignalStatus, StopLine, TrafficLights};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// Lanes with a light at their start at any step.
pub(super) fn governed_lanes(
    map: &MapFeatures,
    steps: &[DynamicMapState],
    origin: Vector,
) -> BTreeSet<usize> {
    let places: BTreeMap<i64, usize> = map
        .lanes
        .iter()
        .enumerate()
        .map(|(i, lane)| (lane.id, i))
        .collect();
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

/// The lights of the first `count` steps, by connector.
pub(super) fn lights(
    map: &LaneMap,
    steps: &[DynamicMapState],
    count: usize,
    origin: Vector,
) -> Vec<Arc<TrafficLights>> {
    let observed: Vec<Vec<(LaneId, SignalStatus)>> = (0..count)
        .map(|step| {
            let states = steps
                .get(step)
                .into_iter()
                .flat_map(|step| &step.lane_states);
            states
                .flat_map(|light| {
                    connectors_of(map, light, origin)
                        .into_iter()
                        .map(|id| (id, status(light)))
                })
                .collect()
        })
        .collect();
    let ever: BTreeSet<LaneId> = observed.iter().flatten().map(|&(id, _)| id).collect();
    let unknown = ever.iter().map(|&id| (id, SignalStatus::Unknown));
    observed
        .iter()
        .map(|now| Arc::new(unknown.clone().chain(now.iter().copied()).collect()))
        .collect()
}

fn connectors_of(map: &LaneMap, light: &TrafficSignalLaneState, origin: Vector) -> Vec<LaneId> {
    let Some(id) = map.lane_by_source(light.lane) else {
        return Vec::new();
    };
    let lane = &map[id];
    if lane.kind == LaneKind::Connector {
        return vec![id];
    }
    if stands_at_end(
        light,
        lane.centerline.start(),
        lane.centerline.end(),
        origin,
    ) {
        return lane
            .outgoing
            .iter()
            .copied()
            .filter(|&next| map[next].is_connector())
            .collect();
    }
    Vec::new()
}

fn status(light: &TrafficSignalLaneState) -> SignalStatus {
    match SignalState::try_from(light.state) {
        Ok(SignalState::Go | SignalState::ArrowGo) => SignalStatus::Green,
        Ok(SignalState::Caution | SignalState::ArrowCaution) => SignalStatus::Yellow,
        Ok(SignalState::Stop | SignalState::ArrowStop) => SignalStatus::Red,
        Ok(SignalState::Unknown | SignalState::FlashingStop | SignalState::FlashingCaution)
        | Err(_) => SignalStatus::Unknown,
    }
}

/// Stop lines of all lights and stop signs. `lit` are the connectors with a light.
pub(super) fn stop_lines(
    map: &MapFeatures,
    connector: &[bool],
    lit: &BTreeSet<usize>,
) -> Vec<StopLine> {
    let signed = map.signs.iter().flat_map(|sign| &sign.lanes).copied();
    let wanted: BTreeSet<(bool, usize)> = lit
        .iter()
        .map(|&lane| (false, lane))
        .chain(signed.map(|lane| (true, lane)))
        .collect();
    let mut lines: Vec<(Pose, StopLine)> = Vec::new();
    for (stop_sign, lane) in wanted.into_iter().filter(|&(_, lane)| connector[lane]) {
        let at = map.lanes[lane].trace.line.pose_at(0.0);
        // Connectors that fork from one lane begin at one place, where there is one line.
        match lines
            .iter_mut()
            .find(|(pose, line)| line.stop_sign == stop_sign && same_place(*pose, at))
        {
            Some((_, line)) => line.lanes.push(LaneId(lane as u32)),
            None => lines.push((
                at,
                StopLine {
                    polygon: across(at),
                    lanes: vec![LaneId(lane as u32)],
                    stop_sign,
                },
            )),
        }
    }
    lines.into_iter().map(|(_, line)| line).collect()
}

fn same_place(a: Pose, b: Pose) -> bool {
    /// Meters.
    const SAME: f64 = 0.5;
    a.distance(&b) < SAME
}

fn across(at: Pose) -> planagent_world::geometry::Polygon {
    /// Thickness of a painted stop line, meters.
    const THICKNESS: f64 = 0.5;
    OrientedBox::new(at, THICKNESS, 2.0 * DEFAULT_HALF).to_polygon()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrows_equal_plain_lights_and_flashing_ones_are_unknown() {
        let shown = |state: SignalState| {
            status(&TrafficSignalLaneState {
                lane: 1,
                state: state as i32,
                stop_point: None,
            })
        };
        assert_eq!(shown(SignalState::ArrowGo), SignalStatus::Green);
        assert_eq!(shown(SignalState::Caution), SignalStatus::Yellow);
        assert_eq!(shown(SignalState::ArrowStop), SignalStatus::Red);
        assert_eq!(shown(SignalState::FlashingStop), SignalStatus::Unknown);
        let strange = TrafficSignalLaneState {
            lane: 1,
            state: 99,
            stop_point: None,
        };
        assert_eq!(status(&strange), SignalStatus::Unknown);
    }
}
