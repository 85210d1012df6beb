//! The targets whose bytes come from what plans: answers of a model to the language agents, their
//! memories, and messages of a command.

use super::{folder, text};
use planagent_agent::planner::{
    CodeSource, ExecReply, PlanAgentSettings, moved, read_reply, trajectory_of,
};
use planagent_agent::planner_registry::PlannerParts;
use planagent_agent::reasoning::{PromptSet, Proposals, ReasoningSettings, Round, Speculation};
use planagent_agent::simulation::{Challenge, ClosedLoop};
use planagent_language_agents::entries;
use planagent_mllm::{
    Answer, ConstraintUse, Conversation, FinishReason, GenerationSettings, LoadReport, Mark, Mllm,
    MllmError, ModelDescription, PromptPrefix, Request, RoundTime, Sampling, TokenCounts,
};
use planagent_scenario::generator::{Spec, generate, types};
use std::cell::OnceCell;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// The agents, in the order of the first byte of an input.
const AGENTS: [&str; 3] = ["gpt-driver", "dilu", "agent-driver"];
/// Answers of the model in a target of a memory.
const PLAIN: [&str; 2] = ["It is free.\n#### 3", "no"];

/// A model that gives its answers in their order, the last one again and again.
#[derive(Debug)]
struct Scripted {
    answers: Vec<String>,
    asked: AtomicUsize,
}

struct ScriptedChat<'a>(&'a Scripted);

impl Mllm for Scripted {
    fn name(&self) -> &'static str {
        "scripted"
    }

    fn describe(&self) -> ModelDescription {
        ModelDescription {
            name: "scripted".to_owned(),
            architecture: "scripted".to_owned(),
            parameters: 0,
            dtype: "none".to_owned(),
            image_size: None,
            image_tokens: 0,
            vocabulary: 0,
            context: 0,
            weights_blake3: String::new(),
            load: LoadReport::default(),
            server: None,
        }
    }

    fn converse<'a>(
        &'a self,
        _: &PromptPrefix,
        _: u64,
    ) -> Result<Box<dyn Conversation + 'a>, MllmError> {
        Ok(Box::new(ScriptedChat(self)))
    }
}

impl Conversation for ScriptedChat<'_> {
    fn ask(&mut self, _: &str, _: &Request) -> Result<Answer, MllmError> {
        let asked = self.0.asked.fetch_add(1, Ordering::Relaxed);
        let answers = &self.0.answers;
        let answer = answers.get(asked).or(answers.last());
        Ok(Answer {
            text: answer.cloned().unwrap_or_default(),
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
        Mark::default()
    }

    fn rewind(&mut self, _: Mark) {}
}

/// Runs `with` in a scene at its beginning.
fn in_scene<T>(with: impl FnOnce(&ClosedLoop<'static>) -> T) -> T {
    thread_local! {
        static SCENE: OnceCell<ClosedLoop<'static>> = const { OnceCell::new() };
    }
    SCENE.with(|scene| {
        with(scene.get_or_init(|| {
            let spec = Spec::new(types::changing_lane::TYPE, 0);
            let scenario = generate(&spec).expect("the scene is generated");
            ClosedLoop::new(Arc::new(scenario), Challenge::Reactive)
                .expect("the scene can be simulated")
        }))
    })
}

/// Drives two steps by an agent; true when a planning call gave a plan.
fn drive(agent: &str, answers: Vec<String>, settings: &PlanAgentSettings) -> bool {
    let Some(entry) = entries().find(|entry| entry.name.as_str() == agent) else {
        return false;
    };
    if entry.prepare(settings).is_err() {
        return false;
    }
    let model = CodeSource::Model {
        model: Arc::new(Scripted {
            answers,
            asked: AtomicUsize::new(0),
        }),
        prompts: Arc::new(PromptSet::open("paper").expect("the set is built in")),
        reasoning: ReasoningSettings {
            rounds: vec![Round::Code],
            generation: GenerationSettings::default(),
            rethink_sampling: Sampling::Greedy,
            grammar: true,
            speculation: Speculation::None,
            proposals: Proposals::default(),
        },
    };
    in_scene(|scene| {
        let built = entry.build(&PlannerParts {
            name: entry.name,
            settings,
            model: Some(&model),
            recording: &[],
            simulation: Some(scene),
            shuffled_bev: None,
        });
        let Ok(mut planner) = built else {
            return false;
        };
        let mut simulation = scene.clone();
        let mut driven = simulation.initialize(planner.as_mut());
        for _ in 0..2 {
            driven = driven.and_then(|()| {
                let plan = simulation.plan(planner.as_mut())?;
                simulation.advance(&plan, agent)
            });
        }
        let calls = planner.take_calls();
        driven.is_ok() && calls.iter().any(|call| call.decision.attempt().is_some())
    })
}

/// Answers of a model to a language agent. The first byte chooses the agent; lines of `---` divide
/// the answers.
pub(super) fn agent_answers(bytes: &[u8]) -> bool {
    let Some((choice, rest)) = bytes.split_first() else {
        return false;
    };
    let agent = AGENTS[usize::from(*choice) % AGENTS.len()];
    let answers = text(rest).split("\n---\n").map(str::to_owned).collect();
    drive(agent, answers, &PlanAgentSettings::default())
}

/// The memory of an agent that has one; the first byte chooses it.
pub(super) fn agent_memory(bytes: &[u8]) -> bool {
    let Some((choice, rest)) = bytes.split_first() else {
        return false;
    };
    let folder = folder(&[("memory.json", rest)]);
    let file = folder.path().join("memory.json");
    let file = file.to_str().map(str::to_owned);
    let mut settings = PlanAgentSettings::default();
    let agents = &mut settings.language_agents;
    let agent = if choice % 2 == 0 {
        AGENTS[1]
    } else {
        AGENTS[2]
    };
    agents.agent_mut(agent).memory = file;
    let entry = entries().find(|entry| entry.name.as_str() == agent);
    let opened = entry.is_some_and(|entry| entry.prepare(&settings).is_ok());
    if opened {
        let _ = drive(agent, PLAIN.map(str::to_owned).to_vec(), &settings);
    }
    opened
}

/// A line that a command wrote, used as the plan of a step or as the states of the other agents.
pub(super) fn exec_answer(bytes: &[u8]) -> bool {
    let Ok(reply) = read_reply(bytes) else {
        return false;
    };
    in_scene(|scene| match reply {
        ExecReply::Trajectory { states } => {
            let mut simulation = scene.clone();
            let plan = trajectory_of(&states, &simulation.present().ego);
            plan.is_ok_and(|plan| simulation.advance(&plan, "exec").is_ok())
        }
        ExecReply::Agents { objects } => {
            let present = &scene.present().objects;
            moved(&objects, present, present).is_ok()
        }
        ExecReply::Ready {} | ExecReply::Error { .. } => true,
    })
}
