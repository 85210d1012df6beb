//! The index of a page: runs, metrics, drives with their scores, means and times.

use super::simulation::{SimulationParts, four_figures};
use super::source::RunSimulations;
use crate::metrics::{MetricList, MetricSpec, Role};
use crate::report::simulation_row::SimulationRow;
use crate::report::summary::{Aggregate, Summary, distinct};
use crate::report::timing::PlannerTiming;
use crate::simulation::Challenge;
use crate::world::PACIFICA;
use serde::Serialize;
use std::collections::BTreeMap;

/// All but the replays.
#[derive(Debug, Serialize)]
pub(super) struct Index {
    vehicle: Vehicle,
    runs: Vec<RunEntry>,
    metrics: Vec<MetricEntry>,
    pub(super) simulations: Vec<SimulationEntry>,
    aggregates: Vec<AggregateEntry>,
    timings: Vec<TimingEntry>,
    /// Drives that can be watched.
    pub(super) replays: usize,
}

/// Measures of the ego, metres.
#[derive(Debug, Serialize)]
struct Vehicle {
    length: f64,
    width: f64,
    rear_axle_to_center: f64,
}

#[derive(Debug, Serialize)]
struct RunEntry {
    name: String,
    version: String,
    started: String,
    model: Option<String>,
    seed: Option<f64>,
    /// λ.
    threshold: Option<f64>,
    /// Drives that have ended, and those that there will be.
    simulations: usize,
    planned: usize,
}

#[derive(Debug, Serialize)]
struct MetricEntry {
    name: &'static str,
    list: MetricList,
    /// None for a multiplier.
    weight: Option<f64>,
}

/// A drive; runs are named by their place in [`Index::runs`].
#[derive(Debug, Serialize)]
pub(super) struct SimulationEntry {
    run: usize,
    number: usize,
    pub(super) scenario: String,
    #[serde(rename = "type")]
    scenario_type: String,
    planner: String,
    challenge: Challenge,
    score: Option<f64>,
    error: Option<String>,
    zeroed_by: Vec<String>,
    metrics: BTreeMap<String, Option<f64>>,
    /// Number of the element that holds its replay, of that with its map, and of that with its pictures.
    pub(super) replay: Option<usize>,
    pub(super) map: Option<usize>,
    pub(super) images: Option<usize>,
    /// Why there is no replay.
    pub(super) absent: Option<Absent>,
}

/// Why a drive cannot be watched.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Absent {
    /// The run kept no replay.
    Run,
    /// Replays of other scenarios were asked for.
    Scenario,
    /// The page would have grown too large.
    Size,
}

#[derive(Debug, Serialize)]
struct AggregateEntry {
    run: usize,
    #[serde(flatten)]
    aggregate: Aggregate,
}

#[derive(Debug, Serialize)]
struct TimingEntry {
    run: usize,
    planner: String,
    step_ms: Option<f64>,
    call_p50_ms: Option<f64>,
    call_p95_ms: Option<f64>,
}

/// The statistics of all drives: a column a statistic, a row a drive in the order of [`Index::drives`].
#[derive(Debug, Serialize)]
pub(super) struct Statistics {
    columns: Vec<Column>,
    rows: Vec<Vec<Option<f64>>>,
}

#[derive(Debug, Serialize)]
struct Column {
    metric: String,
    statistic: String,
    unit: String,
    category: &'static str,
}

impl Index {
    /// The index of runs; no drive names a replay yet.
    pub(super) fn of(runs: &[RunSimulations], parts: &[SimulationParts], wanted: impl Fn(&str) -> bool) -> Self {
        let rows =
            runs.iter().enumerate().flat_map(|(run, simulations)| simulations.rows.iter().map(move |row| (run, row)));
        let absent = |row: &SimulationRow, parts: &SimulationParts| match (parts.was_kept, wanted(&row.scenario)) {
            (false, _) => Some(Absent::Run),
            (true, false) => Some(Absent::Scenario),
            (true, true) => None,
        };
        Self {
            vehicle: Vehicle {
                length: PACIFICA.length(),
                width: PACIFICA.width,
                rear_axle_to_center: PACIFICA.rear_axle_to_center(),
            },
            runs: runs.iter().map(RunEntry::of).collect(),
            metrics: metrics(),
            simulations: rows
                .zip(parts)
                .map(|((run, row), part)| SimulationEntry::of(run, row, absent(row, part)))
                .collect(),
            aggregates: runs
                .iter()
                .enumerate()
                .flat_map(|(run, simulations)| aggregates(run, &simulations.rows))
                .collect(),
            timings: runs.iter().enumerate().flat_map(|(run, simulations)| timings(run, &simulations.rows)).collect(),
            replays: 0,
        }
    }
}

impl RunEntry {
    fn of(run: &RunSimulations) -> Self {
        Self {
            name: run.name.clone(),
            version: run.manifest.planagent.clone(),
            started: run.manifest.started.clone(),
            model: run.model().map(str::to_owned),
            seed: run.setting("seed"),
            threshold: run.setting("reflection.threshold"),
            simulations: run.rows.len(),
            planned: run.manifest.simulations(),
        }
    }
}

impl SimulationEntry {
    fn of(run: usize, row: &SimulationRow, absent: Option<Absent>) -> Self {
        Self {
            run,
            number: row.number,
            scenario: row.scenario.clone(),
            scenario_type: row.scenario_type.clone(),
            planner: row.planner.clone(),
            challenge: row.challenge,
            score: row.score,
            error: row.error.clone(),
            zeroed_by: row.zeroed_by.clone(),
            metrics: row.metrics.iter().map(|metric| (metric.name.clone(), metric.score)).collect(),
            replay: None,
            map: None,
            images: None,
            absent,
        }
    }
}

fn metrics() -> Vec<MetricEntry> {
    let entry = |list, metric: &MetricSpec| MetricEntry {
        name: metric.name,
        list,
        weight: match metric.role {
            Role::Weight(weight) => Some(weight),
            Role::Multiplier | Role::Unscored => None,
        },
    };
    let of = |list: MetricList| list.scored().map(move |metric| entry(list, metric));
    of(MetricList::ClosedLoop).chain(of(MetricList::OpenLoop)).collect()
}

fn aggregates(run: usize, rows: &[SimulationRow]) -> Vec<AggregateEntry> {
    let summary = Summary::new(0, None, &[], rows);
    let all = summary.aggregates.into_iter().chain(summary.scenario_types);
    all.map(|aggregate| AggregateEntry { run, aggregate }).collect()
}

fn timings(run: usize, rows: &[SimulationRow]) -> Vec<TimingEntry> {
    let planners = distinct(rows.iter().map(|row| row.planner.as_str()));
    let entry = |planner: &str| {
        let timing = PlannerTiming::of(planner, rows);
        TimingEntry {
            run,
            planner: timing.planner,
            step_ms: timing.mean_iteration_ms,
            call_p50_ms: timing.planning_call_ms.map(|call| call.p50),
            call_p95_ms: timing.planning_call_ms.map(|call| call.p95),
        }
    };
    planners.into_iter().map(entry).collect()
}

/// The statistics of drives.
pub(super) fn statistics(parts: &[SimulationParts]) -> Statistics {
    let mut places: BTreeMap<(&str, &str), usize> = BTreeMap::new();
    let mut columns = Vec::new();
    for (metric, category, statistic) in parts.iter().flat_map(|part| &part.statistics) {
        places.entry((metric, &statistic.name)).or_insert_with(|| {
            columns.push(Column {
                metric: metric.clone(),
                statistic: statistic.name.clone(),
                unit: statistic.unit.clone(),
                category,
            });
            columns.len() - 1
        });
    }
    let row = |part: &SimulationParts| {
        let mut row = vec![None; columns.len()];
        for (metric, _, statistic) in &part.statistics {
            if let Some(&place) = places.get(&(metric.as_str(), statistic.name.as_str())) {
                row[place] = four_figures(statistic.value);
            }
        }
        row
    };
    Statistics { rows: parts.iter().map(row).collect(), columns }
}
