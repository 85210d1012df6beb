//! Token counts of scene descriptions (the paper's table of token utilization): our texts, and
//! those of the other language agents of the same scenes, counted with OpenAI's `cl100k_base` (that
//! of GPT-3.5 and GPT-4) and with the tokenizer of a model at hand.
//!
//! The scenes are the recorded states of scenarios at the iterations at which PlanAgent would call
//! its model. A description is the text about the scene alone, without system prompt, question and
//! image.

mod counter;
mod table;

pub use counter::TokenCounter;
pub use table::{TokenMean, TokenTable, TokenTableRow};

use planagent_agent::environment::coordinates::llm_assist_text;
use planagent_agent::environment::text::write;
use planagent_agent::environment::{
    Description, GraphedScene, LaneGraph, LaneGraphError, TextForm,
};
use planagent_language_agents::{DescribedText, described_texts};
use planagent_scenario::Scenario;
use planagent_world::{HISTORY_SAMPLES, History, HistorySample, SceneView};
use serde::{Serialize, Serializer};

/// LLM-ASSIST's facts, as far as they are known, and our lane-graph texts for general and for small
/// models.
static OWN: [DescribedText; 3] = [
    DescribedText {
        key: "llm_assist",
        name: "LLM-ASSIST, rewritten",
        definition: "its prompts are not public, so we chose the facts: the ego's motion; the centerlines of its lane and the \
                     adjacent lanes at five points; lights; the ten nearest objects within 50 m with position, heading, speed \
                     and size",
        published: Some(425.81),
        describe: |seen| llm_assist_text(seen.scene, seen.graph),
    },
    DescribedText {
        key: "paper",
        name: "PlanAgent, lane graph (paper prompts)",
        definition: "the node of the ego and its eight neighbors; every agent on them with distance and speed; the lights of all \
                     lanes; the ego's speed and limit; the route. Numbers are whole meters and m/s",
        published: Some(141.32),
        describe: |seen| write(&Description::from_graph(seen.graph), TextForm::Paper),
    },
    DescribedText {
        key: "compact",
        name: "PlanAgent, lane graph (compact prompts)",
        definition: "the same nodes, each with its nearest agent and the number of others, at fixed positions",
        published: None,
        describe: |seen| write(&Description::from_graph(seen.graph), TextForm::Compact),
    },
];

/// A way of describing a scene.
#[derive(Debug, Clone, Copy)]
pub struct SceneText(&'static DescribedText);

impl PartialEq for SceneText {
    fn eq(&self, other: &Self) -> bool {
        self.key() == other.key()
    }
}

impl Serialize for SceneText {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.key())
    }
}

impl SceneText {
    /// All of them, in the order of the table: those of the other agents first.
    pub fn all() -> Vec<Self> {
        described_texts().chain(&OWN).map(Self).collect()
    }

    /// Its name in files.
    pub fn key(self) -> &'static str {
        self.0.key
    }

    pub fn name(self) -> &'static str {
        self.0.name
    }

    pub fn definition(self) -> &'static str {
        self.0.definition
    }

    /// What the paper counts for it on nuPlan.
    pub fn published(self) -> Option<f64> {
        self.0.published
    }

    pub fn describe(self, scene: &SceneView<'_>, graph: &LaneGraph) -> String {
        (self.0.describe)(GraphedScene::new(scene, graph))
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
    /// In the order of [`SceneText::all`].
    pub tokens: Vec<Tokens>,
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
    let texts = SceneText::all().into_iter();
    let tokens = texts.map(|text| counter.count(&text.describe(&scene, &graph)));
    Ok(TokenRow {
        scenario: scenario.id.clone(),
        iteration,
        agents: graph.agents.len(),
        tokens: tokens.collect(),
    })
}
