//! The agents with a scripted model in both challenges, and with an oracle in its place.

use crate::entries;
use planagent_agent::planner::{
    Attempt, CodeSource, Decision, LanguageAgentSettings, NoPlan, PlanAgentSettings, PlanningCall,
    Unreadable,
};
use planagent_agent::planner_registry::{PlannerEntry, PlannerParts};
use planagent_agent::reasoning::{
    PlannerAnswer, PromptSet, Proposals, ReasoningSettings, Round, Speculation,
};
use planagent_agent::reflection::Verdict;
use planagent_agent::simulation::{Challenge, ClosedLoop, SimulationLog, simulate};
use planagent_mllm::{
    Answer, Constraint, ConstraintUse, Conversation, FinishReason, GenerationSettings, Mark, Mllm,
    MllmError, ModelDescription, PromptPrefix, Request, RoundTime, Sampling, TokenCounts,
};
use planagent_scenario::{HeldScenario, Scenario, generator};
use std::collections::BTreeSet;
use std::sync::{Arc, Mutex};

/// An answer by the question and its number.
type Script = Box<dyn Fn(&str, usize) -> String + Send + Sync>;

/// Answers questions by a script; keeps the questions.
pub(crate) struct Stub {
    answer: Script,
    finish: FinishReason,
    pub(crate) asked: Mutex<Vec<(String, Constraint)>>,
    /// The seeds of its conversations.
    seeds: Mutex<Vec<u64>>,
}

impl Stub {
    pub(crate) fn new(answer: impl Fn(&str, usize) -> String + Send + Sync + 'static) -> Arc<Self> {
        Arc::new(Self {
            answer: Box::new(answer),
            finish: FinishReason::Complete,
            asked: Mutex::default(),
            seeds: Mutex::default(),
        })
    }

    fn cut_off(answer: fn(&str, usize) -> String) -> Arc<Self> {
        Arc::new(Self {
            answer: Box::new(answer),
            finish: FinishReason::Length,
            asked: Mutex::default(),
            seeds: Mutex::default(),
        })
    }
}

struct StubChat<'a>(&'a Stub);

impl Mllm for Stub {
    fn name(&self) -> &'static str {
        "stub"
    }

    fn describe(&self) -> ModelDescription {
        ModelDescription {
            name: "stub".to_owned(),
            architecture: "stub".to_owned(),
            parameters: 0,
            dtype: "none".to_owned(),
            image_size: None,
            image_tokens: 0,
            vocabulary: 0,
            context: 0,
            weights_blake3: String::new(),
            load: planagent_mllm::LoadReport::default(),
            server: None,
        }
    }

    fn converse<'a>(
        &'a self,
        prefix: &PromptPrefix,
        seed: u64,
    ) -> Result<Box<dyn Conversation + 'a>, MllmError> {
        assert!(prefix.image.is_none(), "these agents read text alone");
        self.seeds.lock().unwrap().push(seed);
        Ok(Box::new(StubChat(self)))
    }
}

impl Conversation for StubChat<'_> {
    fn ask(&mut self, prompt: &str, request: &Request) -> Result<Answer, MllmError> {
        let mut asked = self.0.asked.lock().unwrap();
        let text = (self.0.answer)(prompt, asked.len());
        asked.push((prompt.to_owned(), request.constraint.clone()));
        Ok(Answer {
            text,
            ids: Vec::new(),
            log_probability: None,
            tokens: TokenCounts::default(),
            time: RoundTime::default(),
            finish: self.0.finish,
            constraint: ConstraintUse::Unconstrained,
            prompt_hash: String::new(),
        })
    }

    fn mark(&self) -> Mark {
        Mark::default()
    }

    fn rewind(&mut self, _: Mark) {}
}

pub(crate) fn default_scene() -> Scenario {
    generator::generate(&generator::DEFAULT).unwrap()
}

/// Drives a scene by the planner of a name.
pub(crate) fn drive(
    name: &str,
    model: Option<Arc<Stub>>,
    scenario: &Scenario,
    challenge: Challenge,
    settings: &PlanAgentSettings,
) -> (Vec<PlanningCall>, SimulationLog) {
    let entry = entries()
        .find(|entry| entry.name.as_str() == name)
        .unwrap_or_else(|| panic!("no planner {name}"));
    let source = model.map(|model| CodeSource::Model {
        model,
        prompts: Arc::new(PromptSet::open("paper").unwrap()),
        reasoning: ReasoningSettings {
            rounds: vec![Round::Code],
            generation: GenerationSettings::default(),
            rethink_sampling: Sampling::Greedy,
            grammar: true,
            speculation: Speculation::None,
            proposals: Proposals::default(),
        },
    });
    let held = HeldScenario::Shared(Arc::new(scenario.clone()));
    let simulation = ClosedLoop::new(held, challenge).unwrap();
    let mut planner = entry
        .build(&PlannerParts {
            name: entry.name,
            settings,
            model: source.as_ref(),
            recording: &[],
            simulation: Some(&simulation),
            shuffled_bev: None,
        })
        .unwrap();
    let log = simulate(scenario, planner.as_mut(), challenge).unwrap();
    (planner.take_calls(), log)
}

/// The speed in a prompt of GPT-Driver, m per half second.
fn speed_in(prompt: &str) -> f64 {
    let line = prompt
        .lines()
        .find(|line| line.contains("Speed along the heading"))
        .unwrap();
    let number = line.rsplit('(').next().unwrap().trim_end_matches(')');
    number.parse().unwrap()
}

/// Goes straight on at the present speed, but no slower than 2 m per half second, which a standing
/// ego reaches smoothly.
fn straight_on(prompt: &str, _: usize) -> String {
    let step = speed_in(prompt).max(1.0);
    let places = (1..=6).map(|i| format!("(0.00,{:.2})", step * f64::from(i)));
    let list = places.collect::<Vec<_>>().join(", ");
    format!("Reasons: none\nAction: move forward at constant speed\nTrajectory: [{list}]")
}

/// Goes away to the right of the road, meters in a half second.
fn off_the_road(aside: f64) -> String {
    let places = (1..=6).map(f64::from);
    let places = places.map(|i| format!("({:.2},{:.2})", aside * i, 2.5 * i));
    format!("Trajectory: [{}]", places.collect::<Vec<_>>().join(", "))
}

#[test]
fn gpt_driver_drives_the_default_scene_and_asks_every_second() {
    for challenge in Challenge::CLOSED_LOOP {
        let model = Stub::new(straight_on);
        let scenario = default_scene();
        let settings = PlanAgentSettings::default();
        let (calls, log) = drive(
            "gpt-driver",
            Some(model.clone()),
            &scenario,
            challenge,
            &settings,
        );
        let at: Vec<usize> = calls.iter().map(|call| call.iteration).collect();
        assert_eq!(at, (0..at.len()).map(|k| k * 10).collect::<Vec<_>>());
        assert!(at.len() >= 14, "{at:?}");
        for call in &calls {
            assert_eq!(call.decision, Decision::Execute(0), "{:?}", call.attempts);
            let attempt = &call.attempts[0];
            assert!(matches!(attempt.answer, Some(PlannerAnswer::Waypoints(_))));
            assert_eq!((attempt.path.len(), attempt.rounds.len()), (41, 1));
            assert_eq!(attempt.rounds[0].round.as_str(), "waypoints");
            assert!(call.scene_text.as_ref().unwrap().contains("Goal: "));
        }
        let asked = model.asked.lock().unwrap();
        assert!(asked.iter().all(|(_, c)| *c != Constraint::Free));
        assert_eq!(log.samples.len(), scenario.iterations() - 1);
        assert!(log.samples.last().unwrap().ego.speed() > 1.0);
    }
}

#[test]
fn off_the_road_the_plan_goes_on_to_the_end() {
    // To the right at the first calls, then straight on: soon no lane is near.
    let model = Stub::new(|prompt, number| {
        if number > 1 {
            return straight_on(prompt, number);
        }
        off_the_road(2.0)
    });
    let scenario = default_scene();
    let settings = PlanAgentSettings::default();
    let (calls, log) = drive(
        "gpt-driver",
        Some(model),
        &scenario,
        Challenge::NonReactive,
        &settings,
    );
    let without_graph = calls.iter().filter(|call| {
        matches!(
            call.decision,
            Decision::KeepActivePlan(NoPlan::NoLaneGraph(_))
        )
    });
    assert!(
        without_graph.count() > 8,
        "a plan of eight seconds must have been prolonged"
    );
    assert_eq!(log.samples.len(), scenario.iterations() - 1);
}

#[test]
fn answers_that_are_no_plan_are_counted_and_the_plan_goes_on() {
    type Case = (fn(&str, usize) -> String, Unreadable);
    let cases: [Case; 4] = [
        (|_, _| "I would wait.".to_owned(), Unreadable::NoLine),
        (
            |_, _| "Trajectory: [(0,1), (0,2)]".to_owned(),
            Unreadable::WrongLine,
        ),
        (
            |_, _| "Trajectory: [(0,inf), (0,2), (0,3), (0,4), (0,5), (0,6)]".to_owned(),
            Unreadable::WrongLine,
        ),
        (
            |_, _| "[(0,40), (0,80), (0,90), (0,91), (0,92), (0,93)]".to_owned(),
            Unreadable::Jump,
        ),
    ];
    let (scenario, settings) = (default_scene(), PlanAgentSettings::default());
    for (answer, cause) in cases {
        let (calls, log) = drive(
            "gpt-driver",
            Some(Stub::new(answer)),
            &scenario,
            Challenge::NonReactive,
            &settings,
        );
        for call in &calls {
            assert_eq!(call.decision, Decision::Brake(NoPlan::Unreadable(cause)));
            assert!(call.parse_errors() > 0, "{:?}", call.attempts);
        }
        let last = log.samples.last().unwrap();
        assert!(last.ego.speed() < 0.1, "without a plan the ego stops");
    }
    // The first answer is a plan, and it goes on for the whole simulation.
    let first = Stub::new(|prompt, n| {
        if n == 0 {
            straight_on(prompt, n)
        } else {
            "no".to_owned()
        }
    });
    let (calls, log) = drive(
        "gpt-driver",
        Some(first),
        &scenario,
        Challenge::NonReactive,
        &settings,
    );
    assert_eq!(calls[0].decision, Decision::Execute(0));
    let kept = Decision::KeepActivePlan(NoPlan::Unreadable(Unreadable::NoLine));
    assert!(calls[1..].iter().all(|call| call.decision == kept));
    let speed = |i: usize| log.samples[i].ego.speed();
    let last = log.samples.len() - 1;
    assert!((speed(40) - speed(last)).abs() < 0.5, "the speed is kept");
    let cut = Stub::cut_off(|_, _| "Trajectory: [(0.00,4.00), (0.".to_owned());
    let (calls, _) = drive(
        "gpt-driver",
        Some(cut),
        &scenario,
        Challenge::NonReactive,
        &settings,
    );
    let cause = NoPlan::Unreadable(Unreadable::CutOff);
    assert_eq!(calls[0].decision, Decision::Brake(cause));
}

/// Every agent is asked three times in a simulation, so that a search ends soon.
pub(crate) fn asked_seldom() -> PlanAgentSettings {
    let mut language_agents = LanguageAgentSettings::default();
    for agent in entries().filter(PlannerEntry::needs_model) {
        language_agents.agent_mut(agent.name.as_str()).interval_s = Some(6.0);
    }
    PlanAgentSettings {
        language_agents,
        ..PlanAgentSettings::default()
    }
}

/// Answers that are no plan of any agent.
fn bad_answers() -> Vec<String> {
    let steady = "(0,1), (0,2), (0,3), (0,4), (0,5), (0,6)";
    let texts = [
        "\u{0}",
        "YES",
        "####",
        "#### 9",
        "#### -1",
        "#### 1.",
        "#### \u{ff11}",
        "#### 99999999999999999999999999",
        "[",
        "[[[[",
        "é[(ü",
        "Trajectory:",
        "Trajectory: []",
        "[(1,1)]",
        "Trajectory: [(0,NaN), (0,2), (0,3), (0,4), (0,5), (0,6)]",
        "Trajectory: [(0,400), (0,2), (0,3), (0,4), (0,5), (0,6)]",
        "Trajectory: {\"x\": 1}",
    ];
    let long = [
        "(".repeat(50_000),
        "trajectory ".repeat(50_000),
        "[(".repeat(50_000),
        "####".repeat(50_000),
        format!("Trajectory: [{}]", "(0,1), ".repeat(20_000)),
        format!("Trajectory: [{steady}] [{steady}]"),
    ];
    texts.map(str::to_owned).into_iter().chain(long).collect()
}

#[test]
fn no_bad_answer_of_any_agent_is_lost_without_a_reason() {
    let (scenario, settings) = (default_scene(), asked_seldom());
    let drive_by = |agent: &str, answer: &str| {
        let answer = answer.to_owned();
        let model = Stub::new(move |_, _| answer.clone());
        drive(
            agent,
            Some(model),
            &scenario,
            Challenge::NonReactive,
            &settings,
        )
        .0
    };
    for agent in ["gpt-driver", "dilu", "agent-driver"] {
        for answer in bad_answers() {
            let beginning: String = answer.chars().take(40).collect();
            for call in drive_by(agent, &answer) {
                assert!(
                    matches!(call.decision, Decision::Brake(NoPlan::Unreadable(_))),
                    "{agent}, {beginning}: {:?}",
                    call.decision
                );
                assert!(call.parse_errors() > 0, "{agent}, {beginning}");
                for error in &call.attempts[0].errors {
                    assert!(
                        error.span.start <= error.span.end
                            && error.span.end <= answer.len()
                            && error.message.len() < 300,
                        "{agent}, {beginning}: {error}"
                    );
                }
            }
        }
        for answer in ["", " \n"] {
            let cause = Decision::Brake(NoPlan::Unreadable(Unreadable::Empty));
            let calls = drive_by(agent, answer);
            assert!(
                calls.iter().all(|call| call.decision == cause),
                "{agent}: {:?}",
                calls[0].decision
            );
        }
    }
}

#[test]
fn an_oracle_drives_by_the_waypoints_of_the_best_codes() {
    let scenario = default_scene();
    let challenge = Challenge::NonReactive;
    let settings = asked_seldom();
    let (calls, log) = drive("oracle-gpt-driver", None, &scenario, challenge, &settings);
    assert_eq!(calls.len(), 3);
    for call in &calls {
        assert_eq!(call.decision, Decision::Execute(0));
        let attempt = &call.attempts[0];
        assert!(attempt.rounds.is_empty());
        assert!(matches!(attempt.answer, Some(PlannerAnswer::Waypoints(_))));
    }
    // The ego is where the waypoints lead.
    let first = log.samples[0].ego.center();
    let Some(PlannerAnswer::Waypoints(waypoints)) = calls[0].attempts[0].answer else {
        panic!("waypoints were matched")
    };
    let reached = first.to_local(log.samples[20].ego.center().position());
    let planned = waypoints.0[3];
    assert!(
        (reached.x - planned.ahead).abs() < 1.0 && (reached.y + planned.right).abs() < 0.5,
        "{reached:?} {planned:?}"
    );
}

/// Settings under which Reflection scores the plans of an agent.
fn with_reflection(agent: &str) -> PlanAgentSettings {
    let mut settings = PlanAgentSettings::default();
    settings.language_agents.agent_mut(agent).reflection = Some(true);
    settings
}

#[test]
fn reflection_refuses_a_plan_and_the_model_is_asked_again_with_feedback() {
    // A way off the road is refused; what is asked for again drives straight on.
    let model = Stub::new(|prompt, number| {
        if prompt.contains("refused") {
            return straight_on(prompt, number);
        }
        off_the_road(2.0)
    });
    let (calls, _) = drive(
        "gpt-driver",
        Some(model.clone()),
        &default_scene(),
        Challenge::NonReactive,
        &with_reflection("gpt-driver"),
    );
    let first = calls.first().unwrap();
    assert_eq!(first.decision, Decision::Execute(1), "{:?}", first.attempts);
    let verdicts = first.attempts.iter().map(|attempt| {
        let report = attempt.reflection.as_ref().unwrap();
        (report.verdict, report.score >= report.threshold)
    });
    assert_eq!(
        verdicts.collect::<Vec<_>>(),
        [(Verdict::Rethink, false), (Verdict::Execute, true)]
    );
    let asked = model.asked.lock().unwrap();
    assert!(
        !asked[0].0.contains("refused") && asked[1].0.contains("Parts: collision"),
        "{}",
        asked[1].0
    );
}

#[test]
fn the_best_of_the_refused_plans_drives_where_all_are_refused() {
    let model = Stub::new(|_, number| off_the_road(if number % 3 == 1 { 2.0 } else { 2.5 }));
    let settings = with_reflection("gpt-driver");
    let (calls, _) = drive(
        "gpt-driver",
        Some(model.clone()),
        &default_scene(),
        Challenge::NonReactive,
        &settings,
    );
    let first = calls.first().unwrap();
    assert_eq!(first.attempts.len(), settings.reflection.max_exec);
    let seeds = model.seeds.lock().unwrap();
    let of_call: BTreeSet<u64> = seeds[..first.attempts.len()].iter().copied().collect();
    assert_eq!(
        of_call.len(),
        first.attempts.len(),
        "each attempt draws its own numbers"
    );
    let score = |attempt: &Attempt| attempt.reflection.as_ref().map(|report| report.score);
    let scores: Vec<Option<f64>> = first.attempts.iter().map(score).collect();
    let Decision::Exhausted(index) = first.decision else {
        panic!("{:?}: {scores:?}", first.decision);
    };
    assert!(
        scores.iter().all(|score| *score <= scores[index]),
        "{scores:?}"
    );
}

#[test]
fn intervals_are_those_of_the_settings() {
    let mut language_agents = LanguageAgentSettings::default();
    language_agents.agent_mut("gpt-driver").interval_s = Some(3.0);
    let settings = PlanAgentSettings {
        language_agents,
        ..PlanAgentSettings::default()
    };
    let (calls, _) = drive(
        "gpt-driver",
        Some(Stub::new(straight_on)),
        &default_scene(),
        Challenge::NonReactive,
        &settings,
    );
    let at: Vec<usize> = calls.iter().map(|call| call.iteration).collect();
    assert_eq!(&at[..3], [0, 30, 60]);
}
