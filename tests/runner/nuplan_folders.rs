//! Folders of nuPlan logs as they come: recorded at one time, damaged, named twice, without maps,
//! moved.

use super::simulations;
use crate::cli::{planagent, read_json};
use arrow_array::cast::AsArray;
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use planagent_scenario::generator::{Spec, generate, types};
use planagent_scenario::nuplan::export::{ExportSettings, Exported, write_scenarios};
use rusqlite::Connection;
use serde_json::Value;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use tempfile::TempDir;

/// A working directory with logs of generated scenes in `nuplan/data`, all of one type and begun at
/// one time.
struct Work {
    folder: TempDir,
    exported: Exported,
}

impl Work {
    fn with(logs: u64) -> Self {
        let folder = TempDir::new().unwrap();
        let scenes: Vec<_> = (0..logs)
            .map(|seed| generate(&Spec::new(types::changing_lane::TYPE, seed)).unwrap())
            .collect();
        let exported = write_scenarios(
            &scenes,
            &folder.path().join("nuplan"),
            &ExportSettings::default(),
        )
        .unwrap();
        Self { folder, exported }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// The file of a log.
    fn log(&self, place: usize) -> PathBuf {
        self.exported
            .data
            .join(format!("{}.db", self.exported.logs[place].log))
    }

    /// Runs in a folder; exit code, stdout, stderr.
    fn run_in(&self, folder: &Path, words: &[&str]) -> (i32, String, String) {
        let mut program = planagent();
        program
            .args(words)
            .current_dir(folder)
            .env("PLANAGENT_CACHE", self.path("cache"));
        let output = program
            .env_remove("NUPLAN_DATA_ROOT")
            .env_remove("NUPLAN_MAPS_ROOT")
            .output()
            .unwrap();
        let text = |bytes: Vec<u8>| String::from_utf8(bytes).unwrap();
        (
            output.status.code().unwrap(),
            text(output.stdout),
            text(output.stderr),
        )
    }

    /// Simulates what `words` name with a quick planner, into the folder `run`.
    fn simulate(&self, words: &[&str]) -> (i32, String, String) {
        let flags = [
            "simulate",
            "--planner",
            "log-replay",
            "--maps-root",
            "nuplan/maps",
            "--out",
            "run",
        ];
        self.run_in(self.folder.path(), &[&flags[..], words].concat())
    }

    fn summary(&self) -> Value {
        read_json(&self.path("run/summary.json"))
    }
}

/// How many scenarios of logs a list names; what does not fit beside a name stands below it.
fn listed(stdout: &str) -> usize {
    stdout.lines().filter(|line| line.contains(".db#")).count()
}

fn change(log: &Path, sql: &str) {
    Connection::open(log).unwrap().execute_batch(sql).unwrap();
}

#[test]
fn logs_recorded_at_one_time_are_all_driven() {
    let work = Work::with(2);
    let (code, stdout, stderr) = work.simulate(&["--scenario", "nuplan/data"]);
    assert_eq!(code, 0, "{stderr}");
    assert_eq!(simulations(&work.path("run")).len(), 2, "{stdout}");
    assert!(!stderr.contains("left out"), "{stderr}");

    // A filter that says so itself means the clock, as the devkit does.
    fs::write(
        work.path("mine.yaml"),
        "scenario_types: [changing_lane]\ntimestamp_threshold_s: 15\n",
    )
    .unwrap();
    let list = [
        "scenarios",
        "list",
        "--data-root",
        "nuplan/data",
        "--split",
        "mine.yaml",
    ];
    let (code, stdout, stderr) = work.run_in(work.folder.path(), &list);
    assert_eq!((code, listed(&stdout)), (0, 1), "{stdout}{stderr}");

    // What nothing passes says which field of the filter took how much.
    fs::write(
        work.path("mine.yaml"),
        "scenario_types: [changing_lane]\nmap_names: [atlantis]\n",
    )
    .unwrap();
    let (code, _, stderr) = work.run_in(work.folder.path(), &list);
    assert!(
        code == 2 && stderr.contains("of 2 rows 2 were excluded by map_names"),
        "{stderr}"
    );
    fs::write(work.path("mine.yaml"), "log_names: [2021.06.09]\n").unwrap();
    let (code, _, stderr) = work.run_in(work.folder.path(), &list);
    assert!(
        code == 2 && stderr.contains("log_names names none of the 2 logs"),
        "{stderr}"
    );
    let lost = [
        "scenarios",
        "list",
        "--data-root",
        "nowhere",
        "--split",
        "mine.yaml",
    ];
    let (code, _, stderr) = work.run_in(work.folder.path(), &lost);
    assert!(
        code == 2
            && stderr.contains("--data-root")
            && stderr.contains("nowhere: cannot open: No such"),
        "{stderr}"
    );
}

#[test]
fn a_scenario_that_two_paths_reach_is_driven_once() {
    let work = Work::with(1);
    let log = work.log(0);
    let roundabout = format!(
        "nuplan/maps/../data/{}",
        log.file_name().unwrap().to_str().unwrap()
    );
    let link = work.path("link.db");
    std::os::unix::fs::symlink(&log, &link).unwrap();
    let words = [
        "--scenario",
        "nuplan/data",
        &roundabout,
        log.to_str().unwrap(),
        "link.db",
    ];
    let (code, _, stderr) = work.simulate(&words);
    assert_eq!(code, 0, "{stderr}");
    assert!(
        stderr.contains("3 scenarios are named more than once and simulated once"),
        "{stderr}"
    );
    assert_eq!(work.summary()["scenarios"].as_array().unwrap().len(), 1);
}

#[test]
fn a_damaged_log_among_others_is_a_failed_drive() {
    let work = Work::with(2);
    fs::write(
        work.exported.data.join("0000.db"),
        b"\x01\x02\x03 the end of a download",
    )
    .unwrap();
    change(&work.log(1), "UPDATE lidar_box SET x = NULL");
    let (code, _, stderr) = work.simulate(&["--scenario", "nuplan/data"]);
    assert_eq!(code, 1, "{stderr}");
    assert!(stderr.contains("2 of 3 simulations failed"), "{stderr}");
    let summary = work.summary();
    let row = |log: &str| {
        let rows = summary["scenarios"].as_array().unwrap();
        rows.iter()
            .find(|row| row["log_name"] == log)
            .unwrap_or_else(|| panic!("no {log} in {summary}"))
            .clone()
    };
    let damaged = row("0000");
    assert!(
        damaged["error"]
            .as_str()
            .unwrap()
            .contains("0000.db: not an SQLite database"),
        "{damaged}"
    );
    assert!(row(&work.exported.logs[0].log)["score"].is_number());
    // A scenario that cannot be opened keeps what the log says of it.
    let broken = row(&work.exported.logs[1].log);
    assert_eq!(
        (&broken["id"], &broken["scenario_type"]),
        (
            &work.exported.logs[1].token.as_str().into(),
            &"changing_lane".into()
        )
    );
    assert!(
        broken["error"]
            .as_str()
            .unwrap()
            .contains("column x is NULL"),
        "{broken}"
    );
    let report =
        File::open(work.path("run/closed_loop_nonreactive_agents/runner_report.parquet")).unwrap();
    let report = ParquetRecordBatchReaderBuilder::try_new(report)
        .unwrap()
        .build()
        .unwrap()
        .next()
        .unwrap()
        .unwrap();
    let logs = report
        .column_by_name("log_name")
        .unwrap()
        .as_string::<i32>();
    assert!(
        logs.iter()
            .flatten()
            .any(|log| log == work.exported.logs[1].log),
        "{logs:?}"
    );

    let (code, stdout, stderr) =
        work.run_in(work.folder.path(), &["scenarios", "list", "nuplan/data"]);
    assert_eq!((code, listed(&stdout)), (1, 2), "{stdout}");
    assert!(
        stderr.contains("error:") && stderr.contains("0000.db"),
        "{stderr}"
    );
    // A list of tokens that the other logs hold whole does not need it.
    let split = |tokens: &[&str]| {
        fs::write(
            work.path("mine.yaml"),
            format!("scenario_tokens: {tokens:?}\n"),
        )
        .unwrap();
        let flags = [
            "scenarios",
            "list",
            "--split",
            "mine.yaml",
            "--data-root",
            "nuplan/data",
        ];
        let (code, stdout, stderr) = work.run_in(work.folder.path(), &flags);
        (code, listed(&stdout), stderr)
    };
    let tokens: Vec<&str> = work
        .exported
        .logs
        .iter()
        .map(|log| log.token.as_str())
        .collect();
    let (code, listed, stderr) = split(&tokens);
    assert!(
        (code, listed) == (0, 2) && stderr.contains("passed over") && stderr.contains("0000.db"),
        "{stderr}"
    );
    let (code, listed, stderr) = split(&[tokens[0], "00000000000000ff"]);
    assert!(
        (code, listed) == (1, 1) && stderr.contains("error:") && stderr.contains("0000.db"),
        "{stderr}"
    );
    let (code, _, stderr) = split(&["00000000000000ff"]);
    assert!(
        code == 2 && stderr.contains("1 logs cannot be read") && stderr.contains("0000.db"),
        "{stderr}"
    );
    // Alone it is bad input.
    let (code, _, stderr) = work.run_in(
        work.folder.path(),
        &["simulate", "--scenario", "nuplan/data/0000.db"],
    );
    assert!(
        code == 2 && stderr.contains("0000.db: not an SQLite database"),
        "{stderr}"
    );
}

#[test]
fn files_that_are_no_logs_are_passed_over() {
    let work = Work::with(1);
    let write = |name: &str, bytes: &[u8]| {
        fs::write(work.exported.data.join(name), bytes).unwrap();
    };
    // What macOS and Windows leave, and the page of an error.
    write(
        "._0000.db",
        b"\x00\x05\x16\x07\x00\x02\x00\x00Mac OS X        ",
    );
    write(".DS_Store", b"\x00\x00\x00\x01Bud1");
    let (code, _, stderr) = work.simulate(&["--scenario", "nuplan/data"]);
    assert_eq!(code, 0, "{stderr}");
    assert!(!stderr.contains("passed over"), "{stderr}");
    write("Thumbs.db", b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1");
    write("0000.db", b"<html>404: not found</html>");
    let (code, stdout, stderr) =
        work.run_in(work.folder.path(), &["scenarios", "list", "nuplan/data"]);
    assert_eq!((code, listed(&stdout)), (0, 1), "{stderr}");
    assert!(
        stderr.contains("2 files are passed over") && stderr.contains("it is a web page"),
        "{stderr}"
    );
    // By its own name it is bad input.
    let (code, _, stderr) = work.run_in(
        work.folder.path(),
        &["simulate", "--scenario", "nuplan/data/0000.db"],
    );
    assert!(
        code == 2 && stderr.contains("0000.db: not an SQLite database: it is a web page"),
        "{stderr}"
    );
}

#[test]
fn missing_maps_are_one_error_before_any_drive() {
    let work = Work::with(2);
    let refusal = |maps: &[&str]| {
        let flags = [
            "simulate",
            "--scenario",
            "nuplan/data",
            "--planner",
            "log-replay",
            "--out",
            "run",
        ];
        let (code, stdout, stderr) = work.run_in(work.folder.path(), &[&flags[..], maps].concat());
        assert!(
            code == 2 && stdout.is_empty() && stderr.matches("error:").count() == 1,
            "{stderr}"
        );
        assert!(!work.path("run").exists(), "nothing was begun");
        stderr
    };
    assert!(refusal(&[]).contains("NUPLAN_MAPS_ROOT"));
    let wrong = refusal(&["--maps-root", "nuplan/data"]);
    assert!(
        wrong.contains("nuplan-maps-v1.0.json: cannot open: No such")
            && wrong.contains("--maps-root"),
        "{wrong}"
    );
    fs::remove_dir_all(work.exported.maps.join(&work.exported.logs[0].location)).unwrap();
    let gone = refusal(&["--maps-root", "nuplan/maps"]);
    assert!(gone.contains("map.gpkg: missing"), "{gone}");
}

#[test]
fn a_run_is_resumed_from_any_directory_and_shows_its_results_without_its_data() {
    let work = Work::with(2);
    let (code, table, stderr) = work.simulate(&["--scenario", "nuplan/data"]);
    assert_eq!(code, 0, "{stderr}");
    let summary = fs::read(work.path("run/summary.json")).unwrap();
    let (elsewhere, run) = (TempDir::new().unwrap(), work.path("run"));
    let resume = || {
        work.run_in(
            elsewhere.path(),
            &["simulate", "--resume", run.to_str().unwrap()],
        )
    };

    let (code, stdout, stderr) = resume();
    assert_eq!((code, &stdout), (0, &table), "{stderr}");
    assert!(
        stderr.contains("2 of 2 simulations are completed, 0 are left"),
        "{stderr}"
    );

    let moved = work.path("moved");
    fs::rename(work.path("nuplan"), &moved).unwrap();
    let (code, stdout, stderr) = resume();
    assert_eq!((code, &stdout), (0, &table), "{stderr}");
    assert!(
        stderr.contains("only its results are shown") && stderr.contains("nuplan/data"),
        "{stderr}"
    );
    assert_eq!(fs::read(work.path("run/summary.json")).unwrap(), summary);

    // Only its results can be shown: every other request needs the data, and so does a simulation
    // that is left.
    let retry = [
        "simulate",
        "--retry-failed",
        "--resume",
        run.to_str().unwrap(),
    ];
    assert_eq!(work.run_in(elsewhere.path(), &retry).0, 2);
    fs::remove_dir_all(&simulations(&run)[1]).unwrap();
    let (code, stdout, stderr) = resume();
    assert!(code == 2 && stdout.is_empty(), "{stdout}");
    let missing = work.path("nuplan/data");
    assert!(
        stderr.contains("1 of 2 simulations completed")
            && stderr.contains(missing.to_str().unwrap()),
        "{stderr}"
    );
    fs::rename(&moved, work.path("nuplan")).unwrap();
    let (code, _, stderr) = resume();
    assert_eq!(code, 0, "{stderr}");
    assert_eq!(fs::read(work.path("run/summary.json")).unwrap(), summary);
}
