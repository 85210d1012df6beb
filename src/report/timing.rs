//! `timing.json`: what was measured, apart from the scores, with the machine it was measured on.

use super::simulation_row::SimulationRow;
use super::summary::distinct;
use crate::planner::PlanningCall;
use crate::simulation::Challenge;
use serde::{Deserialize, Serialize};

/// Wall time of a planning call by part, milliseconds.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CallTimes {
    /// Lane graph, text and BEV map.
    pub environment: f64,
    /// Vision tower and projector.
    pub image_encode: f64,
    /// Prompts of all rounds and attempts.
    pub prefill: f64,
    /// Answers of all rounds and attempts.
    pub decode: f64,
    /// Waiting for a server that computes the model, for the rounds that it answered.
    #[serde(default)]
    pub remote: f64,
    /// Roll-outs and their scores, all attempts.
    pub reflection: f64,
    /// The whole call.
    pub total: f64,
}

impl CallTimes {
    /// The times of one call.
    pub fn of(call: &PlanningCall) -> Self {
        let rounds = || call.attempts.iter().flat_map(|attempt| &attempt.rounds);
        Self {
            environment: call.environment_ms,
            image_encode: rounds().map(|round| round.time.image_encode).sum(),
            prefill: rounds().map(|round| round.time.prefill).sum(),
            decode: rounds().map(|round| round.time.decode).sum(),
            remote: rounds().map(|round| round.time.remote).sum(),
            reflection: call.attempts.iter().map(|attempt| attempt.reflection_ms).sum(),
            total: call.total_ms,
        }
    }
}

/// Median and 95th percentile.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Quantiles {
    /// Half of the values lie at or under this.
    pub p50: f64,
    /// 95 % of the values lie at or under this.
    pub p95: f64,
}

impl Quantiles {
    /// Of a list of values, nearest rank; `None` for an empty one.
    pub fn of(mut values: Vec<f64>) -> Option<Self> {
        values.sort_by(f64::total_cmp);
        let rank = |share: f64| {
            let place = (share * values.len() as f64).ceil() as usize;
            values.get(place.max(1) - 1).copied()
        };
        Some(Self { p50: rank(0.50)?, p95: rank(0.95)? })
    }
}

/// Quantiles of each part of the planning calls, milliseconds.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CallQuantiles {
    environment: Option<Quantiles>,
    image_encode: Option<Quantiles>,
    prefill: Option<Quantiles>,
    decode: Option<Quantiles>,
    remote: Option<Quantiles>,
    reflection: Option<Quantiles>,
    /// The whole call.
    pub total: Option<Quantiles>,
}

/// The time of one drive.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SimulationTiming {
    id: String,
    planner: String,
    challenge: Challenge,
    /// Wall time of the planner over all iterations, seconds.
    planner_s: f64,
    /// Per iteration, milliseconds.
    iteration_ms: Option<Quantiles>,
}

/// What a planner takes, over all its drives in all challenges.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PlannerTiming {
    /// Which planner.
    pub planner: String,
    /// Iterations that the times are of.
    pub iterations: usize,
    /// Mean per iteration, milliseconds: planning calls are spread over the iterations between them.
    pub mean_iteration_ms: Option<f64>,
    /// Per iteration, milliseconds.
    pub iteration_ms: Option<Quantiles>,
    /// Planning calls that the quantiles are of; none for a planner without a model.
    pub planning_calls: usize,
    /// Per planning call, milliseconds.
    pub planning_call_ms: Option<Quantiles>,
}

/// The machine and the session that ended the run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Session {
    /// Processor, as the system names it.
    pub cpu: String,
    /// Threads of the run.
    pub threads: usize,
    /// Wall time of the session, loading of the model included, seconds.
    pub wall_s: f64,
    /// Drives that this session made; a run that was gone on with has others.
    pub simulations: usize,
    /// Time to load the model, seconds.
    pub load_s: Option<f64>,
}

/// The whole file.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Timing {
    /// The machine and the session that ended the run.
    #[serde(flatten)]
    pub session: Session,
    /// Planning calls that the quantiles are of.
    pub planning_calls: usize,
    /// Milliseconds per planning call.
    pub planning_call_ms: CallQuantiles,
    /// A row a planner.
    pub planners: Vec<PlannerTiming>,
    /// A row a drive.
    pub simulation_times: Vec<SimulationTiming>,
}

impl Timing {
    /// The times of a run.
    pub fn new(session: Session, rows: &[SimulationRow]) -> Self {
        let calls: Vec<CallTimes> = rows.iter().flat_map(|row| &row.time.calls).copied().collect();
        let part = |of: fn(&CallTimes) -> f64| Quantiles::of(calls.iter().map(of).collect());
        Self {
            session,
            planning_calls: calls.len(),
            planning_call_ms: CallQuantiles {
                environment: part(|t| t.environment),
                image_encode: part(|t| t.image_encode),
                prefill: part(|t| t.prefill),
                decode: part(|t| t.decode),
                remote: part(|t| t.remote),
                reflection: part(|t| t.reflection),
                total: part(|t| t.total),
            },
            planners: distinct(rows.iter().map(|row| &row.planner))
                .into_iter()
                .map(|planner| PlannerTiming::of(planner, rows))
                .collect(),
            simulation_times: rows
                .iter()
                .filter(|row| row.score.is_some())
                .map(|row| SimulationTiming {
                    id: row.scenario.clone(),
                    planner: row.planner.clone(),
                    challenge: row.challenge,
                    planner_s: row.time.planner_s.iter().sum(),
                    iteration_ms: Quantiles::of(row.time.planner_s.iter().map(|s| s * 1e3).collect()),
                })
                .collect(),
        }
    }
}

impl PlannerTiming {
    /// The times of a planner's drives among `rows`.
    pub(super) fn of(planner: &str, rows: &[SimulationRow]) -> Self {
        let own = || rows.iter().filter(|row| row.planner == planner);
        let steps: Vec<f64> = own().flat_map(|row| &row.time.planner_s).map(|s| s * 1e3).collect();
        let calls: Vec<f64> = own().flat_map(|row| &row.time.calls).map(|call| call.total).collect();
        Self {
            planner: planner.to_owned(),
            iterations: steps.len(),
            mean_iteration_ms: (!steps.is_empty()).then(|| steps.iter().sum::<f64>() / steps.len() as f64),
            iteration_ms: Quantiles::of(steps),
            planning_calls: calls.len(),
            planning_call_ms: Quantiles::of(calls),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_values_that_occurred() {
        let q = Quantiles::of((1..=20).map(f64::from).collect()).unwrap();
        assert!((q.p50 - 10.0).abs() < 1e-12 && (q.p95 - 19.0).abs() < 1e-12);
        assert_eq!(Quantiles::of(vec![]), None);
        assert_eq!(Quantiles::of(vec![3.0]), Some(Quantiles { p50: 3.0, p95: 3.0 }));
    }
}
