//! The simulated part of a recording, and the scenario that it becomes.
//!
//! The simulation starts at the first step with 2 s of history (1 s if the recording is shorter
//! than 12 s). It ends with the recording, after 15 s at most. The steps before it are the history.

use super::error::RecordingFault;
use super::route::route;
use crate::{Contents, FUTURE_FRAMES, Frame, Scenario, UNKNOWN_TYPE};
use planagent_world::geometry::Pose;
use planagent_world::{EgoState, LaneMap, MICROS_PER_SECOND, Route, TrackedObject, TrafficLights};
use std::ops::{Range, RangeInclusive};
use std::sync::Arc;

/// Shorter recordings have a shorter history, s.
const LONG_RECORDING: f64 = 12.0;
/// History of a long recording, s.
const LONG_HISTORY: f64 = 2.0;
/// History of a short recording, s.
const SHORT_HISTORY: f64 = 1.0;
/// Maximum duration of a simulation, s: nuPlan's scenario duration.
const MAX_DURATION: f64 = 15.0;
/// Half a step, s, since recorded times jitter.
const HALF_STEP: f64 = 0.05;
/// Minimum number of steps: a second of history and a second of simulation.
const MIN_STEPS: usize = 21;
/// Allowed distance between steps, s.
const STEP_RANGE: RangeInclusive<f64> = 0.05..=0.15;

/// Times from the first step, whole µs. Fails if the steps are too few or not a tenth of a second
/// apart.
pub(crate) fn step_times(seconds: &[f64]) -> Result<Vec<i64>, RecordingFault> {
    if seconds.len() < MIN_STEPS {
        return Err(RecordingFault::TooShort {
            steps: seconds.len(),
            needed: MIN_STEPS,
        });
    }
    let odd = seconds
        .windows(2)
        .position(|pair| !STEP_RANGE.contains(&(pair[1] - pair[0])));
    if let Some(step) = odd {
        return Err(RecordingFault::StepTime {
            step: step + 1,
            seconds: seconds[step + 1] - seconds[step],
        });
    }
    Ok(seconds
        .iter()
        .map(|t| ((t - seconds[0]) * MICROS_PER_SECOND).round() as i64)
        .collect())
}

/// The simulated steps; those before are the history.
pub(crate) fn window(times_us: &[i64]) -> Range<usize> {
    let seconds = |step: usize| {
        times_us
            .get(step)
            .map_or(0.0, |&t| t as f64 / MICROS_PER_SECOND)
    };
    let duration = seconds(times_us.len().saturating_sub(1));
    let history = if duration < LONG_RECORDING {
        SHORT_HISTORY
    } else {
        LONG_HISTORY
    };
    let first = |after: f64| {
        (0..times_us.len())
            .find(|&step| seconds(step) >= after)
            .unwrap_or(times_us.len())
    };
    let start = first(history - HALF_STEP);
    start..first(seconds(start) + MAX_DURATION + HALF_STEP)
}

/// The contents of a recording with steps at these times.
pub(crate) fn contents(seconds: &[f64], tracks: usize, lanes: usize) -> Contents {
    let first = seconds.first().copied().unwrap_or(0.0);
    let times_us: Vec<i64> = seconds
        .iter()
        .map(|t| ((t - first) * MICROS_PER_SECOND) as i64)
        .collect();
    Contents {
        record: None,
        steps: seconds.len(),
        iterations: window(&times_us).len(),
        tracks,
        lanes,
    }
}

/// A recording in the map's coordinates.
#[derive(Debug)]
pub(crate) struct Recording {
    pub(crate) id: String,
    pub(crate) log_name: String,
    pub(crate) map: LaneMap,
    /// One state per step.
    pub(crate) egos: Vec<EgoState>,
    /// Of each step; those after the simulation may be missing.
    pub(crate) objects: Vec<Arc<[TrackedObject]>>,
    /// Of each step; missing ones are empty.
    pub(crate) lights: Vec<Arc<TrafficLights>>,
}

impl Recording {
    /// Cuts the window and derives the route. The goal is the last recorded pose, even after the
    /// simulation.
    pub(crate) fn scenario(self) -> Scenario {
        let times_us: Vec<i64> = self.egos.iter().map(|ego| ego.time_us).collect();
        let window = window(&times_us);
        let centers: Vec<Pose> = self
            .egos
            .iter()
            .skip(window.start)
            .map(EgoState::center)
            .collect();
        let route = Route {
            roadblocks: route(&self.map, &centers),
            goal: self.egos.last().map(|ego| ego.rear_axle),
            goal_lane: None,
        };
        let future = self
            .egos
            .iter()
            .copied()
            .skip(window.end)
            .take(FUTURE_FRAMES)
            .collect();
        let lights = self
            .lights
            .into_iter()
            // A source without lights gives none, and `zip` would then drop every frame.
            .chain(std::iter::repeat(Arc::default()));
        let frames = self
            .egos
            .into_iter()
            .zip(self.objects)
            .zip(lights)
            .take(window.end);
        Scenario {
            id: self.id,
            scenario_type: UNKNOWN_TYPE.to_owned(),
            log_name: self.log_name,
            map: Arc::new(self.map),
            route,
            frames: frames
                .map(|((ego, objects), lights)| Frame {
                    ego,
                    objects,
                    lights,
                })
                .collect(),
            start: window.start,
            future,
            interaction: None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn steps(count: i64) -> Vec<i64> {
        (0..count).map(|i| i * 100_000).collect()
    }

    #[test]
    fn windows_are_cut_as_documented() {
        assert_eq!(window(&steps(91)), 10..91);
        assert_eq!(window(&steps(120)), 10..120);
        assert_eq!(window(&steps(121)), 20..121);
        assert_eq!(window(&steps(199)), 20..171);
        assert_eq!(window(&steps(21)), 10..21);
    }

    #[test]
    fn only_ten_hertz_is_taken() {
        let mut seconds: Vec<f64> = (0..30).map(|i| 5.0 + f64::from(i) * 0.1).collect();
        assert_eq!(step_times(&seconds).unwrap()[29], 2_900_000);
        seconds[7] = f64::NAN;
        assert!(matches!(
            step_times(&seconds),
            Err(RecordingFault::StepTime { step: 7, .. })
        ));
        seconds[7] = seconds[6];
        assert!(matches!(
            step_times(&seconds),
            Err(RecordingFault::StepTime { step: 7, .. })
        ));
        assert_eq!(
            step_times(&seconds[..20]),
            Err(RecordingFault::TooShort {
                steps: 20,
                needed: 21
            })
        );
    }
}
