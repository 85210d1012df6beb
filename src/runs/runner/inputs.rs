//! Digests of the recordings of a run.

use super::config::Config;
use crate::report::{DataFile, Inputs};
use planagent_files::{path_of, word_of};
use planagent_planners::all_planners;
use planagent_scenario::ScenarioRef;
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

/// Largest file that is read for a digest. Most logs of nuPlan are larger, and a run begins without
/// reading them all: size and time stand for them.
const MAX_DIGESTED_BYTES: u64 = 64 << 20;

/// The files of the scenarios. A file with the size and time it had `before` keeps its digest. A
/// file that cannot be read is left out: opening its scenario says why.
pub fn data_files<'a>(
    sources: impl IntoIterator<Item = &'a ScenarioRef>,
    before: Option<&Inputs>,
) -> BTreeMap<String, DataFile> {
    let paths: BTreeSet<PathBuf> = sources.into_iter().flat_map(ScenarioRef::files).collect();
    let paths: Vec<PathBuf> = paths.into_iter().collect();
    let entry = |path: &PathBuf| {
        let path = std::path::absolute(path).unwrap_or_else(|_| path.clone());
        let name = word_of(path.as_os_str());
        let file = data_file(&path, before.and_then(|inputs| inputs.data.get(&name))).ok()?;
        Some((name, file))
    };
    paths.par_iter().filter_map(entry).collect()
}

fn data_file(path: &Path, before: Option<&DataFile>) -> io::Result<DataFile> {
    let metadata = std::fs::metadata(path)?;
    if !metadata.is_file() {
        return Err(io::ErrorKind::InvalidInput.into());
    }
    let since_1970 = metadata
        .modified()?
        .duration_since(UNIX_EPOCH)
        .unwrap_or_default();
    let modified_ns = i64::try_from(since_1970.as_nanos()).unwrap_or(i64::MAX);
    let stamp = DataFile {
        size: metadata.len(),
        modified_ns,
        blake3: None,
    };
    match before {
        Some(before) if before.same_stamp(&stamp) => Ok(before.clone()),
        _ if stamp.size > MAX_DIGESTED_BYTES => Ok(stamp),
        _ => {
            let mut hasher = blake3::Hasher::new();
            hasher.update_reader(File::open(path)?)?;
            Ok(DataFile {
                blake3: Some(hasher.finalize().to_hex().to_string()),
                ..stamp
            })
        }
    }
}

/// Adds what these planners read themselves: checkpoints, and texts of their own.
pub(super) fn add_own(inputs: &mut Inputs, planners: &[String], config: &Config) {
    inputs.model.extend(checkpoint_digests(planners, config));
    let (registry, settings) = (all_planners(), config.agent_settings());
    let entries = planners
        .iter()
        .filter_map(|planner| registry.find(planner).ok());
    entries.for_each(|entry| inputs.prompts.extend(entry.digests(&settings)));
}

/// BLAKE3 of the checkpoints of these planners, by path. One that cannot be read is left out:
/// preparing its planner says why.
fn checkpoint_digests(planners: &[String], config: &Config) -> BTreeMap<String, String> {
    let digest = |path: &str| {
        let mut hasher = blake3::Hasher::new();
        hasher
            .update_reader(planagent_files::open(&path_of(path)).ok()?)
            .ok()?;
        Some((path.to_owned(), hasher.finalize().to_hex().to_string()))
    };
    planners
        .iter()
        .filter_map(|planner| digest(config.learned.checkpoint(planner)?))
        .collect()
}
