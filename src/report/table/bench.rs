//! The tables of a bench.

use super::plain;
use crate::experiment::bench::EngineName;
use crate::report::{BenchFigures, Comparison, ModelFigures};
use std::fmt::Write as _;

const MEBI: f64 = (1 << 20) as f64;
const GIBI: f64 = (1 << 30) as f64;
/// Weights in a billion.
const BILLION: f64 = 1e9;

/// One column of the table of models.
struct Column {
    header: &'static str,
    /// What the header means.
    meaning: &'static str,
    cell: fn(&ModelFigures) -> String,
}

/// The columns that tell what was loaded, and those that tell what it costs; together too wide for a terminal.
const LOADED: [Column; 6] = [
    Column {
        header: "params",
        meaning: "weights, billions",
        cell: |m| format!("{:.2}", m.about.loaded.parameters as f64 / BILLION),
    },
    Column { header: "weights", meaning: "how they are stored", cell: |m| m.about.loaded.storage.clone() },
    Column { header: "image", meaning: "tokens of the image", cell: |m| m.about.loaded.image_tokens.to_string() },
    Column {
        header: "prompt",
        meaning: "text tokens of a call's prompts",
        cell: |m| m.about.prompt_tokens.to_string(),
    },
    Column { header: "load", meaning: "time to load, s", cell: |m| format!("{:.1}", m.about.loaded.load_s) },
    Column {
        header: "peak",
        meaning: "most memory of the process",
        cell: |m| m.about.peak_memory.map_or_else(dash, memory),
    },
];
const COST: [Column; 7] = [
    Column { header: "encode", meaning: "image encode, ms", cell: |m| m.image_encode_ms.map_or_else(dash, figure) },
    Column {
        header: "prefill",
        meaning: "first prompt, tok/s",
        cell: |m| m.prefill_tokens_per_s.map_or_else(dash, figure),
    },
    Column {
        header: "first",
        meaning: "time to first token, ms",
        cell: |m| m.first_token_ms.map_or_else(dash, figure),
    },
    Column { header: "decode", meaning: "tok/s", cell: |m| m.decode_tokens_per_s.map_or_else(dash, figure) },
    Column {
        header: "call p50",
        meaning: "planning call, ms",
        cell: |m| m.call_ms.map_or_else(dash, |q| figure(q.p50)),
    },
    Column { header: "p95", meaning: "planning call, ms", cell: |m| m.call_ms.map_or_else(dash, |q| figure(q.p95)) },
    Column { header: "calls", meaning: "planning calls measured", cell: |m| m.calls.to_string() },
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
        let all = LOADED.iter().chain(&COST);
        parts.push(all.map(|column| format!("{} = {}", column.header, column.meaning)).collect::<Vec<_>>().join("\n"));
    }
    if !figures.comparisons.is_empty() {
        let rows = figures.comparisons.iter().map(compared).collect();
        parts.push(plain(&COMPARISON.map(str::to_owned), rows, COMPARED_NAMES));
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
        markdown(&mut text, &COMPARISON.map(str::to_owned), COMPARED_NAMES, figures.comparisons.iter().map(compared));
    }
    for (model, problem) in &figures.failed {
        // Writing to a text cannot fail.
        let _ = writeln!(text, "\n{model} could not be measured: {problem}");
    }
    text
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

fn markdown(text: &mut String, header: &[String], names: usize, rows: impl Iterator<Item = Vec<String>>) {
    let rule: Vec<String> = (0..header.len()).map(|i| if i < names { "---" } else { "---:" }.to_owned()).collect();
    text.push('\n');
    for cells in [header.to_vec(), rule].into_iter().chain(rows) {
        let _ = writeln!(text, "| {} |", cells.join(" | "));
    }
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

fn memory(bytes: u64) -> String {
    let bytes = bytes as f64;
    if bytes < GIBI { format!("{:.0} MiB", bytes / MEBI) } else { format!("{:.2} GiB", bytes / GIBI) }
}
