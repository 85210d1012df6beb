//! The controls as a run builds them.

use crate::{entries, search};
use planagent_agent::environment::{DEFAULT_NODE_LENGTH, LaneGraph};
use planagent_agent::planner::{PlanAgentSettings, PlannerInitialization, PlannerInput};
use planagent_agent::planner_registry::{PlannerEntry, PlannerNeeds, PlannerParts};
use planagent_agent::reasoning::PlannerAnswer;
use planagent_agent::simulation::{Challenge, ClosedLoop};
use planagent_scenario::generator::{Spec, generate, types};
use planagent_scenario::{HeldScenario, Scenario};
use planagent_score::pdm::PdmMemory;
use std::sync::Arc;

fn scenario() -> Arc<Scenario> {
    Arc::new(generate(&Spec::new(types::changing_lane::TYPE, 3)).unwrap())
}

pub(crate) fn simulation() -> ClosedLoop<'static> {
    ClosedLoop::new(HeldScenario::Shared(scenario()), Challenge::Reactive).unwrap()
}

fn parts<'a>(
    entry: &PlannerEntry,
    settings: &'a PlanAgentSettings,
    simulation: Option<&'a ClosedLoop<'static>>,
) -> PlannerParts<'a> {
    PlannerParts {
        name: entry.name,
        settings,
        model: None,
        recording: &[],
        simulation,
        shuffled_bev: None,
    }
}

#[test]
fn every_control_is_built_and_makes_its_first_plan() {
    let (ahead, mut settings) = (simulation(), PlanAgentSettings::default());
    // No score reaches it, so LLM-ASSIST asks at once too.
    settings.reflection.threshold = 1.01;
    for entry in entries() {
        let mut planner = entry
            .build(&parts(&entry, &settings, Some(&ahead)))
            .unwrap();
        let scene = ahead.scene();
        let initialization = PlannerInitialization {
            map: &ahead.scenario().map,
            route: scene.route,
        };
        planner.initialize(&initialization).unwrap();
        let input = PlannerInput {
            iteration: 0,
            scene,
        };
        planner.compute_trajectory(&input).unwrap();
        let attempts = &planner.calls()[0].attempts;
        assert!(!attempts.is_empty(), "{}", entry.name);
        assert!(
            attempts.iter().all(|attempt| attempt.answer.is_some()),
            "{}",
            entry.name
        );
    }
}

#[test]
fn the_oracle_says_that_it_needs_a_simulation() {
    let entry = entries()
        .find(|entry| entry.needs == PlannerNeeds::Simulation)
        .unwrap();
    let settings = PlanAgentSettings::default();
    let error = entry.build(&parts(&entry, &settings, None)).err().unwrap();
    assert!(
        error.to_string().contains("a simulation to look ahead in"),
        "{error}"
    );
}

/// Labels say what a code is worth: they must not be of plans that no agent drives. The score that a
/// plan needs may differ, since the agent asks for more where it could leave its lane.
#[test]
fn the_search_scores_and_drives_a_code_as_the_agent_does() {
    let (mut agents, settings) = (simulation(), PlanAgentSettings::default());
    let entry = entries().find(|entry| entry.name.as_str() == "fixed-code");
    let entry = entry.unwrap();
    let mut planner = entry
        .build(&parts(&entry, &settings, Some(&agents)))
        .unwrap();
    agents.initialize(planner.as_mut()).unwrap();
    let trajectory = agents.plan(planner.as_mut()).unwrap();
    let attempt = &planner.calls()[0].attempts[0];
    let Some(PlannerAnswer::Code(code)) = attempt.answer else {
        panic!("the control writes a code");
    };

    let mut searched = simulation();
    let graph = LaneGraph::build(&searched.scene(), DEFAULT_NODE_LENGTH).unwrap();
    let found = search::attempt(&searched, &graph, code).unwrap();
    let judged = attempt.reflection.as_ref().unwrap();
    assert_eq!(
        (found.reflection.score, found.reflection.parts),
        (judged.score, judged.parts)
    );
    assert_eq!(found.reflection.states, judged.states);

    let plan = search::planner(&searched, &graph, code).unwrap();
    search::follow(&mut searched, &plan, &mut PdmMemory::default(), 1).unwrap();
    agents.advance(&trajectory, "agent").unwrap();
    assert_eq!(searched.present().ego, agents.present().ego);
}
