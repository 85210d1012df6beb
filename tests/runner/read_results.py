"""Reads the result tree of a run with pandas, as nuPlan users do, and checks it against summary.json.

Usage: read_results.py RUN
"""

import json
import sys
from pathlib import Path

import pandas as pd
from pandas.api import types

METRIC_HEAD = [
    "log_name", "scenario_name", "scenario_type", "planner_name", "metric_computator", "metric_statistics_name",
    "metric_score", "metric_score_unit", "metric_category",
]
METRIC_TAIL = ["time_series_unit", "time_series_timestamps", "time_series_values", "time_series_selected_frames"]
AGGREGATOR_HEAD = ["scenario", "log_name", "scenario_type", "num_scenarios", "planner_name", "aggregator_type"]
REPORT = [
    "succeeded", "error_message", "start_time", "end_time", "scenario_name", "planner_name", "log_name",
    "compute_trajectory_runtimes_mean", "compute_trajectory_runtimes_median", "compute_trajectory_runtimes_std",
    "duration",
]
CATEGORIES = {"Dynamics", "Planning", "Violations", "Scenario dependent"}


def check_numbers(column):
    """nuBoard takes NaN for a score and shows nothing, so a column without numbers must come back as None."""
    assert types.is_float_dtype(column.dtype) or all(value is None for value in column), column
    assert not (types.is_float_dtype(column.dtype) and column.isna().all()), column


def check_metric(path, scores):
    """One metrics/METRIC.parquet."""
    frame = pd.read_parquet(path)
    columns = list(frame.columns)
    assert columns[: len(METRIC_HEAD)] == METRIC_HEAD, columns
    assert columns[-len(METRIC_TAIL):] == METRIC_TAIL, columns
    assert (frame["metric_statistics_name"] == path.stem).all()
    assert set(frame["metric_category"]) <= CATEGORIES, set(frame["metric_category"])
    check_numbers(frame["metric_score"])
    # nuBoard finds the statistics by the suffix of their columns.
    statistics = [column.split("_stat_type")[0] for column in columns if "_stat_type" in column]
    assert statistics, columns
    for name in statistics:
        kinds = set(frame[f"{name}_stat_type"].dropna())
        values = frame[f"{name}_stat_value"]
        assert len(kinds) == 1 and f"{name}_stat_unit" in columns
        if kinds == {"BOOLEAN"}:
            assert types.is_bool_dtype(values.dtype), (name, values.dtype)
        elif kinds == {"COUNT"} and values.notna().all():
            assert types.is_integer_dtype(values.dtype), (name, values.dtype)
        else:
            assert types.is_float_dtype(values.dtype), (name, values.dtype)
    for _, row in frame.iterrows():
        expected = scores[row["scenario_name"], row["planner_name"]].get(path.stem)
        if expected is not None:
            assert row["metric_score"] == expected, (path.stem, row["metric_score"], expected)
        times, values = row["time_series_timestamps"], row["time_series_values"]
        assert (times is None) == (row["time_series_unit"] is None or pd.isna(row["time_series_unit"]))
        if times is not None:
            assert times.dtype == "int64" and values.dtype == "float64" and len(times) == len(values)
    return len(frame)


def check_aggregator(path, scores, aggregates):
    """The aggregator's table: scenarios, types and final score of each planner."""
    frame = pd.read_parquet(path)
    assert list(frame.columns)[: len(AGGREGATOR_HEAD)] == AGGREGATOR_HEAD
    assert frame.columns[-1] == "score"
    for name in frame.columns[len(AGGREGATOR_HEAD):]:
        check_numbers(frame[name])
    assert types.is_float_dtype(frame["num_scenarios"].dtype)
    assert set(frame["aggregator_type"]) == {"weighted_average"}
    assert frame.iloc[-1]["scenario"] == "final_score"
    for planner, own in frame.groupby("planner_name"):
        scenarios = own[own["num_scenarios"].isna()]
        assert scenarios["log_name"].notna().all()
        for _, row in scenarios.iterrows():
            assert row["score"] == scores[row["scenario"], planner]["score"]
        final = own.iloc[-1]
        assert final["scenario"] == final["scenario_type"] == "final_score"
        assert final["num_scenarios"] == len(scenarios)
        assert abs(final["score"] - scenarios["score"].mean()) < 1e-12
        assert final["score"] == aggregates[planner]
    return len(frame)


def check_challenge(run, challenge, summary):
    """The tree of one challenge."""
    rows = [row for row in summary["scenarios"] if row["challenge"] == challenge]
    scores = {(row["id"], row["planner"]): row for row in rows}
    aggregates = {row["planner"]: row["score"] for row in summary["aggregates"] if row["challenge"] == challenge}
    metrics = sorted((run / challenge / "metrics").glob("*.parquet"))
    assert len(metrics) >= 8, metrics
    for path in metrics:
        assert check_metric(path, scores) == len(rows), path
    (aggregator,) = (run / challenge / "aggregator_metric").glob(f"{challenge}_weighted_average_metrics_*.parquet")
    check_aggregator(aggregator, scores, aggregates)
    report = pd.read_parquet(run / challenge / "runner_report.parquet")
    assert list(report.columns) == REPORT, list(report.columns)
    assert types.is_bool_dtype(report["succeeded"].dtype) and report["succeeded"].all()
    assert set(zip(report["scenario_name"], report["planner_name"])) == set(scores)
    assert (report["end_time"] - report["start_time"] - report["duration"]).abs().max() < 1e-6


def main():
    run = Path(sys.argv[1])
    summary = json.loads((run / "summary.json").read_text())
    challenges = sorted({row["challenge"] for row in summary["scenarios"]})
    for challenge in challenges:
        check_challenge(run, challenge, summary)
    print(f"{len(challenges)} challenges read by pandas {pd.__version__}")


main()
