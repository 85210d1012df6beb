//! `timing.json`: what was measured, apart from the scores, with the machine it was measured on.

use crate::experiment::run::DriveRecord;
use crate::planner::PlanningCall;
use serde::Serialize;

/// Wall time of a planning call by part, milliseconds.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct CallTimes {
    /// Lane graph, text and BEV map.
    pub environment: f64,
    /// Vision tower and projector.
    pub image_encode: f64,
    /// Prompts of all rounds and attempts.
    pub prefill: f64,
    /// Answers of all rounds and attempts.
    pub decode: f64,
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
    reflection: Option<Quantiles>,
    /// The whole call.
    pub total: Option<Quantiles>,
}

/// The time of one drive.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DriveTime {
    id: String,
    planner: String,
    challenge: String,
    /// Wall time of the planner over all iterations, seconds.
    planner_s: f64,
    /// Per iteration, milliseconds.
    iteration_ms: Option<Quantiles>,
}

/// The whole file.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Timing {
    /// Processor, as the system names it.
    pub cpu: String,
    /// Threads of the run.
    pub threads: usize,
    /// Wall time of the run, loading of the model included, seconds.
    pub wall_s: f64,
    /// Time to load the model, seconds.
    pub load_s: Option<f64>,
    /// Planning calls that the quantiles are of.
    pub planning_calls: usize,
    /// Milliseconds per planning call.
    pub planning_call_ms: CallQuantiles,
    /// A row a drive.
    pub drives: Vec<DriveTime>,
}

impl Timing {
    /// The times of a run.
    pub fn new(cpu: String, threads: usize, wall_s: f64, load_s: Option<f64>, records: &[DriveRecord]) -> Self {
        let driven = || records.iter().filter_map(|record| record.outcome.as_ref().ok().map(|driven| (record, driven)));
        let calls: Vec<CallTimes> = driven().flat_map(|(_, driven)| driven.calls.iter().map(CallTimes::of)).collect();
        let part = |of: fn(&CallTimes) -> f64| Quantiles::of(calls.iter().map(of).collect());
        Self {
            cpu,
            threads,
            wall_s,
            load_s,
            planning_calls: calls.len(),
            planning_call_ms: CallQuantiles {
                environment: part(|t| t.environment),
                image_encode: part(|t| t.image_encode),
                prefill: part(|t| t.prefill),
                decode: part(|t| t.decode),
                reflection: part(|t| t.reflection),
                total: part(|t| t.total),
            },
            drives: driven()
                .map(|(record, driven)| DriveTime {
                    id: record.scenario.clone(),
                    planner: record.planner.to_string(),
                    challenge: record.challenge.to_string(),
                    planner_s: driven.log.runtimes_s.iter().sum(),
                    iteration_ms: Quantiles::of(driven.log.runtimes_s.iter().map(|s| s * 1e3).collect()),
                })
                .collect(),
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
