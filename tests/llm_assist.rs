//! LLM-ASSIST with a scripted model and with the one that ships.

use crate::agent::{Script, reasoning, scenario, settings_with};
use planagent_agent::planner::{
    AskedModel, Decision, LlmAssist, NoPlan, PdmClosed, PlanAgentSettings, Planner, PlannerName,
    Unreadable,
};
use planagent_agent::reasoning::{
    AssistVariant, Assistance, PlannerAnswer, PromptSet, ReasoningSettings, Round,
};
use planagent_agent::simulation::{Challenge, SimulationLog, simulate};
use planagent_mllm::{HubAccess, Mllm, ModelRegistry};
use std::path::Path;
use std::sync::{Arc, Mutex};

const SCENE: &str = "generated/high_magnitude_speed/1";

/// No proposal of PDM-Closed reaches this τ, and no answer either.
fn unreachable_threshold() -> PlanAgentSettings {
    settings_with(|settings| settings.reflection.threshold = 1.01)
}

fn drive(
    answers: &[&'static str],
    variant: AssistVariant,
    settings: PlanAgentSettings,
) -> (LlmAssist, SimulationLog, Vec<String>) {
    let script = Arc::new(Script {
        answers: answers.to_vec(),
        asked: Mutex::new(Vec::new()),
    });
    let model: Arc<dyn Mllm> = script.clone();
    let prompts = Arc::new(PromptSet::open("paper").unwrap());
    let asked = AskedModel {
        model,
        prompts,
        reasoning: reasoning(&[Round::Code]),
    };
    let mut planner = LlmAssist::new(PlannerName::new("llm-assist"), variant, asked, settings);
    let log = simulate(&scenario(SCENE), &mut planner, Challenge::NonReactive).unwrap();
    let asked = script.asked.lock().unwrap().clone();
    (planner, log, asked)
}

fn by_rules() -> SimulationLog {
    simulate(
        &scenario(SCENE),
        &mut PdmClosed::new(),
        Challenge::NonReactive,
    )
    .unwrap()
}

#[test]
fn the_model_is_not_asked_while_a_proposal_is_good_enough() {
    let settings = settings_with(|settings| settings.reflection.threshold = 0.1);
    let (planner, log, asked) = drive(&["nothing"], AssistVariant::Unconstrained, settings);
    assert!(planner.calls().is_empty() && asked.is_empty());
    assert_eq!(log.samples, by_rules().samples);
}

#[test]
fn pdm_closed_is_executed_where_no_answer_is_better_or_can_be_read() {
    // PDM-Closed's own parameters give its own proposals.
    let own = "Tune_PDM(v0=40, gap=1, headway=1.5, acc=1.5, dec=3, brake=on)";
    for (answer, variant, why) in [
        (own, AssistVariant::Parameters, NoPlan::Outscored),
        (
            "drive on",
            AssistVariant::Parameters,
            NoPlan::Unreadable(Unreadable::NoLine),
        ),
        (
            "Follow_Waypoints(x1=1)",
            AssistVariant::Unconstrained,
            NoPlan::Unreadable(Unreadable::WrongLine),
        ),
    ] {
        let (planner, log, asked) = drive(&[answer], variant, unreachable_threshold());
        assert_eq!(
            (planner.calls().len(), asked.len()),
            (8, 24),
            "eight calls of three attempts"
        );
        for call in planner.calls() {
            assert_eq!(call.decision, Decision::RuleBased(why.clone()));
            assert_eq!(call.attempts.len(), 3);
        }
        assert_eq!(log.samples, by_rules().samples, "{answer}");
    }
}

#[test]
fn the_question_has_the_scene_in_coordinates_and_the_answer_is_scored() {
    let answer = "Follow_Waypoints(x1=12, y1=0, x2=24, y2=0, x3=36, y3=0, x4=48, y4=0)";
    let (planner, _, asked) = drive(
        &[answer],
        AssistVariant::Unconstrained,
        unreachable_threshold(),
    );
    assert!(
        asked[0].starts_with("Ego: speed ") && asked[0].contains("ego_lane: ("),
        "{}",
        asked[0]
    );
    assert!(
        asked[0].contains("scores 1.00 of 1") || asked[0].contains("scores 0."),
        "{}",
        asked[0]
    );
    assert!(
        asked[1].contains(answer) && asked[1].contains("refused"),
        "{}",
        asked[1]
    );
    let attempt = &planner.calls()[0].attempts[0];
    assert!(matches!(
        attempt.answer,
        Some(PlannerAnswer::Assistance(Assistance::Waypoints(_)))
    ));
    let reflection = attempt.reflection.as_ref().unwrap();
    assert_eq!(reflection.states.len(), 41);
    assert!(
        reflection.score > 0.5 && attempt.path.len() == 41,
        "{:?}",
        reflection.parts
    );
}

/// nano was not trained for these questions; under the grammars its answers can be read.
#[test]
fn the_model_that_ships_answers_so_that_it_can_be_read() {
    let models = Path::new(env!("CARGO_MANIFEST_DIR")).join("models");
    let registry = ModelRegistry::new(
        models,
        HubAccess {
            offline: true,
            ..HubAccess::default()
        },
    );
    let spec = registry.find("nano").unwrap();
    let model: Arc<dyn Mllm> = Arc::from(registry.open(&spec).unwrap());
    for &variant in AssistVariant::ALL {
        let reasoning = ReasoningSettings {
            grammar: true,
            generation: spec.generation,
            ..reasoning(&[Round::Code])
        };
        let prompts = Arc::new(PromptSet::open("compact").unwrap());
        let asked = AskedModel {
            model: model.clone(),
            prompts,
            reasoning,
        };
        let mut planner = LlmAssist::new(
            PlannerName::new("llm-assist"),
            variant,
            asked,
            unreachable_threshold(),
        );
        simulate(&scenario(SCENE), &mut planner, Challenge::NonReactive).unwrap();
        assert_eq!(planner.calls().len(), 8);
        for attempt in planner.calls().iter().flat_map(|call| &call.attempts) {
            assert!(
                attempt.answer.is_some() && attempt.errors.is_empty(),
                "{:?}",
                attempt.errors
            );
        }
    }
}
