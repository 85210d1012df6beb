//! The input of the metrics, and their computation in nuPlan's order.

use super::comfort::{ComfortQuantity, ego_is_comfortable};
use super::corners::DrivenLanes;
use super::{
    MetricResult, Score, ScoreError, TTC_HORIZON_S, drivable_area_compliance, driving_direction_compliance,
    ego_is_making_progress, ego_lane_change, ego_progress_along_expert_route, find_collisions,
    no_ego_at_fault_collisions, speed_limit_compliance, time_to_collision, time_to_collision_within_bound,
};
use crate::world::{EgoState, HistorySample, LaneMap};

/// What the metrics judge.
#[derive(Debug, Clone, Copy)]
pub struct Drive<'a> {
    /// The map.
    pub map: &'a LaneMap,
    /// The simulated samples in order of time: N−1 of them, iteration 0 included.
    pub samples: &'a [HistorySample],
    /// What the recorded driver did: N states, from iteration 0 on.
    pub expert: &'a [EgoState],
}

/// Why a drive cannot be judged.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MetricError {
    /// Fewer samples than the smoothing filters need.
    #[error("the metrics need at least {needed} samples, got {got}")]
    TooFewSamples {
        /// How many there are.
        got: usize,
        /// How many are needed.
        needed: usize,
    },
    /// No expert trajectory.
    #[error("the drive has no expert trajectory")]
    NoExpert,
    /// Times do not grow.
    #[error("time of sample {index} ({time_us} µs) does not lie after its predecessor")]
    TimeNotIncreasing {
        /// Which sample.
        index: usize,
        /// Its time, µs.
        time_us: i64,
    },
    /// A pose, speed or acceleration is NaN or infinite.
    #[error("the {whose} state {index} is not finite")]
    NotFinite {
        /// Whose state: `ego`, `expert`.
        whose: &'static str,
        /// Which one.
        index: usize,
    },
    /// A metric gave no score.
    #[error(transparent)]
    Score(#[from] ScoreError),
}

/// Samples that the yaw-acceleration filter needs: one more than its order 3.
const MIN_SAMPLES: usize = 4;

impl Drive<'_> {
    fn check(&self, states: &[EgoState]) -> Result<(), MetricError> {
        if states.len() < MIN_SAMPLES {
            return Err(MetricError::TooFewSamples { got: states.len(), needed: MIN_SAMPLES });
        }
        if self.expert.is_empty() {
            return Err(MetricError::NoExpert);
        }
        if let Some(before) = states.windows(2).position(|w| w[1].time_us <= w[0].time_us) {
            let index = before + 1;
            return Err(MetricError::TimeNotIncreasing { index, time_us: states[index].time_us });
        }
        for (whose, states) in [("ego", states), ("expert", self.expert)] {
            let finite = |s: &EgoState| {
                s.rear_axle.is_finite()
                    && s.velocity.norm().is_finite()
                    && s.acceleration.norm().is_finite()
                    && (s.angular_velocity + s.angular_acceleration).is_finite()
            };
            if let Some(index) = states.iter().position(|s| !finite(s)) {
                return Err(MetricError::NotFinite { whose, index });
            }
        }
        Ok(())
    }
}

/// All results of a drive.
#[derive(Debug, Clone, PartialEq)]
pub struct Evaluation {
    /// The score.
    pub score: Score,
    /// Every metric in nuPlan's order of computation: the low-level ones, then the scored ones.
    pub metrics: Vec<MetricResult>,
}

impl Evaluation {
    /// A metric by nuPlan's name.
    pub fn metric(&self, name: &str) -> Option<&MetricResult> {
        self.metrics.iter().find(|m| m.name == name)
    }
}

/// Judges a drive with nuPlan's closed-loop metrics.
///
/// # Errors
/// When the drive is too short, has no expert, times that do not grow, or numbers that are not finite.
pub fn evaluate(drive: &Drive<'_>) -> Result<Evaluation, MetricError> {
    let states: Vec<EgoState> = drive.samples.iter().map(|sample| sample.ego).collect();
    drive.check(&states)?;
    let map = drive.map;
    let lanes = DrivenLanes::of(map, &states);

    let mut metrics = vec![ego_lane_change(map, &states, &lanes)];
    for quantity in ComfortQuantity::ALL {
        metrics.push(quantity.evaluate(&states)?);
    }
    let progress = ego_progress_along_expert_route(map, &states, drive.expert);
    let ratio = progress.score.unwrap_or(0.0);
    metrics.push(progress);
    metrics.extend(drivable_area_compliance(map, &states, &lanes));
    let collisions = find_collisions(drive.samples, &lanes);
    metrics.push(no_ego_at_fault_collisions(&collisions));
    let ttc = time_to_collision(map, drive.samples, &lanes, &collisions, TTC_HORIZON_S);
    metrics.push(time_to_collision_within_bound(&states, ttc, TTC_HORIZON_S));
    metrics.push(speed_limit_compliance(map, &states, &lanes.center));
    metrics.push(ego_is_comfortable(&states)?);
    metrics.push(ego_is_making_progress(ratio));
    metrics.push(driving_direction_compliance(map, &states, &lanes.center));
    Ok(Evaluation { score: Score::of(&metrics)?, metrics })
}
