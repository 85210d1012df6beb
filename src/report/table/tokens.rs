//! The table of tokens that scene descriptions take.

use super::{Table, or_dash};
use crate::experiment::tokens::{TokenMean, TokenTable};
use crate::report::number::fixed;

/// A row a description: mean and 95th percentile by each tokenizer, and the paper's mean on nuPlan.
pub fn token_table(table: &TokenTable) -> String {
    let model = table.model.as_deref().unwrap_or("model");
    let counts = |mean: Option<TokenMean>| [or_dash(mean, |m| fixed(m.mean, 1)), or_dash(mean, |m| m.p95.to_string())];
    let rows = table.rows.iter().map(|row| {
        let name = row.text.name().to_owned();
        let paper = or_dash(row.published, |published| fixed(published, 2));
        [name].into_iter().chain(counts(row.cl100k)).chain(counts(row.model)).chain([paper]).collect()
    });
    Table::new(["description", "cl100k", "p95", model, "p95", "paper"], 1, rows).terminal()
}
