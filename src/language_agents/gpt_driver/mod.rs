//! GPT-Driver (Mao et al. 2023): motion planning as writing. The model gets objects, motion and
//! goal in coordinates, writes a short chain of reasons, and six waypoints.
//!
//! What differs from the original stands in docs/agents.md.

mod grammar;
mod taught;

use crate::agent::{ChatAgent, Parts, Reply};
use crate::chat::{Asked, Chat};
use crate::described::DescribedText;
use crate::made::{Agent, asking, handed};
use crate::oracle::best_waypoints;
use crate::teaching::{QuestionTexts, Teaching};
use crate::waypoints::{Motion, WaypointTrack, read_waypoints};
use grammar::answer;
pub(crate) use grammar::{action, reasons};
use minijinja::context;
use planagent_agent::environment::coordinates::{GptDriverText, seen_objects};
use planagent_agent::environment::{GraphedScene, LaneGraph};
use planagent_agent::planner::{AgentKeys, AgentSettings, PlannerError, PlannerInput};
use planagent_agent::reasoning::{
    LISTED_WAYPOINTS, PromptError, QuestionPrompts, ReasoningError, RoundName, WaypointList,
};
use planagent_world::{SceneView, TrackedObject, Trajectory};
use std::sync::Arc;

/// The folder of its prompts.
const PROMPTS: &str = "gpt_driver";
const TEXTS: [(&str, &str); 2] = [
    (
        "system.jinja",
        include_str!("../../../prompts/gpt_driver/system.jinja"),
    ),
    (
        "question.jinja",
        include_str!("../../../prompts/gpt_driver/question.jinja"),
    ),
];
/// Objects of a scene that a chain of reasons may name, the nearest.
const NAMED_OBJECTS: usize = 12;

/// What it is made of.
const PARTS: Parts<GptDriver> = Parts {
    keys: KEYS,
    prompts,
    make: |settings, prompts| {
        Ok(GptDriver {
            settings,
            prompts,
            track: WaypointTrack::default(),
        })
    },
};

/// Its settings.
const KEYS: AgentKeys = AgentKeys {
    planner: "gpt-driver",
    interval_s: 1.0,
    max_tokens: 256,
    examples: None,
    has_memory: false,
};

/// What its model reads about a scene. The paper does not say which part of its text it counts.
const DESCRIBED: &[DescribedText] = &[
    DescribedText {
        key: "gpt_driver",
        name: "GPT-Driver, whole user message",
        definition: "its published facts in our sentences: objects within 20 m ahead, now and in 3 s at constant velocity; the \
                     ego's motion in six lines; four past positions; the goal. Coordinates have two decimals",
        published: Some(448.66),
        describe: |seen| GptDriverText::from_scene(seen.scene, seen.graph).whole(),
    },
    DescribedText {
        key: "gpt_driver_objects",
        name: "GPT-Driver, objects alone",
        definition: "only the objects",
        published: None,
        describe: |seen| GptDriverText::from_scene(seen.scene, seen.graph).objects,
    },
];

/// The agent.
pub(crate) fn agent() -> Agent {
    Agent {
        planner: asking("GPT-Driver; the model gives waypoints", PARTS),
        oracle: handed(
            "oracle-gpt-driver",
            "GPT-Driver with waypoints of codes tried out ahead (a control)",
            PARTS,
            best_waypoints,
        ),
        texts: DESCRIBED,
        teaching: Some(Teaching::from_parts(PARTS)),
        filler: None,
    }
}

/// The prompts of this agent.
fn prompts() -> Result<QuestionPrompts, PromptError> {
    QuestionPrompts::open(PROMPTS, &TEXTS)
}

/// GPT-Driver.
pub(crate) struct GptDriver {
    settings: AgentSettings,
    prompts: Arc<QuestionPrompts>,
    track: WaypointTrack,
}

/// What it sees.
pub(crate) struct Observation {
    text: GptDriverText,
    motion: Motion,
    /// Objects with their places, as the text has them; the nearest first.
    objects: Vec<String>,
}

/// An object that a chain of reasons may name.
struct NamedObject<'a> {
    /// Its kind and place, as the text has them.
    name: String,
    object: &'a TrackedObject,
    /// Its places now and after every half second: meters to the right, meters ahead.
    places: [(f64, f64); LISTED_WAYPOINTS + 1],
}

/// The objects that a chain of reasons may name, the nearest first.
fn nearest_objects<'a>(scene: &SceneView<'a>) -> impl Iterator<Item = NamedObject<'a>> {
    let mut objects: Vec<_> = seen_objects(scene).collect();
    let distance = |[(right, ahead), ..]: &[(f64, f64); LISTED_WAYPOINTS + 1]| right.hypot(*ahead);
    objects.sort_by(|(_, a), (_, b)| distance(a).total_cmp(&distance(b)));
    let nearest = objects.into_iter().take(NAMED_OBJECTS);
    nearest.map(|(object, places)| {
        let [(right, ahead), ..] = places;
        NamedObject {
            name: format!("{} at ({right:.2},{ahead:.2})", object.kind),
            object,
            places,
        }
    })
}

impl GptDriver {
    /// What the model is asked.
    fn question_texts(
        &self,
        observation: &Observation,
        feedback: Option<&str>,
    ) -> Result<QuestionTexts, PromptError> {
        Ok(QuestionTexts {
            system: self.prompts.render("system", context! {})?,
            prompt: self.prompts.render(
                "question",
                context! { scene_text => Self::scene_text(observation), feedback => feedback },
            )?,
        })
    }
}

impl ChatAgent for GptDriver {
    type Observation<'a> = Observation;
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

    fn observe(&mut self, GraphedScene { scene, graph }: GraphedScene<'_>) -> Observation {
        Observation {
            text: GptDriverText::from_scene(scene, graph),
            motion: Motion::from_ego(scene.ego),
            objects: nearest_objects(scene).map(|named| named.name).collect(),
        }
    }

    fn scene_text(observation: &Observation) -> String {
        observation.text.whole()
    }

    fn ask(
        &self,
        observation: &Observation,
        chat: &mut Chat<'_>,
    ) -> Result<Reply<WaypointList>, ReasoningError> {
        let QuestionTexts { system, prompt } = self.question_texts(observation, chat.feedback())?;
        chat.open(system)?;
        let asked = Asked {
            round: RoundName::Waypoints,
            prompt,
            constraint: answer(&observation.objects, observation.motion),
            max_tokens: self.settings.max_tokens(&KEYS),
        };
        Ok(match chat.ask(asked)? {
            Some(text) => read_waypoints(&text, observation.motion, chat),
            None => Reply::none(),
        })
    }

    fn plan(
        &self,
        waypoints: WaypointList,
        _: &Observation,
        seen: GraphedScene<'_>,
    ) -> Result<(Trajectory, Trajectory), PlannerError> {
        let trajectory = WaypointTrack::through(&waypoints, seen)?;
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
