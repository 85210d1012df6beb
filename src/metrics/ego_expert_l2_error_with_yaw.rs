//! `ego_expert_l2_error_with_yaw`: distance and turn between the ego and the recorded driver. It has no score.

use super::ego_expert_l2_error::error_series;
use super::{MetricError, MetricResult};
use crate::geometry::wrap_angle;
use crate::world::EgoState;

/// A radian of turn counts as this many metres (devkit `ego_expert_l2_error_with_yaw_statistics.yaml`).
const HEADING_DIFF_WEIGHT: f64 = 2.5;

/// Distance between the centres of ego and expert plus the weighted turn between their headings at every sample, metres.
///
/// # Errors
/// When the expert trajectory is neither as long as the drive nor one state longer.
pub fn ego_expert_l2_error_with_yaw(states: &[EgoState], expert: &[EgoState]) -> Result<MetricResult, MetricError> {
    error_series("ego_expert_l2_error_with_yaw", states, expert, |ego, expert| {
        let (ego, expert) = (ego.center(), expert.center());
        ego.distance(&expert) + HEADING_DIFF_WEIGHT * wrap_angle(ego.heading - expert.heading).abs()
    })
}
