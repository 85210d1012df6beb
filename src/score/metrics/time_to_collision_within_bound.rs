//! `time_to_collision_within_bound`: whether a collision was ever less than 0.95 s away at constant
//! velocities.

use super::collision::{Collision, in_collision, is_ahead, is_behind};
use super::corners::DrivenLanes;
use super::{MetricList, MetricResult, MetricSpec, Statistic, StatisticKind, TimeSeries};
use planagent_world::geometry::{OrientedBox, Pose, Vector};
use planagent_world::{EgoState, HistorySample, LaneMap, TrackToken, TrackedObject};
use std::collections::BTreeMap;

/// Step of the projection, seconds (devkit `time_to_collision_within_bound_statistics.yaml`).
pub(crate) const TTC_STEP_S: f64 = 0.1;
/// Length of the projection, seconds.
pub const TTC_HORIZON_S: f64 = 3.0;
/// The time to collision must be longer than this, seconds.
pub(crate) const MIN_TIME_TO_COLLISION: f64 = 0.95;
/// An ego up to this speed has no time to collision, m/s.
const STOPPED_SPEED: f64 = 5e-3;

pub(super) const SPEC: MetricSpec = MetricSpec::new("time_to_collision_within_bound", |input| {
    let simulation = &input.simulation;
    let ttc = time_to_collision(
        simulation.map,
        simulation.samples,
        input.lanes(),
        input.collisions(),
        TTC_HORIZON_S,
    );
    Ok(Some(time_to_collision_within_bound(
        input.states(),
        ttc,
        TTC_HORIZON_S,
    )))
})
.only(MetricList::ClosedLoop)
.weight(5.0)
.truth_value()
.bounds(Some(MIN_TIME_TO_COLLISION), None)
.label("TTC");

/// A box that moves along its heading.
#[derive(Debug, Clone, Copy)]
struct Moving {
    shape: OrientedBox,
    velocity: Vector,
}

impl Moving {
    fn new(shape: OrientedBox, speed: f64) -> Self {
        Self {
            shape,
            velocity: shape.center.direction() * speed,
        }
    }

    fn after(&self, seconds: f64) -> OrientedBox {
        let moved = self.shape.center.position() + self.velocity * seconds;
        self.shape
            .moved_to(Pose::at(moved, self.shape.center.heading))
    }

    /// The area that the box sweeps in that time, as one longer box.
    fn swept(&self, seconds: f64) -> OrientedBox {
        let half_way = self.after(seconds / 2.0);
        OrientedBox {
            length: half_way.length + self.velocity.norm() * seconds,
            ..half_way
        }
    }
}

/// Time to collision at every sample, seconds; infinite without a collision within `horizon`
/// seconds, 0 at an at-fault collision.
pub fn time_to_collision(
    map: &LaneMap,
    samples: &[HistorySample],
    lanes: &DrivenLanes,
    collisions: &[Collision],
    horizon: f64,
) -> Vec<f64> {
    let collided_at: BTreeMap<TrackToken, usize> =
        collisions.iter().map(|c| (c.token, c.sample)).collect();
    let at_sample = |(i, sample): (usize, &HistorySample)| {
        if collisions.iter().any(|c| c.sample == i && c.at_fault) {
            return 0.0;
        }
        let ego = &sample.ego;
        if ego.speed() <= STOPPED_SPEED {
            return f64::INFINITY;
        }
        let sideways = !lanes.in_common(i) || map.in_intersection(ego.rear_axle.position());
        let tracks = sample.objects.iter().filter(|track| {
            collided_at.get(&track.token).is_none_or(|&first| first > i)
                && is_relevant(ego, track, sideways)
        });
        first_contact(ego, tracks, horizon)
    };
    samples.iter().enumerate().map(at_sample).collect()
}

/// Tracks ahead count; those beside count while the ego is in multiple lanes, off the road or in an
/// intersection.
fn is_relevant(ego: &EgoState, track: &TrackedObject, sideways: bool) -> bool {
    let center = track.shape.center.position();
    is_ahead(ego.rear_axle, center) || (sideways && !is_behind(ego.rear_axle, center))
}

fn first_contact<'a>(
    ego: &EgoState,
    tracks: impl Iterator<Item = &'a TrackedObject>,
    horizon: f64,
) -> f64 {
    let own = Moving::new(ego.footprint(), ego.speed());
    let own_swept = own.swept(horizon);
    let near: Vec<Moving> = tracks
        .map(|track| {
            Moving::new(
                track.shape,
                if track.kind.is_agent() {
                    track.speed()
                } else {
                    0.0
                },
            )
        })
        .filter(|track| in_collision(&own_swept, &track.swept(horizon)))
        .collect();
    if near.is_empty() {
        return f64::INFINITY;
    }
    // The horizon itself is not reached, and the present not tested: numpy.arange(step, horizon,
    // step).
    let steps = ((horizon - TTC_STEP_S) / TTC_STEP_S).ceil() as usize;
    (1..=steps)
        .map(|step| step as f64 * TTC_STEP_S)
        .find(|&time| {
            let own = own.after(time);
            near.iter()
                .any(|track| in_collision(&own, &track.after(time)))
        })
        .unwrap_or(f64::INFINITY)
}

/// 1 when all times to collision (one a state) are longer than [`MIN_TIME_TO_COLLISION`], else 0.
pub fn time_to_collision_within_bound(
    states: &[EgoState],
    ttc: Vec<f64>,
    horizon: f64,
) -> MetricResult {
    let within = ttc.iter().all(|&t| t > MIN_TIME_TO_COLLISION);
    let least = ttc.iter().copied().fold(f64::INFINITY, f64::min);
    let statistics = vec![Statistic::new(
        StatisticKind::Min,
        "min_time_to_collision",
        "seconds",
        least,
    )];
    let unit = format!("time_to_collision_under_{horizon:.1}_seconds [s]");
    SPEC.judged(within, statistics)
        .with_series(TimeSeries::of_states(unit, states, ttc))
}
