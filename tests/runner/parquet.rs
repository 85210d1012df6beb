//! nuPlan's result tree, read by the `parquet` crate and by pandas.

use super::{quick_run, simulations};
use crate::cli::{read_json, run};
use crate::outside::{Needy, python};
use arrow_array::cast::AsArray;
use arrow_array::types::{Float64Type, Int64Type};
use arrow_array::{Array, RecordBatch};
use arrow_schema::DataType;
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use serde_json::Value;
use std::fs::{self, File};
use std::path::{Path, PathBuf};
use std::process::Command;
use tempfile::TempDir;

/// The only batch of a small file.
fn read(path: &Path) -> RecordBatch {
    let file = File::open(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let mut reader = ParquetRecordBatchReaderBuilder::try_new(file)
        .unwrap()
        .build()
        .unwrap();
    let batch = reader.next().unwrap().unwrap();
    assert!(reader.next().is_none());
    batch
}

fn texts(batch: &RecordBatch, column: &str) -> Vec<Option<String>> {
    let array = batch
        .column_by_name(column)
        .unwrap_or_else(|| panic!("no column {column}"));
    array
        .as_string::<i32>()
        .iter()
        .map(|value| value.map(str::to_owned))
        .collect()
}

/// A column of numbers, or of nulls as pandas writes a column of `None`.
fn floats(batch: &RecordBatch, column: &str) -> Vec<Option<f64>> {
    let array = batch
        .column_by_name(column)
        .unwrap_or_else(|| panic!("no column {column}"));
    match array.data_type() {
        DataType::Null => vec![None; array.len()],
        _ => array.as_primitive::<Float64Type>().iter().collect(),
    }
}

fn names(batch: &RecordBatch) -> Vec<String> {
    batch
        .schema()
        .fields()
        .iter()
        .map(|field| field.name().clone())
        .collect()
}

/// Equal up to the last bit, which `serde_json` may read wrong; `read_results.py` requires exact
/// equality.
fn assert_close(value: Option<f64>, expected: Option<f64>) {
    let close = value
        .zip(expected)
        .is_some_and(|(value, expected)| (value - expected).abs() < 1e-15);
    assert!(close || value == expected, "{value:?} is not {expected:?}");
}

/// A run of three scenes of one type.
fn small_run(work: &TempDir) -> PathBuf {
    let out = work.path().join("run");
    let mut flags = quick_run(3);
    flags.extend(
        [
            "--type",
            "starting_left_turn",
            "--out",
            out.to_str().unwrap(),
        ]
        .map(str::to_owned),
    );
    let (code, _, stderr) = run(&flags.iter().map(String::as_str).collect::<Vec<_>>());
    assert_eq!(code, 0, "{stderr}");
    assert_eq!(simulations(&out).len(), 12);
    out
}

/// The rows of `summary.json` of a challenge and planner.
fn rows<'a>(summary: &'a Value, challenge: &str, planner: &str) -> Vec<&'a Value> {
    let all = summary["scenarios"].as_array().unwrap().iter();
    all.filter(|row| row["challenge"] == challenge && row["planner"] == planner)
        .collect()
}

/// Names of the columns and number of rows of any file.
pub(super) fn table(path: &Path) -> (Vec<String>, usize) {
    let file = File::open(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let builder = ParquetRecordBatchReaderBuilder::try_new(file).unwrap();
    let columns = builder
        .schema()
        .fields()
        .iter()
        .map(|field| field.name().clone())
        .collect();
    (
        columns,
        builder
            .build()
            .unwrap()
            .map(|batch| batch.unwrap().num_rows())
            .sum(),
    )
}

/// The same for the aggregator's table.
pub(super) fn aggregator_table(run: &Path, challenge: &str) -> (Vec<String>, usize) {
    table(&aggregator_file(run, challenge))
}

fn aggregator_file(run: &Path, challenge: &str) -> PathBuf {
    let mut files: Vec<PathBuf> = fs::read_dir(run.join(challenge).join("aggregator_metric"))
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    assert_eq!(files.len(), 1, "{files:?}");
    let file = files.remove(0);
    let name = file.file_name().unwrap().to_str().unwrap();
    assert!(
        name.starts_with(&format!("{challenge}_weighted_average_metrics_2")),
        "{name}"
    );
    file
}

#[test]
fn the_result_tree_is_nuplans() {
    let work = TempDir::new().unwrap();
    let out = small_run(&work);
    let summary = read_json(&out.join("summary.json"));
    for challenge in [
        "closed_loop_nonreactive_agents",
        "closed_loop_reactive_agents",
    ] {
        check_metrics(&out, challenge, &summary);
        check_aggregator(&out, challenge, &summary);
        check_runner_report(&out, challenge);
    }
}

fn check_metrics(out: &Path, challenge: &str, summary: &Value) {
    let metrics = out.join(challenge).join("metrics");
    for name in [
        "no_ego_at_fault_collisions",
        "ego_is_comfortable",
        "ego_jerk",
        "time_to_collision_within_bound",
    ] {
        let batch = read(&metrics.join(format!("{name}.parquet")));
        let columns = names(&batch);
        let head = [
            "log_name",
            "scenario_name",
            "scenario_type",
            "planner_name",
            "metric_computator",
            "metric_statistics_name",
            "metric_score",
            "metric_score_unit",
            "metric_category",
        ];
        assert_eq!(columns[..head.len()], head);
        let series = ["unit", "timestamps", "values", "selected_frames"]
            .map(|part| format!("time_series_{part}"));
        assert_eq!(columns[columns.len() - series.len()..], series);
        assert_eq!(batch.num_rows(), 6);
        assert!(
            texts(&batch, "metric_statistics_name")
                .iter()
                .all(|text| text.as_deref() == Some(name))
        );
        let expected = rows(summary, challenge, "log-replay")
            .into_iter()
            .chain(rows(summary, challenge, "simple"));
        for row in expected {
            let place = (0..6).find(|&i| {
                texts(&batch, "scenario_name")[i].as_deref() == row["id"].as_str()
                    && texts(&batch, "planner_name")[i].as_deref() == row["planner"].as_str()
            });
            assert_close(
                floats(&batch, "metric_score")[place.unwrap()],
                row[name].as_f64(),
            );
        }
    }
    let jerk = read(&metrics.join("ego_jerk.parquet"));
    assert_eq!(
        texts(&jerk, "max_ego_jerk_stat_type")[0].as_deref(),
        Some("MAX")
    );
    assert_eq!(
        texts(&jerk, "max_ego_jerk_stat_unit")[0].as_deref(),
        Some("meters_per_second_cubed")
    );
    let highest = floats(&jerk, "max_ego_jerk_stat_value")[0].unwrap();
    let values = jerk
        .column_by_name("time_series_values")
        .unwrap()
        .as_list::<i32>()
        .value(0);
    let values: Vec<f64> = values
        .as_primitive::<Float64Type>()
        .iter()
        .flatten()
        .collect();
    assert!((values.iter().copied().fold(f64::MIN, f64::max) - highest).abs() < 1e-15);
    let times = jerk
        .column_by_name("time_series_timestamps")
        .unwrap()
        .as_list::<i32>()
        .value(0);
    let times: Vec<i64> = times.as_primitive::<Int64Type>().iter().flatten().collect();
    assert!(
        times.len() == values.len() && times.windows(2).all(|pair| pair[1] - pair[0] == 100_000)
    );
    let collisions = read(&metrics.join("no_ego_at_fault_collisions.parquet"));
    let kind = |column: &str| {
        collisions
            .schema()
            .field_with_name(column)
            .unwrap()
            .data_type()
            .clone()
    };
    assert_eq!(
        kind("no_ego_at_fault_collisions_stat_value"),
        DataType::Boolean
    );
    assert_eq!(
        kind("number_of_all_at_fault_collisions_stat_value"),
        DataType::Int64
    );
}

fn check_aggregator(out: &Path, challenge: &str, summary: &Value) {
    let table = read(&aggregator_file(out, challenge));
    let columns = names(&table);
    let head = [
        "scenario",
        "log_name",
        "scenario_type",
        "num_scenarios",
        "planner_name",
        "aggregator_type",
    ];
    assert_eq!(columns[..head.len()], head);
    assert_eq!(columns.last().unwrap(), "score");
    assert!(
        columns[head.len()..columns.len() - 1].is_sorted(),
        "{columns:?}"
    );
    let (scenario, planner) = (texts(&table, "scenario"), texts(&table, "planner_name"));
    let (score, count) = (floats(&table, "score"), floats(&table, "num_scenarios"));
    let progress = floats(&table, "ego_progress_along_expert_route");
    for name in ["log-replay", "simple"] {
        let own: Vec<usize> = (0..table.num_rows())
            .filter(|&i| planner[i].as_deref() == Some(name))
            .collect();
        let expected = rows(summary, challenge, name);
        // Three scenarios of one type, then the type, then the end.
        assert_eq!(own.len(), 5);
        for (&i, row) in own.iter().zip(&expected) {
            assert_eq!(scenario[i].as_deref(), row["id"].as_str());
            assert_close(score[i], row["score"].as_f64());
            assert_eq!(count[i], None);
        }
        let (of_type, last) = (own[3], own[4]);
        assert_eq!(scenario[of_type].as_deref(), Some("starting_left_turn"));
        assert_eq!(
            (scenario[last].as_deref(), count[last]),
            (Some("final_score"), Some(3.0))
        );
        let mean = expected
            .iter()
            .map(|row| row["score"].as_f64().unwrap())
            .sum::<f64>()
            / 3.0;
        let of_summary = summary["aggregates"].as_array().unwrap().iter();
        let of_summary = of_summary
            .clone()
            .find(|row| row["planner"] == name && row["challenge"] == challenge)
            .unwrap();
        assert!((score[last].unwrap() - mean).abs() < 1e-12);
        assert_close(score[last], of_summary["score"].as_f64());
        // nuPlan's quirk: a type's metric columns are sums, the final row's are means.
        let sum: f64 = own[..3].iter().map(|&i| progress[i].unwrap()).sum();
        assert!((progress[of_type].unwrap() - sum).abs() < 1e-12);
        assert!((progress[last].unwrap() - sum / 3.0).abs() < 1e-12);
    }
    let unscored = table.column_by_name("ego_jerk").unwrap();
    assert_eq!(
        unscored.data_type(),
        &DataType::Null,
        "a metric outside the score has no score"
    );
}

fn check_runner_report(out: &Path, challenge: &str) {
    let report = read(&out.join(challenge).join("runner_report.parquet"));
    assert_eq!(
        names(&report),
        [
            "succeeded",
            "error_message",
            "start_time",
            "end_time",
            "scenario_name",
            "planner_name",
            "log_name",
            "compute_trajectory_runtimes_mean",
            "compute_trajectory_runtimes_median",
            "compute_trajectory_runtimes_std",
            "duration"
        ]
    );
    assert_eq!(report.num_rows(), 6);
    assert!(
        report
            .column_by_name("succeeded")
            .unwrap()
            .as_boolean()
            .iter()
            .all(|value| value == Some(true))
    );
    assert_eq!(
        report.column_by_name("error_message").unwrap().null_count(),
        6
    );
    assert!(
        floats(&report, "duration")
            .into_iter()
            .flatten()
            .all(|seconds| seconds > 0.0)
    );
    assert!(
        floats(&report, "compute_trajectory_runtimes_mean")
            .into_iter()
            .flatten()
            .all(|seconds| seconds > 0.0)
    );
}

#[test]
fn pandas_reads_the_result_tree() -> Needy {
    let python = python(&["pandas", "pyarrow"])?;
    let work = TempDir::new().unwrap();
    let out = small_run(&work);
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/runner/read_results.py");
    let output = Command::new(&python).arg(script).arg(out).output().unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    assert!(
        output.status.success(),
        "{}\n{}",
        text(&output.stdout),
        text(&output.stderr)
    );
    assert!(
        text(&output.stdout).contains("2 challenges read"),
        "{}",
        text(&output.stdout)
    );
    Ok(())
}
