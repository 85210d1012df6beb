"""What a run gives."""

import csv
import io
import math
import re
import subprocess
import sys
from pathlib import Path

import planagent
import pytest

SCENES = ["generated/changing_lane/2", "generated/stopping_with_lead/1"]


def broken(observation):
    return helper(0)


def helper(divisor):
    return 1 / divisor


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    with pytest.warns(planagent.errors.SimulationsFailedWarning, match="4 simulations, 2 failed"):
        return planagent.simulate(SCENES, ["idm", broken], out=tmp_path_factory.mktemp("runs") / "run")


def test_results_are_a_sequence_of_rows(run):
    assert len(run) == 4 and run[0]["planner"] == "idm" and run[-1]["planner"] == "broken"
    assert [row["scenario"] for row in run] == [row["scenario"] for row in run[:]]
    assert run.is_complete and repr(run).startswith("Results(4 simulations, 2 failed, folder=")
    with pytest.raises(IndexError):
        run[4]


def test_no_mean_leaves_failures_out_in_silence(run):
    means = run.means()
    assert means["idm", "nonreactive"].scored == 2 and means["idm", "nonreactive"].failed == 0
    assert means["broken", "nonreactive"].score is None and means["broken", "nonreactive"].failed == 2
    with pytest.warns(planagent.errors.SimulationsFailedWarning, match=r"broken \(nonreactive\): 2 of 2"):
        assert list(run.mean_scores()) == [("idm", "nonreactive")]


def test_the_traceback_of_a_planner_is_kept(run):
    failures = run.failures
    assert [failure.planner for failure in failures] == ["broken", "broken"]
    assert "ZeroDivisionError: division by zero" in failures[0].error and "test_results.py, line" in failures[0].error
    assert "in helper" in failures[0].traceback and "in broken" in failures[0].traceback


def inverse(observation):
    import numpy as np

    return np.linalg.inv(np.zeros((3, 3)))


def ragged(observation):
    return [[1, 2, 3], [1, 2]]


def nothing(observation):
    return None


def leaves(observation):
    raise SystemExit(3)


class NoText(Exception):
    def __str__(self):
        raise ValueError


def textless(observation):
    raise NoText


def test_the_place_of_an_error_is_in_the_planner():
    planners = [inverse, ragged, nothing, leaves, textless]
    with pytest.warns(planagent.errors.SimulationsFailedWarning):
        errors = planagent.simulate(SCENES[0], planners).table()["error"]
    assert all("test_results.py, line" in error for error in errors[:4]), errors
    assert "SystemExit" in errors[3] and "NoText" in errors[4]


def test_a_finished_folder_is_opened(run):
    again = planagent.open_run(run.folder)
    assert again.table().to_dict() == run.table().to_dict() and again.folder == run.folder
    with pytest.raises(FileNotFoundError):
        planagent.open_run(run.folder / "nothing")


def test_statistics_of_all_metrics(run):
    statistics = run.statistics()
    assert set(statistics.columns) >= {"scenario", "planner", "challenge", "metric", "statistic", "value", "unit"}
    rows = [row for row in statistics.rows() if row["metric"] == "ego_mean_speed"]
    assert rows and all(row["planner"] == "idm" and math.isfinite(row["value"]) for row in rows)
    with pytest.raises(planagent.errors.RunError, match="not kept"):
        planagent.simulate(SCENES[0], "simple").statistics()


def test_the_page_of_a_run(run, tmp_path):
    assert run.report() == run.folder / "report.html"
    page = run.report(tmp_path / "page.html")
    assert page.read_text(encoding="utf-8").startswith("<!doctype html>") and page.stat().st_size > 20_000


def test_tables_as_text(run, tmp_path):
    table = run.table()
    table.to_csv(tmp_path / "table.csv")
    rows = list(csv.DictReader(io.StringIO((tmp_path / "table.csv").read_text())))
    assert list(rows[0]) == table.columns and float(rows[0]["score"]) == table["score"][0] and rows[-1]["score"] == ""
    for html in (table._repr_html_(), run._repr_html_()):
        assert html.count("<table>") == html.count("</table>") == 1 and "idm" in html
    assert "division by zero" in run._repr_html_() and not re.search(r"<module|<function", run._repr_html_())


@pytest.mark.parametrize("text", ["=1+1", " +1", "a\n@b", "\tx", "\uff1dx"])
def test_a_cell_is_no_formula(text):
    from planagent._results import _cell

    assert _cell(text) == f"'{text}" and _cell("a=1") == "a=1" and _cell(-1.0) == -1.0 and _cell(None) == ""


def test_frames_have_numbers_also_without_any(run):
    pandas = pytest.importorskip("pandas")
    frame = run.table().to_pandas()
    assert frame["score"].dtype == "float64" and frame["planning_calls"].dtype == "int64"
    assert list(pandas.DataFrame(run.table()).columns) == run.table().columns
    with pytest.warns(planagent.errors.SimulationsFailedWarning):
        failed = planagent.simulate(SCENES[0], broken).table()
    assert failed.to_pandas()["score"].dtype == "float64"


def test_scores_are_drawn(run):
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    axes = run.plot()
    assert [label.get_text() for label in axes.get_xticklabels()] == ["idm", "broken"]
    assert axes.get_ylabel() == "mean score"


def test_progress_is_lines_where_stderr_is_no_terminal(capsys):
    planagent.simulate([f"generated/changing_lane/{seed}" for seed in range(3)], "simple", progress=True)
    lines = capsys.readouterr().err.splitlines()
    assert lines[-1] == "3 of 3 simulations" and not any("\r" in line for line in lines)


def test_changed_records_end_in_results_or_errors(tmp_path):
    script = Path(__file__).with_name("mutated_runs.py")
    command = [sys.executable, "-W", "ignore", script, "8"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=100, cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr[-8000:]
