//! The table of text twins.

use crate::twins::TwinResults;
use planagent_runs::report::fixed;
use planagent_runs::report::table::{LineWidth, Table};
use std::fmt::Write as _;

/// The table for a terminal.
pub fn twin_table(results: &TwinResults, width: LineWidth) -> String {
    let notes = notes(results);
    let notes = notes.lines().flat_map(|note| width.wrapped(note));
    let notes = notes.collect::<Vec<_>>().join("\n");
    format!("{}\n{notes}", twin_rows(results).fitted(width))
        .trim_end()
        .to_owned()
}

/// The same as Markdown.
pub(crate) fn twin_markdown(results: &TwinResults) -> String {
    twin_rows(results).markdown() + "\n" + &notes(results)
}

/// The shares of a list.
pub(crate) fn twin_rows(results: &TwinResults) -> Table {
    let headers = [
        "kind",
        "pairs",
        "both right %",
        "95 %",
        "one right %",
        "none %",
        "same code %",
        "coin %",
    ];
    let rows = results.rows.iter().map(|row| {
        let [low, high] = row.both_interval.map(|bound| fixed(bound, 1));
        let shares = [row.one, row.none, row.same, row.coin].map(|share| fixed(share, 1));
        let first = [
            row.kind.clone(),
            row.pairs.to_string(),
            fixed(row.both, 1),
            format!("{low}-{high}"),
        ];
        first.into_iter().chain(shares).collect()
    });
    Table::new(headers, 1, rows)
}

fn notes(results: &TwinResults) -> String {
    let mut text = String::new();
    for (why, count) in &results.dropped {
        // Writing to a text cannot fail.
        let _ = writeln!(text, "{count} pairs do not count: {why}.");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::twins::TwinRow;

    #[test]
    fn the_table_fits_every_terminal() {
        let row = TwinRow {
            kind: "cross_left_of_the_vehicle".to_owned(),
            pairs: 1000,
            both: 100.0,
            both_interval: [99.9, 100.0],
            one: 100.0,
            none: 100.0,
            same: 100.0,
            coin: 100.0,
        };
        let why = "the prompts of both scenes have different numbers of tokens".repeat(2);
        let results = TwinResults {
            list: "twins".to_owned(),
            blake3: String::new(),
            dropped: [(why, 3)].into(),
            rows: vec![row],
        };
        for columns in [60, 80, 100, 160] {
            let text = twin_table(&results, LineWidth::terminal(columns));
            let fits = |line: &str| line.chars().count() <= usize::from(columns);
            assert!(text.lines().all(fits), "wider than {columns}: {text}");
        }
    }
}
