//! DiLu (Wen et al. 2024): a driver that reasons with remembered decisions. The model gets lanes and
//! cars in words and the most similar decisions of a memory, and picks one of five actions a second,
//! which move the set-points of a lane and speed controller.
//!
//! What differs from the original stands in docs/agents.md.

mod answer;
mod control;
mod describe;
mod item;
mod lesson;
mod oracle;
mod recall;
mod taught;

pub(crate) use item::DiluItem;
#[cfg(test)]
pub(crate) use lesson::{Drive, lesson_items};

use crate::agent::{ChatAgent, Parts, Reply, in_answer};
use crate::chat::{Asked, Chat};
use crate::described::DescribedText;
use crate::fill::{MemoryFiller, MemorySource};
use crate::made::{Agent, asking, handed};
use crate::memory::{Memory, open};
use crate::teaching::{QuestionTexts, Teaching};
use answer::{extraction, grammar, read_action, read_extraction};
pub(crate) use control::SetPoints;
use describe::description;
use lesson::left_items;
use minijinja::context;
use oracle::best_action;
use planagent_agent::environment::{GraphedScene, LaneGraph};
use planagent_agent::planner::{AgentKeys, AgentSettings, PlannerError, PlannerInput};
use planagent_agent::reasoning::{
    DrivingAction, PromptError, QuestionPrompts, ReasoningError, RoundName,
};
use planagent_world::{SceneView, Trajectory};
use recall::Recall;
use std::sync::Arc;

/// Name of the planner.
const NAME: &str = "dilu";
/// The folder of its prompts.
const PROMPTS: &str = "dilu";
const TEXTS: [(&str, &str); 5] = [
    (
        "system.jinja",
        include_str!("../../../prompts/dilu/system.jinja"),
    ),
    (
        "question.jinja",
        include_str!("../../../prompts/dilu/question.jinja"),
    ),
    (
        "extraction.jinja",
        include_str!("../../../prompts/dilu/extraction.jinja"),
    ),
    (
        "lesson_system.jinja",
        include_str!("../../../prompts/dilu/lesson_system.jinja"),
    ),
    (
        "lesson.jinja",
        include_str!("../../../prompts/dilu/lesson.jinja"),
    ),
];
/// Maximum tokens of the action alone.
const ACTION_TOKENS: usize = 16;

/// What it is made of.
const PARTS: Parts<Dilu> = Parts {
    keys: KEYS,
    prompts,
    make: |settings, prompts| {
        let memory: Memory<DiluItem> = open(settings.memory.as_deref(), NAME)?;
        Ok(Dilu {
            settings,
            prompts,
            recall: Arc::new(Recall::new(memory.items)),
            set_points: None,
        })
    },
};

/// Its settings.
const KEYS: AgentKeys = AgentKeys {
    planner: NAME,
    interval_s: 1.0,
    max_tokens: 320,
    examples: Some(3),
    has_memory: true,
};

/// What its model reads about a scene.
const DESCRIBED: &[DescribedText] = &[DescribedText {
    key: "dilu",
    name: "DiLu, description",
    definition: "its published facts in our sentences: lanes; the ego's motion and set-points; the nearest object ahead and \
                         behind on its lane and those beside; with ours, the light and the route. Numbers have two decimals",
    published: None,
    describe: dilu_text,
}];

/// The agent.
pub(crate) fn agent() -> Agent {
    Agent {
        planner: asking(
            "DiLu; the model gives an action, with remembered decisions",
            PARTS,
        ),
        oracle: handed(
            "oracle-dilu",
            "DiLu with actions tried out ahead (a control)",
            PARTS,
            best_action,
        ),
        texts: DESCRIBED,
        teaching: Some(Teaching::from_parts(PARTS)),
        filler: Some(MemoryFiller {
            keys: KEYS,
            about: "decisions of drives by the model, and its lesson of an accident",
            source: MemorySource::Drives(left_items),
        }),
    }
}

/// The prompts of this agent.
fn prompts() -> Result<QuestionPrompts, PromptError> {
    QuestionPrompts::open(PROMPTS, &TEXTS)
}

/// The description of a scene, with the set-points of an ego that goes on as it is.
fn dilu_text(seen: GraphedScene<'_>) -> String {
    description(seen, SetPoints::at(seen))
}

/// DiLu.
pub(crate) struct Dilu {
    settings: AgentSettings,
    prompts: Arc<QuestionPrompts>,
    recall: Arc<Recall>,
    set_points: Option<SetPoints>,
}

impl Dilu {
    /// The set-points in a scene, before an action.
    pub(crate) fn set_points_in(&self, seen: GraphedScene<'_>) -> SetPoints {
        match self.set_points {
            Some(set) => set.tracked(seen.scene),
            None => SetPoints::at(seen),
        }
    }

    /// What the model is asked, with the decisions that it remembers.
    fn question_texts(
        &self,
        observation: &Observation,
        feedback: Option<&str>,
    ) -> Result<QuestionTexts, PromptError> {
        let recalled = self
            .recall
            .nearest(&observation.description, self.settings.examples(&KEYS));
        let examples: Vec<_> = recalled
            .into_iter()
            .map(|item| context! { description => &item.description, answer => &item.answer })
            .collect();
        Ok(QuestionTexts {
            system: self.prompts.render("system", context! {})?,
            prompt: self.prompts.render(
                "question",
                context! {
                    examples => examples,
                    scene_text => &observation.description,
                    feedback => feedback,
                    actions => observation.actions(),
                },
            )?,
        })
    }
}

/// What it sees.
pub(crate) struct Observation {
    /// Lanes, cars, lights and route in words: the key of the memory.
    pub(crate) description: String,
    /// The actions that can be taken.
    pub(crate) offered: Vec<DrivingAction>,
    /// The set-points before the action.
    before: SetPoints,
}

impl Observation {
    /// The actions in words.
    fn actions(&self) -> String {
        let line = |action: &DrivingAction| {
            let words = match action {
                DrivingAction::Left => "aim for the next lane to the left",
                DrivingAction::Idle => "keep the set lane and the set speed",
                DrivingAction::Right => "aim for the next lane to the right",
                DrivingAction::Faster => "raise the set speed",
                DrivingAction::Slower => "lower the set speed",
            };
            format!("{}: {words}", action.id())
        };
        self.offered.iter().map(line).collect::<Vec<_>>().join("\n")
    }
}

impl ChatAgent for Dilu {
    type Observation<'a> = Observation;
    type Answer = DrivingAction;
    type Plan = SetPoints;

    fn interval_s(&self) -> f64 {
        self.settings.interval_s(&KEYS)
    }

    fn reflects(&self) -> bool {
        self.settings.reflects()
    }

    fn reset(&mut self) {
        self.set_points = None;
    }

    fn observe(&mut self, seen: GraphedScene<'_>) -> Observation {
        let before = self.set_points_in(seen);
        self.set_points = Some(before);
        Observation {
            description: description(seen, before),
            offered: before.offered(seen.scene),
            before,
        }
    }

    fn scene_text(observation: &Observation) -> String {
        observation.description.clone()
    }

    fn ask(
        &self,
        observation: &Observation,
        chat: &mut Chat<'_>,
    ) -> Result<Reply<DrivingAction>, ReasoningError> {
        let QuestionTexts { system, prompt } = self.question_texts(observation, chat.feedback())?;
        chat.open(system)?;
        let asked = Asked {
            round: RoundName::Action,
            prompt,
            constraint: grammar(&observation.offered),
            max_tokens: self.settings.max_tokens(&KEYS),
        };
        let Some(text) = chat.ask(asked)? else {
            return Ok(Reply::none());
        };
        let reply = read_action(&text, &observation.offered, chat);
        if reply.answer.is_some() {
            return Ok(reply);
        }
        // As in the original, the model is asked once more which action it meant.
        let asked = Asked {
            round: RoundName::Extraction,
            prompt: self.prompts.render("extraction", context! {})?,
            constraint: extraction(&observation.offered),
            max_tokens: ACTION_TOKENS,
        };
        let Some(text) = chat.ask(asked)? else {
            return Ok(reply);
        };
        let mut again = read_extraction(&text, &observation.offered, chat);
        let first = |error| in_answer("first answer", error);
        again
            .errors
            .splice(0..0, reply.errors.into_iter().map(first));
        Ok(again)
    }

    fn plan(
        &self,
        action: DrivingAction,
        observation: &Observation,
        GraphedScene { scene, .. }: GraphedScene<'_>,
    ) -> Result<(SetPoints, Trajectory), PlannerError> {
        let set = observation.before.moved(action, scene);
        Ok((set, set.trajectory(scene)?))
    }

    fn adopt(&mut self, set: SetPoints) {
        self.set_points = Some(set);
    }

    fn go_on(&mut self, _: &SceneView<'_>, _: Option<&LaneGraph>) -> Result<(), PlannerError> {
        Ok(())
    }

    fn trajectory(&mut self, input: &PlannerInput<'_>) -> Result<Option<Trajectory>, PlannerError> {
        let Some(set) = self.set_points else {
            return Ok(None);
        };
        let set = set.tracked(&input.scene);
        Ok(Some(self.set_points.insert(set).trajectory(&input.scene)?))
    }
}
