//! Words of the command line that name nuPlan scenarios, and splits.

use super::fixture::DataSet;
use planagent_runs::worker::split::split;
use planagent_scenario::nuplan::ScenarioFilter;
use planagent_scenario::{DataRoots, Readers};

fn found(word: &str, readers: &Readers) -> Vec<String> {
    readers
        .find(word)
        .unwrap()
        .iter()
        .map(ToString::to_string)
        .collect()
}

#[test]
fn logs_folders_and_tokens() {
    let set = DataSet::new();
    let readers = Readers::new(&set.roots());
    let log = set.log.display().to_string();
    let only = vec![format!("{log}#{}", set.token)];
    assert_eq!(found(&log, &readers), only);
    assert_eq!(found(&only[0], &readers), only);
    assert_eq!(
        found(
            &set.folder.path().join("data").display().to_string(),
            &readers
        ),
        only
    );
    let source = readers.find(&only[0]).unwrap().remove(0);
    assert_eq!(source.open().unwrap().id, set.token.to_string());
    let error = |word: String| readers.find(&word).unwrap_err().to_string();
    assert!(error(format!("{log}#12")).contains("'12' is no token"));
    assert!(error(format!("{log}#00000000000000aa")).contains("the log does not hold it"));
    assert!(
        error("nowhere.db".to_owned()).contains("there is no log nowhere.db; name it by its path")
    );
    assert!(
        error(set.folder.path().join("maps").display().to_string())
            .contains("no nuPlan logs (*.db)")
    );
    let untagged = DataSet::log_with("DELETE FROM scenario_tag");
    assert!(error(untagged.log.display().to_string()).contains("name one as FILE.db#TOKEN"));
}

#[test]
fn a_log_reports_how_many_of_its_scenarios_lie_too_close() {
    let set = DataSet::log_with(
        "DELETE FROM scenario_tag;
         INSERT INTO scenario_tag SELECT randomblob(8), token, 'behind_bike', NULL FROM lidar_pc;
         UPDATE lidar_pc SET scene_token = (SELECT token FROM scene ORDER BY name LIMIT 1 OFFSET 2);",
    );
    let rows = set
        .find(&ScenarioFilter::default())
        .unwrap()
        .scenarios
        .len();
    let readers = Readers::new(&set.roots());
    let taken = found(&set.log.display().to_string(), &readers).len();
    assert!(taken > 1 && taken < rows);
    let notes = readers.take_notes();
    assert_eq!(notes.len(), 1, "{notes:?}");
    assert!(
        notes[0].contains(&format!("{} tagged scenarios are left out", rows - taken)),
        "{notes:?}"
    );
    assert!(readers.take_notes().is_empty(), "reported once");
}

#[test]
fn a_split_reports_what_is_missing() {
    let set = DataSet::new();
    let readers = Readers::new(&set.roots());
    let file = set.folder.path().join("mine.yaml");
    let write = |tokens: &str| {
        std::fs::write(
            &file,
            format!("scenario_tokens:\n{tokens}log_names: ${{splitter.x}}\n"),
        )
        .unwrap();
    };
    let name = file.display().to_string();
    write(&format!("  - '{}'\n  - '00000000000000aa'\n", set.token));
    let searched = std::sync::atomic::AtomicUsize::new(0);
    let found = split(&name, &readers, &|done, all| {
        assert!(done <= all);
        searched.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
    })
    .unwrap();
    assert_eq!(searched.into_inner(), 1, "one log, counted once");
    assert_eq!(found.scenarios.len(), 1);
    let missing =
        format!("split {name}: 1 of 2 scenarios are missing; 1 in no log: 00000000000000aa");
    assert_eq!(found.missing.to_string(), missing);
    assert!(
        found.notes[0].contains("log_names refers to ${splitter.x}"),
        "{:?}",
        found.notes
    );
    write("  - '00000000000000aa'\n");
    let error = split(&name, &readers, &|_, _| {}).unwrap_err().to_string();
    assert!(
        error.contains("no scenario found") && error.contains("--data-root"),
        "{error}"
    );
    let error = split(&name, &Readers::new(&DataRoots::default()), &|_, _| {})
        .unwrap_err()
        .to_string();
    assert!(error.contains("NUPLAN_DATA_ROOT"), "{error}");
}
