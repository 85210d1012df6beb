//! The metric table, and the evaluation of a simulation with it.

use super::interactive::{INTERACTIVE_METRICS, specs_of};
use super::spec::scored;
use super::{
    EvaluatedSimulation, MetricError, MetricInput, MetricList, MetricResult, MetricSpec, Score,
    Weighting, comfort, common, drivable_area_compliance, driving_direction_compliance,
    ego_lane_change, ego_progress_along_expert_route, ego_stop_at_stop_line,
    no_ego_at_fault_collisions, open_loop, speed_limit_compliance, time_to_collision_within_bound,
};
use planagent_world::InteractionKind;

/// nuPlan's metrics in the order of their results. A score takes the multipliers, then the weighted
/// metrics, in this order.
pub const METRICS: [MetricSpec; 27] = [
    common::MEAN_SPEED,
    common::EXPERT_ERROR,
    common::EXPERT_ERROR_WITH_YAW,
    ego_lane_change::SPEC,
    comfort::JERK,
    comfort::LAT_JERK,
    comfort::LON_JERK,
    comfort::ACCELERATION,
    comfort::LAT_ACCELERATION,
    comfort::LON_ACCELERATION,
    comfort::YAW_ACCELERATION,
    comfort::YAW_RATE,
    ego_progress_along_expert_route::SPEC,
    no_ego_at_fault_collisions::SPEC,
    drivable_area_compliance::SPEC,
    drivable_area_compliance::CORNERS,
    time_to_collision_within_bound::SPEC,
    speed_limit_compliance::SPEC,
    comfort::SPEC,
    ego_progress_along_expert_route::MAKING_PROGRESS,
    driving_direction_compliance::SPEC,
    ego_stop_at_stop_line::SPEC,
    open_loop::AVERAGE_DISPLACEMENT,
    open_loop::FINAL_DISPLACEMENT,
    open_loop::MISS_RATE,
    open_loop::AVERAGE_HEADING,
    open_loop::FINAL_HEADING,
];

/// nuPlan's metric of this name, or one of modified scenarios.
pub fn metric(name: &str) -> Option<&'static MetricSpec> {
    const ALL: &[MetricSpec] = &METRICS;
    const OWN: &[MetricSpec] = &INTERACTIVE_METRICS;
    ALL.iter().chain(OWN).find(|spec| spec.name == name)
}

impl MetricList {
    /// nuPlan's metrics that enter the score of this list, multipliers first.
    pub fn scored(self) -> impl Iterator<Item = &'static MetricSpec> + Clone {
        const ALL: &[MetricSpec] = &METRICS;
        scored(ALL, self)
    }
}

impl Weighting {
    /// nuPlan's weighting of a list of metrics; the same with non-reactive and reactive agents.
    pub fn for_list(list: MetricList) -> Self {
        Self::new(list.scored())
    }

    /// interPlan's weighting of these metrics for a kind.
    pub fn of_kind(kind: InteractionKind, specs: &[MetricSpec]) -> Self {
        Self::new(specs_of(kind, specs).iter())
    }
}

/// The metrics that enter a score, multipliers first: of a kind, with the roles that they have in
/// it, or nuPlan's of a list.
pub fn scored_metrics(list: MetricList, kind: Option<InteractionKind>) -> Vec<MetricSpec> {
    match kind.filter(|_| list == MetricList::ClosedLoop) {
        Some(kind) => scored(&specs_of(kind, &METRICS), list).copied().collect(),
        None => list.scored().copied().collect(),
    }
}

/// The metrics of an evaluation: nuPlan's, and those that a program adds.
#[derive(Debug, Clone)]
pub struct MetricRegistry {
    specs: Vec<MetricSpec>,
}

impl Default for MetricRegistry {
    fn default() -> Self {
        Self {
            specs: METRICS.to_vec(),
        }
    }
}

impl MetricRegistry {
    /// Adds a metric; one of the same name is replaced.
    #[must_use]
    pub fn with(mut self, spec: MetricSpec) -> Self {
        self.specs.retain(|own| own.name != spec.name);
        self.specs.push(spec);
        self
    }

    /// The metrics in the order of their results.
    pub fn specs(&self) -> &[MetricSpec] {
        &self.specs
    }

    /// Computes the metrics of a list and their score.
    ///
    /// # Errors
    /// As [`MetricInput::new`], and when a metric cannot be computed: open-loop metrics need plans
    /// of more than 7 s.
    pub fn evaluate(
        &self,
        list: MetricList,
        simulation: &EvaluatedSimulation<'_>,
    ) -> Result<Evaluation, MetricError> {
        let input = MetricInput::new(*simulation)?;
        let kind = simulation
            .interaction
            .and_then(|added| added.kind)
            .filter(|_| list == MetricList::ClosedLoop);
        let specs = kind.map_or_else(|| self.specs.clone(), |kind| specs_of(kind, &self.specs));
        let of_list = specs
            .iter()
            .filter(|spec| spec.list.is_none_or(|own| own == list));
        let mut metrics = Vec::new();
        for spec in of_list {
            metrics.extend((spec.compute)(&input)?);
        }
        Ok(Evaluation {
            score: Score::from_results(list, &specs, &metrics)?,
            metrics,
        })
    }
}

/// All results of a simulation.
#[derive(Debug, Clone, PartialEq)]
#[non_exhaustive]
pub struct Evaluation {
    /// The score.
    pub score: Score,
    /// The metrics in the order of the registry.
    pub metrics: Vec<MetricResult>,
}

impl Evaluation {
    /// A metric by nuPlan's name.
    pub fn metric(&self, name: &str) -> Option<&MetricResult> {
        self.metrics.iter().find(|m| m.name == name)
    }
}

/// Computes nuPlan's metrics of a list and their score.
pub fn evaluate(
    list: MetricList,
    simulation: &EvaluatedSimulation<'_>,
) -> Result<Evaluation, MetricError> {
    MetricRegistry::default().evaluate(list, simulation)
}
