//! The table of text twins.

use crate::twins::TwinResults;
use planagent_runs::report::fixed;
use planagent_runs::report::table::Table;
use std::fmt::Write as _;

/// The table for a terminal.
pub fn twin_table(results: &TwinResults) -> String {
    format!("{}\n{}", rows(results).terminal(), notes(results))
        .trim_end()
        .to_owned()
}

/// The same as Markdown.
pub(crate) fn twin_markdown(results: &TwinResults) -> String {
    rows(results).markdown() + "\n" + &notes(results)
}

fn rows(results: &TwinResults) -> Table {
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
