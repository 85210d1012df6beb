//! Planned trajectories against the expert's, second by second (devkit
//! `planner_expert_average_l2_error_within_bound.py`, `expert_comparisons.py`, `metric_base.py`).

use super::MetricError;
use planagent_world::geometry::{Pose, wrap_angle};
use planagent_world::{EgoState, PACIFICA, Trajectory, TrajectoryError, TrajectoryState};

/// Horizons of the comparison, seconds (devkit `comparison_horizon`).
pub(crate) const COMPARISON_HORIZONS_S: [usize; 3] = [3, 5, 8];
const FARTHEST_S: usize = COMPARISON_HORIZONS_S[2];
/// Frames of a scenario in one second. The comparison runs at 1 Hz (devkit `comparison_frequency`).
pub(crate) const FRAMES_PER_SECOND: usize = 10;

/// The errors of one planned trajectory within one horizon. Positions are box centers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HorizonErrors {
    /// Mean distance, meters.
    pub average_displacement: f64,
    /// Largest distance, meters.
    pub maximum_displacement: f64,
    /// Distance at the end of the horizon, meters.
    pub final_displacement: f64,
    /// Mean angle between the headings, radians.
    pub average_heading: f64,
    /// Angle between the headings at the end of the horizon, radians.
    pub final_heading: f64,
}

/// The errors of a simulation: one entry a second, each with one value per horizon of
/// [`COMPARISON_HORIZONS_S`].
#[derive(Debug, Clone, PartialEq)]
pub struct PlannerExpertErrors {
    /// Indices of the compared samples.
    pub frames: Vec<usize>,
    /// Times of these samples, µs.
    pub time_stamps: Vec<i64>,
    /// Errors at these samples.
    pub errors: Vec<[HorizonErrors; 3]>,
}

impl PlannerExpertErrors {
    /// One error of all frames within a horizon (an index into [`COMPARISON_HORIZONS_S`]).
    pub(super) fn within(
        &self,
        horizon: usize,
        read: fn(&HorizonErrors) -> f64,
    ) -> impl Iterator<Item = f64> {
        self.errors
            .iter()
            .map(move |of_frame| read(&of_frame[horizon]))
    }
}

pub(super) fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0usize), |(sum, count), value| {
        (sum + value, count + 1)
    });
    sum / count as f64
}

/// Compares the trajectories (one a sample) with the expert. `expert` runs from iteration 0 to the
/// end of the scenario and `future` holds the recording after it, both with `frames_per_second`
/// states a second.
///
/// As in nuPlan, a trajectory that ends less than a second before the farthest horizon is compared
/// at its own end. nuPlan's logs continue after every scenario; here seconds whose next eight are
/// not recorded are left out, and the time series names those that count. One quirk is kept: nuPlan
/// counts the last state of a scenario twice when it lies on a full second.
pub fn compare_with_expert(
    trajectories: &[Trajectory],
    expert: &[EgoState],
    future: &[EgoState],
    frames_per_second: usize,
) -> Result<PlannerExpertErrors, MetricError> {
    let frames: Vec<usize> = (0..trajectories.len()).step_by(frames_per_second).collect();
    let recorded = sampled(
        expert,
        future,
        frames.last().copied().unwrap_or(0),
        frames_per_second,
    );
    let mut found = PlannerExpertErrors {
        frames: Vec::new(),
        time_stamps: Vec::new(),
        errors: Vec::new(),
    };
    for (second, &frame) in frames.iter().enumerate() {
        // Later seconds reach even farther beyond the recording, so the loop ends here.
        let Some(ahead) = recorded.get(second..=second + FARTHEST_S) else {
            break;
        };
        let at_frame = |source| MetricError::Trajectory {
            sample: frame,
            source,
        };
        let (planned, driven) = compared_poses(&trajectories[frame], ahead).map_err(at_frame)?;
        if planned.len() != driven.len() {
            let reach_us = trajectories[frame].end_us() - ahead[0].time_us;
            return Err(MetricError::TrajectoryTooShort {
                sample: frame,
                reach_us,
            });
        }
        found.frames.push(frame);
        found.time_stamps.push(ahead[0].time_us);
        found.errors.push(
            COMPARISON_HORIZONS_S.map(|horizon| errors(&planned[..horizon], &driven[..horizon])),
        );
    }
    if found.errors.is_empty() {
        let recorded_s = (expert.len() + future.len()).saturating_sub(1) / frames_per_second;
        return Err(MetricError::NoRecordedFuture {
            recorded_s,
            needed_s: FARTHEST_S,
        });
    }
    Ok(found)
}

/// The recorded states of the comparison: every second of the scenario, then eight more after its
/// last compared frame.
fn sampled<'a>(
    expert: &'a [EgoState],
    future: &'a [EgoState],
    last: usize,
    step: usize,
) -> Vec<&'a EgoState> {
    let after = (1..=FARTHEST_S).map_while(|second| {
        let index = last + second * step;
        expert
            .get(index)
            .or_else(|| future.get(index - expert.len()))
    });
    expert.iter().step_by(step).chain(after).collect()
}

/// Centers of planner and expert at the eight seconds after the first of `ahead`.
fn compared_poses(
    trajectory: &Trajectory,
    ahead: &[&EgoState],
) -> Result<(Vec<Pose>, Vec<Pose>), TrajectoryError> {
    let center = |state: &TrajectoryState| {
        state
            .rear_axle
            .translated(PACIFICA.rear_axle_to_center(), 0.0)
    };
    let end_us = trajectory.end_us();
    let covered = ahead.iter().filter(|state| state.time_us <= end_us);
    let mut planned: Vec<Pose> = covered
        .map(|state| trajectory.at(state.time_us).map(|s| center(&s)))
        .collect::<Result<_, _>>()?;
    let mut driven: Vec<Pose> = ahead[1..].iter().map(|state| state.center()).collect();
    if planned.len() < ahead.len() {
        planned.push(center(&trajectory.at(end_us)?));
        let mut states: Vec<TrajectoryState> = ahead
            .iter()
            .map(|&state| TrajectoryState::from(state))
            .collect();
        states.dedup_by_key(|state| state.time_us);
        driven.pop();
        driven.push(center(&Trajectory::new(states)?.at(end_us)?));
    }
    planned.remove(0);
    Ok((planned, driven))
}

fn errors(planned: &[Pose], driven: &[Pose]) -> HorizonErrors {
    let distances: Vec<f64> = planned
        .iter()
        .zip(driven)
        .map(|(p, d)| p.distance(d))
        .collect();
    let turns: Vec<f64> = planned
        .iter()
        .zip(driven)
        .map(|(p, d)| wrap_angle(p.heading - d.heading).abs())
        .collect();
    HorizonErrors {
        average_displacement: mean(distances.iter().copied()),
        maximum_displacement: distances.iter().copied().fold(0.0, f64::max),
        final_displacement: distances.last().copied().unwrap_or(f64::NAN),
        average_heading: mean(turns.iter().copied()),
        final_heading: turns.last().copied().unwrap_or(f64::NAN),
    }
}
