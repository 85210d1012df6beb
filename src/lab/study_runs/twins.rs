//! The study `twins`: whether the model's first code is right in both scenes of text twins.

use super::request::StudiesRequest;
use super::runs::{DIGEST, relevant};
use crate::dataset::twins::PairName;
use crate::report::{Records, StudyFolder, twin_markdown};
use crate::twins::{self, NAMES, PairRecord, TwinResults};
use planagent_agent::planner::PlannerName;
use planagent_agent::planner_registry::PlannerNeeds;
use planagent_runs::report::{ScenarioList, json_value, markdown_block, markdown_line};
use planagent_runs::runner::Config;
use planagent_runs::runner::LoadedModel;
use planagent_runs::runner::RunnerError;
use planagent_runs::runner::commands::Commands;
use planagent_runs::runner::model::{OpenModel, agent_parts};
use planagent_runs::runner::simulate::{RunSubject, manifest};
use planagent_runs::runner::{Event, Listener};
use planagent_scenario::modified::TwinKind;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

/// Its title.
pub(super) const TITLE: &str = "Text twins: the model's first code, Reflection off";
/// Name of the file with its answers.
const PAIRS: &str = "pairs.jsonl";
/// With --quick, pairs of each kind.
const QUICK: usize = 2;

/// The names and pairs of the lists of a request, or of the test pairs.
pub(super) fn lists(request: &StudiesRequest) -> Result<Vec<(String, Vec<PairName>)>, RunnerError> {
    let default = vec![twins::TEST.to_owned()];
    let names = if request.suites.is_empty() {
        default
    } else {
        request.suites.clone()
    };
    let of_name = |name: String| {
        let unknown = || RunnerError::UnknownPairs {
            name: name.clone(),
            known: NAMES.join(", "),
        };
        let pairs = twins::list(&name).ok_or_else(unknown)?;
        let limit = if request.quick {
            Some(QUICK * TwinKind::ALL.len())
        } else {
            request.limit
        };
        let pairs = limit.map_or_else(|| pairs.clone(), |limit| twins::evenly(&pairs, limit));
        Ok((name, pairs))
    };
    names.into_iter().map(of_name).collect()
}

/// Asks the model in the pairs of a list; those that it answered before stay.
pub(crate) fn judge(
    (name, pairs): &(String, Vec<PairName>),
    config: &Config,
    runs: &Path,
    listener: &Listener,
) -> Result<TwinResults, RunnerError> {
    let loaded = OpenModel::open(config, listener)?.with_prompts(config)?;
    let words: Vec<String> = pairs.iter().map(ToString::to_string).collect();
    let (folder, blake3) = answers_folder(runs, name, &words, &loaded, config)?;
    let (records, completed) = Records::<PairRecord>::open(&folder, PAIRS)?;
    let mut known: BTreeMap<String, PairRecord> = completed
        .into_iter()
        .map(|record| (record.pair.clone(), record))
        .collect();
    let left: Vec<&PairName> = pairs
        .iter()
        .filter(|pair| !known.contains_key(&pair.to_string()))
        .collect();
    let (total, done) = (pairs.len(), AtomicUsize::new(pairs.len() - left.len()));
    // A server need not be there for what it answered before.
    if !left.is_empty() {
        loaded.probe(config, listener)?;
    }
    listener(Event::Note(format!(
        "{name}: {total} pairs; {} are answered, {} are left",
        total - left.len(),
        left.len()
    )));
    let registry = planagent_planners::all_planners();
    let parts = agent_parts(config, registry, Some(&loaded));
    let answer = |pair: &&PairName| -> Result<PairRecord, RunnerError> {
        let record = twins::judge(pair, &parts)?;
        records.add(&record)?;
        listener(Event::ScenesCounted {
            done: done.fetch_add(1, Ordering::Relaxed) + 1,
            total,
        });
        Ok(record)
    };
    let answered: Vec<PairRecord> = left.par_iter().map(answer).collect::<Result<_, _>>()?;
    known.extend(
        answered
            .into_iter()
            .map(|record| (record.pair.clone(), record)),
    );
    let ordered: Vec<PairRecord> = words.iter().filter_map(|word| known.remove(word)).collect();
    Ok(TwinResults::new(name, blake3, &ordered))
}

/// The folder of a model's answers to questions that these words name, and BLAKE3 of the words. Its
/// name has the digest of all that answers depend on: those to other prompts are never taken for
/// these.
pub(crate) fn answers_folder(
    runs: &Path,
    name: &str,
    words: &[String],
    loaded: &LoadedModel,
    config: &Config,
) -> Result<(PathBuf, String), RunnerError> {
    let blake3 = ScenarioList::digest(words);
    let list = ScenarioList {
        count: words.len(),
        blake3: blake3.clone(),
        words: words.to_vec(),
        ..ScenarioList::default()
    };
    let planner = PlannerName::PLAN_AGENT;
    let settings = relevant(config.clone(), planner.as_str(), PlannerNeeds::Model);
    let planners = vec![planner.to_string()];
    let commands = Commands::default();
    let subject = RunSubject {
        planners,
        commands: &commands,
        challenges: Vec::new(),
        scenarios: list,
        data: BTreeMap::new(),
    };
    let manifest = manifest(subject, Some(loaded), &settings)?;
    // Digests of prompts and model files, which a manifest keeps apart.
    let inputs = format!(
        "{:?}",
        manifest
            .inputs
            .as_ref()
            .expect("a new manifest has its inputs")
    );
    let digest = ScenarioList::digest([manifest.digest(), inputs]);
    let digest = digest.get(..DIGEST).unwrap_or(&digest);
    Ok((runs.join(format!("{name}-{digest}")), blake3))
}

/// Writes the results; `command` made them.
pub(super) fn write(
    folder: &StudyFolder,
    results: &[TwinResults],
    command: &str,
) -> Result<(), RunnerError> {
    let of_list = |results: &TwinResults| {
        let list = markdown_line(&results.list);
        format!("\n## {list}\n\n{}", twin_markdown(results))
    };
    let lists: String = results.iter().map(of_list).collect();
    let command = markdown_block("console", &format!("$ {command}"));
    let markdown = format!("# {TITLE}\n\n{command}\n{lists}");
    let json = serde_json::to_string_pretty(&json_value(&results)?)? + "\n";
    Ok(folder.write_files(&[("results.md", markdown), ("results.json", json)])?)
}
