//! A planner of one's own: registered by name from outside the crate, run, recorded and summarized
//! like those that are built in.

use planagent_agent::planner::{
    Planner, PlannerError, PlannerInitialization, PlannerInput, PlannerName, SimplePlanner,
};
use planagent_agent::planner_registry::{PlannerEntry, PlannerNeeds, PlannerRegistry};
use planagent_agent::simulation::Challenge;
use planagent_runs::report::{SimulationRow, Summary};
use planagent_runs::worker::run::{AgentParts, SimulationTask, run};
use planagent_scenario::generator;
use planagent_world::Trajectory;
use std::sync::Mutex;

/// Drives straight ahead at half the speed of nuPlan's simple planner.
struct Crawler(SimplePlanner);

impl Planner for Crawler {
    fn name(&self) -> &'static str {
        "crawler"
    }

    fn initialize(&mut self, _: &PlannerInitialization<'_>) -> Result<(), PlannerError> {
        Ok(())
    }

    fn compute_trajectory(&mut self, input: &PlannerInput<'_>) -> Result<Trajectory, PlannerError> {
        Ok(self.0.trajectory(input.scene.ego)?)
    }
}

#[test]
fn an_own_planner_is_run_and_recorded_by_its_name() {
    let name = PlannerName::new("crawler");
    let entry = PlannerEntry::new(
        name,
        "drives slowly straight ahead",
        PlannerNeeds::Nothing,
        |_| {
            Ok(Box::new(Crawler(SimplePlanner {
                max_velocity: 2.5,
                ..SimplePlanner::default()
            })))
        },
    );
    let parts = AgentParts {
        registry: PlannerRegistry::default().with(entry),
        ..AgentParts::default()
    };
    let planner = parts.registry.find("crawler").unwrap().name;
    let tasks = Challenge::CLOSED_LOOP.map(|challenge| SimulationTask {
        source: generator::DEFAULT.into(),
        planner,
        challenge,
    });
    let rows = Mutex::new(Vec::new());
    let outcome: Result<(), ()> = run(&tasks, &[0, 1], &parts, &|_| (), &|number, record| {
        rows.lock()
            .unwrap()
            .push(SimulationRow::new(number, &record));
        Ok(())
    });
    outcome.unwrap();
    let rows = rows.into_inner().unwrap();
    assert!(
        rows.iter()
            .all(|row| row.planner == "crawler" && row.error.is_none()),
        "{rows:?}"
    );
    let summary = Summary::new(0, None, &[], &rows);
    assert_eq!(summary.scenarios.len(), 2);
    assert!(
        summary
            .aggregates
            .iter()
            .any(|mean| mean.planner == "crawler" && mean.scenarios == 1)
    );
}

#[test]
fn an_unknown_planner_is_recorded_as_a_failure() {
    let source = generator::DEFAULT.into();
    let challenge = Challenge::NonReactive;
    let tasks = [SimulationTask {
        source,
        planner: PlannerName::new("crawler"),
        challenge,
    }];
    let outcome = run(
        &tasks,
        &[0],
        &AgentParts::default(),
        &|_| (),
        &|_, record| match record.outcome {
            Err(error) if error.contains("unknown planner 'crawler'") => Ok(()),
            outcome => Err(outcome.map(|_| ())),
        },
    );
    outcome.unwrap();
}
