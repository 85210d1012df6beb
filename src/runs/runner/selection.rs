//! The tasks of a run: from the request, else from the run that is resumed, else by default.

use super::error::RunnerError;
use super::event::{Event, Listener};
use super::request::Request;
use super::sample::Sample;
use super::shard::Shard;
use crate::report::{Manifest, ScenarioList};
use crate::worker::run::SimulationTask;
use crate::worker::split::split;
use crate::worker::suite::Suite;
use planagent_agent::planner::PlannerName;
use planagent_agent::planner_registry::PlannerRegistry;
use planagent_agent::simulation::{AgentPolicyName, Challenge};
use planagent_files::word_of;
use planagent_scenario::{
    DEFAULT_SCENARIO, DataRoots, MissingTokens, Readers, ScenarioRef, absolute_path,
};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// The tasks of a run.
pub(super) struct Selection {
    /// The scenarios as the manifest lists them.
    pub(super) list: ScenarioList,
    pub(super) planners: Vec<PlannerName>,
    pub(super) challenges: Vec<Challenge>,
    /// Every scenario with every planner in every challenge.
    pub(super) tasks: Vec<SimulationTask>,
    /// Places of the tasks that this run simulates: all, or those of its shard.
    pub(super) numbers: Vec<usize>,
    /// The readers that found the scenarios; they collect notes on the data that is opened.
    pub(super) readers: Readers,
}

/// The scenarios that words and splits name.
pub struct Selected {
    /// The scenarios, each once.
    pub sources: Vec<ScenarioRef>,
    /// Files of the splits, else their names.
    pub splits: Vec<String>,
    /// Scenarios of the splits that the data does not hold.
    pub missing: Vec<MissingTokens>,
}

impl Selection {
    /// The tasks of a request with the policy of its own agents; `seed` draws the order of shuffled
    /// scenarios.
    pub(super) fn new(
        request: &Request,
        agents: Option<AgentPolicyName>,
        resumed: Option<&Manifest>,
        seed: u64,
        listener: &Listener,
    ) -> Result<Self, RunnerError> {
        let own = |names: &[String], of: fn(&Manifest) -> &Vec<String>| match resumed {
            Some(manifest) if names.is_empty() => of(manifest).clone(),
            _ => names.to_vec(),
        };
        if let Some(manifest) = resumed {
            check_commands(request, agents, manifest)?;
        }
        let planners = planners(
            &request.registry,
            &own(&request.planners, |manifest| &manifest.planners),
        )?;
        let challenges = challenges(
            &own(&request.challenges, |manifest| &manifest.challenges),
            agents,
        )?;
        let named = match resumed {
            Some(Manifest { scenarios, .. }) if !request.names_scenarios() => {
                Named::in_run(scenarios)
            }
            _ => Named::in_request(request)?,
        };
        let Named {
            words,
            splits,
            types,
            shuffle,
            limit,
            shard,
        } = named;
        let roots = roots(request, resumed)?;
        let readers = (request.readers)(&roots);
        // The run can be resumed from any working directory.
        let words: Vec<String> = words
            .iter()
            .map(|word| readers.absolute_word(word))
            .collect();
        let sample = Sample {
            types: types.clone(),
            shuffle: shuffle.then_some(seed),
            limit,
        };
        let Selected {
            sources,
            splits,
            missing,
        } = select(&words, &splits, &sample, &readers, listener)?;
        let shard_list = shard.map(|shard| shard.list(&sources));
        let named = ScenarioList {
            words,
            splits,
            types,
            shuffle,
            limit,
            shard: shard_list,
            missing,
            ..ScenarioList::default()
        };
        let list = scenario_list(&sources, named, roots)?;
        let tasks = tasks(&sources, &planners, &challenges);
        let is_own = |task: &SimulationTask| shard.is_none_or(|shard| shard.has(&task.source));
        let numbers = tasks
            .iter()
            .enumerate()
            .filter(|(_, task)| is_own(task))
            .map(|(number, _)| number)
            .collect();
        Ok(Self {
            list,
            planners,
            challenges,
            tasks,
            numbers,
            readers,
        })
    }

    /// The scenarios that this run simulates, each at least once.
    pub(super) fn own_sources(&self) -> impl Iterator<Item = &ScenarioRef> {
        self.numbers
            .iter()
            .filter_map(|&number| Some(&self.tasks.get(number)?.source))
    }

    /// Refuses a run whose scenarios changed since it started.
    pub(super) fn check_unchanged(&self, manifest: &Manifest) -> Result<(), RunnerError> {
        let (then, now) = (&manifest.scenarios, &self.list);
        if then.blake3 == now.blake3 {
            return Ok(());
        }
        let words = [&then.words[..], &then.splits[..]].concat().join(" ");
        Err(RunnerError::ScenariosChanged {
            then: then.count,
            now: now.count,
            words,
        })
    }
}

/// The scenarios as the user names them.
struct Named {
    words: Vec<String>,
    splits: Vec<String>,
    types: Vec<String>,
    shuffle: bool,
    limit: Option<usize>,
    shard: Option<Shard>,
}

impl Named {
    fn in_run(list: &ScenarioList) -> Self {
        Self {
            words: list.words.clone(),
            splits: list.splits.clone(),
            types: list.types.clone(),
            shuffle: list.shuffle,
            limit: list.limit,
            shard: list.shard.map(Shard::from),
        }
    }

    fn in_request(request: &Request) -> Result<Self, RunnerError> {
        if request.limit == Some(0) {
            return Err(RunnerError::LimitZero);
        }
        let mut splits = request.splits.clone();
        // A draw from the one default scenario would be no draw.
        if request.draws() && splits.is_empty() && request.scenarios.is_empty() {
            splits.push(Suite::DEMONSTRATION.name.to_owned());
        }
        Ok(Self {
            words: request.scenarios.clone(),
            splits,
            types: request.types.clone(),
            shuffle: request.shuffle,
            limit: request.limit,
            shard: request.shard,
        })
    }
}

/// Refuses to take a command from a run that the request does not give: a folder from elsewhere
/// must start no program.
fn check_commands(
    request: &Request,
    agents: Option<AgentPolicyName>,
    manifest: &Manifest,
) -> Result<(), RunnerError> {
    if let (None, Some((policy, command))) = (agents, manifest.agents.iter().next()) {
        return Err(RunnerError::AgentsNotGiven {
            policy: policy.clone(),
            command: command.clone(),
        });
    }
    if !request.planners.is_empty() {
        return Ok(());
    }
    match manifest.commands.iter().next() {
        None => Ok(()),
        Some((planner, command)) => Err(RunnerError::CommandNotGiven {
            planner: planner.clone(),
            command: command.clone(),
        }),
    }
}

/// Completes a manifest's list by the scenarios, and checks that their files exist: before the
/// first simulation instead of in each.
pub fn scenario_list(
    sources: &[ScenarioRef],
    named: ScenarioList,
    roots: DataRoots,
) -> Result<ScenarioList, RunnerError> {
    sources.iter().try_for_each(ScenarioRef::check)?;
    let blake3 = ScenarioList::digest(sources.iter().map(ToString::to_string));
    let DataRoots {
        data: data_root,
        maps: maps_root,
    } = roots;
    Ok(ScenarioList {
        data_root,
        maps_root,
        count: sources.len(),
        blake3,
        ..named
    })
}

/// The folders of nuPlan's data: those of the request, else those of the run that is resumed;
/// absolute.
fn roots(request: &Request, resumed: Option<&Manifest>) -> Result<DataRoots, RunnerError> {
    let DataRoots { data, maps } = request.roots.clone();
    let before =
        |of: fn(&ScenarioList) -> &Option<PathBuf>| resumed.and_then(|m| of(&m.scenarios).clone());
    absolute(DataRoots {
        data: data.or_else(|| before(|l| &l.data_root)),
        maps: maps.or_else(|| before(|l| &l.maps_root)),
    })
}

pub fn absolute(DataRoots { data, maps }: DataRoots) -> Result<DataRoots, RunnerError> {
    let absolute = |folder: Option<PathBuf>| {
        folder
            .map(|path| {
                std::path::absolute(&path).map_err(|source| RunnerError::Absolute { path, source })
            })
            .transpose()
    };
    Ok(DataRoots {
        data: absolute(data)?,
        maps: absolute(maps)?,
    })
}

/// Finds the scenarios that words and splits name, or the default one where both are empty.
pub fn select(
    words: &[String],
    splits: &[String],
    sample: &Sample,
    readers: &Readers,
    listener: &Listener,
) -> Result<Selected, RunnerError> {
    let note = |text: String| listener(Event::Note(text));
    let (mut found, mut missing, mut lists) = (Vec::new(), Vec::new(), Vec::new());
    for name in splits {
        let of_split = split(name, readers, &|done, total| {
            listener(Event::LogsSearched { done, total });
        })?;
        found.extend(of_split.scenarios);
        of_split
            .notes
            .iter()
            .for_each(|text| note(format!("{name}: {text}")));
        if !of_split.missing.is_empty() {
            note(of_split.missing.to_string());
            missing.push(of_split.missing);
        }
        let file = of_split
            .file
            .map(|file| absolute_path(&word_of(file.as_os_str())));
        lists.push(file.unwrap_or_else(|| name.clone()));
    }
    for word in words {
        found.extend(readers.find(word)?);
    }
    if splits.is_empty() && words.is_empty() {
        found.extend(readers.find(DEFAULT_SCENARIO)?);
    }
    readers.take_notes().into_iter().for_each(note);
    // A scenario that is named twice is simulated once, or it would count twice in the means.
    let (sources, repeated) = ScenarioRef::distinct(found);
    if let Some(first) = repeated.first() {
        let count = repeated.len();
        note(format!(
            "{count} scenarios are named more than once and simulated once, for example {first}"
        ));
    }
    let sources = sample.draw(sources)?;
    check_ids(&sources)?;
    if sources.is_empty() {
        return Err(RunnerError::NoScenario);
    }
    Ok(Selected {
        sources,
        splits: lists,
        missing,
    })
}

/// Refuses two scenarios with one id: results name scenarios by their ids.
fn check_ids(sources: &[ScenarioRef]) -> Result<(), RunnerError> {
    let mut by_id: BTreeMap<&str, &ScenarioRef> = BTreeMap::new();
    for source in sources {
        if let Some(id) = source.id()
            && let Some(first) = by_id.insert(id, source)
        {
            let (id, first, second) = (id.to_owned(), first.to_string(), source.to_string());
            return Err(RunnerError::SameId { id, first, second });
        }
    }
    Ok(())
}

fn planners(registry: &PlannerRegistry, names: &[String]) -> Result<Vec<PlannerName>, RunnerError> {
    if names.is_empty() {
        return Ok(vec![PlannerName::PLAN_AGENT]);
    }
    let planners = names
        .iter()
        .map(|name| registry.find(name).map(|entry| entry.name));
    Ok(distinct(planners.collect::<Result<_, _>>()?))
}

/// The challenges by name, and the closed loop with own agents. These alone are simulated if no
/// challenge is named.
fn challenges(
    names: &[String],
    agents: Option<AgentPolicyName>,
) -> Result<Vec<Challenge>, RunnerError> {
    if names.is_empty() && agents.is_none() {
        return Ok(vec![Challenge::NonReactive]);
    }
    let mut challenges = Vec::new();
    for name in names {
        match name.as_str() {
            "both" => challenges.extend(Challenge::CLOSED_LOOP),
            one => challenges.push(
                one.parse()
                    .map_err(|source| RunnerError::Challenge { source })?,
            ),
        }
    }
    challenges.extend(agents.map(Challenge::OwnAgents));
    Ok(distinct(challenges))
}

/// Each value once, at its first place.
fn distinct<T: PartialEq>(values: Vec<T>) -> Vec<T> {
    let mut all = Vec::new();
    for value in values {
        if !all.contains(&value) {
            all.push(value);
        }
    }
    all
}

/// Every scenario with every planner in every challenge.
pub fn tasks(
    sources: &[ScenarioRef],
    planners: &[PlannerName],
    challenges: &[Challenge],
) -> Vec<SimulationTask> {
    let of_planner = |source: &ScenarioRef, planner: PlannerName| {
        let task = |&challenge: &Challenge| SimulationTask {
            source: source.clone(),
            planner,
            challenge,
        };
        challenges.iter().map(task).collect::<Vec<_>>()
    };
    sources
        .iter()
        .flat_map(|source| {
            planners
                .iter()
                .flat_map(move |&planner| of_planner(source, planner))
        })
        .collect()
}
