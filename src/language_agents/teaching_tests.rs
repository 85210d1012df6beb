//! What teachers write, read back by their agents.

use crate::teaching::SearchedState;
use crate::tests::{Stub, default_scene, drive};
use crate::{taught_agents, teacher};
use planagent_agent::environment::{DEFAULT_NODE_LENGTH, LaneGraph};
use planagent_agent::planner::{Decision, PlanAgentSettings};
use planagent_agent::simulation::{Challenge, ClosedLoop};
use planagent_controls::search;
use planagent_scenario::HeldScenario;
use std::sync::Arc;

#[test]
fn an_agent_asks_what_its_teacher_answers_and_carries_the_answer_out() {
    let scenario = default_scene();
    let held = HeldScenario::Shared(Arc::new(scenario.clone()));
    let simulation = ClosedLoop::new(held, Challenge::Reactive).unwrap();
    let graph = LaneGraph::build(&simulation.scene(), DEFAULT_NODE_LENGTH).unwrap();
    let tried = search::search(&simulation, &graph);
    let state = SearchedState {
        simulation: &simulation,
        graph: &graph,
        best: search::best(&tried).unwrap(),
    };
    for name in taught_agents() {
        let teacher = teacher(name).unwrap().unwrap();
        assert_eq!(teacher.name(), name);
        let taught = teacher.teach(state).unwrap().unwrap();
        assert!(!taught.system.is_empty());
        let answer = taught.answer.clone();
        let model = Stub::new(move |_, _| answer.clone());
        let settings = PlanAgentSettings::default();
        let (calls, _) = drive(
            name,
            Some(model.clone()),
            &scenario,
            Challenge::Reactive,
            &settings,
        );
        let first = &calls[0];
        assert_eq!(first.decision, Decision::Execute(0), "{first:?}");
        assert!(first.attempts[0].errors.is_empty(), "{first:?}");
        assert_eq!(model.asked.lock().unwrap()[0].0, taught.prompt);
        assert!(!taught.answer.contains("-0.00"), "{}", taught.answer);
    }
    assert!(teacher("agent-driver").unwrap().is_none());
}
