//! The runs of studies. Each has a folder whose name is a digest of everything that determines
//! the run, so that studies share equal runs and resume interrupted ones.

use super::suites::SelectedSuite;
use crate::study::{Study, StudyError, Variant};
use planagent_agent::planner::{DEFAULT_EXEC_TIMEOUT, ExecCommand};
use planagent_agent::planner_registry::{PlannerNeeds, PlannerRegistry, UsedSettings};
use planagent_agent::simulation::Challenge;
use planagent_runs::report::{RunFolder, SimulationRow};
use planagent_runs::runner::RunnerError;
use planagent_runs::runner::commands::Commands;
use planagent_runs::runner::model::{self, OpenModel};
use planagent_runs::runner::run::{Resume, Run, RunPlan};
use planagent_runs::runner::selection::tasks;
use planagent_runs::runner::simulate::{RunSubject, manifest};
use planagent_runs::runner::{Config, MllmConfig};
use planagent_runs::runner::{Event, Listener};
use planagent_runs::worker::interactive;
use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::path::Path;
use std::time::{Duration, Instant};

/// Characters of the digest in a run's name.
pub(super) const DIGEST: usize = 12;
/// The cell of a model whose weights are not on this machine.
const NO_WEIGHTS: &str = "no weights";

/// The cell of an agent whose prompts are longer than the context of the model.
const SHORT_CONTEXT: &str = "short context";
/// The cell of a learned planner without a checkpoint.
const NO_CHECKPOINT: &str = "no checkpoint";

/// Name of a variant's run, or why there is none.
pub(super) type RunName = Result<String, &'static str>;

/// The runs of a session before their folders are opened, by name.
pub(super) struct PlannedRuns<'a> {
    config: &'a Config,
    registry: &'a PlannerRegistry,
    listener: &'a Listener,
    models: BTreeMap<String, OpenModel>,
    plans: BTreeMap<String, RunPlan>,
    parameters: BTreeMap<String, u64>,
}

/// The runs of a session, by name.
pub(super) struct OpenRuns<'a> {
    listener: &'a Listener,
    open: BTreeMap<String, Run>,
    /// The simulations of the runs that have ended.
    ended: BTreeMap<String, Vec<SimulationRow>>,
}

impl<'a> PlannedRuns<'a> {
    pub(super) fn new(
        config: &'a Config,
        registry: &'a PlannerRegistry,
        listener: &'a Listener,
    ) -> Self {
        let (models, plans, parameters) = Default::default();
        Self {
            config,
            registry,
            listener,
            models,
            plans,
            parameters,
        }
    }

    /// Refuses a study with a setting or a planner that there is not, before a model loads.
    pub(super) fn check(&self, study: &Study) -> Result<(), RunnerError> {
        for variant in &study.variants {
            let labels = variant.labels.join(", ");
            let place = format!("of the study {}, variant {labels}", study.word);
            self.config.overlaid_at(&variant.settings, &place)?;
            let (registry, commands) = self.registry_for(variant)?;
            let planner = commands.planners.keys().next().unwrap_or(&variant.planner);
            registry.find(planner).map_err(|error| StudyError::Value {
                place: study.word.clone(),
                fault: format!("variant {labels}: {error}"),
            })?;
        }
        Ok(())
    }

    /// Plans the run of a variant on a suite and gives its name; or why the variant cannot be
    /// simulated.
    pub(super) fn add(
        &mut self,
        suite: &SelectedSuite,
        variant: &Variant,
    ) -> Result<RunName, RunnerError> {
        let config = self.config.overlaid(&variant.settings)?;
        let mut learned = self.registry.learned();
        let is_learned = learned.any(|planner| planner.as_str() == variant.planner);
        if is_learned && config.learned.checkpoint(&variant.planner).is_none() {
            return Ok(Err(NO_CHECKPOINT));
        }
        let (registry, commands) = self.registry_for(variant)?;
        let entry = registry.find(commands.planners.keys().next().unwrap_or(&variant.planner))?;
        let (planner, needs, least) = (entry.name, entry.needs, entry.least_context());
        let loaded = match needs {
            needs if needs != PlannerNeeds::Model => None,
            _ if !self.has_weights(&config)? => return Ok(Err(NO_WEIGHTS)),
            _ => Some(self.model(&config)?.with_prompts(&config)?),
        };
        // A server does not say how long its context is.
        let context = loaded.as_ref().map_or(0, |loaded| loaded.about.context);
        if context > 0 && context < least {
            return Ok(Err(SHORT_CONTEXT));
        }
        let agent = model::agent_parts(&config, registry, loaded.as_ref());
        let challenges = challenges_of(&suite.name);
        let named = challenges.iter().map(ToString::to_string).collect();
        let relevant = relevant(config, planner.as_str(), needs);
        let subject = RunSubject {
            planners: vec![planner.to_string()],
            commands: &commands,
            challenges: named,
            scenarios: suite.list.clone(),
            data: suite.data.clone(),
        };
        let manifest = manifest(subject, loaded.as_ref(), &relevant)?;
        let digest = manifest.digest();
        let name = format!(
            "{planner}-{}-{}",
            suite.name,
            digest.get(..DIGEST).unwrap_or(&digest)
        );
        if let Some(loaded) = &loaded {
            self.parameters
                .insert(name.clone(), loaded.about.parameters);
        }
        let tasks = tasks(&suite.sources, &[planner], challenges);
        self.plans.entry(name.clone()).or_insert_with(|| RunPlan {
            manifest,
            numbers: (0..tasks.len()).collect(),
            tasks,
            agent,
            load_s: loaded.map(|loaded| loaded.load_s),
        });
        Ok(Ok(name))
    }

    /// The planners, with that of the variant if it is a command, and the command by its name.
    fn registry_for(&self, variant: &Variant) -> Result<(PlannerRegistry, Commands), RunnerError> {
        let mut commands = Commands::default();
        let mut registry = self.registry.clone();
        if let Some(command) = ExecCommand::parse(&variant.planner).transpose()? {
            registry = registry.with_command(&command, DEFAULT_EXEC_TIMEOUT)?;
            commands
                .planners
                .insert(command.name.to_string(), command.command);
        }
        Ok((registry, commands))
    }

    /// Whether the weights of a variant's own model are on this machine. The model of the user's
    /// configuration is not checked: if it cannot be loaded, that is an error.
    fn has_weights(&self, config: &Config) -> Result<bool, RunnerError> {
        if config.mllm.model == self.config.mllm.model {
            return Ok(true);
        }
        let registry = model::model_registry(config, self.listener);
        let spec = registry
            .find(&config.mllm.model)
            .map_err(|error| RunnerError::FindModel(Box::new(error)))?;
        Ok(registry
            .place_here(&spec)
            .and_then(|place| place.weight_bytes())
            .is_ok())
    }

    /// The model of a configuration; each is loaded once.
    fn model(&mut self, config: &Config) -> Result<&OpenModel, RunnerError> {
        Ok(match self.models.entry(toml::to_string(&config.mllm)?) {
            Entry::Occupied(entry) => entry.into_mut(),
            Entry::Vacant(entry) => entry.insert(OpenModel::open(config, self.listener)?),
        })
    }

    /// Parameters of the runs' models, by name of the run.
    pub(super) fn parameters(&self) -> BTreeMap<String, u64> {
        self.parameters.clone()
    }

    /// Opens the folders of all runs.
    pub(super) fn open(
        self,
        folder: &Path,
        retry_failed: bool,
    ) -> Result<OpenRuns<'a>, RunnerError> {
        let how = Resume {
            retry_failed,
            accept_changes: false,
        };
        let mut runs = OpenRuns {
            listener: self.listener,
            open: BTreeMap::new(),
            ended: BTreeMap::new(),
        };
        for (name, plan) in self.plans {
            let path = folder.join(&name);
            if !RunFolder::is_begun(&path)? {
                runs.open.insert(name, Run::create(Some(&path), plan)?);
                continue;
            }
            let changes = RunFolder::manifest(&path)?.changed_inputs(&plan.manifest);
            RunFolder::check_inputs(&path, &changes, false)?;
            let has_results = RunFolder::has_results(&path)?;
            let rows = if has_results {
                RunFolder::read_completed(&path)?.rows
            } else {
                Vec::new()
            };
            let retries = retry_failed && rows.iter().any(|row| row.error.is_some());
            // Studies share runs. One that has ended is read, and needs neither its model nor its
            // scenarios.
            if has_results && rows.len() == plan.numbers.len() && !retries {
                runs.ended.insert(name, rows);
            } else {
                runs.open
                    .insert(name, Run::resume(&path, plan, how, self.listener)?);
            }
        }
        Ok(runs)
    }
}

impl OpenRuns<'_> {
    /// Runs, completed simulations, simulations that are left.
    pub(super) fn counts(&self) -> (usize, usize, usize) {
        let left: usize = self.open.values().map(|run| run.left().len()).sum();
        let total: usize = self
            .open
            .values()
            .map(Run::total)
            .chain(self.ended.values().map(Vec::len))
            .sum();
        (self.open.len() + self.ended.len(), total - left, left)
    }

    /// Asks the servers of the runs' models what the simulations that are left will ask.
    pub(super) fn probe(&self) -> Result<(), RunnerError> {
        self.open
            .values()
            .try_for_each(|run| run.probe(self.listener))
    }

    /// Simulates the first scenario of those runs whose time is not known.
    pub(super) fn simulate_first(&mut self) -> Result<(), RunnerError> {
        let unknown = |run: &&mut Run| run.seconds_per_simulation().is_none();
        let total = self
            .open
            .values_mut()
            .filter(unknown)
            .map(|run| run.first().len())
            .sum();
        (self.listener)(Event::Started { total });
        let outcome = self.open.values_mut().filter(unknown).try_for_each(|run| {
            let first = run.first();
            run.simulate(&first, self.listener)
        });
        (self.listener)(Event::Finished);
        outcome
    }

    /// Time that the simulations that are left take on the threads of the current pool.
    pub(super) fn time_left(&self) -> Duration {
        let of_run =
            |run: &Run| run.left().len() as f64 * run.seconds_per_simulation().unwrap_or_default();
        Duration::from_secs_f64(
            self.open.values().map(of_run).sum::<f64>() / rayon::current_num_threads() as f64,
        )
    }

    /// Simulates all that is left, and writes the results of each run; gives the simulations of all
    /// runs.
    pub(super) fn complete(
        mut self,
        started: Instant,
    ) -> Result<BTreeMap<String, Vec<SimulationRow>>, RunnerError> {
        (self.listener)(Event::Started {
            total: self.counts().2,
        });
        let outcome = std::mem::take(&mut self.open)
            .into_iter()
            .try_for_each(|(name, mut run)| {
                let left = run.left().to_vec();
                run.simulate(&left, self.listener)?;
                self.ended.insert(name, run.finish(started)?.rows);
                Ok(())
            });
        (self.listener)(Event::Finished);
        outcome.map(|()| self.ended)
    }
}

/// The part of a configuration that a planner's simulations depend on.
pub(super) fn relevant(mut config: Config, planner: &str, needs: PlannerNeeds) -> Config {
    config.learned = config.learned.only(planner);
    config.language_agents = config.language_agents.only(planner);
    match needs.settings() {
        UsedSettings::AgentAndModel => {
            (config.mllm.offline, config.mllm.ignore_memory) = (false, false);
        }
        UsedSettings::Agent => config.mllm = MllmConfig::default(),
        UsedSettings::None => config = Config::default(),
        UsedSettings::Checkpoint => {
            config = Config {
                learned: config.learned,
                ..Config::default()
            }
        }
    }
    config
}

/// The challenges of a suite: both in the closed loop; the interactive suites only with reactive
/// agents, as interPlan.
fn challenges_of(suite: &str) -> &'static [Challenge] {
    const REACTIVE: [Challenge; 1] = [Challenge::Reactive];
    const BOTH: [Challenge; 2] = Challenge::CLOSED_LOOP;
    if interactive::NAMES.contains(&suite) {
        &REACTIVE
    } else {
        &BOTH
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_checkpoint_of_another_planner_changes_no_run() {
        let mut one = Config::default();
        one.learned.set("plantf", "a.ckpt".to_owned());
        let mut both = one.clone();
        both.learned.set("dtpp", "b.pth".to_owned());
        assert_eq!(
            relevant(one.clone(), "plantf", PlannerNeeds::Checkpoint),
            relevant(both.clone(), "plantf", PlannerNeeds::Checkpoint)
        );
        assert_eq!(
            relevant(one.clone(), "plantf", PlannerNeeds::Checkpoint),
            one
        );
        assert_eq!(
            relevant(both, "plan-agent", PlannerNeeds::Model),
            Config::default()
        );
    }
}
