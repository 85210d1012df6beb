//! Why a simulation has no metrics.

use planagent_world::{MICROS_PER_SECOND, TrajectoryError};

/// Why a simulation has no metrics.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs, reason = "the message of a variant says what it is")]
pub enum MetricError {
    #[error("the metrics need at least {needed} samples, got {got}")]
    TooFewSamples { got: usize, needed: usize },
    #[error("the simulation has no expert trajectory")]
    NoExpert,
    #[error("the time of sample {index} ({time_us} µs) is not after that of the sample before")]
    TimeNotIncreasing { index: usize, time_us: i64 },
    #[error("state {index} of the {whose} has a NaN or infinite value")]
    NotFinite { whose: &'static str, index: usize },
    #[error(
        "the expert trajectory has {expert} states for {samples} samples; it needs as many, or one more"
    )]
    ExpertLength { samples: usize, expert: usize },
    #[error("the simulation has {samples} samples and {trajectories} trajectories")]
    TrajectoryCount { samples: usize, trajectories: usize },
    #[error("the trajectory of sample {sample} cannot be compared with the expert")]
    Trajectory {
        sample: usize,
        source: TrajectoryError,
    },
    #[error("the trajectory of sample {sample} ends {:.1} s ahead; the open-loop metrics need more than 7 s", *reach_us as f64 / MICROS_PER_SECOND)]
    TrajectoryTooShort { sample: usize, reach_us: i64 },
    #[error(
        "the recording has {recorded_s} s from the start of the scenario; the open-loop metrics need {needed_s} s"
    )]
    NoRecordedFuture { recorded_s: usize, needed_s: usize },
    #[error("the metric {0} has no score")]
    NoScore(&'static str),
}
