//! The scores of the closed loop: with the model, with codes that no model wrote, and with other
//! pictures; each on the same scenes.

use crate::report::{Outcome, SuiteSimulations, VariantSimulations, clusters};
use crate::study::{Figure, Published, Reported, Rows, Study, Variant};
use planagent_agent::planner::PlannerName;
use planagent_agent::simulation::Challenge;
use planagent_runs::report::SimulationRow;
use planagent_runs::worker::interactive;
use planagent_runs::worker::statistics::{Bootstrap, PairedDifference};
use planagent_runs::worker::suite::Suite;
use serde::Serialize;
use std::collections::BTreeMap;

/// The loop as it is.
const MODEL: &str = "the model";
/// Codes that no model wrote, by name of their planner.
const CONTROLS: [&str; 4] = ["random-code", "fixed-code", "grid-code", "grid-code-four"];
/// The model with other pictures, by the key of `environment` that says so.
const PICTURES: [(&str, &str, bool); 2] = [
    ("another scene's picture", "shuffled_bev", true),
    ("no picture", "bev", false),
];
/// The model whose plans come late.
const LATE: &str = "the model, late";

/// The score of a source of codes on a suite.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct SourceScore {
    pub(super) suite: String,
    pub(super) challenge: Challenge,
    /// Scenes of the suite.
    pub(super) scenes: usize,
    pub(super) source: String,
    /// Why it was not simulated.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) not_simulated: Option<&'static str>,
    /// Mean score x 100 of the completed simulations.
    pub(super) score: Option<f64>,
    pub(super) simulations: usize,
    pub(super) failed: usize,
    /// The score of the model minus this one on the same scenes, with the bootstrap interval; none
    /// for the model itself.
    pub(super) model_minus: Option<PairedDifference>,
}

/// The sources of a card, the model first. `sees` says whether it sees a picture, `oncoming` whether
/// its codes may name the oncoming lane: then those of the controls may.
pub(super) fn study(sees: bool, oncoming: bool) -> Study {
    let mut variants = vec![variant(MODEL, PlannerName::PLAN_AGENT.as_str(), &[])];
    let of_control = [("oncoming_lane", oncoming)];
    variants.extend(CONTROLS.map(|name| variant(name, name, &of_control)));
    if sees {
        variants.extend(PICTURES.map(|(name, key, value)| {
            variant(name, PlannerName::PLAN_AGENT.as_str(), &[(key, value)])
        }));
    }
    of_variants(variants)
}

/// The model whose plan of a call becomes active so many milliseconds later.
pub(super) fn late_study(latency_ms: u64) -> Study {
    let mut late = variant(LATE, PlannerName::PLAN_AGENT.as_str(), &[]);
    let latency = i64::try_from(latency_ms).unwrap_or(i64::MAX);
    late.settings.insert(
        "agent".to_owned(),
        toml::Table::from_iter([("latency".to_owned(), latency.into())]).into(),
    );
    of_variants(vec![late])
}

/// A source with these keys of the section `environment`.
fn variant(name: &str, planner: &str, environment: &[(&str, bool)]) -> Variant {
    let keys = environment
        .iter()
        .map(|&(key, value)| (key.to_owned(), value.into()));
    let keys: toml::Table = keys.collect();
    let mut settings = toml::Table::new();
    if !keys.is_empty() {
        settings.insert("environment".to_owned(), keys.into());
    }
    Variant {
        labels: vec![name.to_owned()],
        planner: planner.to_owned(),
        settings,
        published: Published::default(),
        reported: Reported::default(),
        x: None,
    }
}

fn of_variants(variants: Vec<Variant>) -> Study {
    Study {
        name: "card".to_owned(),
        word: "card".to_owned(),
        title: String::new(),
        paper: None,
        labels: vec!["source".to_owned()],
        reference: 0,
        suites: vec![
            Suite::TEST14_HARD.name.to_owned(),
            interactive::GENERATED.to_owned(),
        ],
        rows: Rows::Variants,
        starts: None,
        columns: Vec::new(),
        figure: Figure::Differences,
        remarks: Vec::new(),
        variants,
    }
}

/// The scores of a study's variants on its suites; differences are to the model in `of_model`, the
/// simulations of the same suites.
pub(super) fn scores(
    study: &Study,
    suites: &[SuiteSimulations],
    of_model: &[SuiteSimulations],
) -> Vec<SourceScore> {
    let mut scores = Vec::new();
    for (suite, reference) in suites.iter().zip(of_model) {
        let model = reference
            .variants
            .first()
            .map_or(&[][..], VariantSimulations::rows);
        for challenge in Challenge::CLOSED_LOOP {
            if !model.iter().any(|row| row.challenge == challenge) {
                continue;
            }
            for (variant, simulated) in study.variants.iter().zip(&suite.variants) {
                scores.push(score(
                    suite,
                    challenge,
                    &study.name_of(variant),
                    simulated,
                    model,
                ));
            }
        }
    }
    scores
}

fn score(
    suite: &SuiteSimulations,
    challenge: Challenge,
    source: &str,
    simulated: &VariantSimulations,
    model: &[SimulationRow],
) -> SourceScore {
    let of = |rows: &[SimulationRow]| -> BTreeMap<String, f64> {
        rows.iter()
            .filter(|row| row.challenge == challenge)
            .filter_map(|row| Some((row.source.clone(), row.score? * 100.0)))
            .collect()
    };
    let rows = simulated.rows();
    let (own, of_model) = (of(rows), of(model));
    // Scene by scene, as in studies.
    let differences: Vec<(&str, f64)> = own
        .iter()
        .filter_map(|(scene, score)| Some((scene.as_str(), of_model.get(scene)? - score)))
        .collect();
    let failed = rows
        .iter()
        .filter(|row| row.challenge == challenge && row.score.is_none());
    SourceScore {
        suite: suite.name.clone(),
        challenge,
        scenes: suite.scenes,
        source: source.to_owned(),
        not_simulated: match &simulated.outcome {
            Outcome::Simulated { .. } => None,
            Outcome::NotSimulated(why) => Some(why),
        },
        score: (!own.is_empty()).then(|| own.values().sum::<f64>() / own.len() as f64),
        simulations: own.len(),
        failed: failed.count(),
        model_minus: (source != MODEL)
            .then(|| Bootstrap::default().clustered(&clusters(&differences)))
            .flatten(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn suite(variants: &[&[f64]]) -> SuiteSimulations {
        let simulated = |scores: &&[f64]| VariantSimulations {
            outcome: Outcome::Simulated {
                run: "../runs/a".to_owned(),
                rows: scores
                    .iter()
                    .enumerate()
                    .map(|(seed, &score)| {
                        let planner = "plan-agent";
                        SimulationRow::example(
                            "changing_lane",
                            seed,
                            planner,
                            Challenge::Reactive,
                            Some(score),
                        )
                    })
                    .collect(),
            },
            parameters: None,
        };
        SuiteSimulations {
            name: "suite".to_owned(),
            scenes: 2,
            blake3: String::new(),
            variants: variants.iter().map(simulated).collect(),
        }
    }

    #[test]
    fn a_difference_is_the_model_minus_the_source_on_the_same_scenes() {
        let (study, late) = (study(false, true), late_study(40));
        let of_model = [suite(&[
            &[0.9, 0.7],
            &[0.4, 0.4],
            &[0.8],
            &[0.5, 0.5],
            &[1.0, 1.0],
        ])];
        let found = scores(&study, &of_model, &of_model);
        let names: Vec<&str> = found.iter().map(|row| row.source.as_str()).collect();
        assert_eq!(names[..2], ["the model", "random-code"]);
        assert_eq!((found.len(), found[0].model_minus), (5, None));
        let minus = |row: &SourceScore| row.model_minus.unwrap();
        assert!((minus(&found[1]).mean - 40.0).abs() < 1e-9);
        assert_eq!(minus(&found[2]).pairs, 1, "only common scenes count");
        let waited = scores(&late, &[suite(&[&[0.9, 0.5]])], &of_model);
        assert!((minus(&waited[0]).mean - 10.0).abs() < 1e-9, "{waited:?}");
        assert_eq!(
            late.variants[0].settings.to_string(),
            "[agent]\nlatency = 40\n"
        );
    }

    #[test]
    fn every_source_can_be_configured() {
        let config = planagent_runs::runner::Config::default();
        for study in [study(true, true), study(false, false), late_study(1)] {
            for variant in &study.variants {
                config.overlaid(&variant.settings).unwrap();
            }
        }
        assert_eq!(
            study(true, true).variants.len(),
            study(false, true).variants.len() + 2
        );
    }
}
