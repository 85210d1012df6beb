"""Runs, their results, and planners in Python."""

import json
import sys

import numpy as np
import planagent
import pytest

SCENES = ["generated/changing_lane/2", "generated/stopping_with_lead/1"]


class Keeper:
    """Follows the lane at a share of the limit, and counts its steps."""

    def __init__(self, share=0.5):
        self.share, self.steps = share, 0

    def reset(self):
        self.steps = 0

    def plan(self, observation):
        assert observation.iteration == self.steps
        self.steps += 1
        return observation.trajectory(as_array(observation, self.share))


def as_array(observation, share=0.5):
    return observation.code(speed=share).poses[1:]


def broken(observation):
    raise ZeroDivisionError(f"at {observation.iteration}")


def test_own_planners_stand_beside_those_of_the_library(tmp_path):
    heard = []
    results = planagent.simulate(
        SCENES, ["idm", Keeper, as_array], challenge="both", out=tmp_path / "run", progress=heard.append
    )
    columns = results.table().to_dict()
    assert columns["planner"] == ["idm", "idm", "keeper", "keeper", "as-array", "as-array"] * 2
    assert columns["error"] == [None] * 12
    # The class and the function plan the same, the one by poses alone.
    scores = np.array(columns["score"]).reshape(2, 3, 2)
    assert np.array_equal(scores[:, 1], scores[:, 2])
    assert (heard[-1].done, heard[-1].total, heard[-1].failed) == (12, 12, 0) and heard[-1].steps == 12 * 150
    assert (tmp_path / "run" / "summary.json").is_file()
    assert set(results.mean_scores()) == {(p, c) for p in ("idm", "keeper", "as-array") for c in ("nonreactive", "reactive")}
    stepped = planagent.Simulation(SCENES[0]).run(Keeper)
    assert stepped.score().value == columns["score"][2]


def test_an_object_is_copied_for_each_simulation():
    planner = Keeper(0.8)
    results = planagent.simulate(SCENES, {"fast": planner, "slow": Keeper(0.2)})
    assert planner.steps == 0
    means = results.mean_scores()
    assert set(means) == {("fast", "nonreactive"), ("slow", "nonreactive")}
    assert results.folder is None


def test_an_error_of_a_planner_is_recorded():
    with pytest.warns(planagent.errors.SimulationsFailedWarning, match="2 simulations, 2 failed"):
        results = planagent.simulate(SCENES[0], [broken, lambda_named()])
    errors = results.table().to_dict()["error"]
    assert "ZeroDivisionError: at 0" in errors[0] and "test_runs.py, line" in errors[0]
    assert "returned None" in errors[1]
    with pytest.raises(ZeroDivisionError):
        planagent.Simulation(SCENES[0]).run(broken)


def test_a_plan_that_leaves_the_ego_is_an_error():
    def ahead(distance, count=8):
        """Poses straight ahead, the first one so far away, meters."""

        def plan(observation):
            here = observation.code().poses[0]
            along = np.array([np.cos(here[2]), np.sin(here[2]), 0.0])
            return np.array([here + along * (distance + i * 0.5) for i in range(count)])

        return plan

    planners = {"near": ahead(0.5), "far": ahead(900.0), "one": ahead(0.5, 1)}
    with pytest.warns(planagent.errors.SimulationsFailedWarning, match="3 simulations, 2 failed"):
        results = planagent.simulate(SCENES[0], planners)
    columns = results.table().to_dict()
    errors = dict(zip(columns["planner"], columns["error"]))
    assert errors["near"] is None
    assert "the plan jumps 900" in errors["far"], errors["far"]
    assert "at least 2 poses, got 1" in errors["one"], errors["one"]


def lambda_named():
    def nothing(observation):
        return None

    return nothing


class Advised:
    """Asks planners and scores of the library inside its own plan."""

    def __init__(self):
        self.agent = planagent.Agent(planner="pdm-closed")

    def plan(self, observation):
        plan = self.agent.plan(observation)
        assert observation.score(plan.poses[None, 1:41]).score.shape == (1,)
        return plan


def test_planners_use_the_library_inside_a_run():
    try:
        planagent.set_threads(1)
        results = planagent.simulate(SCENES, [Advised, "pdm-closed"])
    finally:
        planagent.set_threads(None)
    columns = results.table().to_dict()
    assert columns["error"] == [None] * 4
    assert columns["score"][0::2] == columns["score"][1::2]


def test_names_of_planners_are_checked():
    with pytest.raises(ValueError, match="cannot name a planner"):
        planagent.simulate(SCENES[0], {"Not A Name": Keeper})
    with pytest.raises(ValueError, match="planner of the library"):
        planagent.simulate(SCENES[0], {"idm": Keeper})
    with pytest.raises(ValueError, match="two planners"):
        planagent.simulate(SCENES[0], [Keeper, Keeper(0.3)])
    with pytest.raises(ValueError, match="unknown planner"):
        planagent.simulate(SCENES[0], "nobody")


def test_a_run_is_resumed_with_its_planners(tmp_path):
    out = tmp_path / "run"
    first = planagent.simulate(SCENES, ["idm", Keeper], out=out)
    again = planagent.resume(out, ["idm", Keeper])
    assert again.table().to_dict() == first.table().to_dict()
    with pytest.raises(planagent.errors.RunError):
        planagent.simulate(SCENES, "idm", out=out)
    with pytest.raises(FileNotFoundError):
        planagent.resume(tmp_path / "none")


def test_shards_make_the_whole_run(tmp_path):
    scenes = [f"generated/changing_lane/{seed}" for seed in range(4)]
    whole = planagent.simulate(scenes, "idm", out=tmp_path / "whole")
    for shard in (1, 2):
        planagent.simulate(scenes, "idm", out=tmp_path / str(shard), shard=f"{shard}/2")
    merged = planagent.merge([tmp_path / "1", tmp_path / "2"], tmp_path / "merged")
    times = {"seconds"}
    of = lambda results: {k: v for k, v in results.table().to_dict().items() if k not in times}  # noqa: E731
    assert of(merged) == of(whole)
    summaries = [json.loads((tmp_path / run / "summary.json").read_text()) for run in ("whole", "merged")]
    assert summaries[0] == summaries[1]
    with pytest.raises(ValueError, match="SLURM_ARRAY_TASK_ID"):
        planagent.shard_of_environment({"SLURM_ARRAY_TASK_ID": "x", "SLURM_ARRAY_TASK_COUNT": "2"})
    assert planagent.shard_of_environment({}) is None


def test_tables_are_read_by_the_arrow_interface():
    table = planagent.simulate(SCENES, "idm").table()
    assert len(table) == 2 and "no_ego_at_fault_collisions" in table.columns
    pandas, pyarrow = pytest.importorskip("pandas"), pytest.importorskip("pyarrow")
    arrow = pyarrow.table(table)
    assert arrow.to_pydict() == table.to_dict()
    frame = table.to_pandas()
    assert list(frame.columns) == table.columns and frame["score"].dtype == np.float64
    assert pandas.isna(frame["error"]).all()
    # A table can be read again and again.
    assert pyarrow.table(table).equals(arrow)


def test_progress_is_shown_in_a_line(capsys):
    planagent.simulate(SCENES[0], "simple", progress=True)
    shown = capsys.readouterr().err
    assert shown.endswith("1 of 1 simulations\n") and sys.stdout is not None


def test_an_error_of_the_callback_stops_the_run(tmp_path):
    def refuse(progress):
        raise LookupError("enough")

    with pytest.raises(LookupError, match="enough"):
        planagent.simulate([f"generated/changing_lane/{i}" for i in range(40)], "pdm-closed", progress=refuse)
