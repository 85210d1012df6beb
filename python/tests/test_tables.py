"""Scenarios from plain tables."""

import pickle

import numpy as np
import planagent
import pytest

TIMES = np.arange(80) * 0.1


def ego(speed=10.0):
    return {"time_s": TIMES, "x": speed * TIMES, "y": np.full(80, -3.5), "heading": np.zeros(80)}


def agents():
    return {
        "time_s": np.concatenate([TIMES, TIMES]),
        "token": ["truck"] * 80 + ["walker"] * 80,
        "kind": ["vehicle"] * 80 + ["pedestrian"] * 80,
        "x": np.concatenate([40 + 5 * TIMES, np.full(80, 90.0)]),
        "y": np.concatenate([np.full(80, -3.5), 6 - TIMES]),
        "heading": np.zeros(160),
    }


def lanes():
    return {
        "lane": ["left", "left", "right", "right", "ahead", "ahead", "end", "end"],
        "x": [-30, 100, -30, 100, 100, 120, 120, 400],
        "y": [0, 0, -3.5, -3.5, -3.5, -3.5, -3.5, -3.5],
        "left": ["", "", "left", "left", "", "", "", ""],
        "connector": [False] * 4 + [True] * 2 + [False] * 2,
        "light": [False] * 4 + [True] * 2 + [False] * 2,
        "speed_limit": [13.0] * 8,
    }


def lights():
    return {"time_s": TIMES, "lane": ["ahead"] * 80, "status": ["red"] * 40 + ["green"] * 40}


def test_tables_become_a_scenario():
    scenario = planagent.Scenario.of_tables(ego(), agents(), lanes(), lights(), id="mine", history_s=1.0)
    assert (scenario.id, scenario.iterations) == ("mine", 70)
    observation = scenario.observe()
    assert observation.ego.x == pytest.approx(10.0) and observation.ego.vx == pytest.approx(10.0)
    truck, walker = sorted(observation.objects, key=lambda o: o["kind"])
    assert (truck["vx"], walker["vy"]) == (pytest.approx(5.0), pytest.approx(-1.0))
    assert planagent.KINDS[walker["kind"]] == "pedestrian" and walker["length"] == 0.7
    assert list(observation.lights.values()) == ["red"]
    left, right, ahead, end = scenario.lanes()
    assert (right.left, left.right) == ([0], [1]) and right.outgoing == [2] and ahead.outgoing == [3]
    assert ahead.traffic_light and ahead.speed_limit is None
    simulation = planagent.Simulation(scenario, "reactive").run("pdm-closed")
    assert 0 <= simulation.score().value <= 1
    again = pickle.loads(pickle.dumps(scenario))
    assert again.observe().ego == observation.ego


def test_a_frame_of_pandas_is_a_table():
    pandas = pytest.importorskip("pandas")
    frames = [pandas.DataFrame(table) for table in (ego(), agents(), lanes(), lights())]
    one, other = planagent.Scenario.of_tables(*frames), planagent.Scenario.of_tables(ego(), agents(), lanes(), lights())
    assert one.observe().ego == other.observe().ego
    assert np.array_equal(one.observe().objects, other.observe().objects)


def test_a_scenario_becomes_a_log_of_nuplan(tmp_path):
    scenario = planagent.Scenario.of_tables(ego(), agents(), lanes(), id="mine")
    data, maps = scenario.export_nuplan(tmp_path / "nuplan")
    import os

    assert any(name.endswith(".db") for name in os.listdir(data))
    assert "nuplan-maps-v1.0.json" in os.listdir(maps)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda t: t["ego"].pop("heading"), "no column heading"),
        (lambda t: t["ego"].update(time_s=TIMES * 2), "0.1 s apart"),
        (lambda t: t["ego"].update(x=TIMES * np.nan), "NaN"),
        (lambda t: t["ego"].update(y=TIMES * 0 + 500), "on no lane"),
        (lambda t: t["agents"].update(kind=["ufo"] * 160), "kind ufo"),
        (lambda t: t["agents"].update(token=["one"] * 160), "twice"),
        (lambda t: t["agents"].update(time_s=np.full(160, 99.0)), "99 s"),
        (lambda t: t["agents"].update(x=["far"] * 160), "no numbers"),
        (lambda t: t["lanes"].update(left=["gone"] * 8), "gone"),
        (lambda t: t["lights"].update(status=["blue"] * 80), "blue"),
        (lambda t: t["lights"].update(lane=["gone"] * 80), "gone"),
    ],
)
def test_what_is_wrong_with_a_table_is_named(change, said):
    tables = {"ego": ego(), "agents": agents(), "lanes": lanes(), "lights": lights()}
    change(tables)
    with pytest.raises(ValueError, match=said):
        planagent.Scenario.of_tables(*tables.values())


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"ego": None}, "ego is None; expected a table"),
        ({"agents": 3}, "agents is 3; expected a table"),
        ({"lanes": "lanes.csv"}, "lanes is 'lanes.csv'; expected a table"),
        ({"ego": {**ego(), "x": [[1.0, 2.0], [3.0]] * 40}}, "column x of the ego is"),
        ({"id": "\udcff"}, "id is"),
        ({"id": 3}, "id is 3"),
        ({"scenario_type": 3}, "scenario_type is 3"),
        ({"history_s": 0.05}, "history_s is 0.05"),
        ({"route": []}, r"route is \[\]"),
        ({"route": "nowhere"}, "no lane nowhere"),
        ({"agents": {**agents(), "x": np.full(160, 1e300)}}, "column x .* 1e\\+300 in row 0"),
        ({"agents": {**agents(), "length": np.full(160, 1e300)}}, "column length"),
        ({"agents": {**agents(), "width": np.full(160, -1.0)}}, "column width"),
        ({"lanes": {**lanes(), "width": [0.0] * 8}}, "column width"),
        ({"lanes": {**lanes(), "speed_limit": [-1.0] * 8}}, "column speed_limit"),
        ({"lanes": {**lanes(), "connector": ["no"] * 8}}, "column connector"),
        ({"lanes": {**lanes(), "light": [2] * 8}}, "column light"),
    ],
    ids=str,
)
def test_a_wrong_table_is_named(changed, said):
    given = {"ego": ego(), "agents": agents(), "lanes": lanes(), **changed}
    with pytest.raises(ValueError, match=said) as caught:
        planagent.Scenario.of_tables(**given)
    assert isinstance(caught.value, planagent.PlanAgentError)


def test_one_lane_is_a_route_and_a_clock_may_be_that_of_a_computer():
    later = {name: {**table, "time_s": table["time_s"] + 1.7e9} for name, table in (("ego", ego()), ("agents", agents()))}
    scenario = planagent.Scenario.of_tables(lanes=lanes(), route="right", **later)
    assert scenario.iterations == 80
