//! Merges the shards of a run to the run that one process would have made.

use super::error::{MergeError, RunnerError};
use super::run::{self, RunResults};
use crate::report::{
    Inputs, Manifest, RunFolder, ScenarioList, ShardList, SimulationFolder, SimulationRow,
    SimulationTime, simulation_folders, simulation_metrics,
};
use planagent_files::{quoted, word_of};
use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Missing shards that an error lists.
const MAX_LISTED: usize = 100;

/// A run to merge.
struct Part {
    path: PathBuf,
    manifest: Manifest,
}

/// A completed simulation of one of the parts.
struct Simulation<'a> {
    part: &'a Part,
    folder: SimulationFolder,
    row: SimulationRow,
}

/// Copies the simulations of several runs with equal settings to a new folder, and writes the
/// results of all; without a name, the next free `runs/NNNN`. Apart from measured times, the files
/// are those of a run without shards.
///
/// # Errors
/// When settings differ, a simulation is missing, or two runs have different results of one
/// simulation.
pub fn merge(runs: &[PathBuf], out: Option<&Path>) -> Result<RunResults, RunnerError> {
    let started = Instant::now();
    let parts = runs.iter().map(|path| {
        Ok(Part {
            path: path.clone(),
            manifest: RunFolder::manifest(path)?,
        })
    });
    let parts = parts.collect::<Result<Vec<_>, RunnerError>>()?;
    let manifest = merged(&parts)?;
    let simulations = simulations(&parts)?;
    check_complete(&parts, &manifest, &simulations)?;
    check_identities(&parts, &manifest, &simulations)?;
    let folder = RunFolder::create(out, &manifest)?;
    simulations
        .values()
        .try_for_each(|simulation| folder.adopt(&simulation.folder))?;
    let rows = simulations
        .into_values()
        .map(|simulation| simulation.row)
        .collect();
    run::finish(&folder, manifest, run::session(started, 0, None), rows)
}

/// The manifest of the run that the parts are shards of.
fn merged(parts: &[Part]) -> Result<Manifest, MergeError> {
    let first = parts.first().ok_or(MergeError::NoRun)?;
    let whole = whole(&first.manifest);
    for other in parts {
        let mut differences = whole.differences(&self::whole(&other.manifest));
        differences.extend(whole.conflicting_inputs(&other.manifest));
        if !differences.is_empty() {
            let (first, other) = (first.path.clone(), other.path.clone());
            return Err(MergeError::Differs {
                first,
                other,
                differences,
            });
        }
    }
    let all = || parts.iter().map(|part| &part.manifest);
    // Shards may come from programs of other commits with the same results; then none is named.
    let one_commit = all().all(|manifest| manifest.commit == whole.commit);
    let data = all()
        .filter_map(|manifest| manifest.inputs.as_ref())
        .flat_map(|inputs| inputs.data.clone())
        .collect();
    Ok(Manifest {
        inputs: whole.inputs.clone().map(|inputs| Inputs { data, ..inputs }),
        accepted: all()
            .flat_map(|manifest| manifest.accepted.clone())
            .collect(),
        started: all()
            .map(|manifest| manifest.started.clone())
            .min()
            .expect("a merge has one part at least"),
        commit: whole.commit.clone().filter(|_| one_commit),
        ..whole
    })
}

/// The manifest without its shard.
fn whole(manifest: &Manifest) -> Manifest {
    let scenarios = ScenarioList {
        shard: None,
        ..manifest.scenarios.clone()
    };
    Manifest {
        scenarios,
        ..manifest.clone()
    }
}

/// The completed simulations of all parts, by number.
fn simulations(parts: &[Part]) -> Result<BTreeMap<usize, Simulation<'_>>, RunnerError> {
    let mut all: BTreeMap<usize, Simulation<'_>> = BTreeMap::new();
    for part in parts {
        let completed = RunFolder::read_completed(&part.path)?;
        if let Some(record) = completed.damaged.into_iter().next() {
            return Err(MergeError::Damaged {
                record,
                run: part.path.clone(),
            }
            .into());
        }
        let mut folders = simulation_folders(&part.path)?;
        for row in completed.rows {
            let folder = folders
                .remove(&row.number)
                .ok_or_else(|| MergeError::Vanished {
                    number: row.number,
                    run: part.path.clone(),
                })?;
            let own = Simulation { part, folder, row };
            match all.entry(own.row.number) {
                Entry::Vacant(entry) => {
                    entry.insert(own);
                }
                // The same simulation twice is harmless if its results are the same bytes.
                Entry::Occupied(entry) if entry.get().equals(&own)? => {}
                Entry::Occupied(entry) => {
                    let (first, other) = (entry.get().part.path.clone(), part.path.clone());
                    let (number, simulation) = (own.row.number, own.row.identity());
                    return Err(MergeError::Overlap {
                        first,
                        other,
                        number,
                        simulation,
                    }
                    .into());
                }
            }
        }
    }
    Ok(all)
}

impl Simulation<'_> {
    /// Whether the results are equal; measured times may differ.
    fn equals(&self, other: &Self) -> Result<bool, RunnerError> {
        let timeless = |row: &SimulationRow| SimulationRow {
            time: SimulationTime::default(),
            files: BTreeMap::new(),
            ..row.clone()
        };
        if timeless(&self.row) != timeless(&other.row) {
            return Ok(false);
        }
        Ok(self.row.score.is_none()
            || simulation_metrics(&self.folder)? == simulation_metrics(&other.folder)?)
    }
}

/// Refuses to merge what is no complete run.
fn check_complete(
    parts: &[Part],
    manifest: &Manifest,
    simulations: &BTreeMap<usize, Simulation<'_>>,
) -> Result<(), MergeError> {
    let total = manifest.simulations();
    let missing = total.saturating_sub(simulations.range(..total).count());
    if missing == 0 {
        return Ok(());
    }
    Err(MergeError::Incomplete {
        missing,
        total,
        advice: advice(parts),
    })
}

/// How to get the missing simulations.
fn advice(parts: &[Part]) -> String {
    // A part that can be continued comes first: its run exists already.
    for part in parts {
        let rows = RunFolder::read_completed(&part.path)
            .map(|completed| completed.rows.len())
            .unwrap_or_default();
        if rows < part.manifest.simulations() {
            let folder = quoted(&word_of(part.path.as_os_str()));
            return format!("continue with `planagent simulate --resume {folder}`");
        }
    }
    let shards: Vec<ShardList> = parts
        .iter()
        .filter_map(|part| part.manifest.scenarios.shard)
        .collect();
    let of = shards.first().map_or(0, |shard| shard.of);
    let absent = (1..=of).filter(|index| {
        !shards
            .iter()
            .any(|shard| shard.of == of && shard.index == *index)
    });
    let mut absent: Vec<String> = absent
        .take(MAX_LISTED + 1)
        .map(|index| format!("{index}/{of}"))
        .collect();
    if absent.len() > MAX_LISTED {
        absent.truncate(MAX_LISTED);
        absent.push("…".to_owned());
    }
    format!(
        "simulate and name the missing shards ({})",
        absent.join(", ")
    )
}

/// Refuses simulations that are not those of the manifest: every scenario by every planner in every
/// challenge.
fn check_identities(
    parts: &[Part],
    manifest: &Manifest,
    simulations: &BTreeMap<usize, Simulation<'_>>,
) -> Result<(), MergeError> {
    let (planners, challenges) = (&manifest.planners, &manifest.challenges);
    let pairs = planners
        .iter()
        .flat_map(|planner| challenges.iter().map(move |challenge| (planner, challenge)));
    // Numbers go by scenario, planner and challenge, so the pairs repeat with each scenario.
    for (simulation, (planner, challenge)) in simulations.values().zip(pairs.cycle()) {
        let row = &simulation.row;
        if row.planner != *planner || row.challenge.to_string() != *challenge {
            let expected = format!("{} by {planner} in {challenge}", row.source);
            let (run, number, found) = (simulation.part.path.clone(), row.number, row.identity());
            return Err(MergeError::Unexpected {
                run,
                number,
                found,
                expected,
            });
        }
    }
    let sources = simulations
        .values()
        .step_by((planners.len() * challenges.len()).max(1))
        .map(|simulation| &simulation.row.source);
    if ScenarioList::digest(sources) != manifest.scenarios.blake3 {
        return Err(MergeError::OtherScenarios {
            run: parts
                .first()
                .map(|part| part.path.clone())
                .expect("a merge has one part at least"),
        });
    }
    Ok(())
}
