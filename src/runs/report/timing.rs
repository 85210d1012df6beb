//! `timing.json`: wall times, and the machine on which they were measured.

use super::simulation_row::SimulationRow;
use super::times::{CallTimes, Quantiles};
use planagent_agent::simulation::Challenge;
use planagent_score::metrics::distinct;
use serde::Serialize;

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

/// Planner time of one simulation.
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

/// Times of a planner over all its simulations in all challenges.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PlannerTiming {
    /// Name of the planner.
    pub planner: String,
    /// Number of iterations.
    pub iterations: usize,
    /// Mean per iteration, milliseconds; it spreads a planning call over the iterations until the
    /// next.
    pub mean_iteration_ms: Option<f64>,
    /// Per iteration, milliseconds.
    pub iteration_ms: Option<Quantiles>,
    /// Number of planning calls; 0 for a planner without a model.
    pub planning_calls: usize,
    /// Per planning call, milliseconds.
    pub planning_call_ms: Option<Quantiles>,
}

/// The machine and the session that completed the run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Session {
    /// Processor, as the system names it.
    pub cpu: String,
    /// Threads of the run.
    pub threads: usize,
    /// Wall time of the session with the loading of the model, seconds.
    pub wall_s: f64,
    /// Simulations of this session; a resumed run has more.
    pub simulations: usize,
    /// Time to load the model, seconds.
    pub load_s: Option<f64>,
}

/// The wall times of a run.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Timing {
    /// The machine and the session that completed the run.
    #[serde(flatten)]
    pub session: Session,
    /// Number of planning calls.
    pub planning_calls: usize,
    /// Milliseconds per planning call.
    pub planning_call_ms: CallQuantiles,
    /// Times by planner.
    pub planners: Vec<PlannerTiming>,
    /// Times by simulation.
    pub simulation_times: Vec<SimulationTiming>,
}

impl Timing {
    /// The times of a run.
    pub fn new(session: Session, rows: &[SimulationRow]) -> Self {
        let calls: Vec<CallTimes> = rows
            .iter()
            .flat_map(|row| &row.time.calls)
            .copied()
            .collect();
        let part =
            |of: fn(&CallTimes) -> f64| Quantiles::from_values(calls.iter().map(of).collect());
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
                .map(|planner| PlannerTiming::from_rows(planner, rows))
                .collect(),
            simulation_times: rows
                .iter()
                // The time of a failed simulation is not comparable, since it ended early.
                .filter(|row| row.score.is_some())
                .map(|row| SimulationTiming {
                    id: row.scenario.clone(),
                    planner: row.planner.clone(),
                    challenge: row.challenge,
                    planner_s: row.time.planner_s.iter().sum(),
                    iteration_ms: Quantiles::from_values(
                        row.time.planner_s.iter().map(|s| s * 1e3).collect(),
                    ),
                })
                .collect(),
        }
    }
}

impl PlannerTiming {
    /// The times of a planner's simulations among `rows`.
    pub(super) fn from_rows(planner: &str, rows: &[SimulationRow]) -> Self {
        let own = || rows.iter().filter(|row| row.planner == planner);
        let steps: Vec<f64> = own()
            .flat_map(|row| &row.time.planner_s)
            .map(|s| s * 1e3)
            .collect();
        let calls: Vec<f64> = own()
            .flat_map(|row| &row.time.calls)
            .map(|call| call.total)
            .collect();
        Self {
            planner: planner.to_owned(),
            iterations: steps.len(),
            mean_iteration_ms: (!steps.is_empty())
                .then(|| steps.iter().sum::<f64>() / steps.len() as f64),
            iteration_ms: Quantiles::from_values(steps),
            planning_calls: calls.len(),
            planning_call_ms: Quantiles::from_values(calls),
        }
    }
}
