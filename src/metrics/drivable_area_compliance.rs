//! `drivable_area_compliance`: a multiplier that is 0 when a corner of the ego leaves the road by 0.3 m or more.

use super::corners::DrivenLanes;
use super::{MetricName, MetricResult, Statistic, TimeSeries};
use crate::geometry::Point;
use crate::world::{EgoState, LaneId, LaneMap};

/// Corners outside by less than this are tolerated, metres (devkit `drivable_area_compliance_statistics.yaml`).
pub const MAX_DISTANCE_OUTSIDE: f64 = 0.3;
/// nuPlan's name of the second result.
const CORNERS_NAME: &str = "corners_in_drivable_area";

/// Judges the corners of every sample. Gives two results: the scored metric, and `corners_in_drivable_area`, which
/// knows no tolerance and has no score.
pub fn drivable_area_compliance(map: &LaneMap, states: &[EgoState], lanes: &DrivenLanes) -> [MetricResult; 2] {
    let mut complies = true;
    let mut inside = Vec::with_capacity(states.len());
    for ((state, corner_lanes), center_lanes) in states.iter().zip(&lanes.corners).zip(&lanes.center) {
        let outside: Vec<Point> = state
            .footprint()
            .corners()
            .into_iter()
            .zip(corner_lanes)
            .filter(|&(corner, lanes)| lanes.is_empty() && !map.is_drivable(corner))
            .map(|(corner, _)| corner)
            .collect();
        complies &= !outside.iter().any(|&corner| is_far(map, center_lanes, corner));
        inside.push(outside.is_empty());
    }
    let metric = MetricName::DrivableAreaCompliance;
    let statistics = vec![Statistic::boolean(metric.as_str(), complies)];
    let scored = MetricResult::scored(metric, f64::from(u8::from(complies)), statistics);

    let all_inside = Statistic::boolean(CORNERS_NAME, inside.iter().all(|&ok| ok));
    let values = inside.iter().map(|&ok| f64::from(u8::from(ok))).collect();
    let corners = MetricResult {
        computator: metric.to_string(),
        ..MetricResult::unscored(CORNERS_NAME, metric.category(), vec![all_inside])
    };
    [scored, corners.with_series(TimeSeries::of_states("boolean", states, values))]
}

fn is_far(map: &LaneMap, center_lanes: &[LaneId], corner: Point) -> bool {
    let near_lane = center_lanes.iter().any(|&id| map[id].polygon.distance_to(corner) < MAX_DISTANCE_OUTSIDE);
    let near_area = || map.distance_to_drivable(corner, MAX_DISTANCE_OUTSIDE).is_some_and(|d| d < MAX_DISTANCE_OUTSIDE);
    !near_lane && !near_area()
}
