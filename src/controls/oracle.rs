//! `oracle-code`: the agent with the planner codes of the privileged search that labels datasets. A
//! control: no model that learns from them does better, as far as six seconds tell. `oracle-grid`
//! takes the best of all codes of a grid, without the search's reserves. `oracle-end` tries these to
//! the end of the scene and takes the score of the whole simulation: what a code is worth that is
//! kept.

use super::foresight::{self, Foresight};
use super::search::{Candidate, best, highest, search_ahead, search_grid};
use super::trial::{horizon, to_end};
use planagent_agent::environment::{DEFAULT_NODE_LENGTH, LaneGraph};
use planagent_agent::planner::{
    AgentLayer, CodeCall, CodeList, CodeSource, Planner, ReflectionSettings, fixed_code,
};
use planagent_agent::planner_registry::PlannerEntry;
use planagent_agent::reasoning::PlannerCode;
use planagent_agent::simulation::ClosedLoop;
use planagent_world::{HistorySample, SceneView};
use std::sync::{Arc, Mutex, PoisonError};

/// Chooses one of the codes that were tried.
type Choose = fn(&[Candidate]) -> Option<&Candidate>;

/// The codes that are tried out ahead.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Tried {
    /// Those of the search for labels, by its value.
    Search,
    /// All of the grid, by nuPlan's score of the next seconds.
    Grid,
    /// All of the grid, by the score of a simulation that keeps the code to its end.
    End,
}

/// The planners of these names.
pub(crate) fn entries() -> [PlannerEntry; 3] {
    [
        entry(
            "oracle-code",
            "the agent with codes tried out ahead (a control)",
            Tried::Search,
        ),
        entry(
            "oracle-grid",
            "the agent with all codes of a grid tried out ahead (a control)",
            Tried::Grid,
        ),
        entry(
            "oracle-end",
            "the agent with all codes of a grid tried out to the end of the scene (a control)",
            Tried::End,
        ),
    ]
}

fn entry(name: &'static str, summary: &'static str, tries: Tried) -> PlannerEntry {
    foresight::entry(name, summary, move |parts| {
        let code = HandedCode::default();
        let source = CodeSource::Listed(Arc::new(code.clone()));
        Ok(CodeOracle {
            agent: parts.agent(source),
            tries,
            code,
            reflection: parts.settings.reflection.clone(),
            oncoming_lane: parts.settings.environment.oncoming_lane != Some(false),
        })
    })
}

/// The code that the search found for the next planning call; the fixed one where it found none.
#[derive(Debug, Clone, Default)]
struct HandedCode(Arc<Mutex<Option<PlannerCode>>>);

impl HandedCode {
    fn hand(&self, code: Option<PlannerCode>) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = code;
    }
}

impl CodeList for HandedCode {
    fn codes(&self, call: &CodeCall<'_>) -> Vec<PlannerCode> {
        let found = self.0.lock().unwrap_or_else(PoisonError::into_inner).take();
        vec![found.unwrap_or_else(|| fixed_code(call.graph))]
    }
}

/// An agent whose codes are tried out ahead.
struct CodeOracle {
    agent: Box<dyn AgentLayer>,
    tries: Tried,
    code: HandedCode,
    /// How the agent's plans drive, and so the tried ones.
    reflection: ReflectionSettings,
    /// Whether codes may name the oncoming lane.
    oncoming_lane: bool,
}

impl Foresight for CodeOracle {
    fn planner(&self) -> &dyn Planner {
        &self.agent
    }

    fn planner_mut(&mut self) -> &mut dyn Planner {
        &mut self.agent
    }

    fn begins_with_call(&self, scene: &SceneView<'_>) -> bool {
        self.agent.state().begins_with_call(scene)
    }

    /// Hands the best code over. Near the end of the recording the search looks no further than
    /// that; where it finds nothing, the agent takes the fixed code.
    fn look_ahead(&mut self, simulation: &ClosedLoop<'static>, past: &[HistorySample]) {
        let scene = simulation.scene();
        let graph = LaneGraph::build(&scene, DEFAULT_NODE_LENGTH).ok();
        let graph = graph.map(|graph| {
            if self.oncoming_lane {
                graph.with_oncoming_lane(&scene)
            } else {
                graph
            }
        });
        let (reflection, horizon) = (&self.reflection, horizon(simulation));
        let (tried, best): (Vec<Candidate>, Choose) = match (graph, self.tries) {
            (None, _) => (Vec::new(), best),
            (Some(graph), Tried::Search) => {
                (search_ahead(simulation, &graph, reflection, horizon), best)
            }
            (Some(graph), Tried::Grid) => (
                search_grid(simulation, &graph, reflection, (None, horizon)),
                highest,
            ),
            (Some(graph), Tried::End) => {
                let ahead = (Some(past), to_end(simulation));
                (search_grid(simulation, &graph, reflection, ahead), highest)
            }
        };
        self.code.hand(best(&tried).map(|best| best.code));
    }
}
