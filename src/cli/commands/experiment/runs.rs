//! The runs that experiments are made of. Each has a folder of its own, named by everything that determines it, so that
//! experiments share what is the same to them and go on with what was begun.

use super::suites::Suite;
use crate::cli::commands::simulate::selection::tasks;
use crate::cli::model::{self, Opened};
use crate::cli::progress::SimulationProgress;
use crate::cli::{Config, MllmConfig, Printer, drives};
use crate::experiment::run::{AgentParts, SimulationTask};
use crate::experiment::study::Variant;
use crate::planner::{PlannerNeeds, PlannerRegistry};
use crate::report::{FORMAT_VERSION, MANIFEST, Manifest, RunFolder, SUMMARY, ScenarioList, SimulationRow, stamp};
use crate::simulation::Challenge;
use anyhow::Context;
use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime};

/// Characters of the digest in a run's name.
const DIGEST: usize = 12;
/// What is said of a model whose weights are not on this machine.
const NO_WEIGHTS: &str = "no weights";

/// The runs of a session, by name.
pub(super) struct Runs<'a> {
    folder: PathBuf,
    config: &'a Config,
    printer: Printer,
    /// BLAKE3 of the program: another one may drive otherwise.
    program: String,
    models: BTreeMap<String, Opened>,
    by_name: BTreeMap<String, Run>,
}

/// A planner on a suite.
pub(super) struct Run {
    manifest: Manifest,
    tasks: Vec<SimulationTask>,
    agent: AgentParts,
    /// Parameters of its model.
    parameters: Option<u64>,
    /// Open while there is something to do.
    folder: Option<RunFolder>,
    /// Drives to be made.
    todo: Vec<usize>,
    /// Drives that are made,
    rows: Vec<SimulationRow>,
    /// so many of them in this session.
    made: usize,
    /// Time that its model took to load, seconds.
    load_s: Option<f64>,
}

impl<'a> Runs<'a> {
    /// Runs in a folder, by the variants' settings laid over a configuration.
    ///
    /// # Errors
    /// When the program cannot be read.
    pub(super) fn new(folder: PathBuf, config: &'a Config, printer: Printer) -> anyhow::Result<Self> {
        let path = std::env::current_exe().context("cannot find this program, which is part of what names a run")?;
        let mut hasher = blake3::Hasher::new();
        let hashed = std::fs::File::open(&path).and_then(|file| hasher.update_reader(file).map(|_| ()));
        hashed.with_context(|| format!("cannot read {}", path.display()))?;
        let program = hasher.finalize().to_hex().to_string();
        Ok(Self { folder, config, printer, program, models: BTreeMap::new(), by_name: BTreeMap::new() })
    }

    /// Takes up the run of a variant on a suite and gives its name; without one, why the variant cannot drive.
    ///
    /// # Errors
    /// When its settings or its model cannot be used.
    pub(super) fn add(&mut self, suite: &Suite, variant: &Variant) -> anyhow::Result<Result<String, &'static str>> {
        let planner = variant.planner;
        let planners = PlannerRegistry::default();
        let entry = planners.find(planner.as_str())?;
        let asked = self.config.overlaid(variant.settings)?;
        let loaded = match entry {
            entry if !entry.needs_model() => None,
            _ if !self.has_weights(&asked)? => return Ok(Err(NO_WEIGHTS)),
            _ => Some(self.model(&asked)?.asked(&asked)?),
        };
        let model = loaded.as_ref().map(|loaded| toml::Table::try_from(&loaded.about)).transpose()?;
        let agent = model::parts(&asked, loaded.as_ref());
        let manifest = Manifest {
            format_version: FORMAT_VERSION,
            planagent: env!("CARGO_PKG_VERSION").to_owned(),
            started: stamp(SystemTime::now()),
            planners: vec![planner.to_string()],
            challenges: Challenge::CLOSED_LOOP.iter().map(ToString::to_string).collect(),
            scenarios: suite.list.clone(),
            model,
            config: toml::Table::try_from(effective(asked, entry.needs))?,
        };
        let digest = ScenarioList::digest([&self.program, &manifest.digest()]);
        let name = format!("{planner}-{}-{}", suite.name, digest.get(..DIGEST).unwrap_or(&digest));
        self.by_name.entry(name.clone()).or_insert_with(|| Run {
            manifest,
            tasks: tasks(&suite.sources, &[planner], &Challenge::CLOSED_LOOP),
            load_s: loaded.as_ref().map(|loaded| loaded.load_s),
            parameters: loaded.as_ref().map(|loaded| loaded.about.parameters),
            agent,
            folder: None,
            todo: Vec::new(),
            rows: Vec::new(),
            made: 0,
        });
        Ok(Ok(name))
    }

    /// Whether the weights of a variant's own model are on this machine. The model that the user configured is not asked: if
    /// it cannot be used, that is an error.
    fn has_weights(&self, config: &Config) -> anyhow::Result<bool> {
        if config.mllm.model == self.config.mllm.model {
            return Ok(true);
        }
        let registry = model::registry(config, self.printer);
        let spec = registry.find(&config.mllm.model)?;
        Ok(registry.place_here(&spec).and_then(|place| place.weight_bytes()).is_ok())
    }

    /// The model of a configuration; each is loaded once.
    fn model(&mut self, config: &Config) -> anyhow::Result<&Opened> {
        let key = toml::to_string(&config.mllm)?;
        Ok(match self.models.entry(key) {
            Entry::Occupied(entry) => entry.into_mut(),
            Entry::Vacant(entry) => entry.insert(model::open(config, self.printer)?),
        })
    }

    /// Opens the folders of all runs and sees what is left to be made.
    ///
    /// # Errors
    /// When a folder cannot be used, or another process is at it.
    pub(super) fn open(&mut self, retry_failed: bool) -> anyhow::Result<()> {
        for (name, run) in &mut self.by_name {
            run.open(&self.folder.join(name), retry_failed, self.printer)?;
        }
        Ok(())
    }

    /// Drives that are made, and drives that are left.
    pub(super) fn drives(&self) -> (usize, usize) {
        let left = self.by_name.values().map(|run| run.todo.len()).sum();
        (self.by_name.values().map(|run| run.tasks.len()).sum::<usize>() - left, left)
    }

    /// How many runs there are.
    pub(super) fn count(&self) -> usize {
        self.by_name.len()
    }

    /// Makes the first drives of those runs of which no time is known.
    ///
    /// # Errors
    /// When a drive cannot be written.
    pub(super) fn measure(&mut self) -> anyhow::Result<()> {
        let unknown = || |run: &&mut Run| run.seconds_per_drive().is_none() && !run.todo.is_empty();
        let total = self.by_name.values_mut().filter(unknown()).map(|run| run.first().len()).sum();
        let progress = SimulationProgress::new(self.printer, total);
        for run in self.by_name.values_mut().filter(unknown()) {
            let first = run.first();
            run.make(&first, &progress)?;
        }
        progress.finish();
        Ok(())
    }

    /// How long the drives that are left will take on the threads of the current pool.
    pub(super) fn left(&self) -> Duration {
        let runs = self.by_name.values();
        let seconds: f64 = runs.map(|run| run.todo.len() as f64 * run.seconds_per_drive().unwrap_or_default()).sum();
        Duration::from_secs_f64(seconds / rayon::current_num_threads() as f64)
    }

    /// Makes all drives that are left, and writes the files of the runs.
    ///
    /// # Errors
    /// When a drive or file cannot be written.
    pub(super) fn make(&mut self, started: Instant) -> anyhow::Result<()> {
        let progress = SimulationProgress::new(self.printer, self.drives().1);
        for run in self.by_name.values_mut() {
            let todo = run.todo.clone();
            run.make(&todo, &progress)?;
            run.finish(started)?;
        }
        progress.finish();
        Ok(())
    }

    /// The run of a name.
    pub(super) fn get(&self, name: &str) -> Option<&Run> {
        self.by_name.get(name)
    }

    /// All runs.
    pub(super) fn all(&self) -> impl Iterator<Item = &Run> {
        self.by_name.values()
    }
}

impl Run {
    fn open(&mut self, path: &Path, retry_failed: bool, printer: Printer) -> anyhow::Result<()> {
        if path.join(MANIFEST).is_file() {
            let rows = RunFolder::read_completed(path)?.rows;
            let again = retry_failed && rows.iter().any(|row| row.error.is_some());
            if rows.len() == self.tasks.len() && path.join(SUMMARY).is_file() && !again {
                self.rows = rows;
                return Ok(());
            }
        }
        let folder = if path.join(MANIFEST).is_file() {
            RunFolder::resume(path, &self.manifest)?.0
        } else {
            RunFolder::create(Some(path), &self.manifest)?
        };
        let (kept, _) = drives::kept(&folder, &self.tasks, retry_failed, printer)?;
        self.rows = folder.completed(&self.tasks)?.rows;
        self.todo = (0..self.tasks.len()).filter(|number| !kept.contains(number)).collect();
        self.folder = Some(folder);
        Ok(())
    }

    /// The drives of its first scene that are left.
    fn first(&self) -> Vec<usize> {
        let source = self.todo.first().and_then(|&number| self.tasks.get(number)).map(|first| &first.source);
        let same = |number: &usize| self.tasks.get(*number).map(|drive| &drive.source) == source;
        self.todo.iter().copied().take_while(same).collect()
    }

    /// Mean time of the drives that are made; none before the first.
    fn seconds_per_drive(&self) -> Option<f64> {
        let seconds: f64 = self.rows.iter().map(|row| row.time.ended_s - row.time.started_s).sum();
        (!self.rows.is_empty()).then(|| seconds / self.rows.len() as f64)
    }

    /// Makes some of the drives that are left.
    fn make(&mut self, todo: &[usize], progress: &SimulationProgress) -> anyhow::Result<()> {
        let Some(folder) = &self.folder else { return Ok(()) };
        drives::make(folder, &self.tasks, todo, &self.agent, progress)?;
        self.todo.retain(|number| !todo.contains(number));
        self.made += todo.len();
        self.rows = folder.completed(&self.tasks)?.rows;
        Ok(())
    }

    /// Writes the files of the run, all of whose drives are made, and lets its folder go.
    fn finish(&mut self, started: Instant) -> anyhow::Result<()> {
        let Some(folder) = self.folder.take() else { return Ok(()) };
        self.rows = drives::rows(&folder, &self.tasks)?;
        let seed = self.manifest.config.get("seed").and_then(toml::Value::as_integer).unwrap_or_default();
        let session = drives::session(started, self.made, self.load_s);
        drives::finish(&folder, &self.manifest, seed.unsigned_abs(), session, &self.rows)?;
        Ok(())
    }

    /// Its drives.
    pub(super) fn rows(&self) -> &[SimulationRow] {
        &self.rows
    }

    /// Parameters of its model.
    pub(super) fn parameters(&self) -> Option<u64> {
        self.parameters
    }
}

/// What of a configuration a planner's simulations depend on.
fn effective(mut config: Config, needs: PlannerNeeds) -> Config {
    match needs {
        PlannerNeeds::Model => {
            (config.mllm.offline, config.mllm.ignore_memory) = (false, false);
            config
        }
        PlannerNeeds::Settings => {
            config.mllm = MllmConfig::default();
            config
        }
        PlannerNeeds::Nothing | PlannerNeeds::Recording => Config::default(),
    }
}
