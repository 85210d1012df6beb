//! What each metric costs a variant.

use crate::study::{Column, Study};
use planagent_agent::simulation::Challenge;
use planagent_runs::report::SimulationRow;
use serde::Serialize;

/// What a metric costs a variant in a challenge.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MetricLoss {
    pub challenge: Challenge,
    /// nuPlan's name of the metric, or interPlan's.
    pub metric: &'static str,
    /// Its short name.
    #[serde(skip)]
    pub label: &'static str,
    /// Points that the mean score would gain if this metric alone were perfect.
    pub points: f64,
}

impl MetricLoss {
    /// Whether it is of the same metric in the same challenge.
    pub(crate) fn is_of(&self, other: &Self) -> bool {
        (self.challenge, self.metric) == (other.challenge, other.metric)
    }
}

/// The losses by challenge and metric, in the order of the score; none if the study does not compare
/// them. Where scenes are scored by different metrics, a metric costs nothing in the scenes without
/// it.
pub(super) fn losses(study: &Study, rows: &[SimulationRow]) -> Vec<MetricLoss> {
    if !study.columns.contains(&Column::Lost) {
        return Vec::new();
    }
    let mut losses: Vec<MetricLoss> = Vec::new();
    for challenge in Challenge::CLOSED_LOOP {
        let completed = |row: &&SimulationRow| row.challenge == challenge && row.score.is_some();
        let completed: Vec<_> = rows.iter().filter(completed).collect();
        for (spec, lost) in completed.iter().flat_map(|row| row.lost()) {
            let points = 100.0 * lost / completed.len() as f64;
            let is_same =
                |own: &&mut MetricLoss| (own.challenge, own.metric) == (challenge, spec.name);
            match losses.iter_mut().find(is_same) {
                Some(own) => own.points += points,
                None => losses.push(MetricLoss {
                    challenge,
                    metric: spec.name,
                    label: spec.label,
                    points,
                }),
            }
        }
    }
    losses
}
