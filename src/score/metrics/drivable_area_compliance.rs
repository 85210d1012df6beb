//! `drivable_area_compliance`: 0 when a corner of the ego leaves the drivable area by 0.3 m or
//! more.

use super::corners::DrivenLanes;
use super::{MetricList, MetricResult, MetricSpec, Statistic, TimeSeries};
use planagent_world::geometry::Point;
use planagent_world::{EgoState, LaneId, LaneMap};

/// A corner may be outside by less than this, meters (devkit
/// `drivable_area_compliance_statistics.yaml`).
pub(crate) const MAX_DISTANCE_OUTSIDE: f64 = 0.3;

pub(super) const SPEC: MetricSpec = MetricSpec::new("drivable_area_compliance", |input| {
    Ok(Some(drivable_area_compliance(
        input.simulation.map,
        input.states(),
        input.lanes(),
    )))
})
.only(MetricList::ClosedLoop)
.multiplier()
.truth_value()
.label("area");
/// nuPlan's second result of the same metric.
pub(super) const CORNERS: MetricSpec = MetricSpec::new("corners_in_drivable_area", |input| {
    Ok(Some(corners_in_drivable_area(
        input.simulation.map,
        input.states(),
        input.lanes(),
    )))
})
.only(MetricList::ClosedLoop)
.bounds(Some(1.0), None);

/// 0 when a corner is outside by [`MAX_DISTANCE_OUTSIDE`] or more, else 1.
pub fn drivable_area_compliance(
    map: &LaneMap,
    states: &[EgoState],
    lanes: &DrivenLanes,
) -> MetricResult {
    let mut samples = corners_outside(map, states, lanes).zip(&lanes.center);
    let complies = samples
        .all(|(corners, center_lanes)| !corners.iter().any(|&at| is_far(map, center_lanes, at)));
    SPEC.judged(complies, vec![])
}

/// Whether all corners are inside, without tolerance and without score.
pub fn corners_in_drivable_area(
    map: &LaneMap,
    states: &[EgoState],
    lanes: &DrivenLanes,
) -> MetricResult {
    let inside =
        corners_outside(map, states, lanes).map(|corners| f64::from(u8::from(corners.is_empty())));
    let values: Vec<f64> = inside.collect();
    let all_inside = Statistic::boolean(CORNERS.name, values.iter().all(|&inside| inside > 0.0));
    let result = CORNERS
        .unscored(vec![all_inside])
        .with_series(TimeSeries::of_states("boolean", states, values));
    MetricResult {
        computator: SPEC.name.to_owned(),
        ..result
    }
}

/// The corners outside of the drivable area at each sample.
fn corners_outside(
    map: &LaneMap,
    states: &[EgoState],
    lanes: &DrivenLanes,
) -> impl Iterator<Item = Vec<Point>> {
    states
        .iter()
        .zip(&lanes.corners)
        .map(|(state, corner_lanes)| {
            let corners = state.footprint().corners().into_iter().zip(corner_lanes);
            let outside =
                corners.filter(|(corner, lanes)| lanes.is_empty() && !map.is_drivable(*corner));
            outside.map(|(corner, _)| corner).collect()
        })
}

fn is_far(map: &LaneMap, center_lanes: &[LaneId], corner: Point) -> bool {
    let near_lane = center_lanes
        .iter()
        .any(|&id| map[id].polygon.distance_to(corner) < MAX_DISTANCE_OUTSIDE);
    let near_area = || {
        map.distance_to_drivable(corner, MAX_DISTANCE_OUTSIDE)
            .is_some_and(|d| d < MAX_DISTANCE_OUTSIDE)
    };
    !near_lane && !near_area()
}
