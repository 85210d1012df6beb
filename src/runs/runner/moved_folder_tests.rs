//! A run whose folder goes away: it stops, and what was completed is where the folder is.

use super::config::Config;
use super::event::{Event, Listener, silent};
use super::request::Request;
use super::simulate::{resume, start};
use std::fs;
use std::path::Path;
use std::sync::Arc;

/// Scenarios of the run: more than end before the folder is missed.
const SCENARIOS: usize = 12;

fn request() -> Request {
    Request {
        splits: vec!["generated".to_owned()],
        limit: Some(SCENARIOS),
        planners: vec!["log-replay".to_owned()],
        ..Request::default()
    }
}

fn simulations(run: &Path) -> usize {
    fs::read_dir(run.join("simulations")).map_or(0, Iterator::count)
}

/// Starts a run, does something with its folder once a simulation ended, and gives the error.
fn disturbed(run: &Path, disturb: impl Fn() + Send + Sync + 'static) -> String {
    let once = std::sync::Once::new();
    let listener: Listener = Arc::new(move |event| {
        if matches!(event, Event::Ended { .. }) {
            once.call_once(&disturb);
        }
    });
    start(&request(), &Config::default(), Some(run), &listener)
        .unwrap_err()
        .to_string()
}

#[test]
fn a_run_whose_folder_is_moved_stops_and_is_resumed_where_it_is() {
    let work = tempfile::tempdir().unwrap();
    let [run, moved] = ["run", "moved"].map(|name| work.path().join(name));
    let (from, to) = (run.clone(), moved.clone());
    let error = disturbed(&run, move || fs::rename(&from, &to).unwrap());
    assert!(error.contains("was moved or deleted"), "{error}");
    assert!(!run.exists(), "a new folder took the place");
    let kept = simulations(&moved);
    assert!((1..SCENARIOS).contains(&kept), "{kept}");
    let config = Config::of_run(&moved).unwrap();
    let results = resume(&moved, &Request::default(), &config, &silent()).unwrap();
    assert_eq!(results.rows.len(), SCENARIOS);
}

#[test]
fn a_run_whose_folder_is_deleted_stops() {
    let work = tempfile::tempdir().unwrap();
    let run = work.path().join("run");
    let deleted = run.clone();
    // A simulation may be written at this moment.
    let error = disturbed(&run, move || {
        while deleted.exists() {
            let _ = fs::remove_dir_all(&deleted);
        }
    });
    assert!(error.contains("was moved or deleted"), "{error}");
    assert!(!run.exists(), "a new folder took the place");
}
