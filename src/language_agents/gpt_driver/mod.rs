//! GPT-Driver (Mao et al. 2023): motion planning as writing. The model gets objects, motion and
//! goal in coordinates, writes a short chain of reasons, and six waypoints.
//!
//! What differs from the original stands in docs/agents.md.

mod grammar;

use crate::agent::{ChatAgent, Parts, Reply};
use crate::chat::{Asked, Chat};
use crate::waypoints::{Motion, WaypointTrack, read_waypoints};
use grammar::answer;
pub(crate) use grammar::{action, reasons};
use minijinja::context;
use planagent_agent::environment::GraphedScene;
use planagent_agent::environment::coordinates::{GptDriverText, seen_objects};
use planagent_agent::planner::{GptDriverSettings, PlannerError, PlannerInput};
use planagent_agent::reasoning::{
    PromptError, QuestionPrompts, ReasoningError, RoundName, WaypointList,
};
use planagent_world::Trajectory;
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
        let mut objects: Vec<_> = seen_objects(scene)
            .map(|(object, [(right, ahead), ..])| {
                let name = format!("{} at ({right:.2},{ahead:.2})", object.kind);
                (right.hypot(ahead), name)
            })
            .collect();
        objects.sort_by(|(a, _), (b, _)| a.total_cmp(b));
        let nearest = objects.into_iter().take(NAMED_OBJECTS);
        Observation {
            text: GptDriverText::from_scene(scene, graph),
            motion: Motion::from_ego(scene.ego),
            objects: nearest.map(|(_, name)| name).collect(),
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
        chat.open(self.prompts.render("system", context! {})?)?;
        let prompt = self.prompts.render(
            "question",
            context! { scene_text => Self::scene_text(observation) },
        )?;
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

    fn go_on(&mut self, seen: GraphedScene<'_>) -> Result<(), PlannerError> {
        self.track.go_on(seen)
    }

    fn trajectory(&mut self, _: &PlannerInput<'_>) -> Result<Option<Trajectory>, PlannerError> {
        Ok(self.track.trajectory())
    }
}
