//! What a card measures: what a planning call costs, and what that costs in the closed loop. All of
//! it may differ from one time to the next; the rest of a card does not.

use super::error::CardError;
use super::scores::SourceScore;
use planagent_files::MAX_LIST_BYTES;
use planagent_runs::report::{CallTimes, Quantiles, SimulationRow};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// The block of measurements.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Measured {
    #[serde(flatten)]
    pub(super) cost: CallCost,
    /// The loop in which a call's plan becomes active after [`CallCost::latency_ms`].
    pub(super) late: Vec<SourceScore>,
}

/// What a planning call costs.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct CallCost {
    /// Calls that were measured.
    pub(super) calls: usize,
    /// The simulated latency: the median of a whole call, whole milliseconds.
    pub(super) latency_ms: u64,
    /// Stages of a call, the whole call last, milliseconds.
    pub(super) stages: Vec<Cost>,
    /// Questions, and tokens that were read and written; none from a server that counts none.
    pub(super) tokens: Vec<Cost>,
}

/// Median and 95th percentile of a part of a call.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(super) struct Cost {
    pub(super) of: String,
    pub(super) p50: f64,
    pub(super) p95: f64,
}

/// The name of a part of a call, and its time or tokens.
type Part = (&'static str, fn(&CallTimes) -> f64);

/// The stages with their times.
const STAGES: [Part; 7] = [
    ("environment", |call| call.environment),
    ("image encode", |call| call.image_encode),
    ("prefill", |call| call.prefill),
    ("decode", |call| call.decode),
    ("server", |call| call.remote),
    ("reflection", |call| call.reflection),
    ("planning call", |call| call.total),
];

/// What is counted in a call.
const TOKENS: [Part; 3] = [
    ("questions", |call| call.questions as f64),
    ("tokens read", |call| call.read as f64),
    ("tokens written", |call| call.written as f64),
];

/// Name of the JSON file in the folder of a card.
const CARD: &str = "card.json";
/// The block of measurements in it.
const MEASURED: &str = "measured";

impl CallCost {
    /// The cost of the planning calls of simulations; none without a call.
    pub(super) fn from_rows<'a>(rows: impl Iterator<Item = &'a SimulationRow>) -> Option<Self> {
        let calls: Vec<&CallTimes> = rows.flat_map(|row| &row.time.calls).collect();
        let total = quantiles(&calls, |call| call.total)?;
        Some(Self {
            calls: calls.len(),
            latency_ms: (total.p50.round() as u64).max(1),
            stages: costs(&calls, &STAGES),
            tokens: costs(&calls, &TOKENS),
        })
    }

    /// The cost in an earlier card: a folder, or its JSON file.
    ///
    /// # Errors
    /// When there is no such card, or it measured nothing.
    pub(super) fn read(path: &Path) -> Result<Self, CardError> {
        let file: PathBuf = if path.is_dir() {
            path.join(CARD)
        } else {
            path.to_owned()
        };
        let text = planagent_files::read_text(&file, MAX_LIST_BYTES).map_err(|source| {
            CardError::ReadCard {
                path: file.clone(),
                source,
            }
        })?;
        let wrong = |fault: String| CardError::NoTimes {
            path: file.clone(),
            fault,
        };
        let card: serde_json::Value =
            serde_json::from_str(&text).map_err(|error| wrong(error.to_string()))?;
        let Some(measured) = card.get(MEASURED) else {
            return Err(wrong(format!("it has no block {MEASURED}")));
        };
        if let Some(why) = measured.get("not_available") {
            return Err(wrong(format!(
                "its block {MEASURED} is not available: {why}"
            )));
        }
        let cost = serde_json::from_value::<Self>(measured.clone());
        cost.map_err(|error| wrong(format!("in its block {MEASURED}: {error}")))
    }
}

/// Each part that some call has.
fn costs(calls: &[&CallTimes], parts: &[Part]) -> Vec<Cost> {
    let cost = |&(name, of): &(&str, fn(&CallTimes) -> f64)| {
        let found = quantiles(calls, of).filter(|_| calls.iter().any(|call| of(call) > 0.0))?;
        Some(Cost {
            of: name.to_owned(),
            p50: two_decimals(found.p50),
            p95: two_decimals(found.p95),
        })
    };
    parts.iter().filter_map(cost).collect()
}

fn quantiles(calls: &[&CallTimes], of: impl Fn(&CallTimes) -> f64) -> Option<Quantiles> {
    Quantiles::from_values(calls.iter().map(|call| of(call)).collect())
}

/// A number that is read again as it was written.
fn two_decimals(value: f64) -> f64 {
    (value * 100.0).round() / 100.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use planagent_agent::simulation::Challenge;

    fn cost() -> CallCost {
        let mut row = SimulationRow::example("a", 1, "plan-agent", Challenge::Reactive, Some(1.0));
        row.time.calls = (1..=20)
            .map(|i| CallTimes {
                decode: f64::from(i) / 3.0,
                total: f64::from(i) * 2.34,
                questions: 3,
                written: 40,
                ..CallTimes::default()
            })
            .collect();
        CallCost::from_rows([row].iter()).unwrap()
    }

    #[test]
    fn stages_that_no_call_has_are_left_out() {
        let cost = cost();
        let names: Vec<&str> = cost.stages.iter().map(|stage| stage.of.as_str()).collect();
        assert_eq!(names, ["decode", "planning call"]);
        assert_eq!((cost.latency_ms, cost.stages[1].p95), (23, 44.46));
        assert_eq!(cost.tokens.len(), 2);
        assert_eq!(CallCost::from_rows(std::iter::empty()), None);
    }

    #[test]
    fn the_times_of_an_earlier_card_are_read_as_they_were_written() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join(CARD);
        let measured = Measured {
            cost: cost(),
            late: Vec::new(),
        };
        let json = serde_json::json!({ "measured": measured });
        std::fs::write(&file, json.to_string()).unwrap();
        assert_eq!(CallCost::read(folder.path()).unwrap(), cost());
        assert_eq!(CallCost::read(&file).unwrap(), cost());
        for (text, told) in [
            ("{}", "no block measured"),
            ("{", "EOF"),
            (r#"{"measured": {"calls": 3}}"#, "latency_ms"),
            (r#"{"measured": {"not_available": "none"}}"#, "none"),
        ] {
            std::fs::write(&file, text).unwrap();
            let error = CallCost::read(&file).unwrap_err().to_string();
            assert!(
                error.contains(told) && error.contains("--latency-of") && error.contains(CARD),
                "{error}"
            );
        }
        let absent = CallCost::read(&folder.path().join("nowhere")).unwrap_err();
        assert!(absent.to_string().contains("nowhere"), "{absent}");
    }
}
