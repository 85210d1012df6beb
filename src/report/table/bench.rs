//! The tables of a bench.

use super::{fill, markdown, plain};
use crate::experiment::bench::EngineName;
use crate::report::{BenchFigures, Comparison, ModelFigures};
use std::fmt::Write as _;

/// Columns of a terminal that the tables are made for.
const COLUMNS: usize = 80;
const MEBI: f64 = (1 << 20) as f64;
const GIBI: f64 = (1 << 30) as f64;
/// What large numbers of weights are counted in.
const BILLION: f64 = 1e9;
const MILLION: f64 = 1e6;

/// One column of the table of models.
struct Column {
    header: &'static str,
    /// What the header means.
    meaning: &'static str,
    cell: fn(&ModelFigures) -> String,
}

/// The columns that tell what was loaded, and those that tell what it costs; together too wide for a terminal.
const LOADED: [Column; 6] = [
    Column { header: "params", meaning: "weights", cell: |m| count(m.about.loaded.parameters) },
    Column { header: "weights", meaning: "how most are held", cell: |m| m.about.loaded.weight_format.clone() },
    Column { header: "image", meaning: "its tokens", cell: |m| m.about.loaded.image_tokens.to_string() },
    Column { header: "prompt", meaning: "text tokens of a call", cell: |m| m.about.prompt_tokens.to_string() },
    Column { header: "load", meaning: "s", cell: |m| format!("{:.1}", m.about.loaded.load_s) },
    Column { header: "peak", meaning: "most memory", cell: |m| m.about.peak_memory.map_or_else(dash, memory) },
];
const COST: [Column; 7] = [
    Column { header: "encode", meaning: "image, ms", cell: |m| m.image_encode_ms.map_or_else(dash, figure) },
    Column { header: "prefill", meaning: "tok/s", cell: |m| m.prefill_tokens_per_s.map_or_else(dash, figure) },
    Column {
        header: "first",
        meaning: "time to first token, ms",
        cell: |m| m.first_token_ms.map_or_else(dash, figure),
    },
    Column { header: "decode", meaning: "tok/s", cell: |m| m.decode_tokens_per_s.map_or_else(dash, figure) },
    Column { header: "p50", meaning: "planning call, ms", cell: |m| m.call_ms.map_or_else(dash, |q| figure(q.p50)) },
    Column { header: "p95", meaning: "planning call, ms", cell: |m| m.call_ms.map_or_else(dash, |q| figure(q.p95)) },
    Column { header: "calls", meaning: "how many", cell: |m| m.calls.to_string() },
];

/// The tables for a terminal of 80 columns.
pub fn bench_table(figures: &BenchFigures) -> String {
    let mut parts = Vec::new();
    if !figures.models.is_empty() {
        for columns in [&LOADED[..], &COST] {
            let header = ["model"].into_iter().chain(columns.iter().map(|column| column.header)).map(str::to_owned);
            let rows = figures.models.iter().map(|model| cells(model, columns.iter())).collect();
            parts.push(plain(&header.collect::<Vec<_>>(), rows, 1));
        }
        let meanings = LOADED.iter().chain(&COST).map(|column| format!("{} = {}", column.header, column.meaning));
        parts.push(fill(meanings, COLUMNS).join("\n"));
    }
    if !figures.comparisons.is_empty() {
        let rows = figures.comparisons.iter().map(compared).collect();
        parts.push(plain(&COMPARISON.map(str::to_owned), rows, COMPARED_NAMES));
        parts.push(format!("ratio = how many times as fast planagent is  {}", other_engine(figures)));
    }
    parts.extend(figures.failed.iter().map(|(model, problem)| format!("{model} could not be measured: {problem}")));
    parts.join("\n\n")
}

/// The same as Markdown, the models in one wide table; `command` made it on `machine`.
pub fn bench_markdown(figures: &BenchFigures, command: &str, machine: &str) -> String {
    let mut text = format!("{machine}\n\n```console\n$ {command}\n```\n");
    if !figures.models.is_empty() {
        let all = || LOADED.iter().chain(&COST);
        let headers = all().map(|column| format!("{} ({})", column.header, column.meaning));
        let header: Vec<String> = std::iter::once("model".to_owned()).chain(headers).collect();
        markdown(&mut text, &header, 1, figures.models.iter().map(|model| cells(model, all())));
    }
    if !figures.comparisons.is_empty() {
        let _ = writeln!(text, "\nRatio: how many times as fast planagent is. {}.", other_engine(figures));
        markdown(&mut text, &COMPARISON.map(str::to_owned), COMPARED_NAMES, figures.comparisons.iter().map(compared));
    }
    for (model, problem) in &figures.failed {
        // Writing to a text cannot fail.
        let _ = writeln!(text, "\n{model} could not be measured: {problem}");
    }
    text
}

/// Which llama.cpp it was.
fn other_engine(figures: &BenchFigures) -> String {
    let other = figures.models.iter().find(|model| model.about.engine == EngineName::LlamaCpp);
    let version = other.map_or_else(dash, |model| model.about.loaded.version.clone());
    format!("{} = that of llama-cpp-python {version}", EngineName::LlamaCpp)
}

/// Columns of the comparison.
const COMPARISON: [&str; 7] = ["model", "what", "unit", "planagent", "llama.cpp", "ratio", "least to most"];
/// Those of them that are text.
const COMPARED_NAMES: usize = 3;

fn compared(row: &Comparison) -> Vec<String> {
    vec![
        row.model.clone(),
        row.what.clone(),
        row.unit.to_owned(),
        figure(row.ours),
        figure(row.theirs),
        format!("{:.2}", row.ratio.median),
        format!("{:.2} to {:.2}", row.ratio.least, row.ratio.most),
    ]
}

/// A line of the table of models; llama.cpp's stands under that of this program.
fn cells<'a>(model: &ModelFigures, columns: impl Iterator<Item = &'a Column>) -> Vec<String> {
    let name = match model.about.engine {
        EngineName::PlanAgent => model.about.model.clone(),
        EngineName::LlamaCpp => format!("- {}", EngineName::LlamaCpp),
    };
    std::iter::once(name).chain(columns.map(|column| (column.cell)(model))).collect()
}

fn dash() -> String {
    "-".to_owned()
}

/// Three significant digits, and whole numbers from 100 on.
fn figure(value: f64) -> String {
    match value.abs() {
        large if large >= 100.0 => format!("{value:.0}"),
        medium if medium >= 10.0 => format!("{value:.1}"),
        _ => format!("{value:.2}"),
    }
}

fn count(weights: u64) -> String {
    let weights = weights as f64;
    if weights < BILLION { format!("{:.1} M", weights / MILLION) } else { format!("{:.2} B", weights / BILLION) }
}

fn memory(bytes: u64) -> String {
    let bytes = bytes as f64;
    if bytes < GIBI { format!("{:.0} MiB", bytes / MEBI) } else { format!("{:.2} GiB", bytes / GIBI) }
}
