//! `DiLu` with a scripted model and with an oracle.

use crate::dilu::{DiluItem, Drive, lesson_items};
use crate::memory::Memory;
use crate::tests::{Stub, asked_seldom, default_scene, drive};
use planagent_agent::planner::{
    AskedModel, Decision, LanguageAgentSettings, NoPlan, PlanAgentSettings, Unreadable,
};
use planagent_agent::reasoning::{
    DrivingAction, PlannerAnswer, PromptSet, Proposals, ReasoningSettings, Round, Speculation,
};
use planagent_agent::simulation::Challenge;
use planagent_mllm::{Constraint, GenerationSettings, Sampling};
use std::sync::Arc;

/// Goes faster until 8 m/s are set, then keeps on.
fn up_to_eight(prompt: &str, _: usize) -> String {
    let set = prompt.rsplit("Set speed ").next().unwrap();
    let speed: f64 = set.split(' ').next().unwrap().parse().unwrap();
    let action = if speed < 7.0 { 3 } else { 1 };
    format!("The way is free, so that is right.\n#### {action}")
}

#[test]
fn dilu_drives_the_default_scene_by_actions() {
    for challenge in Challenge::CLOSED_LOOP {
        let (scenario, settings) = (default_scene(), PlanAgentSettings::default());
        let model = Stub::new(up_to_eight);
        let (calls, log) = drive("dilu", Some(model.clone()), &scenario, challenge, &settings);
        assert!(calls.len() >= 14);
        for call in &calls {
            assert_eq!(call.decision, Decision::Execute(0), "{:?}", call.attempts);
            let attempt = &call.attempts[0];
            assert!(matches!(attempt.answer, Some(PlannerAnswer::Action(_))));
            assert_eq!(attempt.rounds[0].round.as_str(), "action");
        }
        let asked = model.asked.lock().unwrap();
        assert!(asked[0].0.contains("Your car: speed ") && asked[0].0.contains("\n1: keep"));
        assert!(!asked[0].0.contains("A scene that you met"), "no memory");
        // In parts the reasoning would take the line break before the delimiter.
        assert!(
            matches!(asked[0].1, Constraint::Regex(_)),
            "{:?}",
            asked[0].1
        );
        let last = log.samples.last().unwrap().ego;
        assert!((last.speed() - 7.5).abs() < 0.6, "{}", last.speed());
    }
}

#[test]
fn an_answer_without_an_action_is_asked_about_once_and_then_counted() {
    type Case = (&'static str, fn(&str, usize) -> String, Unreadable);
    let (scenario, settings) = (default_scene(), PlanAgentSettings::default());
    let challenge = Challenge::NonReactive;
    let second = Stub::new(|_, n| {
        if n % 2 == 0 {
            "I keep on.".to_owned()
        } else {
            "1".to_owned()
        }
    });
    let (calls, _) = drive("dilu", Some(second), &scenario, challenge, &settings);
    for call in &calls {
        let attempt = &call.attempts[0];
        assert_eq!(call.decision, Decision::Execute(0));
        assert_eq!((attempt.rounds.len(), attempt.errors.len()), (2, 1));
        assert_eq!(attempt.rounds[1].round.as_str(), "extraction");
    }
    let cases: [Case; 3] = [
        (
            "no number",
            |_, _| "#### soon".to_owned(),
            Unreadable::WrongLine,
        ),
        (
            "out of range",
            |_, _| "#### 7".to_owned(),
            Unreadable::WrongLine,
        ),
        (
            "a word behind it",
            |_, _| "#### 1. Keep on".to_owned(),
            Unreadable::WrongLine,
        ),
    ];
    for (case, answer, cause) in cases {
        let (calls, _) = drive(
            "dilu",
            Some(Stub::new(answer)),
            &scenario,
            challenge,
            &settings,
        );
        let expected = Decision::Brake(NoPlan::Unreadable(cause));
        assert!(calls.iter().all(|call| call.decision == expected), "{case}");
        assert!(calls.iter().all(|call| call.parse_errors() == 2), "{case}");
    }
}

#[test]
fn a_second_question_that_is_not_answered_is_an_empty_answer() {
    let (scenario, settings) = (default_scene(), asked_seldom());
    let silent = Stub::new(|_, n| ["I keep on.", ""][n % 2].to_owned());
    let challenge = Challenge::NonReactive;
    let (calls, _) = drive("dilu", Some(silent), &scenario, challenge, &settings);
    for call in &calls {
        let cause = NoPlan::Unreadable(Unreadable::Empty);
        assert_eq!(call.decision, Decision::Brake(cause));
        let errors = &call.attempts[0].errors;
        assert_eq!((errors.len(), errors[1].span.clone()), (2, 0..0));
        assert!(
            errors[0].message.starts_with("first answer: no ####"),
            "{}",
            errors[0]
        );
    }
}

#[test]
fn an_action_that_is_not_offered_is_refused_and_shown() {
    let (scenario, settings) = (default_scene(), asked_seldom());
    // A road has no end of lanes to the left, so that one of these asks for too much.
    let left = Stub::new(|_, _| "I change.\n#### 0".to_owned());
    let challenge = Challenge::NonReactive;
    let (calls, _) = drive("dilu", Some(left), &scenario, challenge, &settings);
    let refused: Vec<_> = calls
        .iter()
        .filter(|call| call.unreadable() == Some(Unreadable::WrongLine))
        .collect();
    assert!(!refused.is_empty());
    for call in refused {
        let attempt = &call.attempts[0];
        assert_eq!(
            attempt.answer,
            Some(PlannerAnswer::Action(DrivingAction::Left))
        );
        assert!(attempt.errors[0].message.contains("is not offered here"));
        assert!(attempt.path.is_empty());
    }
}

fn memory_of(items: Vec<DiluItem>) -> (tempfile::TempDir, PlanAgentSettings) {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("dilu.json");
    let memory = Memory::new("dilu", "a test".to_owned(), items);
    std::fs::write(&file, serde_json::to_string(&memory).unwrap()).unwrap();
    let mut language_agents = LanguageAgentSettings::default();
    language_agents.agent_mut("dilu").memory = Some(file.to_str().unwrap().to_owned());
    let settings = PlanAgentSettings {
        language_agents,
        ..PlanAgentSettings::default()
    };
    (folder, settings)
}

#[test]
fn remembered_decisions_stand_before_the_question_and_stay_as_they_are() {
    let item = |n: usize| DiluItem {
        description: format!("The road has {n} lanes your way."),
        answer: format!("Decision {n}.\n#### 1"),
        action: DrivingAction::Idle,
        comment: String::new(),
    };
    let (folder, settings) = memory_of((1..=5).map(item).collect());
    let file = folder.path().join("dilu.json");
    let before = std::fs::read(&file).unwrap();
    let model = Stub::new(up_to_eight);
    let challenge = Challenge::NonReactive;
    drive(
        "dilu",
        Some(model.clone()),
        &default_scene(),
        challenge,
        &settings,
    );
    for (prompt, _) in model.asked.lock().unwrap().iter() {
        assert_eq!(prompt.matches("A scene that you met before").count(), 3);
        let (examples, question) = prompt.split_once("These were good decisions").unwrap();
        assert!(examples.contains("Decision ") && question.contains("Your car: "));
    }
    assert_eq!(std::fs::read(&file).unwrap(), before);
    let entry = crate::entries().find(|entry| entry.name.as_str() == "dilu");
    let digests = entry.as_ref().unwrap().digests(&settings);
    assert!(digests.contains_key(file.to_str().unwrap()));
    assert!(digests.contains_key("dilu/system.jinja"));
    std::fs::write(&file, "{}").unwrap();
    assert_ne!(entry.as_ref().unwrap().digests(&settings), digests);
    let error = entry.unwrap().prepare(&settings).unwrap_err();
    assert!(
        format!("{error:?}").contains("opening the memory"),
        "{error:?}"
    );
}

#[test]
fn drives_leave_decisions_and_accidents_leave_the_lesson_of_the_last_decision_that_did_not_brake() {
    let (scenario, settings) = (default_scene(), PlanAgentSettings::default());
    let challenge = Challenge::NonReactive;
    let model = Stub::new(up_to_eight);
    let (calls, _) = drive("dilu", Some(model), &scenario, challenge, &settings);
    let asked = |answer: fn(&str, usize) -> String| AskedModel {
        model: Stub::new(answer),
        prompts: Arc::new(PromptSet::open("paper").unwrap()),
        reasoning: ReasoningSettings {
            rounds: vec![Round::Code],
            generation: GenerationSettings::default(),
            rethink_sampling: Sampling::Greedy,
            grammar: true,
            speculation: Speculation::None,
            proposals: Proposals::default(),
        },
    };
    let teacher = asked(|_, _| "Look further ahead.\n#### 4".to_owned());
    let drive = Drive::new(&calls, None);
    let kept = lesson_items("a", &drive, &teacher, 100, 0)
        .unwrap()
        .unwrap();
    assert_eq!(kept.len(), calls.len().div_ceil(5));
    assert_eq!(kept[1].description, calls[5].scene_text.clone().unwrap());
    let mut crashed = Drive::new(&calls, Some(42));
    crashed.calls[4].action = DrivingAction::Slower;
    let lesson = lesson_items("a", &crashed, &teacher, 100, 0)
        .unwrap()
        .unwrap();
    assert_eq!(lesson.len(), 1);
    assert_eq!(lesson[0].description, crashed.calls[3].description);
    assert_eq!(lesson[0].action, DrivingAction::Slower);
    assert!(lesson[0].answer.ends_with("Look further ahead.\n#### 4"));
    let wordless = asked(|_, _| "#### 4".to_owned());
    let why = lesson_items("a", &crashed, &wordless, 100, 0)
        .unwrap()
        .unwrap_err();
    assert!(why.contains("no words"), "{why}");
    let mute = asked(|_, _| "Who knows".to_owned());
    let why = lesson_items("a", &crashed, &mute, 100, 0)
        .unwrap()
        .unwrap_err();
    assert!(why.contains("no action"), "{why}");
}

#[test]
fn a_decision_that_was_asked_about_twice_is_remembered_with_its_action() {
    let (scenario, settings) = (default_scene(), asked_seldom());
    let twice = Stub::new(|_, n| ["I keep on. ", "1"][n % 2].to_owned());
    let challenge = Challenge::NonReactive;
    let (calls, _) = drive("dilu", Some(twice), &scenario, challenge, &settings);
    let kept = Drive::new(&calls, None).calls;
    assert_eq!(kept.len(), calls.len());
    assert!(kept.iter().all(|call| call.answer == "I keep on.\n#### 1"));
    let long = Stub::new(|_, _| format!("{}\n#### 1", "I keep on. ".repeat(10_000)));
    let (calls, _) = drive("dilu", Some(long), &scenario, challenge, &settings);
    for call in Drive::new(&calls, None).calls {
        assert!(call.answer.len() < 5_000 && call.answer.ends_with("#### 1"));
    }
}

#[test]
fn an_oracle_picks_the_best_action() {
    let (scenario, settings) = (default_scene(), asked_seldom());
    let challenge = Challenge::NonReactive;
    let (calls, _) = drive("oracle-dilu", None, &scenario, challenge, &settings);
    assert_eq!(calls.len(), 3);
    assert!(
        calls
            .iter()
            .all(|call| call.decision == Decision::Execute(0))
    );
}
