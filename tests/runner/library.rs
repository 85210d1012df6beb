//! Runs and studies of a program that uses the library alone.

use planagent::planning::{
    PlannerEntry, PlannerName, PlannerNeeds, PlannerRegistry, SimplePlanner,
};
use planagent::runs::{Config, Event, Listener, Request, Studies, StudiesRequest, resume, start};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use tempfile::TempDir;

const SCENE: &str = "generated/changing_lane/3";
/// Another scene, which a limit leaves out.
const OTHER_SCENE: &str = "generated/stopping_with_lead/1";

#[test]
fn a_program_runs_its_own_planner_and_resumes_the_run() {
    let work = TempDir::new().unwrap();
    let own = PlannerEntry::new(
        PlannerName::new("mine"),
        "straight ahead",
        PlannerNeeds::Nothing,
        |_| Ok(Box::new(SimplePlanner::default())),
    );
    let request = Request {
        scenarios: vec![SCENE.to_owned()],
        planners: vec!["mine".to_owned(), "idm".to_owned()],
        registry: PlannerRegistry::default().with(own),
        ..Request::default()
    };
    let steps = Arc::new(AtomicUsize::new(0));
    let counter = Arc::clone(&steps);
    let listener: Listener = Arc::new(move |event| {
        if event == Event::Stepped {
            counter.fetch_add(1, Ordering::Relaxed);
        }
    });
    let (config, folder) = (Config::default(), work.path().join("run"));
    let results = start(&request, &config, Some(&folder), &listener).unwrap();
    assert_eq!(
        results
            .rows
            .iter()
            .map(|row| row.planner.as_str())
            .collect::<Vec<_>>(),
        ["mine", "idm"]
    );
    let simulated = steps.load(Ordering::Relaxed);
    assert!(simulated >= 300, "{simulated} steps");

    let resumed = resume(&folder, &request, &config, &listener).unwrap();
    assert_eq!(
        (&resumed.rows, &resumed.summary),
        (&results.rows, &results.summary)
    );
    assert_eq!(
        steps.load(Ordering::Relaxed),
        simulated,
        "a simulation was repeated"
    );
    // A program that lacks the planner still reads the results.
    let read = resume(&folder, &Request::default(), &config, &listener).unwrap();
    assert_eq!((read.rows, read.missing.len()), (resumed.rows, 0));
}

#[test]
fn a_program_writes_a_table_of_the_paper() {
    let work = TempDir::new().unwrap();
    let request = StudiesRequest {
        suites: vec!["recorded".to_owned()],
        scenarios: vec![SCENE.to_owned(), OTHER_SCENE.to_owned()],
        limit: Some(1),
        out: work.path().to_owned(),
        ..StudiesRequest::default()
    };
    let (config, listener): (Config, Listener) = (Config::default(), Arc::new(|_| ()));
    let mut studies = Studies::new(&request, &config, &listener).unwrap();
    let outcome = studies.simulate(["scenario-types"]).unwrap();
    assert!(outcome.failed.is_empty() && outcome.missing.is_empty());
    let results = work.path().join("scenario-types-limit-1/results.md");
    let text = std::fs::read_to_string(results).unwrap();
    assert!(
        text.contains("--limit 1 ") && text.contains("1 scene"),
        "{text}"
    );
}
