//! The paper's numbers: closed-loop scores x 100 on nuPlan's Val14 and Test14-hard, with GPT-4V unless a row names another
//! model. They stand beside ours to compare directions; the scenes differ.

use planagent_agent::simulation::Challenge;
use serde::{Deserialize, Serialize};

/// A benchmark of nuPlan.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub enum Benchmark {
    /// Common scenes.
    Val14,
    /// Random scenes of the test logs (PlanTF).
    #[serde(rename = "Test14-random")]
    Test14Random,
    /// Scenes that are hard for PDM-Closed.
    #[serde(rename = "Test14-hard")]
    Test14Hard,
}

impl Benchmark {
    pub fn name(self) -> &'static str {
        match self {
            Self::Val14 => "Val14",
            Self::Test14Random => "Test14-random",
            Self::Test14Hard => "Test14-hard",
        }
    }
}

/// The benchmark of the paper that a suite stands for.
pub fn benchmark(suite: &str) -> Option<Benchmark> {
    match suite {
        "generated-test14" | "generated" | "val14" | "reduced-val14" => Some(Benchmark::Val14),
        "generated-test14-hard" | "test14-hard" => Some(Benchmark::Test14Hard),
        _ => None,
    }
}

/// The benchmarks whose reported scores a suite is compared with.
pub fn reported_benchmarks(suite: &str) -> &'static [Benchmark] {
    match benchmark(suite) {
        Some(Benchmark::Val14) => &[Benchmark::Test14Random, Benchmark::Val14],
        Some(Benchmark::Test14Hard) => &[Benchmark::Test14Hard],
        Some(Benchmark::Test14Random) | None => &[],
    }
}

/// What READMEs of planners report: scores x 100 with non-reactive and with reactive agents. PlanTF's has both Test14, that of
/// `tuplan_garage` Val14; `DiffusionPlanner`'s or the paper has what these lack.
#[derive(Debug, Clone, Copy, PartialEq, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Reported {
    #[serde(default)]
    pub test14_hard: Option<[f64; 2]>,
    #[serde(default)]
    pub test14_random: Option<[f64; 2]>,
    #[serde(default)]
    pub val14: Option<[f64; 2]>,
}

impl Reported {
    /// All benchmarks, in the order of tables.
    pub const BENCHMARKS: [Benchmark; 3] = [Benchmark::Test14Hard, Benchmark::Test14Random, Benchmark::Val14];

    /// The scores on a benchmark.
    pub fn scores(&self, benchmark: Benchmark) -> Option<[f64; 2]> {
        match benchmark {
            Benchmark::Test14Hard => self.test14_hard,
            Benchmark::Test14Random => self.test14_random,
            Benchmark::Val14 => self.val14,
        }
    }

    /// The score in a challenge of a benchmark.
    pub fn score(&self, benchmark: Benchmark, challenge: Challenge) -> Option<f64> {
        of_challenge(self.scores(benchmark)?, challenge)
    }
}

/// The score of a challenge, from those with non-reactive and with reactive agents.
fn of_challenge([nonreactive, reactive]: [f64; 2], challenge: Challenge) -> Option<f64> {
    match challenge {
        Challenge::NonReactive => Some(nonreactive),
        Challenge::Reactive => Some(reactive),
        _ => None,
    }
}

/// What the paper reports of a row: scores with non-reactive and with reactive agents.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Published {
    /// NR-CLS and R-CLS on Val14.
    #[serde(default)]
    pub val14: Option<[f64; 2]>,
    /// NR-CLS and R-CLS on Test14-hard.
    #[serde(default)]
    pub test14_hard: Option<[f64; 2]>,
    #[serde(default)]
    pub model: Option<PublishedModel>,
}

/// A language model in the paper's table.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PublishedModel {
    /// Parameters, as the paper writes them.
    #[serde(default)]
    pub parameters: Option<String>,
    /// Mean time of an inference, milliseconds.
    pub time_ms: u32,
}

impl Published {
    /// The score in a challenge of a benchmark.
    pub fn score(&self, benchmark: Benchmark, challenge: Challenge) -> Option<f64> {
        let scores = match benchmark {
            Benchmark::Val14 => self.val14,
            Benchmark::Test14Hard => self.test14_hard,
            Benchmark::Test14Random => None,
        };
        of_challenge(scores?, challenge)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::study::find;

    /// The paper's source; says so when it is missing.
    fn paper() -> Option<String> {
        crate::outside::data("../paper/planagent.tex").map(|file| std::fs::read_to_string(file).unwrap())
    }

    /// The numbers with two decimals in each row of the table with a label; rows without any are left out.
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

    /// The published rows of a study, by name of the variant.
    fn published(study: &str) -> Vec<(String, Published)> {
        let study = find(study).unwrap();
        let rows = study.variants.iter().map(|variant| (study.name_of(variant), variant.published.clone()));
        rows.filter(|(_, published)| *published != Published::default()).collect()
    }

    #[test]
    #[cfg_attr(not(outside_data), ignore = "needs PLANAGENT_DATA")]
    fn the_main_table_is_the_papers() {
        let Some(paper) = paper() else { return };
        let rows = rows(&paper, "tab: main_result");
        let ours = published("main");
        let named = [
            ("Log-replay", "log-replay"),
            ("{IDM", "idm"),
            ("{PDM-Closed", "pdm-closed"),
            ("{PDM-Open", "pdm-open"),
            ("{PlanTF", "plantf"),
            ("{GameFormer", "gameformer"),
            ("{DTPP", "dtpp"),
            ("{GC-PGP", "gc-pgp"),
            ("{UrbanDriver", "urban-driver"),
            ("{RasterModel", "raster-model"),
            ("{UNC}", "llm-assist-unc"),
            ("{PAR}", "llm-assist-par"),
            ("PlanAgent(Ours)", "plan-agent (paper)"),
            ("PlanAgent(Ours)", "plan-agent"),
        ];
        assert_eq!(ours.len(), named.len());
        for (name, variant) in named {
            let row = rows.iter().find(|(row, _)| row.contains(name)).map(|(_, numbers)| numbers.clone());
            let (_, published) = ours.iter().find(|(own, _)| own == variant).unwrap();
            let scores = [published.val14, published.test14_hard].into_iter().flatten().flatten();
            assert_eq!(row, Some(scores.collect()), "{name}");
        }
    }

    #[test]
    fn seven_rows_of_the_papers_val14_are_test14_random() {
        let study = find("main").unwrap();
        let same = study.variants.iter().filter(|variant| {
            variant.published.val14.is_some() && variant.published.val14 == variant.reported.test14_random
        });
        let names: Vec<&str> = same.map(|variant| variant.planner.as_str()).collect();
        assert_eq!(names, ["log-replay", "idm", "pdm-open", "gameformer", "gc-pgp", "urban-driver", "raster-model"]);
    }

    #[test]
    #[cfg_attr(not(outside_data), ignore = "needs PLANAGENT_DATA")]
    fn the_other_tables_are_the_papers() {
        let Some(paper) = paper() else { return };
        for (label, study) in [
            ("tab: ablation_et", "environment"),
            ("tab: ablation_rr", "reasoning"),
            ("tab: interval", "interval"),
            ("tab: llm", "mllm"),
        ] {
            let mut ours = published(study);
            ours.retain(|(name, _)| name != "(pdm-closed)");
            let table = rows(&paper, label);
            let scores = |published: &Published| published.test14_hard.into_iter().flatten().collect::<Vec<f64>>();
            let mut theirs: Vec<Vec<f64>> = table.iter().map(|(_, numbers)| numbers.clone()).collect();
            let mut own: Vec<Vec<f64>> = ours.iter().map(|(_, published)| scores(published)).collect();
            for numbers in [&mut theirs, &mut own] {
                numbers.sort_by(|a, b| a[0].total_cmp(&b[0]));
            }
            assert_eq!(theirs, own, "{label}");
            for PublishedModel { parameters, time_ms } in
                ours.iter().filter_map(|(_, published)| published.model.clone())
            {
                let cells = format!("& {} & {time_ms} ms", parameters.as_deref().unwrap_or("-"));
                assert!(table.iter().any(|(row, _)| row.contains(&cells)), "{cells}");
            }
        }
    }
}
