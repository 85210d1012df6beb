//! The index of a page: runs, metrics, simulations, comparisons and times.

use super::comparison::{Comparison, comparisons};
use super::simulation::{SimulationParts, four_digits};
use super::source::RunSimulations;
use crate::report::replay::Sketch;
use crate::report::simulation_row::SimulationRow;
use crate::report::summary::ScenarioSummary;
use crate::report::timing::PlannerTiming;
use planagent_score::metrics::{MetricList, MetricSpec, Role, distinct, scored_metrics};
use planagent_world::{InteractionKind, PACIFICA};
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};

/// Everything but statistics and replays.
#[derive(Debug, Serialize)]
pub(super) struct Index {
    vehicle: Vehicle,
    runs: Vec<RunEntry>,
    metrics: Vec<MetricEntry>,
    pub(super) simulations: Vec<SimulationEntry>,
    comparisons: Vec<Comparison>,
    timings: Vec<OfRun<PlannerTiming>>,
    /// Number of simulations with a replay in the page.
    pub(super) replays: usize,
}

/// Dimensions of the ego, meters.
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
    /// Names of its planners, in order.
    planners: Vec<String>,
    seed: Option<f64>,
    thresholds: Thresholds,
    /// Whether the active plan is monitored between planning calls.
    monitoring: bool,
    /// `reflection.after_max_exec`: the attempt that is executed after all were refused.
    after_max_exec: Option<String>,
    /// Completed simulations, and all of the run.
    simulations: usize,
    planned: usize,
}

/// The scores that Reflection requires of a plan.
#[derive(Debug, Serialize)]
struct Thresholds {
    /// λ of plans that keep the lane.
    keep_lane: Option<f64>,
    /// λ of plans that begin a lane change or stay in a blocked lane.
    lane_change: Option<f64>,
    /// τ of LLM-ASSIST.
    assist: Option<f64>,
}

/// A metric of a score.
#[derive(Debug, Serialize)]
struct MetricEntry {
    name: &'static str,
    label: &'static str,
    list: MetricList,
    /// The kind of modified scenarios that has it in this role; none for nuPlan's score.
    kind: Option<&'static str>,
    /// The weight; none for a multiplier.
    weight: Option<f64>,
}

/// A simulation; `run` is an index into [`Index::runs`].
#[derive(Debug, Serialize)]
pub(super) struct SimulationEntry {
    run: usize,
    number: usize,
    #[serde(flatten)]
    pub(super) summary: ScenarioSummary,
    /// The kind by whose metrics it is scored; none: by nuPlan's.
    kind: Option<&'static str>,
    /// Numbers of the elements with its replay, its map and its images.
    pub(super) replay: Option<usize>,
    pub(super) map: Option<usize>,
    pub(super) images: Option<usize>,
    /// Why there is no replay.
    pub(super) absent: Option<Absent>,
    /// The recorded ego's path; only for the first simulation of a scenario.
    sketch: Option<Sketch>,
}

/// Why a simulation has no replay in the page.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Absent {
    /// The run has no replay.
    Run,
    /// Only replays of other scenarios were requested.
    Scenario,
    /// The page would be too large.
    Size,
}

/// A value of the run with the index `run`.
#[derive(Debug, Serialize)]
struct OfRun<T> {
    run: usize,
    #[serde(flatten)]
    value: T,
}

/// The statistics: a column each, with a row for each simulation in the order of
/// [`Index::simulations`].
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
    /// The index of runs, without the elements of the replays.
    pub(super) fn from_runs(
        runs: &[RunSimulations],
        parts: &[SimulationParts],
        wanted: impl Fn(&str) -> bool,
    ) -> Self {
        let rows = runs
            .iter()
            .enumerate()
            .flat_map(|(run, of_run)| of_run.rows.iter().map(move |row| (run, row)));
        let absent = |row: &SimulationRow, parts: &SimulationParts| match (
            parts.sketch.is_some(),
            wanted(&row.scenario),
        ) {
            (false, _) => Some(Absent::Run),
            (true, false) => Some(Absent::Scenario),
            (true, true) => None,
        };
        let mut sketched = BTreeSet::new();
        let entry =
            |((run, row), part): ((usize, &SimulationRow), &SimulationParts)| SimulationEntry {
                run,
                number: row.number,
                summary: ScenarioSummary::from(row),
                kind: row.scored_kind().map(InteractionKind::name),
                replay: None,
                map: None,
                images: None,
                absent: absent(row, part),
                sketch: part
                    .sketch
                    .clone()
                    // Planners share the sketch of a scenario.
                    .filter(|_| sketched.insert(row.scenario.clone())),
            };
        Self {
            vehicle: Vehicle {
                length: PACIFICA.length(),
                width: PACIFICA.width,
                rear_axle_to_center: PACIFICA.rear_axle_to_center(),
            },
            runs: runs.iter().map(RunEntry::from_run).collect(),
            metrics: metrics(runs),
            simulations: rows.zip(parts).map(entry).collect(),
            comparisons: comparisons(runs),
            timings: of_runs(runs, timings),
            replays: 0,
        }
    }
}

/// The values of each run.
fn of_runs<T>(runs: &[RunSimulations], values: fn(&[SimulationRow]) -> Vec<T>) -> Vec<OfRun<T>> {
    let of_run = |(run, simulations): (usize, &RunSimulations)| {
        values(&simulations.rows)
            .into_iter()
            .map(move |value| OfRun { run, value })
    };
    runs.iter().enumerate().flat_map(of_run).collect()
}

impl RunEntry {
    fn from_run(run: &RunSimulations) -> Self {
        Self {
            name: run.name.clone(),
            version: run.manifest.planagent.clone(),
            started: run.manifest.started.to_string(),
            model: run.model(),
            planners: run.manifest.planners.clone(),
            seed: run.setting("seed"),
            thresholds: Thresholds {
                keep_lane: run.setting("reflection.threshold"),
                lane_change: run.setting("reflection.lane_change_threshold"),
                assist: run
                    .setting("agent.gate")
                    .or_else(|| run.setting("reflection.threshold")),
            },
            monitoring: run.is_on("reflection.monitoring"),
            after_max_exec: run.word("reflection.after_max_exec").map(str::to_owned),
            simulations: run.rows.len(),
            planned: run.manifest.simulations(),
        }
    }
}

/// The metrics of nuPlan's scores, and of the kinds of modified scenarios that occur.
fn metrics(runs: &[RunSimulations]) -> Vec<MetricEntry> {
    let of = |list, kind: Option<InteractionKind>| {
        let entry = move |metric: MetricSpec| MetricEntry {
            name: metric.name,
            label: metric.label,
            list,
            kind: kind.map(InteractionKind::name),
            weight: if let Role::Weight(weight) = metric.role {
                Some(weight)
            } else {
                None
            },
        };
        scored_metrics(list, kind).into_iter().map(entry)
    };
    let rows = runs.iter().flat_map(|run| &run.rows);
    let kinds = distinct(rows.filter_map(SimulationRow::scored_kind));
    of(MetricList::ClosedLoop, None)
        .chain(of(MetricList::OpenLoop, None))
        .chain(
            kinds
                .into_iter()
                .flat_map(|kind| of(MetricList::ClosedLoop, Some(kind))),
        )
        .collect()
}

fn timings(rows: &[SimulationRow]) -> Vec<PlannerTiming> {
    let planners = distinct(rows.iter().map(|row| row.planner.as_str()));
    planners
        .into_iter()
        .map(|planner| PlannerTiming::from_rows(planner, rows))
        .collect()
}

/// The statistics of simulations.
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
                row[place] = four_digits(statistic.value);
            }
        }
        row
    };
    Statistics {
        rows: parts.iter().map(row).collect(),
        columns,
    }
}
