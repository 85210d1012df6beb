//! Statistics of a benchmark.

use crate::bench::{Agreement, DRAFTED, EngineName, IterationRow, ModelRow, Row};
use planagent_mllm::{PassTime, Work};
use planagent_runs::report::{Quantiles, Spread};
use serde::Serialize;

/// Statistics of a benchmark.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BenchFigures {
    /// One entry for each model and engine.
    pub models: Vec<ModelFigures>,
    /// This program compared with another engine; empty without one.
    pub comparisons: Vec<Comparison>,
    /// How near the logits and tokens of both engines are.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub agreements: Vec<Agreement>,
    /// Failed models with the reason.
    pub failed: Vec<(String, String)>,
}

/// Cost of a model. Times are medians over the measured iterations.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ModelFigures {
    #[serde(flatten)]
    pub about: ModelRow,
    /// Measured planning calls.
    pub calls: usize,
    /// Preprocessing, vision tower and projector, milliseconds.
    pub image_encode_ms: Option<f64>,
    /// Tokens a second of the first prompt, image included.
    pub prefill_tokens_per_s: Option<f64>,
    /// From the start of a call to the first sampled token, milliseconds.
    pub first_token_ms: Option<f64>,
    /// Tokens a second in passes of one token.
    pub decode_tokens_per_s: Option<f64>,
    /// Planning call, milliseconds.
    pub call_ms: Option<Quantiles>,
    /// Shares of the processor's limits; none where an engine does not count its work.
    pub shares: Option<Shares>,
    /// Planning call with drafts; empty where none were measured.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub drafted_calls: Vec<DraftedCall>,
}

/// How near a model's steps are to the processor's limits: operations of products beside those of
/// 8-bit products in registers, bytes of weights, keys and values beside a plain read.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Shares {
    /// Operations of the image encoding.
    pub encode: Option<f64>,
    /// Operations of the first prompt.
    pub prefill: Option<f64>,
    /// Bytes in passes of one token.
    pub decode: Option<f64>,
}

/// Planning calls whose answers are drafted.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct DraftedCall {
    /// Share of drafted tokens that is accepted.
    pub acceptance: f64,
    /// Median, milliseconds.
    pub ms: f64,
}

/// One measurement of this program and of another engine, iteration by iteration.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Comparison {
    pub model: String,
    pub what: String,
    /// `tok/s` or `ms`.
    pub unit: &'static str,
    /// Median of this program.
    pub ours: f64,
    /// Median of the other engine.
    pub theirs: f64,
    /// Speed of this program relative to the other engine.
    pub ratio: Spread,
}

/// Unit where more is faster.
const TOKENS_PER_S: &str = "tok/s";
/// Unit where less is faster.
const MS: &str = "ms";

/// The workload of the table of models.
const CALL: &str = "call";
/// The start of the names of calls with drafts.
const DRAFTED_CALL: &str = "call-accepted-";

impl BenchFigures {
    pub fn from_rows(rows: &[Row]) -> Self {
        let iterations: Vec<&IterationRow> = rows
            .iter()
            .filter_map(|row| match row {
                Row::Iteration(row) if !row.warm_up => Some(row),
                _ => None,
            })
            .collect();
        let mut figures = Self {
            models: Vec::new(),
            comparisons: Vec::new(),
            agreements: Vec::new(),
            failed: Vec::new(),
        };
        for row in rows {
            match row {
                Row::Model(about) => {
                    figures
                        .models
                        .push(ModelFigures::from_iterations(about, &iterations));
                    // Every comparison is between this program and another engine, so it belongs to
                    // our row.
                    if about.engine == EngineName::PlanAgent {
                        figures
                            .comparisons
                            .extend(comparisons(&about.model, &iterations));
                    }
                }
                Row::Failed(row) => figures
                    .failed
                    .push((row.model.clone(), row.problem.clone())),
                Row::Agreement(row) => figures.agreements.push(row.clone()),
                Row::Iteration(_) => {}
            }
        }
        figures
    }
}

impl ModelFigures {
    fn from_iterations(about: &ModelRow, iterations: &[&IterationRow]) -> Self {
        let of = |workload: &str| -> Vec<&IterationRow> {
            let same = |row: &&&IterationRow| {
                row.model == about.model && row.engine == about.engine && row.workload == workload
            };
            iterations.iter().filter(same).copied().collect()
        };
        let calls = of(CALL);
        let drafted_calls = (1..DRAFTED).filter_map(|accepted| {
            let acceptance = accepted as f64 / DRAFTED as f64;
            let calls = of(&format!("{DRAFTED_CALL}{acceptance}"));
            let ms = Spread::from_values(calls.iter().map(|row| row.total_ms()).collect())?.median;
            Some(DraftedCall { acceptance, ms })
        });
        let median = |of: &dyn Fn(&IterationRow) -> Option<f64>| {
            Spread::from_values(calls.iter().filter_map(|row| of(row)).collect())
                .map(|spread| spread.median)
        };
        Self {
            about: about.clone(),
            calls: calls.len(),
            image_encode_ms: median(&IterationRow::image_encode_ms),
            prefill_tokens_per_s: median(&|row| row.prefill().rate()),
            first_token_ms: median(&IterationRow::first_token_ms),
            decode_tokens_per_s: median(&|row| row.decode().rate()),
            call_ms: Quantiles::from_values(calls.iter().map(|row| row.total_ms()).collect()),
            shares: Shares::from_calls(about, &calls),
            drafted_calls: drafted_calls.collect(),
        }
    }
}

impl Shares {
    fn from_calls(about: &ModelRow, calls: &[&IterationRow]) -> Option<Self> {
        let operations = about.highest(|limits| limits.operations_per_s)?;
        let read = about.highest(|limits| limits.read_bytes_per_s)?;
        let share = |pass: fn(&IterationRow) -> PassTime, work: fn(Work) -> u64, limit: f64| {
            let shares = calls.iter().map(|row| pass(row)).filter_map(|pass| {
                let work = work(pass.work) as f64;
                (work > 0.0 && pass.ms > 0.0).then(|| work / (pass.ms / 1e3) / limit)
            });
            Spread::from_values(shares.collect()).map(|spread| spread.median)
        };
        Some(Self {
            encode: share(IterationRow::encode, |work| work.operations, operations),
            prefill: share(IterationRow::prefill, |work| work.operations, operations),
            decode: share(IterationRow::decode, |work| work.bytes, read),
        })
    }
}

/// Name, unit and value of a compared measurement.
type Compared = (String, &'static str, fn(&IterationRow) -> Option<f64>);

fn comparisons(model: &str, iterations: &[&IterationRow]) -> Vec<Comparison> {
    let mut workloads: Vec<&str> = Vec::new();
    // Other engines make no calls with drafts.
    let shared = |row: &&&IterationRow| !row.workload.starts_with(DRAFTED_CALL);
    for row in iterations
        .iter()
        .filter(|row| row.model == model)
        .filter(shared)
    {
        if !workloads.contains(&row.workload.as_str()) {
            workloads.push(&row.workload);
        }
    }
    let mut all = Vec::new();
    for workload in workloads {
        let of = |own: bool| {
            iterations
                .iter()
                .filter(move |row| {
                    let is_own = row.engine == EngineName::PlanAgent;
                    row.model == model && row.workload == workload && is_own == own
                })
                .copied()
        };
        let pairs: Vec<_> = of(true).zip(of(false)).collect();
        for (what, unit, read) in compared(workload) {
            all.extend(Comparison::from_pairs(model, what, unit, read, &pairs));
        }
    }
    all
}

fn compared(workload: &str) -> Vec<Compared> {
    match workload.strip_prefix("depth-") {
        Some(depth) => vec![
            (format!("prefill {depth}"), TOKENS_PER_S, |row| {
                row.prefill().rate()
            }),
            (format!("decode at {depth}"), TOKENS_PER_S, |row| {
                row.decode().rate()
            }),
        ],
        None => vec![
            ("image encode".to_owned(), MS, IterationRow::image_encode_ms),
            ("first token".to_owned(), MS, IterationRow::first_token_ms),
            ("planning call".to_owned(), MS, |row| Some(row.total_ms())),
        ],
    }
}

impl Comparison {
    fn from_pairs(
        model: &str,
        what: String,
        unit: &'static str,
        read: fn(&IterationRow) -> Option<f64>,
        pairs: &[(&IterationRow, &IterationRow)],
    ) -> Option<Self> {
        let values: Vec<(f64, f64)> = pairs
            .iter()
            .filter_map(|(ours, theirs)| Some((read(ours)?, read(theirs)?)))
            .collect();
        let faster = |&(ours, theirs): &(f64, f64)| {
            if unit == MS {
                theirs / ours
            } else {
                ours / theirs
            }
        };
        Some(Self {
            model: model.to_owned(),
            what,
            unit,
            ours: Spread::from_values(values.iter().map(|pair| pair.0).collect())?.median,
            theirs: Spread::from_values(values.iter().map(|pair| pair.1).collect())?.median,
            ratio: Spread::from_values(values.iter().map(faster).collect())?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::TimedStep;
    use planagent_mllm::{Step, StepTime};

    fn call(engine: EngineName, iteration: usize, ms: f64) -> Row {
        Row::Iteration(IterationRow {
            model: "m".into(),
            engine,
            workload: CALL.into(),
            iteration,
            warm_up: iteration == 0,
            steps: vec![TimedStep {
                step: Step::Compute,
                time: StepTime {
                    ms,
                    ..StepTime::default()
                },
            }],
        })
    }

    #[test]
    fn the_middle_of_an_even_number_is_a_mean() {
        let spread = Spread::from_values(vec![3.0, 1.0, 2.0, 10.0]).unwrap();
        assert_eq!(
            spread,
            Spread {
                median: 2.5,
                min: 1.0,
                max: 10.0
            }
        );
        assert_eq!(
            Spread::from_values(vec![7.0]),
            Some(Spread {
                median: 7.0,
                min: 7.0,
                max: 7.0
            })
        );
        assert_eq!(Spread::from_values(vec![]), None);
    }

    #[test]
    fn ratios_are_of_pairs_and_warm_up_does_not_count() {
        let rows: Vec<Row> = [(100.0, 1.0), (10.0, 20.0), (20.0, 30.0), (10.0, 30.0)]
            .into_iter()
            .enumerate()
            .flat_map(|(i, (ours, theirs))| {
                [
                    call(EngineName::PlanAgent, i, ours),
                    call(EngineName::LlamaCpp, i, theirs),
                ]
            })
            .collect();
        let iterations: Vec<&IterationRow> = rows
            .iter()
            .filter_map(|row| match row {
                Row::Iteration(row) if !row.warm_up => Some(row),
                _ => None,
            })
            .collect();
        let found = comparisons("m", &iterations);
        assert_eq!(found.len(), 1, "{found:?}");
        assert_eq!((found[0].ours, found[0].theirs), (10.0, 30.0));
        assert_eq!(
            found[0].ratio,
            Spread {
                median: 2.0,
                min: 1.5,
                max: 3.0
            }
        );
    }
}
