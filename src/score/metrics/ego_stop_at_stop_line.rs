//! `ego_stop_at_stop_line`: whether the ego, first in its lane, stood when its front was nearest to
//! a stop line (devkit `scenario_dependent/ego_stop_at_stop_line.py`). No list of nuPlan's
//! challenges has it, and it has no score here; nuPlan's is always 1.

use super::route::lanes_at;
use super::{
    MetricCategory, MetricList, MetricResult, MetricSpec, Statistic, StatisticKind, TimeSeries,
};
use planagent_world::dynamics::ProgressPath;
use planagent_world::geometry::{Corridor, Point, Polyline, Pose};
use planagent_world::{HistorySample, LaneId, LaneMap, PACIFICA, StopLine, StopLineId};

/// A stop is nearer to the line than this, meters (devkit `ego_stop_at_stop_line_statistics.yaml`).
const DISTANCE_THRESHOLD: f64 = 5.0;
/// A slower ego stands, m/s.
const VELOCITY_THRESHOLD: f64 = 0.1;

pub(super) const SPEC: MetricSpec = MetricSpec::new("ego_stop_at_stop_line", |input| {
    Ok(ego_stop_at_stop_line(
        input.simulation.map,
        input.simulation.samples,
    ))
})
.only(MetricList::ClosedLoop)
.category(MetricCategory::ScenarioDependent);

/// The samples at which the front edge of the ego is on one stop line.
struct Approach {
    stop_line: StopLineId,
    samples: Vec<usize>,
    speeds: Vec<f64>,
    /// Distance of the front edge from the first edge of the line's polygon, meters.
    distances: Vec<f64>,
}

impl Approach {
    /// Distance and speed where the ego was nearest to the line.
    fn nearest(&self) -> (f64, f64) {
        let pairs = self
            .distances
            .iter()
            .copied()
            .zip(self.speeds.iter().copied());
        pairs
            .min_by(|a, b| a.0.total_cmp(&b.0))
            .unwrap_or((f64::INFINITY, f64::NAN))
    }

    fn stopped(&self) -> bool {
        let (distance, speed) = self.nearest();
        distance < DISTANCE_THRESHOLD && speed < VELOCITY_THRESHOLD
    }
}

/// Evaluates every stop line that the ego reached as the first of its lane; `None` without one, as
/// in nuPlan.
pub fn ego_stop_at_stop_line(map: &LaneMap, samples: &[HistorySample]) -> Option<MetricResult> {
    let approaches = approaches(map, samples);
    if approaches.is_empty() {
        return None;
    }
    let mean = |read: fn(&Approach) -> f64| {
        approaches.iter().map(read).sum::<f64>() / approaches.len() as f64
    };
    let stops = approaches
        .iter()
        .filter(|approach| approach.stopped())
        .count();
    let value =
        |name: &str, unit: &str, value| Statistic::new(StatisticKind::Value, name, unit, value);
    let statistics = vec![
        Statistic::count("number_of_ego_stop_before_stop_line", stops),
        Statistic::count("number_of_ego_before_stop_line", approaches.len()),
        value(
            "mean_ego_min_distance_to_stop_line",
            "meters",
            mean(|a| a.nearest().0),
        ),
        // nuPlan's word for this unit of speed.
        value(
            "mean_ego_min_velocity_before_stop_line",
            "meters_per_second_squared",
            mean(|a| a.nearest().1),
        ),
    ];
    let frames: Vec<usize> = approaches
        .iter()
        .flat_map(|a| a.samples.iter().copied())
        .collect();
    let series = TimeSeries {
        unit: "meters_per_second_squared".to_owned(),
        time_stamps: frames.iter().map(|&i| samples[i].ego.time_us).collect(),
        values: approaches
            .iter()
            .flat_map(|a| a.speeds.iter().copied())
            .collect(),
        selected_frames: Some(frames),
    };
    Some(SPEC.unscored(statistics).with_series(series))
}

/// The samples with the front edge on a stop line and no lead agent, joined while the line stays
/// the same.
fn approaches(map: &LaneMap, samples: &[HistorySample]) -> Vec<Approach> {
    let mut found: Vec<Approach> = Vec::new();
    for (i, sample) in samples.iter().enumerate() {
        let footprint = sample.ego.footprint();
        let Ok(front) = Polyline::new(footprint.front_edge()) else {
            continue;
        };
        let Some((stop_line, shape)) = nearest_stop_line(map, &front, footprint.center) else {
            continue;
        };
        if !shape.polygon.meets_line(&front) || has_lead_agent(map, sample) {
            continue;
        }
        // nuPlan's stop polygon begins with the edge that vehicles stop at; the distance is to that
        // edge.
        let Ok(line) = Polyline::new(shape.polygon.ring().iter().copied().take(2)) else {
            continue;
        };
        if found.last().is_none_or(|last| last.stop_line != stop_line) {
            found.push(Approach {
                stop_line,
                samples: vec![],
                speeds: vec![],
                distances: vec![],
            });
        }
        if let Some(open) = found.last_mut() {
            open.samples.push(i);
            open.speeds.push(sample.ego.speed());
            open.distances.push(line.distance_to_line(&front));
        }
    }
    found
}

/// The lane, not connector, that contains a point.
fn lane_at(map: &LaneMap, point: Point, pose: Pose) -> Option<LaneId> {
    lanes_at(map, point, pose)
        .into_iter()
        .next()
        .filter(|&lane| !map[lane].is_connector())
}

/// The stop line nearest to the middle of the front edge, if that middle is in a lane and the line
/// crosses this lane.
fn nearest_stop_line<'m>(
    map: &'m LaneMap,
    front: &Polyline,
    pose: Pose,
) -> Option<(StopLineId, &'m StopLine)> {
    let middle = front.point_at(front.length() / 2.0);
    let lane = lane_at(map, middle, pose)?;
    let nearest = map.nearest_stop_line(middle)?;
    let line = &map[nearest];
    line.polygon
        .overlaps(&map[lane].polygon)
        .then_some((nearest, line))
}

/// Whether an object is on the strip, as wide as the ego, from its center to the end of its lane.
/// (nuPlan fails where the front is in a lane and the center is not; here there is no lead agent.)
fn has_lead_agent(map: &LaneMap, sample: &HistorySample) -> bool {
    let center = sample.ego.center();
    let Some(lane) = lane_at(map, center.position(), center) else {
        return false;
    };
    let baseline = &map[lane].centerline;
    let Some(path) = ProgressPath::new(&baseline.vertex_poses()) else {
        return false;
    };
    let ahead = path.between(baseline.project(center.position()).s, path.length());
    let Ok(line) = Polyline::new(ahead.iter().map(Pose::position)) else {
        return false;
    };
    let strip = Corridor::new(line, PACIFICA.width / 2.0);
    sample
        .objects
        .iter()
        .any(|object| strip.meets_box(&object.shape))
}
