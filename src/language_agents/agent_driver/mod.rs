//! Agent-Driver (Mao et al. 2024): a model as an agent with tools, memories and reasoning. It asks for
//! the facts that it wants, picks an experience, thinks, and writes six waypoints, which are checked
//! for collisions and moved by a solver.
//!
//! What differs from the original stands in docs/agents.md.

mod check;
mod experience;
mod fill;
mod item;
mod tools;

pub(crate) use item::ExperienceItem;

use crate::agent::{ChatAgent, Parts, Reply, beginning};
use crate::chat::{Asked, Chat};
use crate::described::DescribedText;
use crate::fill::{MemoryFiller, MemorySource};
use crate::gpt_driver::{action, reasons};
use crate::made::{Agent, asking, handed};
use crate::memory::{Memory, open};
use crate::oracle::best_waypoints;
use crate::waypoints::{Motion, WaypointTrack, any_of, read_waypoints, text, waypoint_grammar};
use check::checked;
use experience::{CANDIDATES, nearest};
use fill::{EVERY, FUTURE, left_item};
use minijinja::context;
use planagent_agent::environment::coordinates::EgoFacts;
use planagent_agent::environment::{GraphedScene, LaneGraph};
use planagent_agent::planner::{AgentKeys, AgentSettings, PlannerError, PlannerInput};
use planagent_agent::reasoning::{
    ParseError, PromptError, QuestionPrompts, ReasoningError, RoundName, ToolUse, WaypointList,
};
use planagent_mllm::Constraint;
use planagent_world::{SceneView, Trajectory};
use std::sync::Arc;
use tools::{Facts, Group, call_grammar};

/// Name of the planner.
const NAME: &str = "agent-driver";
/// The folder of its prompts.
const PROMPTS: &str = "agent_driver";
macro_rules! texts {
    ($($name:literal),*) => {
        [$(($name, include_str!(concat!("../../../prompts/agent_driver/", $name)))),*]
    };
}
const TEXTS: [(&str, &str); 9] = texts![
    "perception_system.jinja",
    "need.jinja",
    "tools.jinja",
    "experience_system.jinja",
    "experience.jinja",
    "reasoning_system.jinja",
    "reasoning.jinja",
    "planning_system.jinja",
    "planning.jinja"
];
/// The answers to whether a kind of facts is needed.
const YES: &str = "YES";
const NO: &str = "NO";
/// Maximum tokens of YES or NO, and of the number of an experience.
const WORD_TOKENS: usize = 8;
/// Maximum tokens of a call of a tool.
const CALL_TOKENS: usize = 64;
/// An answer that keeps to its maximum of tokens has at most this many bytes a token.
const MAX_TOKEN_BYTES: usize = 16;
/// Objects that reasons may name under the grammar, the nearest.
const NAMED_OBJECTS: usize = 12;
/// The name of the last stage in records.
const CHECK: &str = "collision_check";

/// An error of a whole answer.
fn in_whole(answer: &str, message: String, hint: String) -> ParseError {
    ParseError {
        span: 0..answer.len(),
        message,
        hint,
    }
}

/// What it is made of.
const PARTS: Parts<AgentDriver> = Parts {
    keys: KEYS,
    prompts,
    make: |settings, prompts| {
        let memory = open(settings.memory.as_deref(), NAME)?;
        Ok(AgentDriver {
            settings,
            prompts,
            memory: Arc::new(memory),
            track: WaypointTrack::default(),
        })
    },
};

/// Its settings.
const KEYS: AgentKeys = AgentKeys {
    planner: NAME,
    interval_s: 2.0,
    max_tokens: 256,
    examples: None,
    has_memory: true,
};

/// What its model reads about a scene.
const DESCRIBED: &[DescribedText] = &[DescribedText {
    key: "agent_driver",
    name: "Agent-Driver, motion and four tools",
    definition: "GPT-Driver's lines about the ego, and what four of its tools tell: the objects within 20 m, where they go, \
                         whether the place ahead is occupied, and the edges of the road",
    published: None,
    describe: agent_driver_text,
}];

/// The agent.
pub(crate) fn agent() -> Agent {
    Agent {
        planner: asking(
            "Agent-Driver; the model calls tools and gives waypoints",
            PARTS,
        ),
        oracle: handed(
            "oracle-agent-driver",
            "Agent-Driver with waypoints of codes tried out ahead (a control)",
            PARTS,
            best_waypoints,
        ),
        texts: DESCRIBED,
        teaching: None,
        filler: Some(MemoryFiller {
            keys: KEYS,
            about: "logged motions; no model is needed",
            source: MemorySource::Logs {
                every: EVERY,
                future: FUTURE,
                item: left_item,
            },
        }),
    }
}

/// The prompts of this agent.
fn prompts() -> Result<QuestionPrompts, PromptError> {
    QuestionPrompts::open(PROMPTS, &TEXTS)
}

/// The motion block of a scene, and what a tool of each kind tells.
fn agent_driver_text(GraphedScene { scene, graph }: GraphedScene<'_>) -> String {
    let facts = Facts::from_scene(scene);
    let told = [
        (Group::Detection, "objects_around()"),
        (Group::Prediction, "futures_in_area(-20, 20, -20, 20)"),
        (Group::Occupancy, "occupied_at([(0, 10)], 2)"),
        (Group::Map, "shoulder_here()"),
    ]
    .map(|(group, call)| facts.answer(group, call).result);
    format!(
        "{}\n{}",
        EgoFacts::from_scene(scene, graph).text(),
        told.join("\n")
    )
}

/// Agent-Driver.
pub(crate) struct AgentDriver {
    settings: AgentSettings,
    prompts: Arc<QuestionPrompts>,
    memory: Arc<Memory<ExperienceItem>>,
    track: WaypointTrack,
}

impl AgentDriver {
    /// Asks for the facts of each kind: whether they are needed, and then which.
    fn perceive(
        &self,
        observation: &Observation<'_>,
        chat: &mut Chat<'_>,
        errors: &mut Vec<ParseError>,
    ) -> Result<Vec<String>, ReasoningError> {
        let ego = &observation.text;
        chat.open(
            self.prompts
                .render("perception_system", context! { ego => ego })?,
        )?;
        let mut found = Vec::new();
        for group in Group::ALL {
            let need = Asked {
                round: RoundName::Need,
                prompt: self
                    .prompts
                    .render("need", context! { group => group.name() })?,
                constraint: any_of([YES, NO]),
                max_tokens: WORD_TOKENS,
            };
            let Some(answer) = chat.ask(need)? else {
                break;
            };
            // As in the original, anything else is a NO; here it is counted as an error too.
            if answer != YES {
                if answer.trim() != NO {
                    let message = format!(
                        "need of {}: '{}' is neither {YES} nor {NO}, and counts as {NO}",
                        group.name(),
                        beginning(&answer)
                    );
                    errors.push(in_whole(&answer, message, format!("answer {YES} or {NO}")));
                }
                continue;
            }
            let lines: Vec<String> = group.tools().map(tools::Tool::line).collect();
            let call = Asked {
                round: RoundName::Tool,
                prompt: self.prompts.render("tools", context! { tools => lines })?,
                constraint: call_grammar(group, &observation.facts),
                max_tokens: CALL_TOKENS,
            };
            let Some(answer) = chat.ask(call)? else {
                break;
            };
            let tool = observation.facts.answer(group, &answer);
            found.push(format!(
                "{} {}:\n{}",
                group.name(),
                tool.function,
                tool.result
            ));
            chat.note_tool(tool);
        }
        Ok(found)
    }

    /// The experience that the model picks among the most similar ones.
    fn recall(
        &self,
        observation: &Observation<'_>,
        chat: &mut Chat<'_>,
        errors: &mut Vec<ParseError>,
    ) -> Result<Option<String>, ReasoningError> {
        let candidates = nearest(&self.memory.items, &observation.ego);
        if candidates.is_empty() {
            return Ok(None);
        }
        chat.open(self.prompts.render("experience_system", context! {})?)?;
        let texts: Vec<String> = candidates
            .iter()
            .map(|(_, item)| item.text.clone())
            .collect();
        let numbers: Vec<String> = (1..=candidates.len()).map(|n| n.to_string()).collect();
        let asked = Asked {
            round: RoundName::Experience,
            prompt: self.prompts.render(
                "experience",
                context! { ego => &observation.text, candidates => texts },
            )?,
            constraint: any_of(numbers),
            max_tokens: WORD_TOKENS,
        };
        let Some(answer) = chat.ask(asked)? else {
            return Ok(None);
        };
        let number: Option<usize> = answer.trim().parse().ok();
        let Some((similarity, item)) = number
            .and_then(|number| number.checked_sub(1))
            .and_then(|place| candidates.get(place))
        else {
            // A wrong number costs the experience and not the call: a plan does not need one.
            let message = format!(
                "experience: '{}' is no number of one; none is given",
                beginning(&answer)
            );
            let hint = format!("write one of 1 to {}", candidates.len().min(CANDIDATES));
            errors.push(in_whole(&answer, message, hint));
            return Ok(None);
        };
        Ok(Some(format!(
            "Trajectory: {} (similarity {similarity:.2})",
            item.list()
        )))
    }
}

/// What it sees. The facts of the tools hold for the instant of the call.
pub(crate) struct Observation<'a> {
    text: String,
    ego: EgoFacts,
    motion: Motion,
    facts: Facts<'a>,
}

impl ChatAgent for AgentDriver {
    type Observation<'a> = Observation<'a>;
    type Answer = WaypointList;
    type Plan = Trajectory;

    fn interval_s(&self) -> f64 {
        self.settings.interval_s(&KEYS)
    }

    fn reflects(&self) -> bool {
        self.settings.reflects()
    }

    fn reset(&mut self) {
        self.track = WaypointTrack::default();
    }

    fn observe<'a>(&mut self, GraphedScene { scene, graph }: GraphedScene<'a>) -> Observation<'a> {
        let ego = EgoFacts::from_scene(scene, graph);
        Observation {
            text: ego.text(),
            ego,
            motion: Motion::from_ego(scene.ego),
            facts: Facts::from_scene(scene),
        }
    }

    fn scene_text(observation: &Observation<'_>) -> String {
        observation.text.clone()
    }

    fn ask(
        &self,
        observation: &Observation<'_>,
        chat: &mut Chat<'_>,
    ) -> Result<Reply<WaypointList>, ReasoningError> {
        let mut errors = Vec::new();
        let facts = self.perceive(observation, chat, &mut errors)?.join("\n\n");
        let experience = self.recall(observation, chat, &mut errors)?;
        let Some(reasons) = self.think(observation, &facts, chat)? else {
            return Ok(Reply::none());
        };
        let reasons = self.passed_on(reasons, &mut errors);
        let plan = Asked {
            round: RoundName::Waypoints,
            prompt: self.prompts.render(
                "planning",
                context! {
                    ego => &observation.text,
                    facts => facts,
                    experience => experience,
                    reasons => reasons,
                    feedback => chat.feedback(),
                },
            )?,
            constraint: Constraint::Sequence(vec![
                text("Trajectory: "),
                waypoint_grammar(observation.motion),
            ]),
            max_tokens: self.settings.max_tokens(&KEYS),
        };
        chat.open(self.prompts.render("planning_system", context! {})?)?;
        let Some(answer) = chat.ask(plan)? else {
            return Ok(Reply::none());
        };
        let mut reply = read_waypoints(&answer, observation.motion, chat);
        reply.errors.splice(0..0, errors);
        // Only noted here. `plan` moves the waypoints, so that the record keeps what the model
        // wrote.
        if let (Some(waypoints), None) = (&reply.answer, reply.unreadable) {
            let after = checked(waypoints, &observation.facts);
            chat.note_tool(ToolUse {
                function: CHECK.to_owned(),
                arguments: String::new(),
                result: after.words(),
                failed: false,
            });
        }
        Ok(reply)
    }

    fn plan(
        &self,
        waypoints: WaypointList,
        observation: &Observation<'_>,
        seen: GraphedScene<'_>,
    ) -> Result<(Trajectory, Trajectory), PlannerError> {
        let after = checked(&waypoints, &observation.facts);
        let trajectory = WaypointTrack::through(&after.waypoints, seen)?;
        Ok((trajectory.clone(), trajectory))
    }

    fn adopt(&mut self, trajectory: Trajectory) {
        self.track.adopt(trajectory);
    }

    fn go_on(
        &mut self,
        scene: &SceneView<'_>,
        graph: Option<&LaneGraph>,
    ) -> Result<(), PlannerError> {
        self.track.go_on(scene, graph)
    }

    fn trajectory(&mut self, _: &PlannerInput<'_>) -> Result<Option<Trajectory>, PlannerError> {
        Ok(self.track.trajectory())
    }
}

impl AgentDriver {
    /// The reasons as they are passed on to the plan. A server may write more than it is asked for.
    fn passed_on(&self, mut reasons: String, errors: &mut Vec<ParseError>) -> String {
        let limit = self
            .settings
            .max_tokens(&KEYS)
            .saturating_mul(MAX_TOKEN_BYTES);
        let message = if reasons.trim().is_empty() {
            "reasoning: the answer is empty; the plan is asked for without reasons".to_owned()
        } else if reasons.len() > limit {
            let bytes = reasons.len();
            format!("reasoning: of {bytes} bytes the first {limit} are passed on")
        } else {
            return reasons;
        };
        let hint = "write two lines: reasons and a plan".to_owned();
        errors.push(in_whole(&reasons, message, hint));
        reasons.truncate(reasons.floor_char_boundary(limit));
        reasons
    }

    /// Reasons about what matters, and what to do.
    fn think(
        &self,
        observation: &Observation<'_>,
        facts: &str,
        chat: &mut Chat<'_>,
    ) -> Result<Option<String>, ReasoningError> {
        chat.open(self.prompts.render("reasoning_system", context! {})?)?;
        let names: Vec<String> = observation
            .facts
            .names()
            .into_iter()
            .take(NAMED_OBJECTS)
            .collect();
        chat.ask(Asked {
            round: RoundName::Reasoning,
            prompt: self.prompts.render(
                "reasoning",
                context! { ego => &observation.text, facts => facts },
            )?,
            constraint: Constraint::Sequence(vec![
                text("Reasons: "),
                reasons(&names),
                text("\nPlan: "),
                action(),
            ]),
            max_tokens: self.settings.max_tokens(&KEYS),
        })
    }
}
