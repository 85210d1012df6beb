//! The run that commands take where none is named.

use super::error::{ReportError, ReportFault};
use super::layout::{MANIFEST, RUNS, SUMMARY};
use super::limits::{MAX_MANIFEST_BYTES, MAX_SUMMARY_BYTES};
use super::run_files::{RunFiles, read_toml};
use serde::Deserialize;
use std::cmp::Reverse;
use std::fs;
use std::path::{Path, PathBuf};

/// The part of a manifest that says when the run started.
#[derive(Deserialize)]
struct Started {
    started: String,
}

/// The part of a summary that says what failed.
#[derive(Deserialize)]
struct Outcomes {
    scenarios: Vec<Outcome>,
}

#[derive(Deserialize)]
struct Outcome {
    succeeded: bool,
}

/// The run of `runs/` that started last, without those in which every simulation failed.
///
/// # Errors
/// When there is none.
pub fn last_run() -> Result<PathBuf, ReportError> {
    last_run_of(Path::new(RUNS))
}

/// The same of another folder.
///
/// # Errors
/// As [`last_run`].
pub fn last_run_of(runs: &Path) -> Result<PathBuf, ReportError> {
    let entries = fs::read_dir(runs).into_iter().flatten().flatten();
    let paths = entries.map(|entry| entry.path());
    let started = |path: &Path| {
        let files = RunFiles::open(path).ok()?;
        let manifest: Started = read_toml(files.root(), MANIFEST, MAX_MANIFEST_BYTES).ok()?;
        Some(manifest.started)
    };
    // Runs of one second are ordered by their names, which count up.
    let mut known: Vec<_> = paths
        .filter_map(|path| Some((started(&path)?, path)))
        .collect();
    known.sort_by_key(|run| Reverse(run.clone()));
    let paths: Vec<PathBuf> = known.into_iter().map(|(_, path)| path).collect();
    let Some(last) = paths.first().cloned() else {
        return Err(ReportError::at(runs)(ReportFault::NoRuns));
    };
    let shown = paths.into_iter().find(|path| !has_only_failures(path));
    shown.ok_or_else(|| ReportError::at(runs)(ReportFault::OnlyFailures { last }))
}

/// Whether a complete run has simulations, and every one failed. A run that goes on has no summary.
fn has_only_failures(run: &Path) -> bool {
    let read = |files: RunFiles| files.root().read(SUMMARY, MAX_SUMMARY_BYTES).ok();
    let outcomes = RunFiles::open(run)
        .ok()
        .and_then(read)
        .and_then(|text| serde_json::from_slice::<Outcomes>(&text).ok());
    outcomes.is_some_and(|Outcomes { scenarios }| {
        !scenarios.is_empty() && scenarios.iter().all(|one| !one.succeeded)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn run(runs: &Path, name: &str, started: &str, succeeded: Option<&[bool]>) {
        let folder = runs.join(name);
        fs::create_dir_all(&folder).unwrap();
        fs::write(
            folder.join(MANIFEST),
            format!("format_version = 1\nstarted = '{started}'\n"),
        )
        .unwrap();
        if let Some(all) = succeeded {
            let scenarios: Vec<_> = all.iter().map(|one| json!({"succeeded": one})).collect();
            let summary = json!({ "scenarios": scenarios });
            fs::write(folder.join(SUMMARY), summary.to_string()).unwrap();
        }
    }

    #[test]
    fn a_run_without_a_success_is_not_the_last_one() {
        let work = tempfile::tempdir().unwrap();
        let runs = work.path();
        let error = last_run_of(&runs.join("none")).unwrap_err().to_string();
        assert!(error.contains("there is no run"), "{error}");
        run(runs, "0003", "2026-01-02", Some(&[false, false]));
        let error = last_run_of(runs).unwrap_err().to_string();
        assert!(
            error.contains("every simulation failed") && error.contains("0003"),
            "{error}"
        );
        run(runs, "0001", "2026-01-01", Some(&[false, true]));
        assert_eq!(last_run_of(runs).unwrap(), runs.join("0001"));
        // One that goes on, and one of an empty shard, have no failures.
        run(runs, "0004", "2026-01-03", None);
        assert_eq!(last_run_of(runs).unwrap(), runs.join("0004"));
        run(runs, "0005", "2026-01-03", Some(&[]));
        assert_eq!(last_run_of(runs).unwrap(), runs.join("0005"));
    }
}
