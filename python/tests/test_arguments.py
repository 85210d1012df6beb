"""What arguments may be, and what is said of those that cannot be used."""

import copy
import math
import os
import pickle
import re
import threading
import types
from pathlib import Path

import numpy as np
import planagent
import pytest
from planagent import errors

SCENE = "generated/changing_lane/2"


@pytest.fixture(scope="module")
def observation():
    return planagent.open(SCENE).observe()


def generator(observation):
    yield observation.code()


async def coroutine(observation):
    return observation.code()


SIMULATE = [
    ({"planners": generator}, "a coroutine or a generator"),
    ({"planners": coroutine}, "a coroutine or a generator"),
    ({"scenarios": "\udcff"}, "no text of Unicode"),
    ({"scenarios": []}, "scenarios is"),
    ({"scenarios": iter(())}, "scenarios is"),
    ({"scenarios": 3}, "scenarios is 3"),
    ({"scenarios": None, "splits": []}, "splits is"),
    ({"scenarios": [SCENE, 3]}, r"scenarios\[1\] is 3"),
    ({"planners": []}, "planners is"),
    ({"planners": {}}, "planners is"),
    ({"challenge": []}, "challenge is"),
    ({"challenge": 1}, "challenge is 1"),
    ({"types": ()}, "types is"),
    ({"types": [2]}, r"types\[0\] is 2"),
    ({"limit": -1}, "limit is -1"),
    ({"limit": 0}, "limit is 0"),
    ({"limit": "3"}, "limit is '3'"),
    ({"limit": 1.5}, "limit is 1.5"),
    ({"limit": True}, "limit is True"),
    ({"shard": 1}, "shard is 1"),
    ({"shuffle": 1}, "shuffle is 1"),
    ({"settings": {"reflection.max_exec": None}}, r"settings\['reflection.max_exec'\] is None"),
    ({"settings": {1: 2}}, "the key 1"),
    ({"settings": {"reflection.max_exec": math.nan}}, "nan"),
    ({"settings": "fast"}, "settings is 'fast'"),
    ({"settings": {"reflection.no_such_key": 1}}, "no_such_key"),
    ({"progress": 1}, "progress is 1"),
    ({"progress": "yes"}, "progress is 'yes'"),
    ({"stop": 1}, "stop is 1"),
    ({"exec_timeout": 0}, "exec_timeout is 0"),
    ({"exec_timeout": math.inf}, "exec_timeout is inf"),
    ({"agents": 3}, "agents is 3"),
    ({"out": 3}, "out is 3"),
    ({"out": ""}, "out is ''"),
    ({"out": "a\0b"}, "out is"),
    ({"scenarios": ""}, "scenarios is ''"),
    ({"scenarios": "a\0b"}, "scenarios is"),
    ({"planners": b"idm"}, "planners is b'idm'"),
    ({"planners": {3: "idm"}}, "the name 3 is no text"),
    ({"limit": 10**30}, "limit is 1000"),
    ({"exec_timeout": 1e300}, "exec_timeout is 1e"),
    ({"settings": {"reflection.threshold": math.inf}}, r"settings\['reflection.threshold'\] is inf"),
    ({"settings": {"seed": 2**70}}, r"settings\['seed'\] is 1180"),
    ({"settings": {"mllm.model": "\udcff"}}, "no text of Unicode"),
    ({"settings": {"mllm": {"quantize": "q9"}}}, "settings: unknown weight format"),
    ({"scenarios": None, "splits": "val15"}, "val15"),
    ({"scenarios": None, "splits": "generated", "types": "no_such_type"}, "no_such_type"),
]


@pytest.mark.parametrize(("arguments", "said"), SIMULATE, ids=[str(arguments) for arguments, _ in SIMULATE])
def test_a_wrong_argument_of_a_run_is_named(arguments, said, tmp_path):
    given = {"scenarios": SCENE, "planners": "idm", "out": tmp_path / "run", **arguments}
    with pytest.raises(ValueError, match=said) as caught:
        planagent.simulate(**given)
    assert isinstance(caught.value, errors.PlanAgentError)
    assert "line 1 column" not in str(caught.value) and " --" not in str(caught.value) and "\n" not in str(caught.value)
    # The corrected call is not refused.
    assert not (tmp_path / "run").exists()


class Unshown:
    def __repr__(self):
        raise LookupError


CALLS = {
    "lanes": (lambda o: o.lanes(-50.0), "within_m is -50"),
    "lanes of nan": (lambda o: o.lanes(math.nan), "within_m is nan"),
    "lanes of text": (lambda o: o.lanes("near"), "within_m is 'near'"),
    "image": (lambda o: o.image(-1), "pixels is -1"),
    "meters": (lambda o: o.image(64, 0.0), "meters is 0"),
    "render": (lambda o: o.render(64.5), "pixels is 64.5"),
    "code speed": (lambda o: o.code(speed=math.nan), "speed is nan"),
    "code back": (lambda o: o.code(speed=-1.0), "speed is -1"),
    "code accelerations": (lambda o: o.code(accelerations=(-1.0, -3.0)), r"accelerations\[0\] is -1"),
    "code one": (lambda o: o.code(accelerations=(math.nan, 3.0)), r"accelerations\[0\] is nan"),
    "code three": (lambda o: o.code(accelerations=(1.0, 2.0, 3.0)), "accelerations is"),
    "code name": (lambda o: o.code(3), "centerline is 3"),
    "dt": (lambda o: o.trajectory(np.zeros((3, 3)), dt=-0.1), "dt is -0.1"),
    "ragged": (lambda o: o.trajectory([[1, 2, 3], [1, 2]]), "poses"),
    "observe": (lambda o: planagent.open(SCENE).observe(-1), "iteration is -1"),
    "far": (lambda o: planagent.open(SCENE).observe(151), "iteration is 151"),
    "open": (lambda o: planagent.open(3), "name is 3"),
    "threads": (lambda o: planagent.set_threads(-1), "count is -1"),
    "steps": (lambda o: planagent.Simulation(SCENE).run("idm", steps=-1), "steps is -1"),
    "steps of an own one": (lambda o: planagent.Simulation(SCENE).run(lambda o: o.code(), steps=2.5), "steps is 2.5"),
    "challenge": (lambda o: planagent.Simulation(SCENE, 1), "challenge is 1"),
    "scenario": (lambda o: planagent.Simulation(3), "scenario is 3"),
    "agent": (lambda o: planagent.Agent(planner=3), "planner is 3"),
    "scenario of an agent": (lambda o: planagent.Agent(planner="log-replay", scenario=SCENE), "scenario is 'generated"),
    "seed": (lambda o: planagent.Agent(planner="idm", seed=-1), "seed is -1"),
    "max_tokens": (lambda o: planagent.Model().ask(None, "q", max_tokens=-1), "max_tokens is -1"),
    "choices": (lambda o: planagent.Model().ask(None, "q", choices=[]), "choices is"),
    "choice": (lambda o: planagent.Model().ask(None, "q", choices=["a", 1]), r"choices\[1\] is 1"),
    "deadline": (lambda o: planagent.Model().ask(None, "q", deadline_s=math.nan), "deadline_s is nan"),
    "merge": (lambda o: planagent.merge(3, "x"), "runs is 3"),
    "complex": (lambda o: o.trajectory(np.zeros((9, 3), complex)), "complex"),
    "texts": (lambda o: o.trajectory(np.full((9, 3), "1")), "of type <U1"),
    "masked": (lambda o: o.trajectory(np.ma.masked_array(np.zeros((9, 3)), mask=True)), "masked"),
    "no poses": (lambda o: o.trajectory(None), "it is None"),
    "half a microsecond": (lambda o: planagent.Trajectory(np.zeros((2, 3)), [0, 0.5]), r"times_us\[1\] is 0.5"),
    "late": (lambda o: planagent.Trajectory(np.zeros((2, 3)), [0, 2**70]), r"times_us\[1\] is 11805"),
    "never": (lambda o: planagent.Trajectory(np.zeros((2, 3)), [0, 9]).at(math.nan), "time_us is nan"),
    "settings": (lambda o: planagent.Agent(settings=["seed"]), r"settings is \['seed'\]"),
    "settings of a model": (lambda o: planagent.Model(settings=["seed"]), r"settings is \['seed'\]"),
    "half a character": (lambda o: planagent.open("\udcff"), "no text of Unicode"),
    "what cannot be shown": (lambda o: planagent.open(Unshown()), "a Unshown that cannot be shown"),
    "many tokens": (lambda o: planagent.Model().ask(None, "q", max_tokens=10**30), "max_tokens is 1000"),
    "empty choice": (lambda o: planagent.Model().ask(None, "q", choices=["a", ""]), "one of them is empty"),
    "regex": (lambda o: planagent.Model().ask(None, "q", regex="("), "regex cannot be used"),
}


@pytest.mark.parametrize("name", CALLS)
def test_a_wrong_argument_is_named(name, observation):
    call, said = CALLS[name]
    with pytest.raises(ValueError, match=said) as caught:
        call(observation)
    assert isinstance(caught.value, errors.PlanAgentError)


class NeedsSpeed:
    def __init__(self, speed):
        self.speed = speed

    def plan(self, observation):
        return observation.code()


class Locked:
    def __init__(self):
        self.lock = threading.Lock()

    def plan(self, observation):
        return observation.code()


class NoPlan:
    pass


class PlansNothing:
    plan = 3


class TakesNothing:
    def plan(self):
        return None


NO_PLANNERS = {
    "number": 3,
    "nothing": None,
    "list": [3],
    "arguments": NeedsSpeed,
    "lock": Locked(),
    "class": NoPlan,
    "object": NoPlan(),
    "attribute": PlansNothing(),
    "no observation": TakesNothing,
    "no observation of an object": TakesNothing(),
    "function of nothing": lambda: None,
    "function of two": lambda observation, more: None,
    "bytes": b"idm",
}


@pytest.mark.parametrize("name", NO_PLANNERS)
def test_what_is_no_planner_is_refused_before_the_run(name, tmp_path):
    with pytest.raises(ValueError, match="planners is|planner"):
        planagent.simulate(SCENE, {"own": NO_PLANNERS[name]}, out=tmp_path / "run")
    assert not (tmp_path / "run").exists()


class Static:
    @staticmethod
    def plan(observation):
        return observation.code()


class ByClass:
    @classmethod
    def plan(cls, observation):
        return observation.code()


class WithDefault:
    def __init__(self, speed=1.0):
        self.plan = lambda observation: observation.code(speed=speed)


class Called:
    def __call__(self, observation):
        return observation.code()


@pytest.mark.parametrize("planner", [Static, ByClass, WithDefault, Called, Static(), ByClass(), WithDefault(), Called()])
def test_all_forms_of_planners_are_taken(planner):
    assert planagent.simulate(SCENE, {"own": planner}).table()["error"] == [None]


class Counter:
    """Slow in its first simulation alone."""

    def __init__(self):
        self.steps = 0

    def act(self, observation):
        self.steps += 1
        return observation.code(speed=0.2 if self.steps <= 151 else 1.0)

    __call__ = act


class Plans(Counter):
    plan = Counter.act


def test_each_simulation_has_a_copy_of_an_object():
    scenes = [SCENE, "generated/changing_lane/3"]
    try:
        planagent.set_threads(1)
        scores = [planagent.simulate(scenes, {"own": p}).table()["score"] for p in (Plans(), Counter(), Counter().act)]
    finally:
        planagent.set_threads(None)
    assert scores[0] == scores[1] == scores[2]


def test_values_of_numpy_paths_and_generators_are_taken(tmp_path, observation):
    results = planagent.simulate(
        (scene for scene in [SCENE, Path(SCENE)]),
        (name for name in ["idm"]),
        challenge=np.str_("reactive"),
        limit=np.int64(1),
        shuffle=np.bool_(False),
        settings=types.MappingProxyType({"seed": np.int64(3), "reflection": {"max_exec": np.int32(2)}}),
        progress=np.bool_(False),
        out=tmp_path / "run",
    )
    assert results.table()["challenge"] == ["reactive"]
    assert observation.image(np.int64(32), np.float32(20)).shape == (32, 32, 3)
    assert len(observation.lanes(math.inf)) == len(observation.lanes(None)) > 0
    assert observation.code(speed=np.float32(0.5), accelerations=np.array([1.0, 2.0]))
    assert planagent.Agent(planner="log-replay", scenario=planagent.open(SCENE), seed=np.int64(1)).plan(observation)
    merged = planagent.merge(tmp_path / "run", tmp_path / "merged")
    assert merged.table().to_dict() == results.table().to_dict()
    answer = planagent.Model().ask(observation.image(), "Which lane?", choices="left")
    assert answer.text == "left"


def test_an_agent_of_the_library_is_a_planner_under_another_name():
    agent = planagent.Agent(planner="idm")
    with pytest.raises(ValueError, match="dictionary"):
        planagent.simulate(SCENE, agent)
    table = planagent.simulate(SCENE, {"mine": agent, "idm": "idm"}).table()
    assert table["planner"] == ["mine", "idm"] and table["score"][0] == table["score"][1]


def test_the_folder_of_a_run_stays_where_it_was(tmp_path, monkeypatch):
    (tmp_path / "other").mkdir()
    monkeypatch.chdir(tmp_path)

    def moves(observation):
        os.chdir(tmp_path / "other")
        return observation.code()

    results = planagent.simulate([SCENE, "generated/stopping_with_lead/1"], moves, out="rel")
    assert results.folder == tmp_path / "rel" and os.listdir(tmp_path / "other") == []
    assert planagent.resume(tmp_path / "rel", {"moves": moves}).table().to_dict() == results.table().to_dict()


def test_a_run_of_an_own_planner_asks_for_it(tmp_path):
    def own(observation):
        return observation.code()

    def tell(progress):
        if progress.steps > 200:
            raise LookupError

    scenes = [f"generated/changing_lane/{seed}" for seed in range(6)]
    with pytest.raises(LookupError):
        planagent.simulate(scenes, own, out=tmp_path / "run", progress=tell)
    with pytest.raises(ValueError, match="in Python.*planners=") as caught:
        planagent.resume(tmp_path / "run")
    assert " --" not in str(caught.value)
    assert len(planagent.resume(tmp_path / "run", own)) == 6


def test_errors_name_no_options_of_the_command_line(tmp_path):
    planagent.simulate(SCENE, "idm", out=tmp_path / "run")
    (tmp_path / "begun").mkdir()
    (tmp_path / "begun" / "manifest.toml").touch()
    calls = [
        lambda: planagent.simulate(SCENE, "idm", out=tmp_path / "run"),
        lambda: planagent.resume(tmp_path / "begun"),
        lambda: planagent.open_run(tmp_path / "begun"),
        lambda: planagent.simulate(splits="val14", planners="idm"),
        lambda: planagent.open("generated/changin_lane/2"),
        lambda: planagent.merge([tmp_path / "begun"], tmp_path / "merged"),
        lambda: planagent.simulate(SCENE, "idm", agents="no command"),
        lambda: planagent.simulate(SCENE, "pdm-open"),
    ]
    for call in calls:
        with pytest.raises(planagent.PlanAgentError) as caught:
            call()
        assert not re.search(r"(^|[\s(`'])--[a-z]|`planagent ", str(caught.value)), caught.value


def test_results_tables_and_observations_pickle(observation, tmp_path):
    results = planagent.simulate(SCENE, ["idm", "simple"], out=tmp_path / "run")
    for copied in (pickle.loads(pickle.dumps(results)), copy.deepcopy(results), copy.copy(results)):
        assert copied.table().to_dict() == results.table().to_dict() and copied.folder == results.folder
    table = pickle.loads(pickle.dumps(results.table()))
    assert table.to_dict() == results.table().to_dict() and table.columns == results.table().columns
    again = pickle.loads(pickle.dumps(observation))
    assert again.ego == observation.ego and np.array_equal(again.objects, observation.objects)
    assert again.lane_graph() == observation.lane_graph() and np.array_equal(again.image(), observation.image())
    assert np.array_equal(again.code().poses, observation.code().poses)
    assert [s.ego for s in again.history] == [s.ego for s in observation.history] and again.lights == observation.lights
    assert copy.deepcopy(observation).ego == observation.ego


def test_what_is_given_twice_must_agree():
    with pytest.raises(planagent.PlanAgentError, match=r"settings\['mllm.model'\] is 'other'.*'nano'"):
        planagent.Model("nano", settings={"mllm.model": "other"})
    with pytest.raises(planagent.PlanAgentError, match=r"settings\['seed'\] is 3"):
        planagent.Agent(planner="idm", seed=4, settings={"seed": 3})
    assert planagent.Agent(planner="idm", seed=4, settings={"seed": 4}).name == "idm"


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: planagent.merge([], "out"), r"runs is \[\]"),
        (lambda: planagent.open(""), "name is ''"),
        (lambda: planagent.Model(""), "name is ''"),
        (lambda: planagent.Model("nano").ask(None, "?", choices=["a"] * 5000), "5000 of them"),
        (lambda: planagent.Model("nano").ask([[1, 2], [3]], "?"), r"image is \[\[1, 2\], \[3\]\]; expected a picture"),
        (lambda: planagent.Model("nano").ask(None, "?", deadline_s=1e300), "deadline_s is 1e"),
        (lambda: planagent.open(SCENE).observe().code("there"), "centerline is 'there'; expected one of ego_lane"),
        (lambda: planagent.open(SCENE).observe().lane_graph("long"), "form is 'long'; expected one of paper"),
        (lambda: planagent.Simulation(SCENE).run(["idm"]), r"planner is \['idm'\]"),
        (lambda: planagent.Trajectory([[0, 0, 0], [1, 0, 0]], [-(2**63), 2**63 - 1]), r"times_us\[0\] is"),
        (lambda: planagent.Trajectory([[0, 0, 0], [1, 0, 0]], [0, 1]).at(2**62), "time_us is"),
    ],
    ids=str,
)
def test_other_arguments_are_named(call, said):
    with pytest.raises(ValueError, match=said) as caught:
        call()
    assert isinstance(caught.value, errors.PlanAgentError)


def test_steps_beyond_the_end_are_the_end():
    for planner in ("idm", lambda observation: observation.code()):
        assert planagent.Simulation(SCENE).run(planner, steps=10**20).is_over


@pytest.mark.parametrize("dt", [1e300, 1e9, 1e7, 1e-9])
def test_poses_without_a_time_are_refused(dt):
    poses = np.tile(planagent.open(SCENE).observe().ego.pose, (40, 1))
    with pytest.raises(planagent.errors.ArgumentError):
        planagent.Simulation(SCENE).step(poses, dt=dt)


def test_a_plan_of_years_is_refused():
    def years(observation):
        ego = observation.ego
        return planagent.Trajectory([ego.pose, ego.pose], [ego.time_us, ego.time_us + 10**15])

    with pytest.raises(planagent.PlanAgentError, match="600 s are the limit"):
        planagent.Simulation(SCENE).run(years, steps=1)
    with pytest.warns(planagent.errors.SimulationsFailedWarning, match="1 failed"):
        results = planagent.simulate(SCENE, {"years": years, "idm": "idm"})
    assert [failure.planner for failure in results.failures] == ["years"]


def test_a_step_follows_no_plan_that_leaves_the_ego():
    simulation, other = planagent.Simulation(SCENE), planagent.open("generated/stopping_with_lead/1")
    ahead = np.column_stack([np.arange(1, 41), np.zeros(40), np.zeros(40)])
    for plan in (ahead, ahead + [1e6, 0, 0], other.observe().code()):
        with pytest.raises(planagent.errors.ArgumentError, match="the plan"):
            simulation.step(plan)
        with pytest.raises(planagent.PlanAgentError, match="the plan"):
            simulation.run(lambda observation, plan=plan: plan, steps=1)
    assert simulation.iteration == 0


def test_a_relative_path_needs_a_working_directory(tmp_path, monkeypatch):
    gone = tmp_path / "gone"
    gone.mkdir()
    monkeypatch.chdir(gone)
    gone.rmdir()
    with pytest.raises(planagent.errors.ArgumentError, match="out is 'run'"):
        planagent.simulate(SCENE, "idm", out="run")
