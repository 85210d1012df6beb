//! Several codes an attempt, and codes that were refused.

use crate::agent::{Script, code_source, scenario, settings_with};
use planagent_agent::planner::{Attempt, CodeSource, PlanAgent, Planner, PlannerName, Proposal};
use planagent_agent::reasoning::{PlannerAnswer, PromptSet, Proposals, ReasoningConfig, Round};
use planagent_agent::simulation::{Challenge, simulate};
use planagent_mllm::{HubAccess, ModelRegistry};
use std::path::Path;
use std::sync::{Arc, Mutex};

/// Nano, with a number of proposals.
fn nano(proposals: usize) -> CodeSource {
    let models = Path::new(env!("CARGO_MANIFEST_DIR")).join("models");
    let registry = ModelRegistry::new(
        models,
        HubAccess {
            offline: true,
            ..HubAccess::default()
        },
    );
    let spec = registry.find("nano").unwrap();
    let config = ReasoningConfig {
        proposals: Proposals::try_from(proposals).unwrap(),
        ..ReasoningConfig::default()
    };
    CodeSource::Model {
        model: Arc::from(registry.open(&spec).unwrap()),
        prompts: Arc::new(PromptSet::open("compact").unwrap()),
        reasoning: config.settings(spec.generation),
    }
}

/// The attempts of the calls in the first seconds of a scene, where no plan scores enough.
fn refused_attempts(source: CodeSource) -> Vec<Vec<Attempt>> {
    let settings = settings_with(|settings| {
        (settings.reflection.threshold, settings.reflection.max_exec) = (1.5, 3);
        settings.agent.interval_s = 5.0;
    });
    let mut agent = PlanAgent::new(PlannerName::PLAN_AGENT, source, settings);
    simulate(
        &scenario("generated/starting_left_turn/1"),
        &mut agent,
        Challenge::NonReactive,
    )
    .unwrap();
    agent
        .calls()
        .iter()
        .map(|call| call.attempts.clone())
        .collect()
}

#[test]
fn a_further_attempt_repeats_no_refused_code() {
    for calls in [refused_attempts(nano(1)), refused_attempts(nano(4))] {
        assert!(calls.len() >= 3);
        for attempts in calls {
            let proposed = |attempt: &Attempt| match attempt.proposals.as_slice() {
                [] => vec![attempt.answer.unwrap()],
                several => several.iter().map(|proposal| proposal.answer).collect(),
            };
            let all: Vec<PlannerAnswer> = attempts.iter().flat_map(proposed).collect();
            assert!(all.len() >= 3);
            let repeated = (1..all.len()).find(|&i| all[..i].contains(&all[i]));
            assert_eq!(repeated, None, "{all:?}");
        }
    }
}

#[test]
fn the_best_proposal_is_the_answer_of_the_attempt() {
    assert!(
        refused_attempts(nano(1))
            .iter()
            .flatten()
            .all(|attempt| attempt.proposals.is_empty())
    );
    let mut other = 0;
    for attempt in refused_attempts(nano(4)).iter().flatten() {
        let score = |proposal: &Proposal| {
            proposal
                .reflection
                .as_ref()
                .map_or(f64::NEG_INFINITY, |report| report.score)
        };
        assert!(attempt.proposals.len() == 4, "{:?}", attempt.proposals);
        let better = |a: &usize, b: &usize| {
            score(&attempt.proposals[*a]).total_cmp(&score(&attempt.proposals[*b]))
        };
        let first = (0..4).rev().max_by(better).unwrap();
        assert_eq!(attempt.answer, Some(attempt.proposals[first].answer));
        assert_eq!(attempt.reflection, attempt.proposals[first].reflection);
        // The round has the likeliest one.
        let text = attempt.proposals[0].answer.to_string();
        assert_eq!(attempt.rounds.last().unwrap().answer, text);
        other += usize::from(first > 0);
    }
    assert!(other > 0, "a less likely code is sometimes better");
}

#[test]
fn proposals_of_a_model_without_probabilities_are_an_error() {
    let script = Script {
        answers: vec![""],
        asked: Mutex::default(),
    };
    let CodeSource::Model {
        model,
        prompts,
        mut reasoning,
    } = code_source(Arc::new(script), &[Round::Code])
    else {
        panic!("a model")
    };
    reasoning.proposals = Proposals::try_from(2).unwrap();
    let source = CodeSource::Model {
        model,
        prompts,
        reasoning,
    };
    let mut agent = PlanAgent::new(PlannerName::PLAN_AGENT, source, settings_with(|_| ()));
    let error = simulate(
        &scenario("generated/starting_left_turn/1"),
        &mut agent,
        Challenge::NonReactive,
    )
    .unwrap_err();
    let text = format!("{error:?}");
    assert!(text.contains("does not say how likely"), "{text}");
    for count in [0, 5] {
        assert!(
            Proposals::try_from(count)
                .unwrap_err()
                .contains("an attempt has 1 to 4")
        );
    }
}
