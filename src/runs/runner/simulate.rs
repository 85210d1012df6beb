//! Starts and resumes runs.

use super::commands::Commands;
use super::config::{Config, ConfigError};
use super::error::RunnerError;
use super::event::{Event, Listener};
use super::inputs::{add_own, data_files};
use super::machine::build_commit;
use super::model::{self, LoadedModel};
use super::of_run::{MODEL, OfRun, checkpoint_key};
use super::request::Request;
use super::result_version::RESULT_VERSION;
use super::run::{self, Resume, Run, RunPlan, RunResults};
use super::selection::Selection;
use crate::report::{DataFile, FORMAT_VERSION, Inputs, Manifest, RunFolder, ScenarioList, stamp};
use crate::worker::run::AgentParts;
use planagent_agent::planner::PlannerName;
use planagent_planners::all_planners;
use std::collections::BTreeMap;
use std::path::Path;
use std::time::{Instant, SystemTime};

/// Simulates what a request names in a new folder; without a name, in the next free `runs/NNNN`. A
/// failed simulation is recorded and no error.
pub fn start(
    request: &Request,
    config: &Config,
    folder: Option<&Path>,
    listener: &Listener,
) -> Result<RunResults, RunnerError> {
    let started = Instant::now();
    let (request, commands) = &request.with_commands()?;
    let selection = Selection::new(request, commands.policy(), None, config.seed, listener)?;
    // Loading a model takes long: what is wrong with the folder is said before.
    RunFolder::check_new(folder)?;
    let data = data_files(selection.own_sources(), None);
    let plan = plan(request, commands, &selection, data, config, listener)?;
    if !plan.numbers.is_empty() {
        plan.probe(listener)?;
    }
    let run = Run::create(folder, plan)?;
    complete(run, &selection, config, started, listener)
}

/// Resumes the run in a folder. The request and the configuration must be those it was started
/// with; completed simulations stay. A run without simulations left gives its results even if its
/// scenarios cannot be found.
pub fn resume(
    folder: &Path,
    request: &Request,
    config: &Config,
    listener: &Listener,
) -> Result<RunResults, RunnerError> {
    let started = Instant::now();
    let before = RunFolder::manifest(folder)?;
    let (request, commands) = &request.with_commands()?;
    let is_plain = request.is_plain_resume();
    let selected = Selection::new(
        request,
        commands.policy(),
        Some(&before),
        config.seed,
        listener,
    );
    let selected = selected.and_then(|selection| {
        if is_plain {
            selection.check_unchanged(&before)?;
        }
        Ok(selection)
    });
    let selection = match selected {
        Ok(selection) => selection,
        Err(cause) if is_plain => {
            return without_scenarios(folder, &before, config, cause, listener);
        }
        Err(cause) => return Err(cause),
    };
    // Loading a model takes long: a run with other settings is refused before.
    check_checkpoints(&selection.planners, config)?;
    let data = data_files(selection.own_sources(), before.inputs.as_ref());
    let now = of_selection(&selection, commands, None, data.clone(), config)?;
    let differences = before.differences(&Manifest {
        model: before.model.clone(),
        prompts: before.prompts.clone(),
        ..now
    });
    if !differences.is_empty() {
        return Err(RunnerError::OtherSettings {
            folder: folder.to_owned(),
            differences,
        });
    }
    if let Some(then) = &before.inputs {
        let mut inputs = Inputs {
            data: data.clone(),
            ..then.clone()
        };
        // Files that are not on this machine yet are compared once the model is loaded.
        if before.model.is_some() {
            match model::inputs_here(config, listener) {
                Ok(of_model) => {
                    inputs = Inputs {
                        data: data.clone(),
                        ..of_model
                    };
                    add_own(&mut inputs, &before.planners, config);
                }
                Err(error @ RunnerError::NotNamed(_)) => return Err(error),
                Err(_) => {}
            }
        }
        RunFolder::check_inputs(folder, &then.changes(&inputs), request.accept_changes)?;
    }
    RunFolder::check_resumable(folder)?;
    let plan = plan(request, commands, &selection, data, config, listener)?;
    let how = Resume {
        retry_failed: request.retry_failed,
        accept_changes: request.accept_changes,
    };
    let run = Run::resume(folder, plan, how, listener)?;
    run.probe(listener)?;
    if let (Some(then), Some(now)) = (before.commit.as_deref(), build_commit())
        && then != now
        && !run.left().is_empty()
    {
        let text = format!(
            "the run was started by commit {then}, this program is {now}; both have the same result version"
        );
        listener(Event::Note(text));
    }
    let (total, left) = (run.total(), run.left().len());
    let failed = if run.retried > 0 {
        format!(", {} of them had failed", run.retried)
    } else {
        String::new()
    };
    let completed = total - left;
    listener(Event::Note(format!(
        "{completed} of {total} simulations are completed, {left} are left{failed}"
    )));
    complete(run, &selection, config, started, listener)
}

impl Config {
    /// The configuration that the run in a folder was started with.
    pub fn of_run(folder: &Path) -> Result<Self, RunnerError> {
        let place = format!("of the run in {}", folder.display());
        let table = RunFolder::manifest(folder)?.config;
        let config: Self = table.try_into().map_err(|source| ConfigError::Parse {
            place: place.clone(),
            source: Box::new(source),
        })?;
        let mut config = config.checked(place)?;
        let planners = all_planners();
        let checkpoints = planners.entries().iter().filter_map(|entry| {
            let planner = entry.name.as_str();
            config.learned.checkpoint(planner)?;
            Some(checkpoint_key(planner))
        });
        let memories = config.language_agents.memories();
        let keys = checkpoints
            .chain(memories.map(|(key, ..)| key))
            .chain([MODEL.to_owned()]);
        config.of_run = OfRun::new(folder, keys.collect::<Vec<_>>());
        Ok(config)
    }
}

/// Loads the model, if a planner needs it, and writes the manifest.
fn plan(
    request: &Request,
    commands: &Commands,
    selection: &Selection,
    data: BTreeMap<String, DataFile>,
    config: &Config,
    listener: &Listener,
) -> Result<RunPlan, RunnerError> {
    check_checkpoints(&selection.planners, config)?;
    let mut needs_model = false;
    for &planner in &selection.planners {
        let entry = request.registry.find(planner.as_str())?;
        if let Some(key) = entry.unsupported(&config.agent_settings()) {
            return Err(RunnerError::Unsupported { key, planner });
        }
        entry
            .prepare(&config.agent_settings())
            .map_err(|source| RunnerError::Prepare(Box::new(source)))?;
        needs_model |= entry.needs_model();
    }
    // After the checks, because loading a model takes long.
    let loaded = if needs_model {
        Some((request.loader)(config, listener)?)
    } else {
        None
    };
    Ok(RunPlan {
        manifest: of_selection(selection, commands, loaded.as_deref(), data, config)?,
        tasks: selection.tasks.clone(),
        numbers: selection.numbers.clone(),
        agent: AgentParts {
            agents: commands.agents.clone(),
            stop: request.stop.clone(),
            ..model::agent_parts(config, request.registry.clone(), loaded.as_deref())
        },
        load_s: loaded.map(|loaded| loaded.load_s),
    })
}

/// Refuses checkpoints of these planners that only the run names.
fn check_checkpoints(planners: &[PlannerName], config: &Config) -> Result<(), RunnerError> {
    let checkpoints = checkpoints(planners, config);
    config.of_run.check_checkpoints(checkpoints)?;
    Ok(config.of_run.check_memories(memories(planners, config))?)
}

/// The memories of these planners, by their keys.
fn memories<'a>(
    planners: &'a [PlannerName],
    config: &'a Config,
) -> impl Iterator<Item = (String, &'a str)> {
    let is_simulated = |name: &str| planners.iter().any(|planner| planner.as_str() == name);
    let set = config.language_agents.memories();
    set.filter_map(move |(key, planner, file)| is_simulated(&planner).then_some((key, file)))
}

/// The checkpoints of these planners.
fn checkpoints<'a>(
    planners: &'a [PlannerName],
    config: &'a Config,
) -> impl Iterator<Item = (&'a str, &'a str)> {
    planners.iter().filter_map(|planner| {
        let planner = planner.as_str();
        Some((planner, config.learned.checkpoint(planner)?))
    })
}

/// What a run of a selection would be started with now.
fn of_selection(
    selection: &Selection,
    commands: &Commands,
    loaded: Option<&LoadedModel>,
    data: BTreeMap<String, DataFile>,
    config: &Config,
) -> Result<Manifest, RunnerError> {
    let planners = selection.planners.iter().map(ToString::to_string).collect();
    let challenges = selection
        .challenges
        .iter()
        .map(ToString::to_string)
        .collect();
    let subject = RunSubject {
        planners,
        commands,
        challenges,
        scenarios: selection.list.clone(),
        data,
    };
    manifest(subject, loaded, config)
}

/// What a run simulates.
pub struct RunSubject<'a> {
    pub planners: Vec<String>,
    /// The commands of those planners that are commands.
    pub commands: &'a Commands,
    pub challenges: Vec<String>,
    pub scenarios: ScenarioList,
    /// The files of the scenarios.
    pub data: BTreeMap<String, DataFile>,
}

/// What a run would be started with now.
pub fn manifest(
    RunSubject {
        planners,
        commands,
        challenges,
        scenarios,
        data,
    }: RunSubject<'_>,
    loaded: Option<&LoadedModel>,
    config: &Config,
) -> Result<Manifest, RunnerError> {
    let mut inputs = Inputs {
        data,
        ..loaded
            .map(|loaded| loaded.inputs.clone())
            // Without a model there are no files of one among the inputs.
            .unwrap_or_default()
    };
    add_own(&mut inputs, &planners, config);
    Ok(Manifest {
        format_version: FORMAT_VERSION,
        result_version: RESULT_VERSION,
        planagent: env!("CARGO_PKG_VERSION").to_owned(),
        commit: build_commit().map(str::to_owned),
        started: stamp(SystemTime::now()),
        planners,
        commands: commands.planners.clone(),
        agents: commands.of_agents(),
        challenges,
        scenarios,
        model: loaded
            .map(|loaded| toml::Table::try_from(&loaded.about))
            .transpose()?,
        prompts: loaded.and_then(LoadedModel::prompt_list),
        config: toml::Table::try_from(config)?,
        inputs: Some(inputs),
        accepted: Vec::new(),
    })
}

/// Simulates what is left of a run and writes its results.
fn complete(
    mut run: Run,
    selection: &Selection,
    config: &Config,
    started: Instant,
    listener: &Listener,
) -> Result<RunResults, RunnerError> {
    let left = run.left().to_vec();
    let registry = model::model_registry(config, listener);
    let model = run.has_model().then_some(config.mllm.model.as_str());
    listener(Event::Opened {
        folder: run.path().to_owned(),
        has_commands: run.has_commands(),
        named_again: OfRun::options(
            model,
            checkpoints(&selection.planners, config),
            memories(&selection.planners, config),
            &registry,
        ),
    });
    listener(Event::Started { total: left.len() });
    let simulated = run.simulate(&left, listener);
    listener(Event::Finished);
    // The progress display must end before an error is shown.
    simulated?;
    selection
        .readers
        .take_notes()
        .into_iter()
        .for_each(|text| listener(Event::Note(text)));
    run.finish(started)
}

/// The results of a run whose scenarios cannot be found, because of `cause`.
fn without_scenarios(
    folder: &Path,
    manifest: &Manifest,
    config: &Config,
    cause: RunnerError,
    listener: &Listener,
) -> Result<RunResults, RunnerError> {
    let started = Instant::now();
    let rows = RunFolder::read_completed(folder)?.rows;
    let (completed, total) = (rows.len(), manifest.simulations());
    let folder = folder.to_owned();
    if completed != total || manifest.config != toml::Table::try_from(config)? {
        return Err(RunnerError::CannotResume {
            folder,
            completed,
            total,
            source: Box::new(cause),
        });
    }
    let shown = folder.display();
    listener(Event::Note(format!(
        "the run in {shown} has ended; only its results are shown, because {cause}"
    )));
    let (locked, manifest, _) = RunFolder::resume(&folder, manifest, false)?;
    run::finish(&locked, manifest, run::session(started, 0, None), rows)
}
