//! `planagent models list`.

use super::row::{BUILT_IN, Row, rounded};
use crate::{Exit, Printer};
use planagent_mllm::{ModelRegistry, WeightFormat};
use planagent_runs::report::table::{Table, or_dash};
use std::collections::BTreeSet;

/// The weight formats of the table.
const FORMATS: [WeightFormat; 4] = [
    WeightFormat::Q4K,
    WeightFormat::Q8_0,
    WeightFormat::F16,
    WeightFormat::F32,
];
/// The format whose keys and values and calls the table has.
const USUAL: WeightFormat = WeightFormat::Q4K;
/// What the columns mean, and what to do next.
const NOTE: &str = "*: on this machine. image: tokens of the drawn BEV map. GiB of the weights in \
    four formats; kv: GiB of 16-bit keys and values of up to 4096 tokens. call: seconds of a \
    planning call in q4_k with the model's prompt set, estimated for this machine. \
    `planagent bench MODEL` measures it; `planagent models show MODEL` has more.";
/// Bytes of a GiB.
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
    printer.table(table(&rows).fitted(printer.line_width()));
    // A broken description is no failure of the list, since the other models can be used.
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
    for line in printer.line_width().wrapped(NOTE) {
        printer.note(line);
    }
    Ok(Exit::Success)
}

/// A row for each model: a star where it is on this machine, its size, license, image tokens,
/// memory, and the time of a call.
fn table(rows: &[Row]) -> Table {
    let headers = ["  model", "size", "license", "image"]
        .into_iter()
        .chain(FORMATS.map(WeightFormat::name))
        .chain(["kv", "call"]);
    Table::new(headers, 1, rows.iter().map(cells))
        .with_texts(LICENSE)
        .with_gap(1)
}

/// The column of the licenses.
const LICENSE: usize = 2;

fn cells(row: &Row) -> Vec<String> {
    let gib = |bytes: u64| rounded(bytes as f64 / GIB);
    let need = |format: WeightFormat| row.memory.get(format.name());
    // What follows a comma is a remark.
    let license = row
        .license
        .as_deref()
        .and_then(|license| license.split(',').next());
    let here = if row.place.is_some() { "*" } else { " " };
    let memory = FORMATS.map(|format| or_dash(need(format), |need| gib(need.weights)));
    [
        format!("{here} {}", row.model),
        or_dash(row.size(), |size| size),
        license.unwrap_or("-").to_owned(),
        or_dash(row.image_tokens, |tokens| tokens.to_string()),
    ]
    .into_iter()
    .chain(memory)
    .chain([
        or_dash(need(USUAL), |need| gib(need.cache)),
        or_dash(row.call.get(USUAL.name()), |call| rounded(call.seconds())),
    ])
    .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use planagent_lab::bench::CallEstimate;
    use planagent_mllm::MemoryNeed;
    use planagent_runs::report::LineWidth;

    const NEED: MemoryNeed = MemoryNeed {
        weights: 142 << 30,
        cache: 17 << 30,
        work: 0,
        picture: 0,
    };

    #[test]
    fn the_table_fits_every_terminal() {
        let row = |name: &str| Row {
            model: name.to_owned(),
            license: Some("a-research-license, with a remark".to_owned()),
            parameters: Some(17_640_000_000),
            image_tokens: Some(2880),
            memory: FORMATS.map(|format| (format.name(), NEED)).into(),
            call: [(
                USUAL.name(),
                CallEstimate {
                    decode_s: 142.0,
                    ..CallEstimate::default()
                },
            )]
            .into(),
            place: Some("here".into()),
            ..Row::default()
        };
        let rows = [
            row("nano"),
            row(
                "a-folder/of-a-model/with-a-name/that-is-longer/than-a-terminal/of-80-columns.gguf",
            ),
        ];
        for columns in [60, 80, 100, 160] {
            let text = table(&rows).fitted(LineWidth::terminal(columns));
            let fits = |line: &str| line.chars().count() <= usize::from(columns);
            assert!(text.lines().all(fits), "wider than {columns}: {text}");
            assert!(text.contains("* nano") && text.contains("17.6B"), "{text}");
        }
    }
}
