//! Text twins as a test of a model: whether its first code is right in both scenes of a pair, with
//! Reflection off.
//!
//! The privileged search drew the lists before any model answered.

use super::dataset::twins::{self, NoPair, PairName, TwinScene};
use planagent_agent::environment::BevView;
use planagent_agent::planner::{
    AgentLayer as _, CodeSource, Planner as _, PlannerInput, PlanningCall,
};
use planagent_agent::reasoning::{PlannerAnswer, PlannerCode, PromptError, PromptSet};
use planagent_runs::worker::run::{AgentParts, with_causes};
use planagent_runs::worker::seeds::Split;
use planagent_runs::worker::statistics::wilson;
use planagent_scenario::generator::ScenarioType;
use planagent_scenario::modified::TwinKind;
use planagent_world::SceneView;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Name of the list of test pairs.
pub const TEST: &str = "twins";
/// Name of the list of validation pairs.
pub const VALIDATION: &str = "twins-validation";
/// Names of the lists.
pub const NAMES: [&str; 2] = [TEST, VALIDATION];

/// Pairs of each kind in [`TEST`].
pub const TEST_PAIRS: usize = 130;
/// Pairs of each kind in [`VALIDATION`].
pub const VALIDATION_PAIRS: usize = 25;
/// First seed of a split that candidates may have: those before belong to other suites.
const FIRST_SEED: u64 = 2_000;
/// Candidates that are tried at once; the list does not depend on it.
const BATCH: u64 = 80;
/// Prompt sets in which a pair of a list has the same prompts; that of [`draw`] is the first.
const PROMPT_SETS: [&str; 2] = ["compact-2", "compact"];

const TEST_LIST: &str = include_str!("../../suites/twins.txt");
const VALIDATION_LIST: &str = include_str!("../../suites/twins-validation.txt");
const HEADER: &str = "\
# Text twins: pairs of scenes with the same prompts, other pictures and other best codes, of each kind the first that fit, seed by seed.
# Drawn by the search before any model answered, by: planagent scenarios twins --seeds ";

/// The pairs of a list; `None` for other names.
pub fn list(name: &str) -> Option<Vec<PairName>> {
    let text = match name {
        TEST => TEST_LIST,
        VALIDATION => VALIDATION_LIST,
        _ => return None,
    };
    Some(
        text.lines()
            .filter(|line| !line.starts_with('#'))
            .filter_map(|line| line.parse().ok())
            .collect(),
    )
}

/// The pairs of the list [`TEST`].
pub(crate) fn test() -> Vec<PairName> {
    list(TEST).expect("the list of test pairs is built in")
}

/// So many pairs of a list, evenly of each kind.
pub(crate) fn evenly(pairs: &[PairName], limit: usize) -> Vec<PairName> {
    let of_kind = |kind: TwinKind| pairs.iter().copied().filter(move |pair| pair.kind == kind);
    let kinds = TwinKind::ALL.len();
    let of = TwinKind::ALL.into_iter().enumerate();
    of.flat_map(|(place, kind)| {
        of_kind(kind).take(limit / kinds + usize::from(place < limit % kinds))
    })
    .collect()
}

#[cfg(test)]
#[test]
fn twins_are_taken_evenly_from_the_kinds() {
    let all = test();
    for limit in [1, 4, 6, 10_000] {
        let pairs = evenly(&all, limit);
        assert_eq!(pairs.len(), limit.min(all.len()));
        let of = |kind| pairs.iter().filter(|pair| pair.kind == kind).count();
        let counts = TwinKind::ALL.map(of);
        assert!(
            counts.iter().max().unwrap() - counts.iter().min().unwrap() <= 1,
            "{limit}: {counts:?}"
        );
    }
}

/// The pairs that were drawn, and what became of the candidates.
#[derive(Debug, Clone, Default)]
pub struct Drawn {
    /// Kind by kind, in the order of their seeds.
    pub pairs: Vec<PairName>,
    /// Candidates that are no pairs, by kind, reason and type.
    pub refused: BTreeMap<(TwinKind, NoPair, ScenarioType), usize>,
}

/// Draws the first `per_kind` pairs of each kind among the seeds of a split, or among its first
/// `candidates`. `on_pairs` gets the number of pairs found.
///
/// # Errors
/// When a prompt set cannot be used.
pub fn draw(
    split: Split,
    per_kind: usize,
    candidates: Option<u64>,
    on_pairs: &dyn Fn(usize),
) -> Result<Drawn, PromptError> {
    let sets = PROMPT_SETS
        .map(PromptSet::open)
        .into_iter()
        .collect::<Result<Vec<_>, _>>()?;
    let first = split.seeds().start + FIRST_SEED;
    let mut drawn = Drawn::default();
    let count = |drawn: &Drawn, kind| drawn.pairs.iter().filter(|pair| pair.kind == kind).count();
    let mut next = 0;
    let last = split.seeds().end;
    let end = candidates.map_or(last, |count| first.saturating_add(count).min(last));
    while TwinKind::ALL
        .into_iter()
        .any(|kind| count(&drawn, kind) < per_kind)
        && first + next < end
    {
        let wanted = |names: &[PairName; 2]| count(&drawn, names[0].kind) < per_kind;
        // Batches in the order of the seeds: the list does not depend on the threads.
        let candidates = (next..(next + BATCH).min(end - first))
            .map(|number| PairName::candidates(first + number, number, true));
        let candidates: Vec<[PairName; 2]> = candidates.filter(wanted).collect();
        let tried = candidates.par_iter().map(|names| {
            twins::open_first(names, &sets, &BevView::default())
                .map(|(name, opened)| (name, opened.err()))
        });
        for (name, refused) in tried.collect::<Result<Vec<_>, _>>()? {
            match refused {
                Some(why) => {
                    *drawn
                        .refused
                        .entry((name.kind, why, name.base.scenario_type))
                        .or_default() += 1;
                }
                None if count(&drawn, name.kind) < per_kind => drawn.pairs.push(name),
                None => {}
            }
        }
        on_pairs(drawn.pairs.len());
        next += BATCH;
    }
    drawn.pairs.sort_by_key(|pair| pair.kind);
    Ok(drawn)
}

/// The text of a list.
pub fn list_text(split: Split, per_kind: usize, pairs: &[PairName]) -> String {
    let header = format!("{HEADER}{} --count {per_kind}\n", split.as_str());
    pairs
        .iter()
        .fold(header, |list, pair| format!("{list}{pair}\n"))
}

/// What a model answered to a pair.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PairRecord {
    pub pair: String,
    pub kind: String,
    /// Why the pair does not count for this model or program; its scenes are missing then.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dropped: Option<String>,
    /// The scene in which the ego's lane is closed, then the other.
    pub scenes: Vec<SceneRecord>,
}

/// What a model answered in one scene of a pair.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SceneRecord {
    /// Best code of the search.
    pub best: String,
    /// The model's first code; none if its answer could not be read.
    pub answer: Option<String>,
    /// What the best code gains over it in the search's value; none if it gives no plan.
    pub loss: Option<f64>,
    /// Whether it is as good as the best one.
    pub right: bool,
    /// Whether the best code of the other scene is.
    pub other_is_right: bool,
}

/// Asks the model of `parts` in both scenes of a pair.
///
/// # Errors
/// When a prompt cannot be made, or the planning call fails.
pub fn judge(name: &PairName, parts: &AgentParts) -> Result<PairRecord, TwinError> {
    let Some(CodeSource::Model { prompts, .. }) = &parts.model else {
        return Err(TwinError::NoModel);
    };
    let record = |dropped, scenes| PairRecord {
        pair: name.to_string(),
        kind: name.kind.to_string(),
        dropped,
        scenes,
    };
    let mut parts = parts.clone();
    // After a refusal the agent would ask again, and the test is about its first code.
    parts.settings.reflection.enabled = false;
    let view = BevView::new(
        BevView::default().pixels(),
        parts.settings.environment.view_m,
    )?;
    let pair = match twins::open(name, std::slice::from_ref(prompts.as_ref()), &view)? {
        Ok(pair) => pair,
        Err(why) => return Ok(record(Some(why.to_string()), Vec::new())),
    };
    let [own, beside] = &pair;
    let scenes =
        [(own, beside), (beside, own)].map(|(scene, other)| -> Result<SceneRecord, TwinError> {
            let answer = first_code(name, scene, &parts)?;
            let value = answer.and_then(|code| scene.value(code));
            Ok(SceneRecord {
                best: scene.best.code.to_string(),
                answer: answer.map(|code| code.to_string()),
                loss: value.map(|value| scene.best.value - value),
                right: answer.is_some_and(|code| scene.is_right(code)),
                other_is_right: scene.is_right(other.best.code),
            })
        });
    Ok(record(None, scenes.into_iter().collect::<Result<_, _>>()?))
}

#[derive(Debug, thiserror::Error)]
pub enum TwinError {
    #[error(transparent)]
    Prompt(#[from] PromptError),
    #[error(transparent)]
    View(#[from] planagent_agent::environment::BevError),
    #[error("there is no model to ask")]
    NoModel,
    #[error("{pair}: {fault}")]
    Call { pair: String, fault: String },
}

/// The first code of the model at the present of a scene; none if its answer could not be read.
fn first_code(
    name: &PairName,
    scene: &TwinScene,
    parts: &AgentParts,
) -> Result<Option<PlannerCode>, TwinError> {
    let id = &scene.simulation.scenario().id;
    let call = first_call(parts, id, scene.simulation.scene())?;
    let call = call.map_err(|fault| TwinError::Call {
        pair: name.to_string(),
        fault,
    })?;
    Ok(call
        .attempts
        .first()
        .and_then(|attempt| attempt.answer.as_ref())
        .and_then(PlannerAnswer::code))
}

/// The first planning call of the agent of `parts` in a scene; or why it failed.
///
/// # Errors
/// When there is no model.
pub(crate) fn first_call(
    parts: &AgentParts,
    scenario_id: &str,
    scene: SceneView<'_>,
) -> Result<Result<PlanningCall, String>, TwinError> {
    let mut agent = parts.agent(scenario_id).ok_or(TwinError::NoModel)?;
    agent.state_mut().request_call();
    let input = PlannerInput {
        iteration: 0,
        scene,
    };
    if let Err(error) = agent.compute_trajectory(&input) {
        return Ok(Err(with_causes(&error)));
    }
    let call = agent.take_calls().pop();
    Ok(call.ok_or_else(|| "the agent made no planning call".to_owned()))
}

/// Shares over the pairs of a kind, percent.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TwinRow {
    /// The kind, or `all`.
    pub kind: String,
    pub pairs: usize,
    /// The first code is right in both scenes.
    pub both: f64,
    /// Wilson's interval of that, 95 %.
    pub both_interval: [f64; 2],
    /// It is right in one scene.
    pub one: f64,
    /// It is right in neither.
    pub none: f64,
    /// It is the same in both scenes: right in one at most.
    pub same: f64,
    /// Right in both, if a fair coin chose one of the two best codes in each scene.
    pub coin: f64,
}

/// What a list of pairs came to.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TwinResults {
    /// Name of the list.
    pub list: String,
    /// BLAKE3 of its lines.
    pub blake3: String,
    /// Pairs that do not count, by reason.
    pub dropped: BTreeMap<String, usize>,
    /// All pairs, then kind by kind.
    pub rows: Vec<TwinRow>,
}

impl TwinResults {
    /// The shares of records.
    pub fn new(list: &str, blake3: String, records: &[PairRecord]) -> Self {
        let mut dropped = BTreeMap::new();
        for why in records.iter().filter_map(|record| record.dropped.clone()) {
            *dropped.entry(why).or_default() += 1;
        }
        let all: Vec<&PairRecord> = records
            .iter()
            .filter(|record| record.dropped.is_none())
            .collect();
        let of_kind = |kind: TwinKind| {
            let own: Vec<&PairRecord> = all
                .iter()
                .copied()
                .filter(|record| record.kind == kind.name())
                .collect();
            (!own.is_empty()).then(|| TwinRow::from_records(kind.name(), &own))
        };
        let rows = std::iter::once(TwinRow::from_records("all", &all))
            .chain(TwinKind::ALL.into_iter().filter_map(of_kind));
        Self {
            list: list.to_owned(),
            blake3,
            dropped,
            rows: rows.collect(),
        }
    }
}

impl TwinRow {
    fn from_records(kind: &str, records: &[&PairRecord]) -> Self {
        let right = |record: &PairRecord| record.scenes.iter().filter(|scene| scene.right).count();
        let with = |count: usize| {
            records
                .iter()
                .filter(|record| right(record) == count)
                .count()
        };
        let is_same = |record: &&&PairRecord| match record.scenes.as_slice() {
            [one, other] => one.answer == other.answer,
            _ => false,
        };
        // Of four choices the one of both best codes is right, and others where a best code is
        // right in the other scene.
        let coin = |record: &&PairRecord| {
            let in_scene = |scene: &SceneRecord| if scene.other_is_right { 1.0 } else { 0.5 };
            record.scenes.iter().map(in_scene).product::<f64>()
        };
        let share = |count: f64| 100.0 * count / records.len().max(1) as f64;
        Self {
            kind: kind.to_owned(),
            pairs: records.len(),
            both: share(with(2) as f64),
            both_interval: wilson(with(2), records.len()).map(|bound| 100.0 * bound),
            one: share(with(1) as f64),
            none: share(with(0) as f64),
            same: share(records.iter().filter(is_same).count() as f64),
            coin: share(records.iter().map(coin).sum()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    fn record(kind: &str, right: [bool; 2], answers: [&str; 2]) -> PairRecord {
        let scene = |i: usize| SceneRecord {
            best: "best".to_owned(),
            answer: Some(answers[i].to_owned()),
            loss: Some(0.0),
            right: right[i],
            other_is_right: false,
        };
        PairRecord {
            pair: "pair".to_owned(),
            kind: kind.to_owned(),
            dropped: None,
            scenes: vec![scene(0), scene(1)],
        }
    }

    #[test]
    fn both_scenes_must_be_right() {
        let lost = PairRecord {
            dropped: Some("the prompts differ".to_owned()),
            scenes: Vec::new(),
            ..record("taper", [true; 2], ["a", "b"])
        };
        let records = [
            record("taper", [true; 2], ["a", "b"]),
            record("taper", [true, false], ["a", "a"]),
            record("person", [false; 2], ["b", "a"]),
            lost,
        ];
        let results = TwinResults::new("twins", String::new(), &records);
        let [all, taper, person] = results.rows.as_slice() else {
            panic!("{results:?}")
        };
        assert_eq!(
            (
                all.pairs,
                all.kind.as_str(),
                results.dropped["the prompts differ"]
            ),
            (3, "all", 1)
        );
        assert!((all.both - 100.0 / 3.0).abs() < 1e-9 && (all.coin - 25.0).abs() < 1e-9);
        assert_eq!((taper.both, taper.one, taper.same), (50.0, 50.0, 50.0));
        assert_eq!((person.both, person.none), (0.0, 100.0));
        assert!(
            taper.both_interval[0] < 10.0 && taper.both_interval[1] > 90.0,
            "{taper:?}"
        );
    }

    #[test]
    fn the_lists_have_their_pairs_of_seeds_of_their_own() {
        for (name, split, per_kind) in [
            (TEST, Split::Test, TEST_PAIRS),
            (VALIDATION, Split::Validation, VALIDATION_PAIRS),
        ] {
            let pairs = list(name).unwrap();
            let seeds: BTreeSet<u64> = pairs.iter().map(|pair| pair.base.seed).collect();
            assert_eq!((pairs.len(), seeds.len()), (4 * per_kind, 4 * per_kind));
            assert!(seeds.iter().all(|seed| split.seeds().contains(seed)));
            assert_eq!(
                list_text(split, per_kind, &pairs),
                if name == TEST {
                    TEST_LIST
                } else {
                    VALIDATION_LIST
                }
            );
        }
    }
}
