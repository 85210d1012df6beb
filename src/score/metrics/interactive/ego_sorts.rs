//! `ego_sorts_*`: whether the ego got past what was in its way.

use crate::metrics::{
    MetricCategory, MetricInput, MetricList, MetricResult, MetricSpec, Statistic, StatisticKind,
};
use planagent_world::EgoState;
use planagent_world::geometry::{Point, Polyline};

const fn spec(name: &'static str, compute: crate::metrics::Compute) -> MetricSpec {
    MetricSpec::new(name, compute)
        .only(MetricList::ClosedLoop)
        .category(MetricCategory::ScenarioDependent)
        .truth_value()
        .label("past")
}

pub(super) const CONSTRUCTION_ZONE: MetricSpec = spec("ego_sorts_construction_zone", |input| {
    Ok(result(&CONSTRUCTION_ZONE, input))
});
pub(super) const STOPPED_VEHICLE: MetricSpec = spec("ego_sorts_stopped_vehicle", |input| {
    Ok(result(&STOPPED_VEHICLE, input))
});
pub(super) const JAYWALKING_PEDESTRIAN: MetricSpec =
    spec("ego_sorts_jaywalking_pedestrian", |input| {
        Ok(result(&JAYWALKING_PEDESTRIAN, input))
    });

/// The share of the expert's way at which all obstacles are passed. It is their largest projection
/// on the line through its positions, over the length, and 1 where the line has no length.
pub(crate) fn passing_ratio(expert: &[Point], obstacles: &[Point]) -> f64 {
    let Ok(line) = Polyline::new(expert.iter().copied()) else {
        return 1.0;
    };
    obstacles
        .iter()
        .map(|&obstacle| line.project(obstacle).s / line.length())
        .fold(0.0, f64::max)
}

/// 1 if the ego's share of the expert's progress reaches the ratio, else 0.
pub fn sorted(progress_ratio: f64, passing_ratio: f64) -> f64 {
    f64::from(u8::from(progress_ratio >= passing_ratio))
}

fn result(spec: &'static MetricSpec, input: &MetricInput<'_>) -> Option<MetricResult> {
    let interaction = input.simulation.interaction?;
    if super::sorting(interaction.kind?) != Some(spec.name) {
        return None;
    }
    let expert: Vec<Point> = input
        .simulation
        .expert
        .iter()
        .map(EgoState::center)
        .map(|center| center.position())
        .collect();
    let (needed, ratio) = (
        passing_ratio(&expert, &interaction.obstacles),
        input.progress_ratio(),
    );
    let value = |name: &str, value| Statistic::new(StatisticKind::Ratio, name, "ratio", value);
    Some(spec.scored(
        sorted(ratio, needed),
        vec![
            value("passing_ratio", needed),
            value("progress_ratio", ratio),
        ],
    ))
}
