//! The paper's numbers: closed-loop scores x 100 on nuPlan's Val14 and Test14-hard, with GPT-4V
//! unless a row names another model. They stand beside ours to compare directions; the scenes
//! differ.

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
pub(crate) fn benchmark(suite: &str) -> Option<Benchmark> {
    match suite {
        "generated-test14" | "generated" | "val14" | "reduced-val14" => Some(Benchmark::Val14),
        "generated-test14-hard" | "test14-hard" => Some(Benchmark::Test14Hard),
        _ => None,
    }
}

/// The benchmarks whose reported scores a suite is compared with.
pub(crate) fn reported_benchmarks(suite: &str) -> &'static [Benchmark] {
    match benchmark(suite) {
        Some(Benchmark::Val14) => &[Benchmark::Test14Random, Benchmark::Val14],
        Some(Benchmark::Test14Hard) => &[Benchmark::Test14Hard],
        Some(Benchmark::Test14Random) | None => &[],
    }
}

/// What READMEs of planners report: scores x 100 with non-reactive and with reactive agents.
/// PlanTF's has both Test14, that of `tuplan_garage` Val14; `DiffusionPlanner`'s or the paper has
/// what these lack.
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
    pub(crate) const BENCHMARKS: [Benchmark; 3] = [
        Benchmark::Test14Hard,
        Benchmark::Test14Random,
        Benchmark::Val14,
    ];

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
