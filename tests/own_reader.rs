//! A scenario reader from outside the crate: its scenarios are found and simulated as those of the
//! package.

use planagent_agent::planner::PlannerName;
use planagent_agent::simulation::Challenge;
use planagent_runs::worker::run::{self as runner, AgentParts, SimulationTask};
use planagent_scenario::generator::{self, Spec};
use planagent_scenario::{DataRoots, ReaderError, Readers, Scenario, ScenarioReader, ScenarioRef};
use std::sync::Mutex;

/// Takes words of the form `mirror:generated/TYPE/SEED`.
struct MirrorReader;

impl ScenarioReader for MirrorReader {
    fn recognizes(&self, word: &str) -> bool {
        word.starts_with("mirror:")
    }

    fn list(&self, word: &str) -> Result<Vec<ScenarioRef>, ReaderError> {
        let spec: Spec = word
            .trim_start_matches("mirror:")
            .parse()
            .map_err(ReaderError::new)?;
        let open = move || {
            let scenario = generator::generate(&spec).map_err(ReaderError::new)?;
            Ok(Scenario {
                id: format!("mirror-{}", spec.seed),
                log_name: "mirror".to_owned(),
                ..scenario
            })
        };
        Ok(vec![ScenarioRef::new(word, open).with_log_name("mirror")])
    }

    fn absolute_word(&self, word: &str) -> String {
        word.to_owned()
    }
}

#[test]
fn a_reader_from_outside_is_one_type_and_one_line() {
    let readers = Readers::new(&DataRoots::default()).with(MirrorReader);
    let found = readers.find("mirror:generated/changing_lane/2").unwrap();
    assert_eq!(
        found.iter().map(ToString::to_string).collect::<Vec<_>>(),
        ["mirror:generated/changing_lane/2"]
    );
    assert_eq!(readers.absolute_word("mirror:x"), "mirror:x");
    assert!(
        readers
            .find("mirror:x")
            .unwrap_err()
            .to_string()
            .contains("does not name a generated scenario")
    );
    assert_eq!(
        readers.find("generated/changing_lane/2").unwrap()[0].id(),
        Some("generated/changing_lane/2")
    );
    let task = SimulationTask {
        source: found[0].clone(),
        planner: PlannerName::new("simple"),
        challenge: Challenge::NonReactive,
    };
    let record = Mutex::new(None);
    let outcome: Result<(), ()> = runner::run(
        &[task],
        &[0],
        &AgentParts::default(),
        &|_| (),
        &|_, done| {
            *record.lock().unwrap() = Some(done);
            Ok(())
        },
    );
    outcome.unwrap();
    let record = record.into_inner().unwrap().unwrap();
    assert_eq!(
        (record.scenario.as_str(), record.log_name.as_str()),
        ("mirror-2", "mirror")
    );
    assert!(record.outcome.unwrap().score.value >= 0.0);
}
