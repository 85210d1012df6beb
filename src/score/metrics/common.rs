//! nuPlan's `common_metrics.yaml`: metrics of any simulation, without score.

use super::{
    EvaluatedSimulation, MetricCategory, MetricError, MetricInput, MetricResult, MetricSpec,
    Statistic, StatisticKind, TimeSeries,
};
use planagent_world::EgoState;
use planagent_world::geometry::wrap_angle;

pub(super) const MEAN_SPEED: MetricSpec = MetricSpec::new("ego_mean_speed", |input| {
    Ok(Some(ego_mean_speed(input.states())))
})
.category(MetricCategory::Dynamics);
pub(super) const EXPERT_ERROR: MetricSpec = MetricSpec::new("ego_expert_L2_error", |input| {
    ego_expert_l2_error(input.states(), expert(input)).map(Some)
});
pub(super) const EXPERT_ERROR_WITH_YAW: MetricSpec =
    MetricSpec::new("ego_expert_l2_error_with_yaw", |input| {
        ego_expert_l2_error_with_yaw(input.states(), expert(input)).map(Some)
    });

/// A radian of heading error counts as this many meters (devkit
/// `ego_expert_l2_error_with_yaw_statistics.yaml`).
const HEADING_DIFF_WEIGHT: f64 = 2.5;

fn expert<'a>(input: &MetricInput<'a>) -> &'a [EgoState] {
    // A modified scenario may end early, at its goal.
    let EvaluatedSimulation {
        expert,
        interaction,
        samples,
        ..
    } = input.simulation;
    let ends_early = interaction.is_some_and(|added| added.goal.is_some());
    if ends_early {
        &expert[..expert.len().min(samples.len() + 1)]
    } else {
        expert
    }
}

/// The mean norm of the rear-axle velocity, m/s.
pub fn ego_mean_speed(states: &[EgoState]) -> MetricResult {
    let mean = states.iter().map(EgoState::speed).sum::<f64>() / states.len() as f64;
    MEAN_SPEED.unscored(vec![Statistic::new(
        StatisticKind::Value,
        "ego_mean_speed_value",
        "meters_per_second",
        mean,
    )])
}

/// Distance between the centers of ego and expert at every sample, meters. nuPlan's discount of
/// later samples is 1 in its configuration, so there is none.
pub fn ego_expert_l2_error(
    states: &[EgoState],
    expert: &[EgoState],
) -> Result<MetricResult, MetricError> {
    error_series(&EXPERT_ERROR, "meters", states, expert, |ego, expert| {
        ego.center().distance(&expert.center())
    })
}

/// Distance between the centers of ego and expert plus the weighted heading error at every sample.
/// Its unit is nuPlan's word `None`.
pub fn ego_expert_l2_error_with_yaw(
    states: &[EgoState],
    expert: &[EgoState],
) -> Result<MetricResult, MetricError> {
    error_series(
        &EXPERT_ERROR_WITH_YAW,
        "None",
        states,
        expert,
        |ego, expert| {
            let (ego, expert) = (ego.center(), expert.center());
            ego.distance(&expert)
                + HEADING_DIFF_WEIGHT * wrap_angle(ego.heading - expert.heading).abs()
        },
    )
}

/// One distance a sample with nuPlan's three statistics of it.
fn error_series(
    spec: &MetricSpec,
    unit: &str,
    states: &[EgoState],
    expert: &[EgoState],
    error: impl Fn(&EgoState, &EgoState) -> f64,
) -> Result<MetricResult, MetricError> {
    if !(states.len()..=states.len() + 1).contains(&expert.len()) {
        return Err(MetricError::ExpertLength {
            samples: states.len(),
            expert: expert.len(),
        });
    }
    let errors = states
        .iter()
        .zip(expert)
        .map(|(ego, expert)| error(ego, expert))
        .collect();
    let series = TimeSeries::of_states(unit, states, errors);
    let statistics = series.statistics_of(
        spec.name,
        &[StatisticKind::Max, StatisticKind::Mean, StatisticKind::P90],
    );
    Ok(spec.unscored(statistics).with_series(series))
}
