//! What stands in a model's place: the best answer of a form, tried out in the simulation itself. No
//! model does better by this form, as far as the search tells.

use crate::agent::ChatAgent;
use crate::planner::{Handed, LanguagePlanner, Source};
use crate::waypoints::SPACING_STEPS;
use planagent_agent::environment::{DEFAULT_NODE_LENGTH, LaneGraph};
use planagent_agent::planner::{PlanAgentSettings, Planner, PlannerError, ReflectionSettings};
use planagent_agent::planner_registry::PlannerEntry;
use planagent_agent::reasoning::{SeenPlace, WaypointList};
use planagent_agent::simulation::ClosedLoop;
use planagent_controls::foresight::{self, Foresight};
use planagent_controls::search::{Candidate, best, search_ahead};
use planagent_controls::trial::horizon;
use planagent_world::{HistorySample, SceneView};

/// Finds the best answer at the present of a simulation.
pub(crate) type Find<A> = fn(&ClosedLoop<'static>, &A) -> Option<<A as ChatAgent>::Answer>;

/// An agent whose answers come from a search.
struct AnswerOracle<A: ChatAgent> {
    planner: LanguagePlanner<A>,
    handed: Handed<A::Answer>,
    find: Find<A>,
}

/// The planner of a name.
pub(crate) fn entry<A: ChatAgent + 'static>(
    name: &'static str,
    summary: &'static str,
    agent: impl Fn(&PlanAgentSettings) -> Result<A, PlannerError> + Send + Sync + 'static,
    find: Find<A>,
) -> PlannerEntry {
    foresight::entry(name, summary, move |parts| {
        let handed = Handed::default();
        let source = Source::Handed(handed.clone());
        let agent = agent(parts.settings)?;
        Ok(AnswerOracle {
            planner: LanguagePlanner::new(parts.name, agent, source, parts.settings.clone()),
            handed,
            find,
        })
    })
}

impl<A: ChatAgent> Foresight for AnswerOracle<A> {
    fn planner(&self) -> &dyn Planner {
        &self.planner
    }

    fn planner_mut(&mut self) -> &mut dyn Planner {
        &mut self.planner
    }

    fn begins_with_call(&self, scene: &SceneView<'_>) -> bool {
        self.planner.begins_with_call(scene)
    }

    fn look_ahead(&mut self, simulation: &ClosedLoop<'static>, _: &[HistorySample]) {
        let found = (self.find)(simulation, self.planner.agent());
        self.handed.hand(found);
    }
}

/// Where the best planner code of a search leads in the roll-out of its plan.
pub(crate) fn best_waypoints<A>(simulation: &ClosedLoop<'static>, _: &A) -> Option<WaypointList> {
    let scene = simulation.scene();
    let graph = LaneGraph::build(&scene, DEFAULT_NODE_LENGTH).ok()?;
    let reflection = ReflectionSettings::default();
    let tried = search_ahead(simulation, &graph, &reflection, horizon(simulation));
    waypoints_of(simulation, best(&tried)?)
}

/// Where a planner code leads in the roll-out of its plan from the present.
pub(crate) fn waypoints_of(simulation: &ClosedLoop<'_>, code: &Candidate) -> Option<WaypointList> {
    let states = &code.reflection.states;
    let from = simulation.scene().ego.center();
    let seen = |waypoint: usize| {
        let state = states.get((waypoint + 1) * SPACING_STEPS)?;
        let place = from.to_local(state.center().position());
        Some(SeenPlace {
            right: -place.y,
            ahead: place.x,
        })
    };
    let [a, b, c, d, e, f] = std::array::from_fn(seen);
    Some(WaypointList([a?, b?, c?, d?, e?, f?]))
}
