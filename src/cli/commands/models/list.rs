//! `planagent models list`.

use super::row::{BUILT_IN, Row, rounded};
use crate::{Exit, Printer};
use planagent_mllm::{ModelRegistry, WeightFormat};
use std::collections::BTreeSet;

/// The weight formats of the table.
const FORMATS: [WeightFormat; 4] = [
    WeightFormat::Q4K,
    WeightFormat::Q8_0,
    WeightFormat::F16,
    WeightFormat::F32,
];
/// The format whose keys and values the table has.
const USUAL: WeightFormat = WeightFormat::Q4K;
const GIB: f64 = (1_u64 << 30) as f64;

/// Lists the described models.
pub(super) fn run(registry: &ModelRegistry, csv: bool, printer: Printer) -> anyhow::Result<Exit> {
    let rows: Vec<Row> = registry
        .names()?
        .into_iter()
        .map(|name| Row::for_model(name, registry))
        .collect();
    if csv {
        printer.csv(&rows)?;
        return Ok(Exit::Success);
    }
    if printer.is_json() {
        for row in &rows {
            printer.json(row)?;
        }
        return Ok(Exit::Success);
    }
    printer.line(line(
        "",
        "model",
        "size",
        "license",
        ["image", "kv"],
        FORMATS.map(WeightFormat::name),
    ));
    for row in &rows {
        printer.line(row_line(row));
    }
    let broken = rows.iter().filter(|row| row.source.is_none());
    broken.for_each(|row| {
        printer.line(format!(
            "{}: {}",
            row.model,
            row.problem
                .as_deref()
                .expect("a row without a source has its problem")
        ));
    });
    let sets = rows
        .iter()
        .filter_map(|row| Some((row.prompt_set.as_deref()?, row.prompts.as_deref()?)));
    for (set, place) in sets
        .filter(|(_, place)| *place != BUILT_IN)
        .collect::<BTreeSet<_>>()
    {
        printer.line(format!("{set} prompts in {place}"));
    }
    printer.note(
        "*: on this machine. image: tokens of the drawn BEV map. GiB of the weights in\n\
         four formats; kv: GiB of 16-bit keys and values of up to 4096 tokens.\n\
         `planagent bench MODEL` measures the time of a planning call;\n\
         `planagent models show MODEL` has more.",
    );
    Ok(Exit::Success)
}

/// The line of a model.
fn row_line(row: &Row) -> String {
    let unknown = || "-".to_owned();
    let weights = |format: WeightFormat| {
        row.memory
            .get(format.name())
            .map(|need| rounded(need.weights as f64 / GIB))
    };
    let image = row.image_tokens.map(|tokens| tokens.to_string());
    let cache = row
        .memory
        .get(USUAL.name())
        .map(|need| rounded(need.cache as f64 / GIB));
    // What follows a comma is a remark.
    let license = row
        .license
        .as_deref()
        .and_then(|license| license.split(',').next())
        .unwrap_or("-");
    let [image, cache] = [image, cache].map(|text| text.unwrap_or_else(unknown));
    let here = if row.place.is_some() { "*" } else { "" };
    let memory = FORMATS.map(|format| weights(format).unwrap_or_else(unknown));
    let size = row.size().unwrap_or_else(unknown);
    line(
        here,
        &row.model,
        &size,
        license,
        [&image, &cache],
        memory.each_ref().map(String::as_str),
    )
}

/// A line of at most 80 columns, where name and license are not longer than those that ship.
fn line(
    here: &str,
    name: &str,
    size: &str,
    license: &str,
    [image, cache]: [&str; 2],
    [a, b, c, d]: [&str; 4],
) -> String {
    format!(
        "{here:1} {name:<21} {size:>5} {license:<13} {image:>5} {a:>4} {b:>4} {c:>4} {d:>4} {cache:>4}"
    )
}
