//! Wall times of simulations and planning calls.

use super::recorded;
use super::simulation_row::is_zero;
use planagent_agent::planner::PlanningCall;
use serde::{Deserialize, Serialize};

/// Wall time of a planning call by part, milliseconds, and what was asked and answered in it.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CallTimes {
    /// Lane graph, text and BEV map.
    #[serde(deserialize_with = "recorded::time")]
    pub environment: f64,
    /// Vision tower and projector.
    #[serde(deserialize_with = "recorded::time")]
    pub image_encode: f64,
    /// Prompts of all rounds and attempts.
    #[serde(deserialize_with = "recorded::time")]
    pub prefill: f64,
    /// Answers of all rounds and attempts.
    #[serde(deserialize_with = "recorded::time")]
    pub decode: f64,
    /// Waiting for the model's server, in rounds that it answered.
    #[serde(default, deserialize_with = "recorded::time")]
    pub remote: f64,
    /// Roll-outs and their scores, all attempts.
    #[serde(deserialize_with = "recorded::time")]
    pub reflection: f64,
    /// The whole call.
    #[serde(deserialize_with = "recorded::time")]
    pub total: f64,
    /// Questions to the model.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub questions: usize,
    /// Tokens that the model read in them: of texts and images, without those that it had read.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub read: usize,
    /// Tokens of its answers.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub written: usize,
}

impl CallTimes {
    /// The times of one call.
    pub fn from_call(call: &PlanningCall) -> Self {
        let rounds = || call.attempts.iter().flat_map(|attempt| &attempt.rounds);
        Self {
            environment: call.environment_ms,
            image_encode: rounds().map(|round| round.time.image_encode).sum(),
            prefill: rounds().map(|round| round.time.prefill).sum(),
            decode: rounds().map(|round| round.time.decode).sum(),
            remote: rounds().map(|round| round.time.remote).sum(),
            reflection: call
                .attempts
                .iter()
                .map(|attempt| attempt.reflection_ms)
                .sum(),
            total: call.total_ms,
            questions: rounds().count(),
            read: rounds()
                .map(|round| round.tokens.text + round.tokens.image)
                .sum(),
            written: rounds()
                .map(|round| round.tokens.fast_forwarded + round.tokens.sampled)
                .sum(),
        }
    }
}

/// Wall times of a simulation.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SimulationTime {
    /// Start, seconds since 1970.
    #[serde(deserialize_with = "recorded::time")]
    pub started_s: f64,
    /// End, seconds since 1970.
    #[serde(deserialize_with = "recorded::time")]
    pub ended_s: f64,
    /// Planner time of each iteration, seconds.
    #[serde(deserialize_with = "recorded::times")]
    pub planner_s: Vec<f64>,
    /// The planning calls by part.
    pub calls: Vec<CallTimes>,
}

/// Median and 95th percentile.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Quantiles {
    /// Half of the values are at most this.
    pub p50: f64,
    /// 95 % of the values are at most this.
    pub p95: f64,
}

impl Quantiles {
    /// Quantiles by nearest rank; `None` for an empty list.
    pub fn from_values(mut values: Vec<f64>) -> Option<Self> {
        values.sort_by(f64::total_cmp);
        let rank = |share: f64| {
            let place = (share * values.len() as f64).ceil() as usize;
            values.get(place.max(1) - 1).copied()
        };
        Some(Self {
            p50: rank(0.50)?,
            p95: rank(0.95)?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quantiles_are_values_that_occurred() {
        let q = Quantiles::from_values((1..=20).map(f64::from).collect()).unwrap();
        assert!((q.p50 - 10.0).abs() < 1e-12 && (q.p95 - 19.0).abs() < 1e-12);
        assert_eq!(Quantiles::from_values(vec![]), None);
        assert_eq!(
            Quantiles::from_values(vec![3.0]),
            Some(Quantiles { p50: 3.0, p95: 3.0 })
        );
    }
}
