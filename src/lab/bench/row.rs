//! The rows of a benchmark's results.

use super::agreement::Agreement;
use super::engine::EngineName;
use super::protocol::Loaded;
use planagent_mllm::{Limits, PassTime, Step, StepTime};
use serde::{Deserialize, Serialize};

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(tag = "row", rename_all = "snake_case")]
pub enum Row {
    Iteration(IterationRow),
    /// An engine finished a model.
    Model(ModelRow),
    /// How near two engines are.
    Agreement(Agreement),
    Failed(FailedRow),
}

/// One iteration of a workload.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct IterationRow {
    pub model: String,
    pub engine: EngineName,
    pub workload: String,
    pub iteration: usize,
    pub warm_up: bool,
    pub steps: Vec<TimedStep>,
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct TimedStep {
    pub step: Step,
    pub time: StepTime,
}

/// The loaded model and its memory.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ModelRow {
    pub model: String,
    pub engine: EngineName,
    pub loaded: Loaded,
    /// Text tokens of a planning call's prompts.
    pub prompt_tokens: usize,
    /// Peak memory of the process, bytes; `None` where the system does not report it.
    pub peak_memory: Option<u64>,
    /// What the processor could do at most, before and after this program was measured; empty for
    /// other engines.
    #[serde(default)]
    pub limits: Vec<Limits>,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct FailedRow {
    pub model: String,
    pub problem: String,
}

impl Row {
    pub fn model(&self) -> &str {
        match self {
            Self::Iteration(row) => &row.model,
            Self::Model(row) => &row.model,
            Self::Agreement(row) => &row.model,
            Self::Failed(row) => &row.model,
        }
    }
}

impl ModelRow {
    /// The highest of a limit.
    pub(crate) fn highest(&self, limit: fn(&Limits) -> f64) -> Option<f64> {
        self.limits.iter().map(limit).reduce(f64::max)
    }
}

impl IterationRow {
    /// Wall time of all steps, milliseconds.
    pub fn total_ms(&self) -> f64 {
        self.steps.iter().map(|timed| timed.time.ms).sum()
    }

    /// Image encoding; without tokens.
    pub(crate) fn encode(&self) -> PassTime {
        let mut sum = PassTime::default();
        for timed in self.steps.iter().filter(|timed| timed.step == Step::Encode) {
            sum += PassTime {
                tokens: 0,
                ms: timed.time.ms,
                work: timed.time.work,
            };
        }
        sum
    }

    /// Wall time of image encoding, milliseconds; `None` without an image.
    pub(crate) fn image_encode_ms(&self) -> Option<f64> {
        Some(self.encode().ms).filter(|ms| *ms > 0.0)
    }

    /// From the start to the first sampled token, milliseconds.
    pub fn first_token_ms(&self) -> Option<f64> {
        let mut before = 0.0;
        for TimedStep { time, .. } in &self.steps {
            if let Some(within) = time.first_token_ms {
                return Some(before + within);
            }
            before += time.ms;
        }
        None
    }

    /// The passes of the first prompt.
    pub fn prefill(&self) -> PassTime {
        let mut sum = PassTime::default();
        for TimedStep { time, .. } in &self.steps {
            sum += time.batch;
            if time.first_token_ms.is_some() {
                break;
            }
        }
        sum
    }

    /// The passes of answers, fast-forwarded tokens included. The first pass after a prompt
    /// computes the prompt and does not count.
    pub fn decode(&self) -> PassTime {
        let mut sum = PassTime::default();
        let mut after_prompt = false;
        for TimedStep { step, time } in &self.steps {
            match step {
                Step::Text(_) | Step::Image => after_prompt = true,
                Step::FastForwarded(_) | Step::Sampled(_) | Step::Verified { .. } => {
                    sum += time.single;
                    if !after_prompt {
                        sum += time.batch;
                    }
                    after_prompt &= time.batch.tokens == 0;
                }
                Step::Keep(_) | Step::Encode | Step::Compute => {}
            }
        }
        sum
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn timed(
        step: Step,
        ms: f64,
        first_token_ms: Option<f64>,
        batch: (usize, f64),
        single: (usize, f64),
    ) -> TimedStep {
        let pass = |(tokens, ms)| PassTime {
            tokens,
            ms,
            ..PassTime::default()
        };
        TimedStep {
            step,
            time: StepTime {
                ms,
                first_token_ms,
                batch: pass(batch),
                single: pass(single),
                ..StepTime::default()
            },
        }
    }

    #[test]
    fn figures_are_taken_from_the_steps_they_stand_for() {
        let row = IterationRow {
            model: "m".into(),
            engine: EngineName::PlanAgent,
            workload: "call".into(),
            iteration: 0,
            warm_up: false,
            steps: vec![
                timed(Step::Encode, 100.0, None, (0, 0.0), (0, 0.0)),
                timed(Step::Image, 40.0, None, (64, 40.0), (0, 0.0)),
                timed(Step::Text(20), 0.0, None, (0, 0.0), (0, 0.0)),
                timed(Step::Sampled(3), 30.0, Some(10.0), (20, 10.0), (2, 20.0)),
                timed(Step::FastForwarded(8), 0.0, None, (0, 0.0), (0, 0.0)),
                timed(Step::Sampled(2), 25.0, Some(15.0), (9, 15.0), (1, 10.0)),
            ],
        };
        assert_eq!(
            (row.total_ms(), row.image_encode_ms(), row.first_token_ms()),
            (195.0, Some(100.0), Some(150.0))
        );
        assert_eq!(
            row.prefill(),
            PassTime {
                tokens: 84,
                ms: 50.0,
                ..PassTime::default()
            }
        );
        assert_eq!(
            row.decode(),
            PassTime {
                tokens: 12,
                ms: 45.0,
                ..PassTime::default()
            }
        );
        let text = serde_json::to_string(&Row::Iteration(row.clone())).unwrap();
        assert_eq!(
            serde_json::from_str::<Row>(&text).unwrap(),
            Row::Iteration(row)
        );
    }
}
