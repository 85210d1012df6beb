//! The table of what scene descriptions take.

use super::plain;
use crate::experiment::tokens::{TokenMean, TokenTable};
use crate::report::number::fixed;

/// A row a description: mean and 95th percentile by each tokenizer, and the paper's mean on nuPlan.
pub fn token_table(table: &TokenTable) -> String {
    let model = table.model.as_deref().unwrap_or("model");
    let header = ["description", "cl100k", "p95", model, "p95", "paper"].map(str::to_owned);
    let rows = table.rows.iter().map(|row| {
        let counts = [row.cl100k, row.model].map(cells).concat();
        let paper = row.published.map_or_else(|| "-".to_owned(), |published| fixed(published, 2));
        [row.text.name().to_owned()].into_iter().chain(counts).chain([paper]).collect()
    });
    plain(&header, rows.collect(), 1)
}

fn cells(mean: Option<TokenMean>) -> [String; 2] {
    mean.map_or_else(|| ["-", "-"].map(str::to_owned), |mean| [fixed(mean.mean, 1), mean.p95.to_string()])
}
