//! The tables of tokens that scene descriptions take.

use crate::tokens::{TokenMean, TokenTable};
use planagent_runs::report::fixed;
use planagent_runs::report::table::{LineWidth, Table, or_dash};
use std::fmt::Write as _;

/// The table for a terminal.
pub fn token_table(table: &TokenTable, width: LineWidth) -> String {
    let model = table.model.as_deref().unwrap_or("model");
    counts(
        table,
        ["description", "cl100k", "p95", model, "p95", "paper"],
        1,
    )
    .fitted(width)
}

/// The same as Markdown, with the definitions of the descriptions.
pub fn token_markdown(table: &TokenTable) -> String {
    let model = table.model.as_deref().unwrap_or("model");
    let [mean, p95] = ["mean", "p95"].map(|what| format!("{model} {what}"));
    let headers = [
        "description",
        "cl100k mean",
        "cl100k p95",
        &mean,
        &p95,
        "paper, on nuPlan",
    ];
    let mut text = counts(table, headers, 2).markdown();
    let agents = table.agents.map_or_else(String::new, |mean| {
        format!(", {mean:.1} agents on the nine nodes on average")
    });
    // Writing to a string cannot fail.
    let _ = writeln!(
        text,
        "\n{} states{agents}. The counts are of:\n",
        table.states
    );
    for row in &table.rows {
        let _ = writeln!(text, "- {}: {}.", row.text.name(), row.definition);
    }
    text
}

/// A row for each description: mean and 95th percentile by each tokenizer, and the paper's mean on
/// nuPlan.
fn counts(table: &TokenTable, headers: [&str; 6], decimals: usize) -> Table {
    let cells = |mean: Option<TokenMean>| {
        [
            or_dash(mean, |mean| fixed(mean.mean, decimals)),
            or_dash(mean, |mean| mean.p95.to_string()),
        ]
    };
    let rows = table.rows.iter().map(|row| {
        let paper = or_dash(row.published, |published| fixed(published, 2));
        [row.text.name().to_owned()]
            .into_iter()
            .chain(cells(row.cl100k))
            .chain(cells(row.model))
            .chain([paper])
            .collect()
    });
    Table::new(headers, 1, rows)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_table_fits_every_terminal() {
        for columns in [60, 80, 100, 160] {
            let text = token_table(&TokenTable::new(&[], None), LineWidth::terminal(columns));
            let fits = |line: &str| line.chars().count() <= usize::from(columns);
            assert!(text.lines().all(fits), "wider than {columns}: {text}");
        }
    }

    #[test]
    fn missing_counts_are_dashes() {
        let text = token_markdown(&TokenTable::new(&[], None));
        assert!(
            text.contains("| GPT-Driver, whole user message | - | - | - | - | 448.66 |"),
            "{text}"
        );
        assert!(text.contains("| model mean | model p95 |"), "{text}");
    }
}
