//! `metrics/METRIC.parquet`: a file for each metric, with a row for each simulation.

use super::table::{Column, Columns, TableWriter};
use crate::report::file_names::NamePart;
use crate::report::{ReportError, SimulationRow};
use planagent_files::OpenFolder;
use planagent_score::metrics::{MetricResult, ScoreUnit, Statistic, StatisticKind};
use std::collections::BTreeMap;

/// Simulations in memory at a time.
const BATCH: usize = 256;

/// A statistic of a metric, with what is the same in all simulations.
#[derive(Debug, Clone, PartialEq)]
struct StatisticColumns {
    name: String,
    kind: StatisticKind,
    unit: String,
}

impl From<&Statistic> for StatisticColumns {
    fn from(statistic: &Statistic) -> Self {
        Self {
            name: statistic.name.clone(),
            kind: statistic.kind,
            unit: statistic.unit.clone(),
        }
    }
}

/// What a metric has in any simulation.
#[derive(Debug, Default)]
struct Schema {
    /// Whether it has a score.
    scored: bool,
    /// In the order of their first occurrence. Some occur in few simulations, such as the energies
    /// of collisions.
    statistics: Vec<StatisticColumns>,
}

impl Schema {
    fn add(&mut self, metric: &MetricResult) {
        self.scored |= metric.score.is_some();
        for statistic in &metric.statistics {
            if !self
                .statistics
                .iter()
                .any(|known| known.name == statistic.name)
            {
                self.statistics.push(statistic.into());
            }
        }
    }
}

/// A row: the simulation and its result.
type Row<'a> = (&'a SimulationRow, MetricResult);

/// Writes the files in two passes over the simulations: one for the columns, one for the values.
pub(in crate::report) fn write_metric_files<'a>(
    folder: &OpenFolder,
    simulations: impl Iterator<Item = Result<(&'a SimulationRow, Vec<MetricResult>), ReportError>>
    + Clone,
) -> Result<(), ReportError> {
    let mut schemas: BTreeMap<String, Schema> = BTreeMap::new();
    // Two passes: the columns depend on all simulations, and those of a large run need not fit the
    // memory.
    for simulation in simulations.clone() {
        for metric in simulation?.1 {
            schemas.entry(metric.name.clone()).or_default().add(&metric);
        }
    }
    let mut tables: BTreeMap<String, MetricTable<'a>> = schemas
        .into_iter()
        .map(|(name, schema)| {
            (
                name,
                MetricTable {
                    schema,
                    waiting: Vec::new(),
                    writer: None,
                },
            )
        })
        .collect();
    for simulation in simulations {
        let (row, metrics) = simulation?;
        for metric in metrics {
            let name = metric.name.clone();
            if let Some(table) = tables.get_mut(&name) {
                table.waiting.push((row, metric));
                if table.waiting.len() == BATCH {
                    table.flush(folder, &name)?;
                }
            }
        }
    }
    for (name, mut table) in tables {
        table.flush(folder, &name)?;
        if let Some(writer) = table.writer {
            writer.finish()?;
        }
    }
    Ok(())
}

/// A file in progress.
struct MetricTable<'a> {
    schema: Schema,
    waiting: Vec<Row<'a>>,
    writer: Option<TableWriter>,
}

impl MetricTable<'_> {
    fn flush(&mut self, folder: &OpenFolder, name: &str) -> Result<(), ReportError> {
        if self.waiting.is_empty() {
            return Ok(());
        }
        let columns = columns(&self.schema, &self.waiting);
        self.waiting.clear();
        if let Some(writer) = &mut self.writer {
            writer.append(columns)
        } else {
            let name = NamePart::parse(name).map_err(ReportError::at(folder.path()))?;
            let file = format!("{name}.parquet");
            self.writer = Some(TableWriter::begin(folder, &file, columns)?);
            Ok(())
        }
    }
}

/// The columns of the devkit's `construct_dataframe` and `MetricStatistics.serialize_dataframe`.
fn columns(schema: &Schema, rows: &[Row<'_>]) -> Columns {
    let text = |of: fn(&SimulationRow) -> &str| Column::text(rows.iter().map(|(row, _)| of(row)));
    let of_metric = |of: fn(&MetricResult) -> Option<&str>| {
        Column::Text(
            rows.iter()
                .map(|(_, metric)| of(metric).map(str::to_owned))
                .collect(),
        )
    };
    let scores = rows.iter().map(|(_, metric)| metric.score);
    let scores = if schema.scored {
        Column::Float(scores.collect())
    } else {
        Column::Nulls(rows.len())
    };
    let mut all = vec![
        ("log_name".to_owned(), text(|row| &row.log_name)),
        ("scenario_name".to_owned(), text(|row| &row.scenario)),
        ("scenario_type".to_owned(), text(|row| &row.scenario_type)),
        ("planner_name".to_owned(), text(|row| &row.planner)),
        (
            "metric_computator".to_owned(),
            of_metric(|metric| Some(&metric.computator)),
        ),
        (
            "metric_statistics_name".to_owned(),
            of_metric(|metric| Some(&metric.name)),
        ),
        ("metric_score".to_owned(), scores),
        (
            "metric_score_unit".to_owned(),
            of_metric(|metric| metric.score_unit.map(ScoreUnit::as_str)),
        ),
        (
            "metric_category".to_owned(),
            of_metric(|metric| Some(metric.category.as_str())),
        ),
    ];
    for StatisticColumns { name, kind, unit } in &schema.statistics {
        let found: Vec<Option<&Statistic>> = rows
            .iter()
            .map(|(_, metric)| metric.statistics.iter().find(|s| s.name == *name))
            .collect();
        // Type and unit stand in every row, because nuBoard takes the unit of a planner's first row
        // for all of its rows.
        all.push((
            format!("{name}_stat_type"),
            Column::text(rows.iter().map(|_| kind.name())),
        ));
        all.push((
            format!("{name}_stat_unit"),
            Column::text(rows.iter().map(|_| unit.as_str())),
        ));
        all.push((format!("{name}_stat_value"), values(*kind, &found)));
    }
    all.extend(time_series(rows));
    all
}

/// Booleans and counts have their own types, as in the devkit.
fn values(kind: StatisticKind, found: &[Option<&Statistic>]) -> Column {
    let values = found.iter().map(|statistic| statistic.map(|s| s.value));
    match kind {
        StatisticKind::Boolean => {
            Column::Boolean(values.map(|value| value.map(|v| v > 0.5)).collect())
        }
        StatisticKind::Count => {
            Column::Integer(values.map(|value| value.map(|v| v as i64)).collect())
        }
        _ => Column::Float(values.collect()),
    }
}

fn time_series(rows: &[Row<'_>]) -> Columns {
    let series = || rows.iter().map(|(_, metric)| metric.time_series.as_ref());
    let units = series()
        .map(|series| series.map(|s| s.unit.clone()))
        .collect();
    let times = series()
        .map(|series| series.map(|s| s.time_stamps.clone()))
        .collect();
    let values = series()
        .map(|series| series.map(|s| s.values.clone()))
        .collect();
    let frames = series().map(|series| {
        let frames = series.and_then(|s| s.selected_frames.as_ref());
        frames.map(|frames| frames.iter().map(|&frame| frame as i64).collect())
    });
    let frames = frames.collect();
    vec![
        ("time_series_unit".to_owned(), Column::Text(units)),
        ("time_series_timestamps".to_owned(), Column::Integers(times)),
        ("time_series_values".to_owned(), Column::Floats(values)),
        (
            "time_series_selected_frames".to_owned(),
            Column::Integers(frames),
        ),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use planagent_agent::simulation::Challenge;
    use planagent_score::metrics::metric;

    #[test]
    fn a_statistic_that_a_simulation_lacks_has_no_value() {
        let metric = metric("speed_limit_compliance").unwrap();
        let count = "number_of_violations_of_speed_limit_compliance";
        let kept = Statistic::boolean(metric.name, true);
        let broken = vec![
            Statistic::count(count, 2),
            Statistic::boolean(metric.name, false),
        ];
        let row =
            SimulationRow::example("changing_lane", 0, "idm", Challenge::NonReactive, Some(1.0));
        let rows = [
            (&row, metric.scored(0.5, broken)),
            (&row, metric.scored(1.0, vec![kept])),
        ];
        let columns = columns_of(&rows);
        assert_eq!(
            columns[&format!("{count}_stat_value")],
            Column::Integer(vec![Some(2), None])
        );
        assert_eq!(
            columns[&format!("{count}_stat_type")],
            Column::text(["COUNT"; 2])
        );
        assert_eq!(
            columns[&format!("{count}_stat_unit")],
            Column::text(["count"; 2])
        );
        assert_eq!(
            columns["speed_limit_compliance_stat_value"],
            Column::Boolean(vec![Some(false), Some(true)])
        );
    }

    #[test]
    fn a_metric_without_scores_has_nulls_that_pandas_reads_as_none() {
        let metric = metric("ego_jerk").unwrap();
        let row =
            SimulationRow::example("changing_lane", 0, "idm", Challenge::NonReactive, Some(1.0));
        let columns = columns_of(&[
            (&row, metric.unscored(Vec::new())),
            (&row, metric.unscored(Vec::new())),
        ]);
        assert_eq!(columns["metric_score"], Column::Nulls(2));
    }

    fn columns_of(rows: &[Row<'_>]) -> BTreeMap<String, Column> {
        let mut schema = Schema::default();
        for (_, metric) in rows {
            schema.add(metric);
        }
        columns(&schema, rows).into_iter().collect()
    }
}
