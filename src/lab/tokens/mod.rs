//! Token counts of scene descriptions (the paper's table of token utilization): our texts, and
//! those of GPT-Driver, LLM-ASSIST, `DiLu` and Agent-Driver of the same scenes, counted with OpenAI's `cl100k_base` (that
//! of GPT-3.5 and GPT-4) and with the tokenizer of a model at hand.
//!
//! The scenes are the recorded states of scenarios at the iterations at which PlanAgent would call
//! its model. A description is the text about the scene alone, without system prompt, question and
//! image.

mod counter;
mod table;

pub use counter::TokenCounter;
pub use table::{TokenMean, TokenTable, TokenTableRow};

use planagent_agent::environment::coordinates::{GptDriverText, llm_assist_text};
use planagent_agent::environment::text::write;
use planagent_agent::environment::{
    Description, GraphedScene, LaneGraph, LaneGraphError, TextForm,
};
use planagent_language_agents::{agent_driver_text, dilu_text};
use planagent_scenario::Scenario;
use planagent_world::{HISTORY_SAMPLES, History, HistorySample, SceneView};
use serde::Serialize;

/// A way of describing a scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum SceneText {
    /// Our lane-graph text for general models.
    Paper,
    /// Our lane-graph text for small models.
    Compact,
    /// GPT-Driver's user message.
    GptDriver,
    /// Its list of objects alone.
    GptDriverObjects,
    /// LLM-ASSIST's facts as far as they are known.
    LlmAssist,
    /// DiLu's description.
    Dilu,
    /// Agent-Driver's motion block, and a tool of each kind.
    AgentDriver,
}

/// What the table says of a description, and how one is made.
struct Row {
    text: SceneText,
    name: &'static str,
    definition: &'static str,
    /// What the paper counts for it on nuPlan; of GPT-Driver's text it does not say which part.
    published: Option<f64>,
    describe: fn(GraphedScene<'_>) -> String,
}

/// The descriptions in the order of the table.
const ROWS: [Row; 7] = [
    Row {
        text: SceneText::GptDriver,
        name: "GPT-Driver, whole user message",
        definition: "its published facts in our sentences: objects within 20 m ahead, now and in 3 s at constant velocity; the \
                     ego's motion in six lines; four past positions; the goal. Coordinates have two decimals",
        published: Some(448.66),
        describe: |seen| GptDriverText::from_scene(seen.scene, seen.graph).whole(),
    },
    Row {
        text: SceneText::GptDriverObjects,
        name: "GPT-Driver, objects alone",
        definition: "only the objects",
        published: None,
        describe: |seen| GptDriverText::from_scene(seen.scene, seen.graph).objects,
    },
    Row {
        text: SceneText::LlmAssist,
        name: "LLM-ASSIST, rewritten",
        definition: "its prompts are not public, so we chose the facts: the ego's motion; the centerlines of its lane and the \
                     adjacent lanes at five points; lights; the ten nearest objects within 50 m with position, heading, speed \
                     and size",
        published: Some(425.81),
        describe: |seen| llm_assist_text(seen.scene, seen.graph),
    },
    Row {
        text: SceneText::Dilu,
        name: "DiLu, description",
        definition: "its published facts in our sentences: lanes; the ego's motion and set-points; the nearest object ahead and \
                     behind on its lane and those beside; with ours, the light and the route. Numbers have two decimals",
        published: None,
        describe: dilu_text,
    },
    Row {
        text: SceneText::AgentDriver,
        name: "Agent-Driver, motion and four tools",
        definition: "GPT-Driver's lines about the ego, and what four of its tools tell: the objects within 20 m, where they go, \
                     whether the place ahead is occupied, and the edges of the road",
        published: None,
        describe: agent_driver_text,
    },
    Row {
        text: SceneText::Paper,
        name: "PlanAgent, lane graph (paper prompts)",
        definition: "the node of the ego and its eight neighbors; every agent on them with distance and speed; the lights of all \
                     lanes; the ego's speed and limit; the route. Numbers are whole meters and m/s",
        published: Some(141.32),
        describe: |seen| write(&Description::from_graph(seen.graph), TextForm::Paper),
    },
    Row {
        text: SceneText::Compact,
        name: "PlanAgent, lane graph (compact prompts)",
        definition: "the same nodes, each with its nearest agent and the number of others, at fixed positions",
        published: None,
        describe: |seen| write(&Description::from_graph(seen.graph), TextForm::Compact),
    },
];

impl SceneText {
    /// All of them, in the order of the table.
    pub const ALL: [Self; ROWS.len()] = {
        let (mut all, mut i) = ([Self::Paper; ROWS.len()], 0);
        while i < all.len() {
            all[i] = ROWS[i].text;
            i += 1;
        }
        all
    };

    fn row(self) -> &'static Row {
        ROWS.iter()
            .find(|row| row.text == self)
            .expect("each description has a row")
    }

    pub fn name(self) -> &'static str {
        self.row().name
    }

    pub fn definition(self) -> &'static str {
        self.row().definition
    }

    /// What the paper counts for it on nuPlan.
    pub fn published(self) -> Option<f64> {
        self.row().published
    }

    pub fn describe(self, scene: &SceneView<'_>, graph: &LaneGraph) -> String {
        (self.row().describe)(GraphedScene::new(scene, graph))
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Tokens {
    /// By `cl100k_base`.
    pub cl100k: usize,
    /// By the tokenizer of the model at hand.
    pub model: Option<usize>,
}

/// The token counts of one recorded state.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TokenRow {
    pub scenario: String,
    pub iteration: usize,
    /// Agents and obstacles on the nine nodes.
    pub agents: usize,
    /// In the order of [`SceneText::ALL`].
    pub tokens: [Tokens; SceneText::ALL.len()],
}

/// Counts the descriptions of a scenario's recorded states, one every `interval` iterations; an
/// error for a state without a lane graph.
pub fn count(
    scenario: &Scenario,
    interval: usize,
    node_length_m: f64,
    counter: &TokenCounter<'_>,
) -> Vec<Result<TokenRow, LaneGraphError>> {
    let iterations = (0..scenario.iterations()).step_by(interval.max(1));
    iterations
        .map(|iteration| count_at(scenario, iteration, node_length_m, counter))
        .collect()
}

fn count_at(
    scenario: &Scenario,
    iteration: usize,
    node_length_m: f64,
    counter: &TokenCounter<'_>,
) -> Result<TokenRow, LaneGraphError> {
    let now = scenario.start + iteration;
    let frame = &scenario.frames[now];
    let mut history = History::default();
    for past in &scenario.frames[now.saturating_sub(HISTORY_SAMPLES - 1)..=now] {
        history.push(HistorySample {
            ego: past.ego,
            objects: past.objects.clone(),
        });
    }
    let scene = scenario.scene(frame, &history);
    let graph = LaneGraph::build(&scene, node_length_m)?;
    let tokens = SceneText::ALL.map(|kind| counter.count(&kind.describe(&scene, &graph)));
    Ok(TokenRow {
        scenario: scenario.id.clone(),
        iteration,
        agents: graph.agents.len(),
        tokens,
    })
}
