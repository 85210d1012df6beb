//! The numbers of the paper's tables: closed-loop scores x 100 on nuPlan's Val14 and Test14-hard, GPT-4V where nothing else is
//! said. They are set beside our own for the direction; the scenes are others.

use crate::simulation::Challenge;
use serde::Serialize;

/// Which of nuPlan's benchmarks a number is of.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub enum Benchmark {
    /// Common scenes.
    Val14,
    /// Scenes that are hard for PDM-Closed.
    #[serde(rename = "Test14-hard")]
    Test14Hard,
}

impl Benchmark {
    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Val14 => "Val14",
            Self::Test14Hard => "Test14-hard",
        }
    }
}

/// NR-CLS and R-CLS.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Scores {
    /// Among replayed traffic.
    pub nonreactive: f64,
    /// Among reactive traffic.
    pub reactive: f64,
}

/// What the paper reports of a row.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Published {
    /// On Val14.
    pub val14: Option<Scores>,
    /// On Test14-hard.
    pub test14_hard: Option<Scores>,
    /// What its model is and takes.
    pub model: Option<PublishedModel>,
}

/// A language model in the paper's table.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PublishedModel {
    /// Parameters, as the paper writes them.
    pub parameters: Option<&'static str>,
    /// Mean time of an inference, milliseconds.
    pub time_ms: u32,
}

impl Published {
    /// What the paper does not have.
    pub const NOTHING: Self = Self { val14: None, test14_hard: None, model: None };

    /// A row of both benchmarks.
    const fn both(val14: [f64; 2], test14_hard: [f64; 2]) -> Self {
        Self { val14: Some(scores(val14)), test14_hard: Some(scores(test14_hard)), model: None }
    }

    /// A row without numbers on Test14-hard.
    const fn common(val14: [f64; 2]) -> Self {
        Self { val14: Some(scores(val14)), ..Self::NOTHING }
    }

    /// A row of the ablations.
    const fn hard(test14_hard: [f64; 2]) -> Self {
        Self { test14_hard: Some(scores(test14_hard)), ..Self::NOTHING }
    }

    /// A row of the table of models.
    const fn of_model(test14_hard: [f64; 2], parameters: Option<&'static str>, time_ms: u32) -> Self {
        Self { model: Some(PublishedModel { parameters, time_ms }), ..Self::hard(test14_hard) }
    }

    /// The score in a challenge of a benchmark.
    pub fn score(&self, benchmark: Benchmark, challenge: Challenge) -> Option<f64> {
        let scores = match benchmark {
            Benchmark::Val14 => self.val14,
            Benchmark::Test14Hard => self.test14_hard,
        };
        match challenge {
            Challenge::NonReactive => scores.map(|scores| scores.nonreactive),
            Challenge::Reactive => scores.map(|scores| scores.reactive),
            Challenge::OpenLoop => None,
        }
    }
}

const fn scores([nonreactive, reactive]: [f64; 2]) -> Scores {
    Scores { nonreactive, reactive }
}

// Comparison with other methods.
pub(super) const LOG_REPLAY: Published = Published::both([94.03, 75.86], [85.96, 68.80]);
pub(super) const IDM: Published = Published::both([70.39, 72.42], [56.16, 62.26]);
pub(super) const PDM_CLOSED: Published = Published::both([92.51, 91.79], [65.07, 75.18]);
pub(super) const LLM_ASSIST_UNC: Published = Published::common([90.11, 90.32]);
pub(super) const LLM_ASSIST_PAR: Published = Published::common([93.05, 92.20]);
pub(super) const PLAN_AGENT: Published = Published::both([93.26, 92.75], [72.51, 76.82]);

// Ablation of the Environment Transformation.
pub(super) const NEITHER_INPUT: Published = Published::hard([67.96, 72.44]);
pub(super) const LANE_GRAPH_ALONE: Published = Published::hard([70.97, 75.61]);
pub(super) const BEV_ALONE: Published = Published::hard([71.23, 75.25]);

// Ablation of the Reasoning Engine and Reflection.
pub(super) const WITHOUT_UNDERSTANDING: Published = Published::hard([70.09, 75.26]);
pub(super) const WITHOUT_INSTRUCTION: Published = Published::hard([70.60, 75.39]);
pub(super) const WITHOUT_REFLECTION: Published = Published::hard([69.84, 74.08]);

// Ablation of the interval between calls.
pub(super) const EVERY_SECOND: Published = Published::hard([71.85, 76.10]);
pub(super) const EVERY_THIRD_SECOND: Published = Published::hard([71.35, 75.26]);

// Language models.
pub(super) const COGVLM: Published = Published::of_model([68.37, 72.21], Some("17B"), 4405);
pub(super) const LLAVA_7B: Published = Published::of_model([67.73, 72.06], Some("7B"), 2936);
pub(super) const LLAVA_13B: Published = Published::of_model([69.40, 73.89], Some("13B"), 3694);
pub(super) const GPT_4V: Published = Published::of_model([72.51, 76.82], None, 5568);

#[cfg(test)]
mod tests {
    use super::*;

    /// The paper's source; says so when it is missing.
    fn paper() -> Option<String> {
        crate::outside::data("../paper/planagent.tex").map(|file| std::fs::read_to_string(file).unwrap())
    }

    /// The numbers with two decimals in each row of the table with a label, rows without any left out.
    fn rows(paper: &str, label: &str) -> Vec<(String, Vec<f64>)> {
        let end = paper.find(&format!("\\label{{{label}}}")).unwrap();
        let begin = paper[..end].rfind("\\begin{tabular}").unwrap();
        let numbers = |row: &str| -> Vec<f64> {
            let words = row.split(|c: char| !c.is_ascii_digit() && c != '.');
            words
                .filter(|w| w.split_once('.').is_some_and(|(_, cents)| cents.len() == 2))
                .flat_map(str::parse)
                .collect()
        };
        let rows = paper[begin..end].split("\\\\").map(|row| (row.to_owned(), numbers(row)));
        rows.filter(|(_, numbers)| numbers.len() > 1).collect()
    }

    fn of(published: &Published) -> Vec<f64> {
        let scores = [published.val14, published.test14_hard].into_iter().flatten();
        scores.flat_map(|scores| [scores.nonreactive, scores.reactive]).collect()
    }

    #[test]
    fn the_main_table_is_the_papers() {
        let Some(paper) = paper() else { return };
        let rows = rows(&paper, "tab: main_result");
        let named = [
            ("Log-replay", LOG_REPLAY),
            ("{IDM", IDM),
            ("{PDM-Closed", PDM_CLOSED),
            ("{UNC}", LLM_ASSIST_UNC),
            ("{PAR}", LLM_ASSIST_PAR),
            ("PlanAgent(Ours)", PLAN_AGENT),
        ];
        for (name, published) in named {
            let row = rows.iter().find(|(row, _)| row.contains(name));
            assert_eq!(row.map(|(_, numbers)| numbers), Some(&of(&published)), "{name}");
        }
    }

    #[test]
    fn the_other_tables_are_the_papers() {
        let Some(paper) = paper() else { return };
        let full = Published::hard([72.51, 76.82]);
        let tables = [
            ("tab: ablation_et", vec![NEITHER_INPUT, LANE_GRAPH_ALONE, BEV_ALONE, full]),
            ("tab: ablation_rr", vec![WITHOUT_UNDERSTANDING, WITHOUT_INSTRUCTION, WITHOUT_REFLECTION, full]),
            ("tab: interval", vec![EVERY_SECOND, full, EVERY_THIRD_SECOND]),
            ("tab: llm", vec![COGVLM, LLAVA_7B, LLAVA_13B, GPT_4V]),
        ];
        for (label, expected) in tables {
            let rows = rows(&paper, label);
            let numbers: Vec<Vec<f64>> = rows.iter().map(|(_, numbers)| numbers.clone()).collect();
            assert_eq!(numbers, expected.iter().map(of).collect::<Vec<_>>(), "{label}");
            for ((row, _), model) in rows.iter().zip(expected.iter().map(|published| published.model)) {
                let Some(PublishedModel { parameters, time_ms }) = model else { continue };
                assert!(row.contains(&format!("& {} & {time_ms} ms", parameters.unwrap_or("-"))), "{row}");
            }
        }
        assert_eq!(PLAN_AGENT.test14_hard, full.test14_hard);
    }
}
