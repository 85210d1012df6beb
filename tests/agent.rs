//! The agent with a scripted model and answers of every kind.

use planagent_agent::environment::{CenterlineName, DEFAULT_NODE_LENGTH, GraphedScene, LaneGraph};
use planagent_agent::planner::{
    AfterMaxExec, AgentLayer, CodeSource, Decision, NoPlan, PlanAgent, PlanAgentSettings, Planner,
    PlannerInput, PlannerName, PlanningCall,
};
use planagent_agent::planner_registry::PlannerParts;
use planagent_agent::reasoning::{
    Interruption, PlannerCode, PromptSet, Proposals, ReasoningSettings, Round, Speculation,
};
use planagent_agent::reflection::{
    Judge, LeadPolicy, PlanBuilder, ProgressReference, Ride, Verdict, needs_emergency_brake,
};
use planagent_agent::simulation::{Challenge, ClosedLoop, SimulationLog, simulate};
use planagent_mllm::{
    Answer, ConstraintUse, Conversation, FinishReason, GenerationSettings, Mark, Mllm, MllmError,
    ModelDescription, PromptPrefix, Request, RoundTime, Sampling, TokenCounts,
};
use planagent_planners::all_planners;
use planagent_runs::worker::run::{AgentParts, SimulationTask, run};
use planagent_scenario::{Scenario, generator};
use planagent_score::pdm::PdmMemory;
use planagent_world::geometry::{OrientedBox, Pose};
use planagent_world::{ObjectKind, Route, SceneView, TrackToken, TrackedObject};
use std::sync::{Arc, Mutex};

/// Answers the n-th question with the n-th answer, from the start again at the end; remembers the
/// questions.
pub(crate) struct Script {
    pub(crate) answers: Vec<&'static str>,
    pub(crate) asked: Mutex<Vec<String>>,
}

/// The answer of a script that is too slow for every deadline.
const SLOW: &str = "(slow)";

/// A conversation with a [`Script`].
struct Scripted<'a>(&'a Script);

impl Mllm for Script {
    fn name(&self) -> &'static str {
        "script"
    }

    fn describe(&self) -> ModelDescription {
        ModelDescription {
            name: "script".to_owned(),
            architecture: "script".to_owned(),
            parameters: 0,
            dtype: "none".to_owned(),
            image_size: Some(64),
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
        _: &PromptPrefix,
        _: u64,
    ) -> Result<Box<dyn Conversation + 'a>, MllmError> {
        Ok(Box::new(Scripted(self)))
    }
}

impl Conversation for Scripted<'_> {
    fn ask(&mut self, prompt: &str, request: &Request) -> Result<Answer, MllmError> {
        let mut asked = self.0.asked.lock().unwrap();
        let text = self.0.answers[asked.len() % self.0.answers.len()].to_owned();
        asked.push(prompt.to_owned());
        if text == SLOW {
            std::thread::sleep(
                request
                    .deadline
                    .left()
                    .expect("a slow answer needs a deadline"),
            );
            request.deadline.check()?;
        }
        Ok(Answer {
            text,
            ids: Vec::new(),
            log_probability: None,
            tokens: TokenCounts::default(),
            time: RoundTime::default(),
            finish: FinishReason::Complete,
            constraint: ConstraintUse::Unconstrained,
            prompt_hash: String::new(),
        })
    }

    fn mark(&self) -> Mark {
        // A script has no state to go back to; any mark of a real conversation would do.
        Mark::default()
    }

    fn rewind(&mut self, _: Mark) {}
}

/// The settings of the paper's loop.
pub(crate) fn settings() -> PlanAgentSettings {
    let mut settings = PlanAgentSettings::default();
    // The scripts of these tests answer each attempt, and no code is tried beyond them.
    settings.reflection.further_codes = false;
    (
        settings.reflection.after_max_exec,
        settings.reflection.monitoring,
    ) = (AfterMaxExec::Last, false);
    settings.agent.blocked_interval_s = settings.agent.interval_s;
    settings
}

/// The same with a change.
pub(crate) fn settings_with(change: impl FnOnce(&mut PlanAgentSettings)) -> PlanAgentSettings {
    let mut settings = settings();
    change(&mut settings);
    settings
}

pub(crate) fn scenario(id: &str) -> Scenario {
    generator::generate(&id.parse().unwrap()).unwrap()
}

/// These rounds, whose answers are free.
pub(crate) fn reasoning(rounds: &[Round]) -> ReasoningSettings {
    ReasoningSettings {
        rounds: rounds.to_vec(),
        generation: GenerationSettings::default(),
        rethink_sampling: Sampling::Greedy,
        grammar: false,
        speculation: Speculation::History,
        proposals: Proposals::default(),
    }
}

/// A model that is asked these rounds by the paper's prompts.
pub(crate) fn code_source(model: Arc<dyn Mllm>, rounds: &[Round]) -> CodeSource {
    CodeSource::Model {
        model,
        prompts: Arc::new(PromptSet::open("paper").unwrap()),
        reasoning: reasoning(rounds),
    }
}

/// Drives a scene with scripted answers; gives the agent, the log and the questions.
pub(crate) fn drive(
    answers: &[&'static str],
    rounds: &[Round],
    settings: PlanAgentSettings,
    id: &str,
) -> (Box<dyn AgentLayer>, SimulationLog, Vec<String>) {
    let script = Arc::new(Script {
        answers: answers.to_vec(),
        asked: Mutex::new(Vec::new()),
    });
    let mut agent = PlanAgent::new(
        PlannerName::PLAN_AGENT,
        code_source(script.clone(), rounds),
        settings,
    )
    .layered();
    let log = simulate(&scenario(id), &mut agent, Challenge::NonReactive).unwrap();
    let asked = script.asked.lock().unwrap().clone();
    (agent, log, asked)
}

#[test]
fn a_readable_code_is_executed_and_three_rounds_are_asked() {
    let answers = [
        "A straight road.",
        "Longitudinal: maintain, because free\nLateral: keep, because it serves",
        "Generate_IDM_Planner(c=ego_lane, la=None, v0=8, acc=1, dec=3)",
    ];
    let (agent, log, asked) = drive(
        &answers,
        Round::ALL,
        settings(),
        "generated/high_magnitude_speed/1",
    );
    assert_eq!(agent.calls().len(), 8);
    assert!(
        asked[0].contains("Ego:") && asked[0].contains("Step 1"),
        "{}",
        asked[0]
    );
    assert!(asked[1].contains("Step 2") && !asked[1].contains("Ego:"));
    assert!(asked[2].contains("ego_lane"));
    let call = &agent.calls()[0];
    assert_eq!(call.parse_errors(), 0);
    assert!(call.accepted().unwrap().instruction.is_some());
    // The target speed is 8 m/s.
    assert!((log.samples.last().unwrap().ego.speed() - 8.0).abs() < 0.5);
}

#[test]
fn unreadable_answers_are_fed_back_counted_and_end_in_a_stop() {
    let answers = ["drive on, it looks fine"];
    let (agent, log, asked) = drive(
        &answers,
        &[Round::Code],
        settings(),
        "generated/high_magnitude_speed/1",
    );
    let call = &agent.calls()[0];
    assert_eq!(
        (call.attempts.len(), call.parse_errors(), call.rethinks()),
        (3, 3, 2)
    );
    assert!(
        matches!(call.decision, Decision::Brake(_)),
        "{:?}",
        call.decision
    );
    assert!(
        !asked[0].contains("refused") && asked[1].contains("no call of Generate_IDM_Planner"),
        "{}",
        asked[1]
    );
    assert!(
        asked[0].contains("Ego:"),
        "the first round that is asked carries the scene"
    );
    assert!(log.samples.last().unwrap().ego.speed() < 0.3);
}

#[test]
fn the_active_plan_is_kept_when_later_answers_fail() {
    // Eight calls: one readable code, then answers that no attempt can read.
    let mut answers = vec!["nothing to read"; 60];
    answers[0] = "Generate_IDM_Planner(c=ego_lane, la=None, v0=6, acc=1, dec=3)";
    let mut settings = settings();
    settings.reflection.enabled = false;
    let (agent, log, _) = drive(
        &answers,
        &[Round::Code],
        settings,
        "generated/high_magnitude_speed/1",
    );
    assert_eq!(agent.calls()[0].decision, Decision::Execute(0));
    assert!(
        agent.calls()[1..]
            .iter()
            .all(|call| matches!(call.decision, Decision::KeepActivePlan(_)))
    );
    assert!((log.samples.last().unwrap().ego.speed() - 6.0).abs() < 0.5);
}

#[test]
fn feedback_names_the_parts_and_the_last_refused_plan_is_executed() {
    // A crawl on a free road makes no progress beside the proposals, so it scores under the
    // threshold.
    let answers = ["Generate_IDM_Planner(c=ego_lane, la=None, v0=1, acc=0.5, dec=3)"];
    let (agent, _, asked) = drive(
        &answers,
        &[Round::Code],
        settings(),
        "generated/high_magnitude_speed/1",
    );
    let refused = agent
        .calls()
        .iter()
        .find(|call| call.rethinks() == 2)
        .expect("a crawl is refused somewhere");
    assert_eq!(refused.decision, Decision::Exhausted(2));
    assert!(
        refused
            .attempts
            .iter()
            .all(|a| a.reflection.as_ref().unwrap().verdict == Verdict::Rethink)
    );
    assert!(
        asked.iter().any(|prompt| prompt.contains("progress 0.")),
        "{:?}",
        asked.last()
    );
}

#[test]
fn a_deadline_ends_the_call_and_keeps_the_active_plan() {
    // A whole first call; in the second the instruction is too slow; in the third an attempt cannot
    // be read, and thinking again is too slow; nothing is in time after that.
    let code = "Generate_IDM_Planner(c=ego_lane, la=None, v0=8, acc=1, dec=3)";
    let mut answers = vec![
        "A road.", "keep", code, "A road.", SLOW, "A road.", "keep", "drive on", SLOW,
    ];
    answers.extend([SLOW; 5]);
    let mut settings = settings();
    settings.reflection.enabled = false;
    settings.agent.deadline_ms = Some(400);
    let (agent, log, asked) = drive(
        &answers,
        Round::ALL,
        settings,
        "generated/high_magnitude_speed/1",
    );
    assert_eq!((agent.calls().len(), asked.len()), (8, answers.len()));
    assert_eq!(agent.calls()[0].decision, Decision::Execute(0));
    let ended = Decision::KeepActivePlan(NoPlan::Interrupted(Interruption::Deadline));
    for call in &agent.calls()[1..] {
        assert_eq!(call.decision, ended);
        assert!(call.total_ms >= 400.0 && call.accepted().is_none());
    }
    let attempts: Vec<Vec<usize>> = agent
        .calls()
        .iter()
        .map(|call| {
            call.attempts
                .iter()
                .map(|attempt| attempt.rounds.len())
                .collect()
        })
        .collect();
    assert_eq!(
        attempts[..4],
        [vec![3], vec![1], vec![3], vec![]],
        "what was answered in time is recorded"
    );
    let errors: Vec<usize> = agent.calls()[..4]
        .iter()
        .map(PlanningCall::parse_errors)
        .collect();
    assert_eq!(
        errors,
        [0, 0, 1, 0],
        "what was not answered was not misunderstood"
    );
    assert!(
        (log.samples.last().unwrap().ego.speed() - 8.0).abs() < 0.5,
        "the first plan is kept to the end"
    );
}

#[test]
fn a_refused_plan_is_not_executed_at_the_deadline() {
    let code = "Generate_IDM_Planner(c=ego_lane, la=None, v0=8, acc=1, dec=3)";
    let mut settings = settings();
    settings.reflection.threshold = 1.5;
    settings.agent.deadline_ms = Some(2000);
    let (agent, _, _) = drive(
        &[code, SLOW],
        &[Round::Code],
        settings,
        "generated/high_magnitude_speed/1",
    );
    let call = &agent.calls()[0];
    assert_eq!(
        call.decision,
        Decision::Brake(NoPlan::Interrupted(Interruption::Deadline))
    );
    assert_eq!(call.attempts.len(), 1);
    assert!(call.attempts[0].answer.is_some() && agent.state().active_plan().is_none());
}

#[test]
fn without_an_active_plan_a_deadline_ends_in_a_stop() {
    let mut settings = settings();
    settings.agent.deadline_ms = Some(20);
    let (agent, log, _) = drive(
        &[SLOW],
        &[Round::Code],
        settings,
        "generated/high_magnitude_speed/1",
    );
    let ended = Decision::Brake(NoPlan::Interrupted(Interruption::Deadline));
    assert!(agent.calls().iter().all(|call| call.decision == ended));
    assert!(log.samples.last().unwrap().ego.speed() < 0.3);
}

/// A plan in the ego's lane at the start of a scene.
pub(crate) fn planner_at<'a>(
    drive: &'a ClosedLoop<'a>,
    graph: &LaneGraph,
    target_speed: f64,
    lead_policy: LeadPolicy,
) -> planagent_agent::reflection::IdmPlan {
    let code = PlannerCode {
        centerline: CenterlineName::EgoLane,
        lead_agent: None,
        target_speed,
        accel_max: 2.0,
        decel_max: 3.0,
    };
    PlanBuilder {
        lead_policy,
        ride: Ride::Idm,
        horizon_s: 4.0,
    }
    .build(GraphedScene::new(&drive.scene(), graph), code)
    .unwrap()
    .unwrap()
}

#[test]
fn reflection_refuses_to_hit_the_lead_agent_and_accepts_to_follow_it() {
    let (mut seen, mut braked) = (0, 0);
    for seed in 0..12 {
        let scenario = scenario(&format!("generated/stationary_in_traffic/{seed}"));
        let drive = ClosedLoop::new(&scenario, Challenge::NonReactive).unwrap();
        let scene = drive.scene();
        let Ok(graph) = LaneGraph::build(&scene, DEFAULT_NODE_LENGTH) else {
            continue;
        };
        let close = graph
            .lead_agent(CenterlineName::EgoLane)
            .is_some_and(|lead_agent| lead_agent.gap < 6.0 && lead_agent.speed < 0.5);
        if !close {
            continue;
        }
        seen += 1;
        braked += usize::from(needs_emergency_brake(
            &scene,
            &planner_at(&drive, &graph, 10.0, LeadPolicy::Named).roll_out(&scene, 40),
            &mut PdmMemory::default(),
        ));
        let judge = Judge::new(&scene, &graph, 4.0, &mut PdmMemory::default()).unwrap();
        let blind = planner_at(&drive, &graph, 10.0, LeadPolicy::Named);
        let report = judge.reflect(&blind, 0.75).unwrap();
        assert_eq!(
            report.verdict,
            Verdict::Rethink,
            "seed {seed}: {:?}",
            report.parts
        );
        assert!(
            report.parts.no_collision < 1.0,
            "seed {seed}: {:?}",
            report.parts
        );
        let careful = planner_at(&drive, &graph, 10.0, LeadPolicy::Nearest);
        let report = judge.reflect(&careful, 0.75).unwrap();
        assert_eq!(
            report.verdict,
            Verdict::Execute,
            "seed {seed}: {:?}",
            report.parts
        );
        assert!(!needs_emergency_brake(
            &scene,
            &careful.roll_out(&scene, 40),
            &mut PdmMemory::default()
        ));
    }
    assert!(
        seen >= 3,
        "only {seen} scenes have a standing lead agent close ahead"
    );
    assert!(
        braked >= 1,
        "the emergency brake never overrules a plan that ignores its lead agent"
    );
}

#[test]
fn a_report_names_what_progress_was_compared_with() {
    let scenario = scenario("generated/high_magnitude_speed/1");
    let drive = ClosedLoop::new(&scenario, Challenge::NonReactive).unwrap();
    let scene = drive.scene();
    let graph = LaneGraph::build(&scene, DEFAULT_NODE_LENGTH).unwrap();
    let planner = planner_at(&drive, &graph, 3.0, LeadPolicy::Nearest);
    let report = |scene: &SceneView<'_>| {
        let mut memory = PdmMemory::default();
        let report = Judge::new(scene, &graph, 4.0, &mut memory)
            .unwrap()
            .reflect(&planner, 0.75)
            .unwrap();
        (
            report.progress_reference,
            report.parts.progress,
            memory.reference_path.is_some(),
        )
    };
    let (reference, progress, found) = report(&scene);
    assert!(
        reference == ProgressReference::PdmProposals && found && progress < 0.9,
        "{progress}"
    );
    let nowhere = Route::default();
    let (reference, progress, found) = report(&SceneView {
        route: &nowhere,
        ..scene
    });
    assert!(
        reference == ProgressReference::OwnProgress && !found,
        "without a route PDM-Closed has no proposals"
    );
    assert!(progress <= 1.0);
}

#[test]
fn a_roll_out_stops_before_a_red_light() {
    let mut seen = 0;
    for seed in 0..30 {
        let id = format!("generated/starting_straight_traffic_light_intersection_traversal/{seed}");
        let scenario = scenario(&id);
        let drive = ClosedLoop::new(&scenario, Challenge::NonReactive).unwrap();
        let scene = drive.scene();
        let Ok(graph) = LaneGraph::build(&scene, DEFAULT_NODE_LENGTH) else {
            continue;
        };
        let red = graph
            .ego_lane()
            .light
            .filter(|light| light.status == planagent_world::SignalStatus::Red);
        let Some(light) = red.filter(|light| light.distance > 12.0) else {
            continue;
        };
        seen += 1;
        let planner = planner_at(&drive, &graph, 15.0, LeadPolicy::Nearest);
        let rollout = planner.roll_out(&scene, 150);
        assert!(
            rollout.distance() < light.distance + 2.5,
            "{id}: {} m, light in {} m",
            rollout.distance(),
            light.distance
        );
        assert!(
            rollout.speeds[150] < 0.5,
            "{id}: {} m/s at the end",
            rollout.speeds[150]
        );
    }
    assert!(seen >= 3, "only {seen} scenes start before a red light");
}

#[test]
fn the_baselines_plan_without_a_model() {
    let registry = all_planners();
    let best = |name: &str| {
        let entry = registry.find(name).unwrap();
        let parts = PlannerParts {
            name: entry.name,
            settings: &settings(),
            model: None,
            recording: &[],
            simulation: None,
            shuffled_bev: None,
        };
        let mut agent = entry.build(&parts).unwrap();
        simulate(
            &scenario("generated/changing_lane/3"),
            agent.as_mut(),
            Challenge::NonReactive,
        )
        .unwrap();
        let calls = agent.calls().to_vec();
        assert_eq!(calls.len(), 8);
        assert!(
            calls
                .iter()
                .all(|call| call.image.is_none() && call.scene_text.is_none())
        );
        calls
    };
    let codes = |calls: &[PlanningCall]| -> Vec<PlannerCode> {
        calls
            .iter()
            .flat_map(|call| &call.attempts)
            .map(|attempt| attempt.answer.unwrap().code().unwrap())
            .collect()
    };
    let fixed = best("fixed-code");
    assert!(fixed.iter().all(|call| call.attempts.len() == 1));
    assert!(
        codes(&fixed)
            .iter()
            .all(|code| code.centerline == CenterlineName::EgoLane
                && (code.accel_max - 1.5).abs() < 1e-9)
    );

    let random = best("random-code");
    assert!(
        random
            .iter()
            .all(|call| (1..=3).contains(&call.attempts.len()))
    );
    assert_eq!(codes(&random), codes(&best("random-code")));
    assert!(codes(&random).windows(2).any(|pair| pair[0] != pair[1]));

    // At the first call the three see the same scene, and the grid contains the fixed code.
    let grid = best("grid-code");
    let first = |calls: &[PlanningCall]| {
        calls[0]
            .accepted()
            .unwrap()
            .reflection
            .as_ref()
            .unwrap()
            .score
    };
    assert!(first(&grid) >= first(&fixed));
    assert!(grid.iter().all(|call| call.attempts.len() == 1));
}

#[test]
fn a_control_is_an_agent_of_the_library() {
    let control = |name: &str| planagent::Agent::builder().planner(name).build();
    let scenario = scenario("generated/changing_lane/3");
    let mut agent = control("fixed-code").unwrap();
    planagent::simulate(&scenario, &mut agent, Challenge::NonReactive).unwrap();
    // A call every 2 s of the 15 s, and more often while the lane is blocked.
    assert!(agent.calls().len() >= 8);
    let error = control("oracle-code").unwrap_err().to_string();
    assert!(error.contains("a simulation to look ahead in"), "{error}");
}

#[test]
fn a_run_gives_the_oracle_its_simulation() {
    let parts = AgentParts::default();
    let task = SimulationTask {
        source: generator::DEFAULT.into(),
        planner: parts.registry.find("oracle-code").unwrap().name,
        challenge: Challenge::Reactive,
    };
    let records = Mutex::new(Vec::new());
    let outcome: Result<(), ()> = run(&[task], &[0], &parts, &|_| (), &|_, record| {
        records.lock().unwrap().push(record);
        Ok(())
    });
    outcome.unwrap();
    let record = records.into_inner().unwrap().pop().unwrap();
    let simulation = record.outcome.unwrap();
    assert!(!simulation.calls.is_empty());
    assert!(simulation.score.value > 0.0);
}

/// A car at 3 m/s.
fn slow_car(at: Pose) -> TrackedObject {
    TrackedObject {
        token: TrackToken(1),
        kind: ObjectKind::Vehicle,
        shape: OrientedBox::new(at, 4.5, 1.9),
        velocity: at.direction() * 3.0,
    }
}

#[test]
fn a_lane_change_that_scores_too_little_does_not_begin() {
    let scenario = scenario("generated/changing_lane/4");
    let drive = ClosedLoop::new(&scenario, Challenge::NonReactive).unwrap();
    let free = SceneView {
        objects: &[],
        ..drive.scene()
    };
    let graph = LaneGraph::build(&free, DEFAULT_NODE_LENGTH).unwrap();
    let lane = |name| {
        let path = &graph.centerline(name).unwrap().path;
        path.lane_at(path.centerline.project(free.ego.center().position()).s)
    };
    let left = &graph.centerline(CenterlineName::LeftLane).unwrap();
    let goal = left.path.centerline.pose_at(left.ego_s + 60.0);
    let route = Route {
        goal: Some(goal),
        goal_lane: Some(left.path.lane_at(left.ego_s + 60.0)),
        ..free.route.clone()
    };
    let with_goal = SceneView {
        route: &route,
        ..free
    };
    let call = |free: SceneView<'_>, lane_change_threshold| {
        let answers = vec!["Generate_IDM_Planner(c=left_lane, la=None, v0=12, acc=1.5, dec=3)"; 3];
        let code_source = code_source(
            Arc::new(Script {
                answers,
                asked: Mutex::default(),
            }),
            &[Round::Code],
        );
        let settings = settings_with(|settings| {
            settings.reflection.lane_change_threshold = lane_change_threshold;
            settings.reflection.after_max_exec = AfterMaxExec::Best;
        });
        let mut agent = PlanAgent::new(PlannerName::PLAN_AGENT, code_source, settings);
        agent
            .compute_trajectory(&PlannerInput {
                iteration: 0,
                scene: free,
            })
            .unwrap();
        let call = &agent.calls()[0];
        (
            agent.state().active_plan().unwrap().lane_now(&free),
            call.attempts.len(),
            call.decision.clone(),
            call.aborted_lane_change,
        )
    };
    let own = graph.ego_lane();
    let slow = [slow_car(own.path.centerline.pose_at(own.ego_s + 30.0))];
    let behind_slow = SceneView {
        objects: &slow,
        ..free
    };
    let changed = (
        lane(CenterlineName::LeftLane),
        1,
        Decision::Execute(0),
        None,
    );
    let stayed = (
        lane(CenterlineName::EgoLane),
        3,
        Decision::Exhausted(0),
        Some(0),
    );
    assert_eq!(call(behind_slow, 0.0), changed);
    // No plan scores 1.1: the code is executed in the ego's own lane.
    assert_eq!(call(behind_slow, 1.1), stayed);
    assert_eq!(call(with_goal, 1.1), changed, "the goal is in that lane");
    assert_eq!(call(free, 0.0), stayed, "without a cause");
}

#[test]
fn the_lead_agent_is_a_fact_of_the_scene() {
    let scenario = scenario("generated/following_lane_with_lead/0");
    let drive = ClosedLoop::new(&scenario, Challenge::NonReactive).unwrap();
    let graph = LaneGraph::build(&drive.scene(), DEFAULT_NODE_LENGTH).unwrap();
    let leads = graph
        .lead_agent(CenterlineName::EgoLane)
        .map(|agent| agent.token);
    assert!(leads.is_some());
    // Codes without a lead agent.
    assert_eq!(
        planner_at(&drive, &graph, 10.0, LeadPolicy::Nearest).lead_agent,
        leads
    );
    assert_eq!(
        planner_at(&drive, &graph, 10.0, LeadPolicy::Named).lead_agent,
        None
    );
}

#[test]
fn the_best_refused_plan_is_executed_only_if_the_active_plan_is_worse() {
    // The second call and those after it ask for a stop in the middle of the road, which makes no
    // progress.
    let go = "Generate_IDM_Planner(c=ego_lane, la=None, v0=12, acc=1.5, dec=3)";
    let stop = "Generate_IDM_Planner(c=ego_lane, la=None, v0=0, acc=0.5, dec=6)";
    let mut answers = vec![go];
    answers.extend([stop; 21]);
    let mut settings = settings();
    settings.reflection.after_max_exec = AfterMaxExec::Best;
    let (agent, log, _) = drive(
        &answers,
        &[Round::Code],
        settings,
        "generated/high_magnitude_speed/1",
    );
    assert_eq!(agent.calls()[0].decision, Decision::Execute(0));
    assert_eq!(
        agent.calls()[1].decision,
        Decision::KeepActivePlan(NoPlan::Worse)
    );
    assert!(log.samples.last().unwrap().ego.speed() > 8.0);
}
