//! GPT-Driver (Mao et al. 2023): motion planning as writing. The model gets objects, motion and
//! goal in coordinates, writes a short chain of reasons, and six waypoints.
//!
//! What differs from the original stands in docs/agents.md.

mod grammar;
mod taught;

use crate::agent::{ChatAgent, Parts, Reply};
use crate::chat::{Asked, Chat};
use crate::teaching::QuestionTexts;
use crate::waypoints::{Motion, WaypointTrack, read_waypoints};
use grammar::answer;
pub(crate) use grammar::{action, reasons};
use minijinja::context;
use planagent_agent::environment::coordinates::{GptDriverText, seen_objects};
use planagent_agent::environment::{GraphedScene, LaneGraph};
use planagent_agent::planner::{GptDriverSettings, PlannerError, PlannerInput};
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
pub(crate) const PARTS: Parts<GptDriver> = Parts {
    name: "gpt-driver",
    prompts,
    memory: |_| None,
    make: |settings, prompts| {
        Ok(GptDriver {
            settings: settings.gpt_driver.clone(),
            prompts,
            track: WaypointTrack::default(),
        })
    },
};

/// The prompts of this agent.
fn prompts() -> Result<QuestionPrompts, PromptError> {
    QuestionPrompts::open(PROMPTS, &TEXTS)
}

/// GPT-Driver.
pub(crate) struct GptDriver {
    settings: GptDriverSettings,
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
    fn question_texts(&self, observation: &Observation) -> Result<QuestionTexts, PromptError> {
        Ok(QuestionTexts {
            system: self.prompts.render("system", context! {})?,
            prompt: self.prompts.render(
                "question",
                context! { scene_text => Self::scene_text(observation) },
            )?,
        })
    }
}

impl ChatAgent for GptDriver {
    type Observation<'a> = Observation;
    type Answer = WaypointList;
    type Plan = Trajectory;

    fn interval_s(&self) -> f64 {
        self.settings.interval_s
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
        let QuestionTexts { system, prompt } = self.question_texts(observation)?;
        chat.open(system)?;
        let asked = Asked {
            round: RoundName::Waypoints,
            prompt,
            constraint: answer(&observation.objects, observation.motion),
            max_tokens: self.settings.max_tokens,
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
