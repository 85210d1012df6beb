//! A small nuPlan data set: an exported scene, written once and copied for each test.

use planagent_scenario::generator::{Spec, generate, types};
use planagent_scenario::nuplan::export::{ExportSettings, write_scenario};
use planagent_scenario::nuplan::{
    LogScenario, Logs, MapStore, NuPlanError, ScenarioFilter, SearchResult, Token, open, search,
};
use planagent_scenario::{DataRoots, Scenario};
use rusqlite::Connection;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use tempfile::TempDir;

/// Name of the map.
pub(super) const LOCATION: &str = "test-town";

struct Written {
    folder: TempDir,
    token: Token,
}

fn written() -> &'static Written {
    static WRITTEN: OnceLock<Written> = OnceLock::new();
    WRITTEN.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let scenario = generate(&Spec::new(types::changing_lane::TYPE, 0)).unwrap();
        let settings = ExportSettings {
            location: Some(LOCATION.to_owned()),
            ..ExportSettings::default()
        };
        let exported = write_scenario(&scenario, &folder.path().join("out"), &settings).unwrap();
        Written {
            token: exported.logs[0].token.parse().unwrap(),
            folder,
        }
    })
}

/// A copy of the data set that a test may change.
pub(super) struct DataSet {
    pub(super) folder: TempDir,
    pub(super) log: PathBuf,
    pub(super) map: PathBuf,
    pub(super) token: Token,
}

impl DataSet {
    pub(super) fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        copy(&written().folder.path().join("out"), folder.path());
        let mut logs = std::fs::read_dir(folder.path().join("data")).unwrap();
        let log = logs.next().unwrap().unwrap().path();
        let map = folder
            .path()
            .join("maps")
            .join(LOCATION)
            .join("1.0")
            .join("map.gpkg");
        assert!(map.is_file());
        Self {
            folder,
            log,
            map,
            token: written().token,
        }
    }

    pub(super) fn log_with(sql: &str) -> Self {
        let set = Self::new();
        run(&set.log, sql);
        set
    }

    pub(super) fn map_with(sql: &str) -> Self {
        let set = Self::new();
        run(&set.map, sql);
        set
    }

    pub(super) fn roots(&self) -> DataRoots {
        DataRoots {
            data: Some(self.folder.path().join("data")),
            maps: Some(self.folder.path().join("maps")),
        }
    }

    pub(super) fn maps(&self) -> MapStore {
        MapStore::with_cache(self.roots().maps, Some(self.folder.path().join("cache")))
    }

    pub(super) fn find(&self, filter: &ScenarioFilter) -> Result<SearchResult, NuPlanError> {
        let logs = Logs::under(&self.folder.path().join("data"))?;
        search(&logs.logs, filter, &self.maps(), &|_, _| {})
    }

    /// The exported scenario, found by its token.
    pub(super) fn found(&self) -> Result<LogScenario, NuPlanError> {
        let filter = ScenarioFilter {
            scenario_tokens: Some(vec![self.token]),
            ..ScenarioFilter::default()
        };
        let findings = self.find(&filter)?;
        assert_eq!(findings.excluded, [], "the exported token is a scenario");
        Ok(findings
            .scenarios
            .into_iter()
            .next()
            .expect("the exported token is in the log"))
    }

    pub(super) fn open(&self) -> Result<Scenario, NuPlanError> {
        open(&self.maps(), &self.found()?)
    }

    /// The error of opening the scenario.
    pub(super) fn error(&self) -> String {
        match self.open() {
            Ok(_) => panic!("the broken data set opens"),
            Err(error) => error.to_string(),
        }
    }

    /// Asserts that the error contains all parts.
    pub(super) fn assert_error_has(&self, parts: &[&str]) {
        let error = self.error();
        for part in parts {
            assert!(error.contains(part), "`{part}` is not in: {error}");
        }
    }
}

/// Runs SQL on a database.
pub(super) fn run(path: &Path, sql: &str) {
    let connection = Connection::open(path).unwrap();
    connection.execute_batch(sql).unwrap();
}

fn copy(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).unwrap();
    for entry in std::fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        let target = to.join(entry.file_name());
        if entry.path().is_dir() {
            copy(&entry.path(), &target);
        } else {
            std::fs::copy(entry.path(), target).unwrap();
        }
    }
}
