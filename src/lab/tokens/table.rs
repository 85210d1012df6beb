//! Means over counted scenes, as a table.

use super::{SceneText, TokenRow, Tokens};
use serde::Serialize;

/// Mean and 95th percentile (by rank) of a number of tokens.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct TokenMean {
    pub mean: f64,
    /// 95 of 100 descriptions take no more.
    pub p95: usize,
}

impl TokenMean {
    /// Of these counts; `None` of none.
    fn from_counts(mut counts: Vec<usize>) -> Option<Self> {
        counts.sort_unstable();
        let rank = (counts.len() as f64 * 0.95).ceil() as usize;
        let p95 = *counts.get(rank.max(1) - 1)?;
        Some(Self {
            mean: counts.iter().sum::<usize>() as f64 / counts.len() as f64,
            p95,
        })
    }
}

/// A way of describing scenes, and what it takes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TokenTableRow {
    pub text: SceneText,
    pub definition: &'static str,
    /// The paper's number, on nuPlan.
    pub published: Option<f64>,
    /// By `cl100k_base`.
    pub cl100k: Option<TokenMean>,
    /// By the model's own tokenizer.
    pub model: Option<TokenMean>,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TokenTable {
    /// States that were counted.
    pub states: usize,
    /// Mean number of agents and obstacles on the nine nodes.
    pub agents: Option<f64>,
    /// Name of the model whose tokenizer counts.
    pub model: Option<String>,
    /// A row a description, in the order of [`SceneText::all`].
    pub rows: Vec<TokenTableRow>,
}

impl TokenTable {
    /// The table of counted states; `model` names the model whose tokenizer counted.
    pub fn new(rows: &[TokenRow], model: Option<&str>) -> Self {
        let column = |place: usize, of: fn(&Tokens) -> Option<usize>| {
            TokenMean::from_counts(
                rows.iter()
                    .filter_map(|row| of(row.tokens.get(place)?))
                    .collect(),
            )
        };
        let described = SceneText::all()
            .into_iter()
            .enumerate()
            .map(|(place, text)| TokenTableRow {
                text,
                definition: text.definition(),
                published: text.published(),
                cl100k: column(place, |tokens| Some(tokens.cl100k)),
                model: column(place, |tokens| tokens.model),
            });
        let agents = rows.iter().map(|row| row.agents).sum::<usize>() as f64 / rows.len() as f64;
        Self {
            states: rows.len(),
            agents: (!rows.is_empty()).then_some(agents),
            model: model.map(str::to_owned),
            rows: described.collect(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn means_and_percentiles_are_over_all_states() {
        let row = |count: usize| TokenRow {
            scenario: "a".to_owned(),
            iteration: 0,
            agents: count,
            tokens: vec![Tokens {
                cl100k: count,
                model: None,
            }],
        };
        let rows: Vec<TokenRow> = (1..=20).map(row).collect();
        let table = TokenTable::new(&rows, None);
        assert_eq!(
            table.rows[0].cl100k,
            Some(TokenMean {
                mean: 10.5,
                p95: 19
            })
        );
        assert_eq!(
            (table.states, table.agents, table.rows[0].model),
            (20, Some(10.5), None)
        );
        assert_eq!(TokenTable::new(&[], None).rows[0].cl100k, None);
    }
}
