//! The input of the metrics, and their computation in nuPlan's order.

use super::comfort::ComfortQuantity;
use super::corners::DrivenLanes;
use super::{
    FRAMES_PER_SECOND, MetricList, MetricResult, Score, ScoreError, TTC_HORIZON_S, compare_with_expert,
    drivable_area_compliance, driving_direction_compliance, ego_expert_l2_error, ego_expert_l2_error_with_yaw,
    ego_is_comfortable, ego_is_making_progress, ego_lane_change, ego_mean_speed, ego_progress_along_expert_route,
    ego_stop_at_stop_line, find_collisions, no_ego_at_fault_collisions,
    planner_expert_average_heading_error_within_bound, planner_expert_average_l2_error_within_bound,
    planner_expert_final_heading_error_within_bound, planner_expert_final_l2_error_within_bound,
    planner_miss_rate_within_bound, speed_limit_compliance, time_to_collision, time_to_collision_within_bound,
};
use crate::world::{EgoState, HistorySample, LaneMap, MICROS_PER_SECOND, Trajectory, TrajectoryError};

/// What the closed-loop metrics judge.
#[derive(Debug, Clone, Copy)]
pub struct EvaluatedSimulation<'a> {
    /// The map.
    pub map: &'a LaneMap,
    /// The simulated samples in order of time: N−1 of them, iteration 0 included.
    pub samples: &'a [HistorySample],
    /// What the recorded driver did: N states, from iteration 0 on.
    pub expert: &'a [EgoState],
}

/// What the open-loop metrics judge.
#[derive(Debug, Clone, Copy)]
pub struct EvaluatedPlans<'a> {
    /// The samples in order of time: N−1 of them, iteration 0 included. The ego in them is the recorded one.
    pub samples: &'a [HistorySample],
    /// What the planner wanted at each of them.
    pub trajectories: &'a [Trajectory],
    /// What the recorded driver did: N states, from iteration 0 on.
    pub expert: &'a [EgoState],
    /// What the recorded driver did after that, as far as it is recorded, at the same rate.
    pub future: &'a [EgoState],
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
    /// The expert trajectory does not belong to the drive: it must have as many states, or one more.
    #[error("the expert trajectory has {expert} states beside {samples} samples of the drive")]
    ExpertLength {
        /// How many samples the drive has.
        samples: usize,
        /// How many states the expert trajectory has.
        expert: usize,
    },
    /// Not as many trajectories as samples.
    #[error("the drive has {samples} samples and {trajectories} trajectories")]
    TrajectoryCount {
        /// How many samples.
        samples: usize,
        /// How many trajectories.
        trajectories: usize,
    },
    /// A trajectory does not cover the times at which it is compared.
    #[error("the trajectory of sample {sample} cannot be compared with the recorded drive")]
    Trajectory {
        /// Which sample.
        sample: usize,
        /// Why.
        source: TrajectoryError,
    },
    /// A trajectory ends too early.
    #[error("the plan of sample {sample} ends {:.1} s ahead; open-loop metrics compare plans 8 s ahead and need more than 7 s", *reach_us as f64 / MICROS_PER_SECOND)]
    TrajectoryTooShort {
        /// Which sample.
        sample: usize,
        /// How far ahead of the sample it ends, µs.
        reach_us: i64,
    },
    /// The recording ends too early for any comparison.
    #[error("{recorded_s} s are recorded from the start of the scenario on; open-loop metrics need {needed_s}")]
    NoRecordedFuture {
        /// How many seconds there are.
        recorded_s: usize,
        /// How many are needed.
        needed_s: usize,
    },
    /// A metric gave no score.
    #[error(transparent)]
    Score(#[from] ScoreError),
}

/// Samples that the yaw-acceleration filter needs: one more than its order 3.
const MIN_SAMPLES: usize = 4;

/// Refuses what no metric can judge.
fn check(states: &[EgoState], expert: &[EgoState]) -> Result<(), MetricError> {
    if states.len() < MIN_SAMPLES {
        return Err(MetricError::TooFewSamples { got: states.len(), needed: MIN_SAMPLES });
    }
    if expert.is_empty() {
        return Err(MetricError::NoExpert);
    }
    if let Some(before) = states.windows(2).position(|w| w[1].time_us <= w[0].time_us) {
        let index = before + 1;
        return Err(MetricError::TimeNotIncreasing { index, time_us: states[index].time_us });
    }
    for (whose, states) in [("ego", states), ("expert", expert)] {
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

/// All results of a drive.
#[derive(Debug, Clone, PartialEq)]
pub struct Evaluation {
    /// The score.
    pub score: Score,
    /// Every metric in nuPlan's order of computation: the common ones, the low-level ones, then the scored ones.
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
pub fn evaluate(drive: &EvaluatedSimulation<'_>) -> Result<Evaluation, MetricError> {
    let states: Vec<EgoState> = drive.samples.iter().map(|sample| sample.ego).collect();
    check(&states, drive.expert)?;
    let map = drive.map;
    let lanes = DrivenLanes::of(map, &states);

    let mut metrics = common_metrics(&states, drive.expert)?;
    metrics.push(ego_lane_change(map, &states, &lanes));
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
    metrics.extend(ego_stop_at_stop_line(map, drive.samples));
    Ok(Evaluation { score: Score::of(MetricList::ClosedLoop, &metrics)?, metrics })
}

/// Judges the plans of a drive with nuPlan's open-loop metrics.
///
/// # Errors
/// When the drive is too short, has no expert, times that do not grow, numbers that are not finite, or plans that reach less
/// than 7 s ahead.
pub fn evaluate_open_loop(drive: &EvaluatedPlans<'_>) -> Result<Evaluation, MetricError> {
    let states: Vec<EgoState> = drive.samples.iter().map(|sample| sample.ego).collect();
    check(&states, drive.expert)?;
    let (samples, trajectories) = (states.len(), drive.trajectories.len());
    if trajectories != samples {
        return Err(MetricError::TrajectoryCount { samples, trajectories });
    }
    let errors = compare_with_expert(drive.trajectories, drive.expert, drive.future, FRAMES_PER_SECOND)?;
    let mut metrics = common_metrics(&states, drive.expert)?;
    metrics.push(planner_expert_average_l2_error_within_bound(&errors));
    metrics.push(planner_expert_final_l2_error_within_bound(&errors));
    metrics.push(planner_miss_rate_within_bound(&errors));
    metrics.push(planner_expert_final_heading_error_within_bound(&errors));
    metrics.push(planner_expert_average_heading_error_within_bound(&errors));
    Ok(Evaluation { score: Score::of(MetricList::OpenLoop, &metrics)?, metrics })
}

/// nuPlan's `common_metrics.yaml`, which its challenges leave to the user: about any drive, without score.
fn common_metrics(states: &[EgoState], expert: &[EgoState]) -> Result<Vec<MetricResult>, MetricError> {
    Ok(vec![
        ego_mean_speed(states),
        ego_expert_l2_error(states, expert)?,
        ego_expert_l2_error_with_yaw(states, expert)?,
    ])
}
