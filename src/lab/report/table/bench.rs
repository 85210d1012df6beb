//! The tables of a bench.

use crate::bench::{Agreement, EngineName, PythonEngine};
use crate::report::{BenchFigures, Comparison, ModelFigures};
use planagent_mllm::Limits;
use planagent_runs::report::table::{LineWidth, Table, or_dash, three_digits, weights};
use planagent_runs::report::{markdown_block, markdown_line};
use std::fmt::Write as _;

/// Bytes of a MiB and of a GiB.
const MEBI: f64 = (1 << 20) as f64;
const GIBI: f64 = (1 << 30) as f64;

struct Column {
    header: &'static str,
    meaning: &'static str,
    cell: fn(&ModelFigures) -> String,
}

const fn column(
    header: &'static str,
    meaning: &'static str,
    cell: fn(&ModelFigures) -> String,
) -> Column {
    Column {
        header,
        meaning,
        cell,
    }
}

/// What was loaded.
const LOADED: [Column; 6] = [
    column("params", "weights", |m| weights(m.about.loaded.parameters)),
    column("weights", "how most are held", |m| {
        m.about.loaded.weight_format.clone()
    }),
    column("image", "its tokens", |m| {
        m.about.loaded.image_tokens.to_string()
    }),
    column("prompt", "text tokens of a call", |m| {
        m.about.prompt_tokens.to_string()
    }),
    column("load", "s", |m| format!("{:.1}", m.about.loaded.load_s)),
    column("peak", "maximum memory", |m| {
        or_dash(m.about.peak_memory, memory)
    }),
];
/// What it costs. Both together are too wide for a terminal.
const COST: [Column; 7] = [
    column("encode", "image, ms", |m| {
        or_dash(m.image_encode_ms, three_digits)
    }),
    column("prefill", "tok/s", |m| {
        or_dash(m.prefill_tokens_per_s, three_digits)
    }),
    column("first", "time to first token, ms", |m| {
        or_dash(m.first_token_ms, three_digits)
    }),
    column("decode", "tok/s", |m| {
        or_dash(m.decode_tokens_per_s, three_digits)
    }),
    column("p50", "planning call, ms", |m| {
        or_dash(m.call_ms, |call| three_digits(call.p50))
    }),
    column("p95", "planning call, ms", |m| {
        or_dash(m.call_ms, |call| three_digits(call.p95))
    }),
    column("calls", "number of planning calls", |m| m.calls.to_string()),
];

/// How near its steps are to the processor's limits.
const SHARES: [Column; 3] = [
    column("encode", "operations of the image, beside the limit", |m| {
        or_dash(m.shares.and_then(|shares| shares.encode), percent)
    }),
    column("prefill", "operations of the first prompt", |m| {
        or_dash(m.shares.and_then(|shares| shares.prefill), percent)
    }),
    column("decode", "bytes of weights, beside a plain read", |m| {
        or_dash(m.shares.and_then(|shares| shares.decode), percent)
    }),
];

/// What it costs with drafts.
const DRAFTED_COST: [Column; 4] = [
    column("0", "planning call, ms, without drafts", |m| {
        or_dash(m.call_ms, |call| three_digits(call.p50))
    }),
    column(
        "0.25",
        "with drafts of four tokens, of which a quarter is accepted",
        |m| drafted_call(m, 0.25),
    ),
    column("0.5", "half of them", |m| drafted_call(m, 0.5)),
    column("0.75", "three quarters", |m| drafted_call(m, 0.75)),
];

/// The planning call at an acceptance.
fn drafted_call(model: &ModelFigures, acceptance: f64) -> String {
    let call = model
        .drafted_calls
        .iter()
        .find(|call| (call.acceptance - acceptance).abs() < f64::EPSILON);
    or_dash(call, |call| three_digits(call.ms))
}

fn has_drafts(figures: &BenchFigures) -> bool {
    figures
        .models
        .iter()
        .any(|model| !model.drafted_calls.is_empty())
}

/// The tables for a terminal.
pub fn bench_table(figures: &BenchFigures, width: LineWidth) -> String {
    let mut parts = Vec::new();
    if !figures.models.is_empty() {
        parts.extend(
            [&LOADED[..], &COST]
                .map(|columns| models(figures, columns, |c| c.header.to_owned()).fitted(width)),
        );
        let both = LOADED.iter().chain(&COST);
        parts.push(meanings(both, None, width));
    }
    let limits = limits(figures);
    for (columns, limits, shown) in [
        (&SHARES[..], limits.clone(), limits.is_some()),
        (&DRAFTED_COST, None, has_drafts(figures)),
    ] {
        if shown {
            parts.push(models(figures, columns, |c| c.header.to_owned()).fitted(width));
            parts.push(meanings(columns.iter(), limits, width));
        }
    }
    if !figures.comparisons.is_empty() {
        parts.push(comparisons(figures).fitted(width));
        let ratio = format!("ratio = {}", ratio(figures));
        parts.push(width.listed([ratio, other_engine(figures)]).join("\n"));
    }
    let agreements = figures.agreements.iter().map(Agreement::in_words);
    parts.extend(agreements.map(|line| width.wrapped(&line).join("\n")));
    parts.extend(failed(figures).map(|line| width.wrapped(&line).join("\n")));
    parts.join("\n\n")
}

/// What columns mean, and a line behind.
fn meanings<'a>(
    columns: impl Iterator<Item = &'a Column>,
    behind: Option<String>,
    width: LineWidth,
) -> String {
    let meanings = columns.map(|column| format!("{} = {}", column.header, column.meaning));
    width.listed(meanings.chain(behind)).join("\n")
}

/// The same as Markdown, the models in one wide table; `command` ran on `machine`.
pub fn bench_markdown(figures: &BenchFigures, command: &str, machine: &str) -> String {
    let mut text = format!(
        "{}\n\n{}\n",
        markdown_line(machine),
        markdown_block("console", &format!("$ {command}"))
    );
    // Writing to a string cannot fail.
    if !figures.models.is_empty() {
        let all = LOADED.iter().chain(&COST);
        let table = models(figures, all, |column| {
            format!("{} ({})", column.header, column.meaning)
        });
        let _ = write!(text, "\n{}", table.markdown());
    }
    let limits = limits(figures);
    for (columns, shown) in [
        (&SHARES[..], limits.is_some()),
        (&DRAFTED_COST, has_drafts(figures)),
    ] {
        if shown {
            let table = models(figures, columns, |column| {
                format!("{} ({})", column.header, column.meaning)
            });
            let _ = write!(text, "\n{}", table.markdown());
        }
    }
    if let Some(limits) = limits {
        let _ = writeln!(text, "\n{limits}.");
    }
    if !figures.comparisons.is_empty() {
        let other = markdown_line(&other_engine(figures));
        let table = comparisons(figures).markdown();
        let _ = write!(text, "\nRatio: {}. {other}.\n\n{table}", ratio(figures));
    }
    for agreement in &figures.agreements {
        let _ = writeln!(text, "\n{}", markdown_line(&agreement.in_words()));
    }
    for line in failed(figures) {
        let _ = writeln!(text, "\n{}", markdown_line(&line));
    }
    text
}

/// A row for each model and engine; the other engine's row follows that of this program.
fn models<'a>(
    figures: &BenchFigures,
    columns: impl IntoIterator<Item = &'a Column>,
    header: impl Fn(&Column) -> String,
) -> Table {
    let columns: Vec<&Column> = columns.into_iter().collect();
    let rows = figures.models.iter().map(|model| {
        let name = match model.about.engine {
            EngineName::PlanAgent => model.about.model.clone(),
            other => format!("- {other}"),
        };
        std::iter::once(name)
            .chain(columns.iter().map(|column| (column.cell)(model)))
            .collect()
    });
    let headers = columns.iter().map(|column| header(column));
    Table::new(
        std::iter::once("model".to_owned()).chain(headers),
        1,
        rows.collect::<Vec<_>>(),
    )
}

fn comparisons(figures: &BenchFigures) -> Table {
    let row = |row: &Comparison| {
        let [ours, theirs] = [row.ours, row.theirs].map(three_digits);
        let range = format!("{:.2} to {:.2}", row.ratio.min, row.ratio.max);
        let ratio = format!("{:.2}", row.ratio.median);
        vec![
            row.model.clone(),
            row.what.clone(),
            row.unit.to_owned(),
            ours,
            theirs,
            ratio,
            range,
        ]
    };
    let other = other(figures).to_string();
    let headers = [
        "model",
        "what",
        "unit",
        "planagent",
        other.as_str(),
        "ratio",
        "range",
    ];
    Table::new(headers, 3, figures.comparisons.iter().map(row))
}

fn failed(figures: &BenchFigures) -> impl Iterator<Item = String> {
    figures
        .failed
        .iter()
        .map(|(model, problem)| format!("{model} failed: {problem}"))
}

/// The engine that is compared with.
fn other(figures: &BenchFigures) -> EngineName {
    let engines = figures.models.iter().map(|model| model.about.engine);
    engines
        .into_iter()
        .find(|engine| *engine != EngineName::PlanAgent)
        .unwrap_or(EngineName::LlamaCpp)
}

fn ratio(figures: &BenchFigures) -> String {
    format!("speed of planagent / speed of {}", other(figures))
}

fn other_engine(figures: &BenchFigures) -> String {
    let engine = other(figures);
    let other = figures
        .models
        .iter()
        .find(|model| model.about.engine == engine);
    let version = or_dash(other, |model| model.about.loaded.version.clone());
    match PythonEngine::find(engine) {
        None => format!("{engine} = {version}"),
        Some(python) => format!("{engine} = that of {} {version}", python.package),
    }
}

/// The best limits of the processor, in words; none where no engine counts its work.
fn limits(figures: &BenchFigures) -> Option<String> {
    let highest = |limit: fn(&Limits) -> f64| {
        let all = figures.models.iter().filter_map(|m| m.about.highest(limit));
        all.reduce(f64::max)
    };
    let kernels = figures.models.iter().find_map(|m| m.about.limits.first())?;
    Some(format!(
        "limit = {} TOP/s of 8-bit products ({}), {} GB/s of reads",
        three_digits(highest(|limits| limits.operations_per_s)? / 1e12),
        kernels.kernels,
        three_digits(highest(|limits| limits.read_bytes_per_s)? / 1e9)
    ))
}

fn percent(share: f64) -> String {
    format!("{:.0} %", 100.0 * share)
}

fn memory(bytes: u64) -> String {
    let bytes = bytes as f64;
    if bytes < GIBI {
        format!("{:.0} MiB", bytes / MEBI)
    } else {
        format!("{:.2} GiB", bytes / GIBI)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::protocol::Loaded;
    use crate::bench::{Layout, ModelRow};
    use crate::report::{DraftedCall, Shares};
    use planagent_runs::report::{Quantiles, Spread};

    #[test]
    fn the_tables_fit_every_terminal() {
        let loaded = Loaded {
            parameters: 17_640_000_000,
            weight_format: "q4_k".to_owned(),
            image_side: 672,
            image_tokens: 2880,
            vocabulary: 32_000,
            image_token: None,
            context: 4096,
            layout: Layout::PrefixFirst,
            load_s: 120.5,
            version: "0.3.16".to_owned(),
        };
        let name = "a-folder/of-a-model/with-a-name/that-is-longer/than-60-columns.gguf, brief";
        let model = |engine| ModelFigures {
            about: ModelRow {
                model: name.to_owned(),
                engine,
                loaded: loaded.clone(),
                prompt_tokens: 1234,
                peak_memory: Some(17 << 30),
                limits: vec![Limits {
                    kernels: "AVX-512 VNNI".to_owned(),
                    operations_per_s: 1.76e12,
                    read_bytes_per_s: 45.6e9,
                }],
            },
            calls: 5,
            image_encode_ms: Some(12_345.0),
            prefill_tokens_per_s: Some(123.0),
            first_token_ms: Some(23_456.0),
            decode_tokens_per_s: Some(12.3),
            call_ms: Some(Quantiles {
                p50: 123_456.0,
                p95: 234_567.0,
            }),
            shares: Some(Shares {
                encode: Some(0.385),
                prefill: Some(0.5),
                decode: None,
            }),
            drafted_calls: vec![DraftedCall {
                acceptance: 0.25,
                ms: 123_456.0,
            }],
        };
        let ratio = Spread {
            median: 1.0,
            min: 0.5,
            max: 10.0,
        };
        let figures = BenchFigures {
            models: vec![model(EngineName::PlanAgent), model(EngineName::LlamaCpp)],
            comparisons: vec![Comparison {
                model: name.to_owned(),
                what: "prefill of 1024 tokens".to_owned(),
                unit: "tok/s",
                ours: 123.0,
                theirs: 124.0,
                ratio,
            }],
            agreements: Vec::new(),
            failed: vec![(
                name.to_owned(),
                "it needs more memory than is free".repeat(4),
            )],
        };
        for columns in [60, 80, 100, 160] {
            let text = bench_table(&figures, LineWidth::terminal(columns));
            let fits = |line: &str| line.chars().count() <= usize::from(columns);
            assert!(text.lines().all(fits), "wider than {columns}: {text}");
        }
    }
}
