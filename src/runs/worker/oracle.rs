//! `oracle-code`: the agent with the planner codes of the privileged search that labels datasets. A
//! control: no model can do better by its codes, as far as six seconds tell.

use super::search::{HORIZON, best, search_ahead};
use planagent_agent::environment::{DEFAULT_NODE_LENGTH, LaneGraph};
use planagent_agent::planner::{
    AgentLayer, CodeSource, HandedCode, PlanAgent, PlanAgentSettings, Planner, PlannerError,
    PlannerInitialization, PlannerInput, PlannerName, PlanningCall,
};
use planagent_agent::simulation::ClosedLoop;
use planagent_world::Trajectory;

/// An agent beside the simulation that it takes part in: before a planning call it tries its codes
/// out there.
pub(super) struct OracleAgent<'a> {
    /// The same simulation, with the same trajectories.
    shadow: ClosedLoop<'a>,
    agent: Box<dyn AgentLayer>,
    code: HandedCode,
    /// Whether codes may name the oncoming lane.
    oncoming_lane: bool,
}

impl<'a> OracleAgent<'a> {
    /// An agent in a simulation that has not begun.
    pub(super) fn new(
        name: PlannerName,
        settings: PlanAgentSettings,
        simulation: ClosedLoop<'a>,
    ) -> Self {
        let (code, oncoming_lane) = (
            HandedCode::default(),
            settings.environment.oncoming_lane == Some(true),
        );
        let agent = PlanAgent::new(name, CodeSource::Handed(code.clone()), settings).layered();
        Self {
            shadow: simulation,
            agent,
            code,
            oncoming_lane,
        }
    }

    /// Hands the best code over. Near the end of the recording the search looks no further than
    /// that; where it finds nothing, the agent takes the fixed code.
    fn search(&self) {
        let left = self.shadow.scenario().iterations() - 1 - self.shadow.iteration();
        let scene = self.shadow.scene();
        let graph = LaneGraph::build(&scene, DEFAULT_NODE_LENGTH).ok();
        let graph = graph.map(|graph| {
            if self.oncoming_lane {
                graph.with_oncoming_lane(&scene)
            } else {
                graph
            }
        });
        let tried = graph
            .map(|graph| search_ahead(&self.shadow, &graph, HORIZON.min(left)))
            .unwrap_or_default();
        self.code.hand(best(&tried).map(|best| best.code));
    }
}

impl Planner for OracleAgent<'_> {
    fn name(&self) -> &str {
        self.agent.name()
    }

    fn initialize(
        &mut self,
        initialization: &PlannerInitialization<'_>,
    ) -> Result<(), PlannerError> {
        self.agent.initialize(initialization)
    }

    fn compute_trajectory(&mut self, input: &PlannerInput<'_>) -> Result<Trajectory, PlannerError> {
        if self.agent.state().begins_with_call(&input.scene) {
            self.search();
        }
        let trajectory = self.agent.compute_trajectory(input)?;
        let name = self.agent.name().to_owned();
        let failed = |source| PlannerError::Failed {
            doing: "looking ahead",
            source: Box::new(source),
        };
        self.shadow.advance(&trajectory, &name).map_err(failed)?;
        Ok(trajectory)
    }

    fn calls(&self) -> &[PlanningCall] {
        self.agent.calls()
    }

    fn take_calls(&mut self) -> Vec<PlanningCall> {
        self.agent.take_calls()
    }
}
