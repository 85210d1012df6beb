//! interPlan's metrics and scores, for modified scenarios of its kinds (interPlan
//! `lane_changes_to_goal.py`, `ego_sorts_obstacle.py`,
//! `interplan_weighted_average_metric_aggregator.py`).
//!
//! Where interPlan fails, the value here is defined. A goal that cannot be compared counts as not
//! reached, and a line without length as never passed.

mod ego_sorts;
mod lane_changes_to_goal;
mod neighbors;

pub use ego_sorts::sorted;

use super::{MetricSpec, Role};
use planagent_world::InteractionKind;

/// Metrics of modified scenarios beside nuPlan's.
pub(crate) const INTERACTIVE_METRICS: [MetricSpec; 4] = [
    lane_changes_to_goal::SPEC,
    ego_sorts::CONSTRUCTION_ZONE,
    ego_sorts::STOPPED_VEHICLE,
    ego_sorts::JAYWALKING_PEDESTRIAN,
];

/// Weight of a metric that interPlan does not name.
const DEFAULT_WEIGHT: f64 = 1.0;

/// The metric that a kind multiplies by because the ego has to pass something.
pub(super) fn sorting(kind: InteractionKind) -> Option<&'static str> {
    use InteractionKind as Kind;
    match kind {
        Kind::LowTrafficDensity | Kind::MediumTrafficDensity | Kind::HighTrafficDensity => None,
        Kind::OvertakeParkedVehicle | Kind::NudgeAroundParkedVehicle | Kind::AvoidCrashedCars => {
            Some(ego_sorts::STOPPED_VEHICLE.name)
        }
        Kind::ApproachingConstructionZone => Some(ego_sorts::CONSTRUCTION_ZONE.name),
        Kind::JaywalkingPedestrian => Some(ego_sorts::JAYWALKING_PEDESTRIAN.name),
    }
}

/// How a metric enters the score of a kind. Passing something replaces the driving direction among
/// the multipliers, and the direction then weighs 1. Where a person crosses, both multiply.
pub(super) fn role(kind: InteractionKind, spec: &MetricSpec) -> Role {
    let (sorting, direction) = (
        sorting(kind),
        super::driving_direction_compliance::SPEC.name,
    );
    if sorting == Some(spec.name) {
        Role::Multiplier
    } else if spec.name == direction
        && sorting.is_some()
        && kind != InteractionKind::JaywalkingPedestrian
    {
        Role::Weight(DEFAULT_WEIGHT)
    } else if INTERACTIVE_METRICS.iter().any(|own| own.name == spec.name)
        && spec.name != "lane_changes_to_goal"
    {
        Role::Unscored
    } else {
        spec.role
    }
}

/// The metrics of a kind, those of nuPlan with the roles that they have in it.
pub(super) fn specs_of(kind: InteractionKind, specs: &[MetricSpec]) -> Vec<MetricSpec> {
    let own = INTERACTIVE_METRICS
        .iter()
        .filter(|spec| !specs.iter().any(|known| known.name == spec.name));
    specs
        .iter()
        .chain(own)
        .map(|spec| MetricSpec {
            role: role(kind, spec),
            ..*spec
        })
        .collect()
}

#[cfg(test)]
mod tests;
