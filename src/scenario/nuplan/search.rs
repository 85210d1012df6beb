//! Finds scenarios in logs: nuPlan's scenario query, then the filters in the devkit's order.

use super::database::{Database, Record};
use super::error::NuPlanError;
use super::exclusion::{Exclusion, Exclusions};
use super::filter::ScenarioFilter;
use super::filter_steps::{self, Filtered};
use super::logs::{Log, LogScenario, UnreadableLog};
use super::map_store::MapStore;
use super::schema::{EGO_POSE, LIDAR, LIDAR_PC, LOG, SCENARIO_TAG, SCENE};
use super::token::Token;
use crate::{OnProgress, UNKNOWN_TYPE};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

/// The result of a search.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct SearchResult {
    /// The scenarios, in order of their tokens, or shuffled.
    pub scenarios: Vec<LogScenario>,
    /// Tokens of the filter that no log holds, sorted.
    pub absent: Vec<Token>,
    /// Tokens of the filter that a log holds but that are no scenario of it, sorted.
    pub excluded: Vec<(Token, Exclusion)>,
    /// What was excluded, counted.
    pub exclusions: Exclusions,
    /// Logs that cannot be read, in order of names.
    pub unreadable: Vec<UnreadableLog>,
}

/// Finds the scenarios of a filter in logs, in parallel. Fails when no log can be read, when two
/// logs hold the same scenario, or when a map or file that a filter needs cannot be read.
pub fn search(
    logs: &[Arc<Log>],
    filter: &ScenarioFilter,
    maps: &MapStore,
    on_progress: OnProgress<'_>,
) -> Result<SearchResult, NuPlanError> {
    let done = AtomicUsize::new(0);
    let searched = logs.par_iter().map(|log| {
        let found = search_log(log, filter);
        on_progress(done.fetch_add(1, Ordering::Relaxed) + 1, logs.len());
        found
    });
    let searched: Vec<Result<Option<InLog>, NuPlanError>> = searched.collect();
    let mut result = SearchResult::default();
    let mut held: BTreeMap<Token, &Log> = BTreeMap::new();
    let mut excluded: BTreeMap<Token, Exclusion> = BTreeMap::new();
    let mut found = Vec::new();
    let mut first_error = None;
    // In the order of the logs, whichever thread was first: each run finds the same scenarios.
    for (log, searched) in logs.iter().zip(searched) {
        let in_log = match searched {
            Ok(Some(in_log)) => in_log,
            Ok(None) => {
                result.exclusions.other_logs += 1;
                continue;
            }
            Err(error) => {
                result.unreadable.push(UnreadableLog {
                    log: log.clone(),
                    cause: error.to_string(),
                });
                first_error.get_or_insert(error);
                continue;
            }
        };
        result.exclusions.logs += 1;
        for (exclusion, count) in in_log.counts {
            *result.exclusions.rows.entry(exclusion).or_default() += count;
        }
        for token in in_log
            .scenarios
            .iter()
            .map(|f| f.token)
            .chain(in_log.excluded.iter().map(|(token, _)| *token))
        {
            if let Some(first) = held.insert(token, log) {
                let (first, second) = (first.path.clone(), log.path.clone());
                return Err(NuPlanError::TwoLogs {
                    token,
                    first,
                    second,
                });
            }
        }
        found.extend(in_log.scenarios);
        excluded.extend(in_log.excluded);
    }
    if let Some(error) = first_error.filter(|_| result.exclusions.logs == 0) {
        return Err(error);
    }
    let Filtered {
        kept,
        excluded: filtered,
    } = filter_steps::apply(found, filter, maps)?;
    for (_, exclusion) in &filtered {
        *result.exclusions.rows.entry(*exclusion).or_default() += 1;
    }
    result.scenarios = kept;
    if let Some(wanted) = &filter.scenario_tokens {
        excluded.extend(filtered);
        result.excluded = excluded.into_iter().collect();
        let wanted: BTreeSet<Token> = wanted.iter().copied().collect();
        result.absent = wanted
            .into_iter()
            .filter(|token| !held.contains_key(token))
            .collect();
    }
    Ok(result)
}

/// All types among the tags of these logs, in alphabetical order. Logs that cannot be read are
/// skipped, unless all are: [`search`] reports them.
pub(crate) fn tag_types(logs: &[Arc<Log>]) -> Result<Vec<String>, NuPlanError> {
    let of_log = |log: &Arc<Log>| {
        let tags = tags(&log.open()?, None)?;
        Ok(tags.into_values().collect::<BTreeSet<String>>())
    };
    let read: Vec<Result<BTreeSet<String>, NuPlanError>> = logs.par_iter().map(of_log).collect();
    if read.iter().all(Result::is_err) {
        return read
            .into_iter()
            .collect::<Result<Vec<_>, _>>()
            .map(|_| Vec::new());
    }
    Ok(read
        .into_iter()
        .flatten()
        .flatten()
        .collect::<BTreeSet<String>>()
        .into_iter()
        .collect())
}

/// The scenarios of a filter in one log.
#[derive(Default)]
struct InLog {
    scenarios: Vec<LogScenario>,
    /// Tokens of the filter that are no scenario of it.
    excluded: Vec<(Token, Exclusion)>,
    /// Number of excluded rows by reason.
    counts: BTreeMap<Exclusion, usize>,
}

/// A row that may be a scenario.
struct Candidate {
    token: Token,
    time_us: i64,
    lidar: Token,
    scene: Option<Token>,
}

/// nuPlan's scenario query on one log: all rows of a valid scene that pass the filter, in order of
/// time. `None` for a log that the filter does not name.
fn search_log(log: &Arc<Log>, filter: &ScenarioFilter) -> Result<Option<InLog>, NuPlanError> {
    let named = filter
        .log_names
        .as_ref()
        .is_none_or(|names| names.contains(&log.name));
    if !named && filter.scenario_tokens.is_none() {
        return Ok(None);
    }
    let database = log.open()?;
    let candidates = candidates(&database, filter)?;
    if candidates.is_empty() {
        return Ok(Some(InLog::default()));
    }
    let tags = tags(&database, filter.scenario_types.as_deref())?;
    let scenes = scenes(&database)?;
    let maps = map_names(&database)?;
    let mut in_log = InLog::default();
    for candidate in candidates {
        let tag = tags.get(&candidate.token);
        let map_name = maps.get(&candidate.lidar);
        let scene = candidate.scene.and_then(|scene| scenes.get(&scene));
        // One chain in the devkit's order, so that each row is counted under the first rule that
        // excludes it.
        let exclusion = if !named {
            Some(Exclusion::OtherLog)
        } else if !scene.is_some_and(|scene| scene.is_valid) || map_name.is_none() {
            Some(Exclusion::SceneAtEdge)
        } else if filter.scenario_types.is_some() && tag.is_none() {
            Some(Exclusion::OtherType)
        } else if map_name.is_some_and(|map| {
            filter
                .map_names
                .as_ref()
                .is_some_and(|names| !names.contains(map))
        }) {
            Some(Exclusion::OtherMap)
        } else if filter.remove_invalid_goals && !scene.is_some_and(|scene| scene.has_goal) {
            Some(Exclusion::NoGoal)
        } else {
            None
        };
        match exclusion {
            None => in_log.scenarios.push(LogScenario {
                log: log.clone(),
                token: candidate.token,
                scenario_type: tag.cloned().unwrap_or_else(|| UNKNOWN_TYPE.to_owned()),
                timestamp_us: candidate.time_us,
                map_name: map_name.cloned().expect("a row without a map is excluded"),
            }),
            Some(exclusion) => {
                *in_log.counts.entry(exclusion).or_default() += 1;
                if filter.scenario_tokens.is_some() {
                    in_log.excluded.push((candidate.token, exclusion));
                }
            }
        }
    }
    Ok(Some(in_log))
}

/// The rows of the filter's tokens, of its types, or all, in order of time.
fn candidates(database: &Database, filter: &ScenarioFilter) -> Result<Vec<Candidate>, NuPlanError> {
    let mut found = Vec::new();
    let mut take = |record: &Record<'_>| {
        found.push(Candidate {
            token: record.token("token")?,
            time_us: record.integer("timestamp")?,
            lidar: record.token("lidar_token")?,
            scene: record.maybe_token("scene_token")?,
        });
        Ok(())
    };
    match &filter.scenario_tokens {
        // Without an index, a query per token would read the whole table each time.
        Some(tokens) if database.is_indexed(LIDAR_PC.name, "token")? => {
            for token in tokens {
                database.each(LIDAR_PC, "WHERE token = ?1", [token], &mut take)?;
            }
        }
        Some(tokens) => {
            let wanted: BTreeSet<Token> = tokens.iter().copied().collect();
            database.each(LIDAR_PC, "", [], |record| {
                if wanted.contains(&record.token("token")?) {
                    take(record)
                } else {
                    Ok(())
                }
            })?;
        }
        None if filter.scenario_types.is_some() => {
            database.each(
                LIDAR_PC,
                "WHERE token IN (SELECT lidar_pc_token FROM scenario_tag)",
                [],
                &mut take,
            )?;
        }
        None => database.each(LIDAR_PC, "", [], &mut take)?,
    }
    found.sort_by_key(|candidate| (candidate.time_us, candidate.token));
    Ok(found)
}

/// The alphabetically last of the wanted types of each tagged row.
fn tags(
    database: &Database,
    types: Option<&[String]>,
) -> Result<BTreeMap<Token, String>, NuPlanError> {
    let mut tags: BTreeMap<Token, String> = BTreeMap::new();
    database.each(SCENARIO_TAG, "", [], |record| {
        let Some(name) = record.maybe_name("type")? else {
            return Ok(());
        };
        if types.is_none_or(|types| types.contains(&name)) {
            let tag = tags.entry(record.token("lidar_pc_token")?).or_default();
            if *tag < name {
                *tag = name;
            }
        }
        Ok(())
    })?;
    Ok(tags)
}

/// A scene of a log.
struct SceneState {
    /// At least two scenes lie before it and two behind it, in order of names.
    is_valid: bool,
    has_goal: bool,
}

fn scenes(database: &Database) -> Result<BTreeMap<Token, SceneState>, NuPlanError> {
    let mut rows: Vec<(Token, Option<Token>)> = Vec::new();
    database.each(SCENE, "ORDER BY name ASC, scene.rowid", [], |record| {
        rows.push((
            record.token("token")?,
            record.maybe_token("goal_ego_pose_token")?,
        ));
        Ok(())
    })?;
    let count = rows.len();
    let mut scenes = BTreeMap::new();
    for (place, (token, goal)) in rows.into_iter().enumerate() {
        let has_goal = match goal {
            Some(goal) => database
                .first(EGO_POSE, "WHERE token = ?1", [goal], |_| Ok(()))?
                .is_some(),
            None => false,
        };
        let number = place + 1;
        scenes.insert(
            token,
            SceneState {
                is_valid: number >= 3 && number + 1 < count,
                has_goal,
            },
        );
    }
    Ok(scenes)
}

/// The map of each lidar of a log.
fn map_names(database: &Database) -> Result<BTreeMap<Token, String>, NuPlanError> {
    let mut of_log: BTreeMap<Token, String> = BTreeMap::new();
    database.each(LOG, "", [], |record| {
        of_log.insert(record.token("token")?, record.text("map_version")?);
        Ok(())
    })?;
    let mut of_lidar = BTreeMap::new();
    database.each(LIDAR, "", [], |record| {
        if let Some(map) = of_log.get(&record.token("log_token")?) {
            of_lidar.insert(record.token("token")?, map.clone());
        }
        Ok(())
    })?;
    Ok(of_lidar)
}
