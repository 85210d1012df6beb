//! The open-loop metrics: the planned trajectories of every second against the expert's
//! ([`PlannerExpertErrors`]).

use super::expert_comparison::{COMPARISON_HORIZONS_S, HorizonErrors, PlannerExpertErrors, mean};
use super::{MetricList, MetricResult, MetricSpec, Statistic, StatisticKind, TimeSeries};

/// Mean distance at which the score is 0, meters (devkit
/// `planner_expert_average_l2_error_within_bound_statistics.yaml`).
pub(crate) const MAX_AVERAGE_L2_ERROR: f64 = 8.0;
/// Final distance at which the score is 0, meters (devkit
/// `planner_expert_final_l2_error_within_bound_statistics.yaml`).
pub(crate) const MAX_FINAL_L2_ERROR: f64 = 8.0;
/// Mean heading error at which the score is 0, radians (devkit
/// `planner_expert_average_heading_error_within_bound_statistics.yaml`).
pub(crate) const MAX_AVERAGE_HEADING_ERROR: f64 = 0.8;
/// Final heading error at which the score is 0, radians (devkit
/// `planner_expert_final_heading_error_within_bound_statistics.yaml`).
pub(crate) const MAX_FINAL_HEADING_ERROR: f64 = 0.8;
/// A trajectory farther than this from the expert within a horizon is a miss, meters (devkit
/// `planner_miss_rate_within_bound_statistics.yaml`).
pub(crate) const MAX_DISPLACEMENTS: [f64; 3] = [6.0, 8.0, 16.0];
/// Acceptable share of misses at every horizon.
pub(crate) const MAX_MISS_RATE: f64 = 0.3;

pub(super) const AVERAGE_DISPLACEMENT: MetricSpec =
    MetricSpec::new("planner_expert_average_l2_error_within_bound", |input| {
        Ok(Some(planner_expert_average_l2_error_within_bound(
            input.comparison()?,
        )))
    })
    .only(MetricList::OpenLoop)
    .weight(1.0)
    .label("ADE");
pub(super) const FINAL_DISPLACEMENT: MetricSpec =
    MetricSpec::new("planner_expert_final_l2_error_within_bound", |input| {
        Ok(Some(planner_expert_final_l2_error_within_bound(
            input.comparison()?,
        )))
    })
    .only(MetricList::OpenLoop)
    .weight(1.0)
    .label("FDE");
pub(super) const AVERAGE_HEADING: MetricSpec = MetricSpec::new(
    "planner_expert_average_heading_error_within_bound",
    |input| {
        Ok(Some(planner_expert_average_heading_error_within_bound(
            input.comparison()?,
        )))
    },
)
.only(MetricList::OpenLoop)
.weight(2.0)
.label("AHE");
pub(super) const FINAL_HEADING: MetricSpec =
    MetricSpec::new("planner_expert_final_heading_error_within_bound", |input| {
        Ok(Some(planner_expert_final_heading_error_within_bound(
            input.comparison()?,
        )))
    })
    .only(MetricList::OpenLoop)
    .weight(2.0)
    .label("FHE");
pub(super) const MISS_RATE: MetricSpec =
    MetricSpec::new("planner_miss_rate_within_bound", |input| {
        Ok(Some(planner_miss_rate_within_bound(input.comparison()?)))
    })
    .only(MetricList::OpenLoop)
    .multiplier()
    .truth_value()
    .label("miss");

/// The mean distance between planned and recorded centers (ADE).
pub fn planner_expert_average_l2_error_within_bound(errors: &PlannerExpertErrors) -> MetricResult {
    let names = ("planner_expert_ADE", "meter");
    mean_within(
        &AVERAGE_DISPLACEMENT,
        errors,
        names,
        MAX_AVERAGE_L2_ERROR,
        |errors| errors.average_displacement,
    )
}

/// The distance between planned and recorded center at the end of a horizon (FDE).
pub fn planner_expert_final_l2_error_within_bound(errors: &PlannerExpertErrors) -> MetricResult {
    let names = ("planner_expert_FDE", "meter");
    mean_within(
        &FINAL_DISPLACEMENT,
        errors,
        names,
        MAX_FINAL_L2_ERROR,
        |errors| errors.final_displacement,
    )
}

/// The mean angle between planned and recorded heading (AHE).
pub fn planner_expert_average_heading_error_within_bound(
    errors: &PlannerExpertErrors,
) -> MetricResult {
    let names = ("planner_expert_AHE", "radian");
    mean_within(
        &AVERAGE_HEADING,
        errors,
        names,
        MAX_AVERAGE_HEADING_ERROR,
        |errors| errors.average_heading,
    )
}

/// The angle between planned and recorded heading at the end of a horizon (FHE).
pub fn planner_expert_final_heading_error_within_bound(
    errors: &PlannerExpertErrors,
) -> MetricResult {
    let names = ("planner_expert_FHE", "radian");
    mean_within(
        &FINAL_HEADING,
        errors,
        names,
        MAX_FINAL_HEADING_ERROR,
        |errors| errors.final_heading,
    )
}

/// 1 when the share of missed trajectories is at most [`MAX_MISS_RATE`] at every horizon, else 0.
pub fn planner_miss_rate_within_bound(errors: &PlannerExpertErrors) -> MetricResult {
    let rates: Vec<f64> = MAX_DISPLACEMENTS
        .iter()
        .enumerate()
        .map(|(i, &max)| {
            mean(
                errors
                    .within(i, |e| e.maximum_displacement)
                    .map(|d| f64::from(u8::from(d > max))),
            )
        })
        .collect();
    let within = rates.iter().all(|&rate| rate <= MAX_MISS_RATE);
    let named = rates
        .iter()
        .zip(COMPARISON_HORIZONS_S)
        .map(|(&rate, horizon)| {
            Statistic::new(
                StatisticKind::Ratio,
                format!("planner_miss_rate_horizon_{horizon}"),
                "ratio",
                rate,
            )
        });
    MISS_RATE.judged(within, named.collect())
}

/// The mean error of each horizon, whether the overall mean is within `threshold`, and that mean.
/// The score falls from 1 to 0 as the overall mean grows to `threshold`. `short` is nuPlan's name
/// of the error (`planner_expert_ADE`).
fn mean_within(
    spec: &MetricSpec,
    errors: &PlannerExpertErrors,
    (short, unit): (&str, &str),
    threshold: f64,
    read: fn(&HorizonErrors) -> f64,
) -> MetricResult {
    let mean_statistic =
        |name: String, value| Statistic::new(StatisticKind::Mean, name, unit, value);
    let mut statistics: Vec<Statistic> = COMPARISON_HORIZONS_S
        .iter()
        .enumerate()
        .map(|(i, horizon)| {
            mean_statistic(
                format!("{short}_horizon_{horizon}"),
                mean(errors.within(i, read)),
            )
        })
        .collect();
    let by_frame: Vec<f64> = errors
        .errors
        .iter()
        .map(|of_frame| mean(of_frame.iter().map(read)))
        .collect();
    // Every frame has the same horizons, so the mean of all errors is that of the frames' means.
    let overall = mean(errors.errors.iter().flatten().map(read));
    let averaged = format!("avg_{short}_over_all_horizons");
    statistics.push(Statistic::boolean(spec.name, overall <= threshold));
    statistics.push(mean_statistic(averaged.clone(), overall));
    let series = TimeSeries {
        unit: format!("{averaged} [{unit}]"),
        time_stamps: errors.time_stamps.clone(),
        values: by_frame,
        selected_frames: Some(errors.frames.clone()),
    };
    spec.scored((1.0 - overall / threshold).max(0.0), statistics)
        .with_series(series)
}
