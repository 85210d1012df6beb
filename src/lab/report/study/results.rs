//! `results.json` of a study. Scores and differences are nuPlan's scores x 100, as in the
//! paper.

use super::agreement::{Agreement, agreements};
use super::asked::{AskedFigures, asks_for_figures};
use super::lost::{MetricLoss, losses};
use super::recordings::{CallShares, RecordingResults, recordings};
use crate::report::ModelFigures;
use crate::study::{Benchmark, Column, PublishedModel, Quick, Rows, Study, Variant, benchmark};
use planagent_agent::simulation::Challenge;
use planagent_runs::report::Quantiles;
use planagent_runs::report::SimulationRow;
use planagent_runs::worker::statistics::{Bootstrap, PairedDifference};
use planagent_scenario::modified::without_modification;
use planagent_scenario::without_start;
use planagent_score::metrics::distinct;
use serde::Serialize;
use std::collections::BTreeMap;

/// The simulations of a suite.
#[derive(Debug, Clone, PartialEq)]
pub struct SuiteSimulations {
    pub name: String,
    /// Number of scenes.
    pub scenes: usize,
    /// BLAKE3 of their names.
    pub blake3: String,
    /// The variants of the study, in its order.
    pub variants: Vec<VariantSimulations>,
}

/// The simulations of a variant.
#[derive(Debug, Clone, PartialEq)]
pub struct VariantSimulations {
    /// Its simulations, or why it has none.
    pub outcome: Outcome,
    /// Parameters of its model, if one was loaded.
    pub parameters: Option<u64>,
}

/// The simulations of a variant, or why it has none.
#[derive(Debug, Clone, PartialEq)]
pub enum Outcome {
    Simulated {
        /// Folder of the run, relative to that of the results.
        run: String,
        rows: Vec<SimulationRow>,
    },
    /// It was not simulated; the reason in a word or two.
    NotSimulated(&'static str),
}

/// The whole file `results.json`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct StudyResults {
    pub planagent: &'static str,
    pub study: String,
    pub title: String,
    /// The paper's table or figure.
    pub paper: Option<String>,
    /// Scenes of each type; none if all were simulated.
    pub quick: Option<Quick>,
    pub seed: u64,
    pub bootstrap: Bootstrap,
    /// The variant that the others are compared with.
    pub reference: String,
    pub suites: Vec<SuiteResults>,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SuiteResults {
    pub name: String,
    /// The paper's benchmark that is compared.
    pub benchmark: Option<Benchmark>,
    pub scenes: usize,
    /// BLAKE3 of their names.
    pub blake3: String,
    /// The variants, in the study's order.
    pub variants: Vec<VariantResults>,
    /// Each recording, in a study of recordings.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub recordings: Vec<RecordingResults>,
    /// How far the order of the planners agrees with reported ones.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub agreement: Vec<Agreement>,
}

impl SuiteResults {
    /// The challenges of its tables: those with simulations. Where nothing was simulated, all: the
    /// tables say why.
    pub fn challenges(&self) -> Vec<Challenge> {
        let results = || self.variants.iter().flat_map(|variant| &variant.challenges);
        let is_simulated = |challenge: &Challenge| {
            results().any(|result| {
                result.challenge == *challenge && result.simulations + result.failed > 0
            })
        };
        let simulated: Vec<Challenge> = Challenge::CLOSED_LOOP
            .into_iter()
            .filter(is_simulated)
            .collect();
        if simulated.is_empty() {
            Challenge::CLOSED_LOOP.to_vec()
        } else {
            simulated
        }
    }
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct VariantResults {
    pub name: String,
    pub planner: String,
    /// Configuration keys that it replaces.
    pub settings: toml::Table,
    /// Folder of the run.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub run: Option<String>,
    /// Why it was not simulated.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub not_simulated: Option<&'static str>,
    pub challenges: Vec<ChallengeResults>,
    /// Scores by scenario type, if the study compares these.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub scenario_types: Vec<TypeResults>,
    /// Mean number of planning calls; none for planners without a model.
    pub calls_per_simulation: Option<f64>,
    /// Its planning calls, in a study of recordings.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub calls: Option<CallShares>,
    /// Its planning calls by what they asked and gave, if the study compares this.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub asked: Option<AskedFigures>,
    /// What each metric costs it, if the study compares this.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub lost: Vec<MetricLoss>,
    /// Cost of its model, if the study compares it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub model: Option<ModelCost>,
}

/// Scores in a challenge.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ChallengeResults {
    pub challenge: Challenge,
    /// Mean score of the completed simulations.
    pub score: Option<f64>,
    /// Number of completed simulations.
    pub simulations: usize,
    /// Number of failed simulations.
    pub failed: usize,
    /// Score minus the reference's on the same scenes; none for the reference itself.
    pub difference: Option<PairedDifference>,
    /// The paper's score on [`SuiteResults::benchmark`].
    pub paper: Option<f64>,
    /// The paper's difference there.
    pub paper_difference: Option<f64>,
}

/// Scores in a scenario type.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TypeResults {
    pub scenario_type: String,
    pub challenges: Vec<ChallengeResults>,
}

/// The cost of a model. The time is a measurement.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ModelCost {
    /// Number of parameters.
    pub parameters: Option<u64>,
    /// Median time of a planning call, milliseconds.
    pub call_ms: Option<f64>,
    /// Whether the time is from a bench instead of the simulations.
    pub benched: bool,
    /// The paper's values.
    pub paper: Option<PublishedModel>,
}

impl StudyResults {
    /// The results of simulations; `bench` has the times of models that were not simulated.
    pub fn new(
        study: &Study,
        suites: &[SuiteSimulations],
        quick: Option<Quick>,
        seed: u64,
        bench: &[ModelFigures],
    ) -> Self {
        let bootstrap = Bootstrap::default();
        let reference = study
            .variants
            .get(study.reference)
            .expect("a study checks its reference");
        let source = ResultSource {
            study,
            bootstrap,
            bench,
        };
        Self {
            planagent: env!("CARGO_PKG_VERSION"),
            study: study.name.clone(),
            title: study.title.clone(),
            paper: study.paper.clone(),
            quick,
            seed,
            bootstrap,
            reference: study.name_of(reference),
            suites: suites.iter().map(|suite| source.suite(suite)).collect(),
        }
    }
}

/// What the results are computed from.
struct ResultSource<'a> {
    study: &'a Study,
    bootstrap: Bootstrap,
    bench: &'a [ModelFigures],
}

impl ResultSource<'_> {
    fn suite(&self, suite: &SuiteSimulations) -> SuiteResults {
        let benchmark = benchmark(&suite.name);
        let reference = suite
            .variants
            .get(self.study.reference)
            .map_or(&[][..], VariantSimulations::rows);
        let variants = self.study.variants.iter().zip(&suite.variants).enumerate();
        let of_recordings = self.study.rows == Rows::Recordings;
        SuiteResults {
            recordings: if of_recordings {
                recordings(&suite.variants, self.study.reference)
            } else {
                Vec::new()
            },
            name: suite.name.clone(),
            agreement: agreements(self.study, suite, self.bootstrap),
            benchmark,
            scenes: suite.scenes,
            blake3: suite.blake3.clone(),
            variants: variants
                .map(|(place, (variant, simulations))| {
                    let against = (place != self.study.reference).then_some(reference);
                    self.variant(variant, simulations, against, benchmark)
                })
                .collect(),
        }
    }

    fn variant(
        &self,
        variant: &Variant,
        simulations: &VariantSimulations,
        against: Option<&[SimulationRow]>,
        benchmark: Option<Benchmark>,
    ) -> VariantResults {
        let rows = simulations.rows();
        let (run, not_simulated) = match &simulations.outcome {
            Outcome::Simulated { run, .. } => (Some(run.clone()), None),
            Outcome::NotSimulated(why) => (None, Some(*why)),
        };
        let scenario_types = match self.study.rows {
            Rows::Variants | Rows::Recordings => Vec::new(),
            Rows::ScenarioTypes => distinct(rows.iter().map(|row| &row.scenario_type))
                .into_iter()
                .map(|kind| TypeResults {
                    scenario_type: kind.clone(),
                    challenges: self.challenges(variant, rows, against, None, |row| {
                        row.scenario_type == *kind
                    }),
                })
                .collect(),
        };
        let completed = rows.iter().filter(|row| row.score.is_some());
        let calls: usize = completed.clone().map(|row| row.planning_calls).sum();
        VariantResults {
            name: self.study.name_of(variant),
            planner: variant.planner.clone(),
            settings: variant.settings.clone(),
            run,
            not_simulated,
            challenges: self.challenges(variant, rows, against, benchmark, |_| true),
            scenario_types,
            // Most planners never call a model; zero is shown only in a study with a column for
            // calls.
            calls_per_simulation: (calls > 0 || self.study.columns.contains(&Column::Calls))
                .then(|| calls as f64 / completed.count() as f64),
            calls: (self.study.rows == Rows::Recordings).then(|| CallShares::from_rows(rows)),
            asked: asks_for_figures(self.study).then(|| AskedFigures::from_rows(rows)),
            lost: losses(self.study, rows),
            model: self
                .study
                .measures_models()
                .then(|| self.cost(variant, simulations)),
        }
    }

    fn challenges(
        &self,
        variant: &Variant,
        rows: &[SimulationRow],
        against: Option<&[SimulationRow]>,
        benchmark: Option<Benchmark>,
        counts: impl Fn(&SimulationRow) -> bool + Copy,
    ) -> Vec<ChallengeResults> {
        let published =
            |variant: &Variant, challenge| variant.published.score(benchmark?, challenge);
        let reference = self.study.variants.get(self.study.reference);
        Challenge::CLOSED_LOOP
            .into_iter()
            .map(|challenge| {
                let own = |row: &&SimulationRow| row.challenge == challenge && counts(row);
                let of = |rows: &[SimulationRow]| -> BTreeMap<String, f64> {
                    let scored = rows
                        .iter()
                        .filter(own)
                        .filter_map(|row| Some((row.source.clone(), row.score?)));
                    scored
                        .map(|(source, score)| (source, score * 100.0))
                        .collect()
                };
                let scores = of(rows);
                let others = against.map(of);
                // Scene by scene: scenes differ far more from each other than planners do on one
                // scene.
                let differences: Vec<(&str, f64)> = others
                    .iter()
                    .flatten()
                    .filter_map(|(s, o)| Some((s.as_str(), scores.get(s)? - o)))
                    .collect();
                let paper = published(variant, challenge);
                let reference = against
                    .and(reference)
                    .and_then(|reference| published(reference, challenge));
                ChallengeResults {
                    challenge,
                    score: (!scores.is_empty())
                        .then(|| scores.values().sum::<f64>() / scores.len() as f64),
                    simulations: scores.len(),
                    failed: rows
                        .iter()
                        .filter(own)
                        .filter(|row| row.score.is_none())
                        .count(),
                    difference: self.bootstrap.clustered(&clusters(&differences)),
                    paper,
                    paper_difference: paper.zip(reference).map(|(own, other)| own - other),
                }
            })
            .collect()
    }

    /// The time is that of the planning calls, or of a bench for a model that was not simulated.
    fn cost(&self, variant: &Variant, simulations: &VariantSimulations) -> ModelCost {
        let benched = self
            .bench
            .iter()
            .find(|model| variant.labels.first() == Some(&model.about.model));
        let calls = simulations
            .rows()
            .iter()
            .flat_map(|row| &row.time.calls)
            .map(|call| call.total)
            .collect();
        let simulated = Quantiles::from_values(calls).map(|quantiles| quantiles.p50);
        let from_bench = benched
            .and_then(|model| model.call_ms)
            .map(|quantiles| quantiles.p50);
        ModelCost {
            parameters: simulations
                .parameters
                .or_else(|| benched.map(|model| model.about.loaded.parameters)),
            call_ms: simulated.or(from_bench),
            benched: simulated.is_none() && from_bench.is_some(),
            paper: variant.published.model.clone(),
        }
    }
}

/// Differences by source in the clusters that the bootstrap draws: those of one recording together,
/// whatever its start and its modification.
pub(crate) fn clusters(differences: &[(&str, f64)]) -> Vec<Vec<f64>> {
    let mut clusters: BTreeMap<&str, Vec<f64>> = BTreeMap::new();
    for &(source, difference) in differences {
        // A word may have its start before or behind its modification.
        let recording = without_start(without_modification(without_start(source)));
        clusters.entry(recording).or_default().push(difference);
    }
    clusters.into_values().collect()
}

impl VariantSimulations {
    pub(crate) fn rows(&self) -> &[SimulationRow] {
        match &self.outcome {
            Outcome::Simulated { rows, .. } => rows,
            Outcome::NotSimulated(_) => &[],
        }
    }
}
