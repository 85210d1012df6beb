"""Scenarios, observations and simulations."""

import copy
import pickle

import numpy as np
import planagent
import pytest

SCENE = "generated/changing_lane/2"


def test_a_scenario_says_what_it_is():
    scenario = planagent.open(SCENE)
    assert (scenario.id, scenario.scenario_type, scenario.iterations) == (SCENE, "changing_lane", 151)
    assert scenario.expert.shape == (151, 7)
    lanes = scenario.lanes()
    assert [lane.id for lane in lanes] == list(range(len(lanes)))
    assert any(lane.on_route for lane in lanes) and not all(lane.on_route for lane in lanes)
    ahead = next(lane for lane in lanes if lane.outgoing)
    assert ahead.id in lanes[ahead.outgoing[0]].incoming
    assert np.allclose(ahead.centerline[-1], lanes[ahead.outgoing[0]].centerline[0], atol=0.5)


def test_an_observation_has_the_recorded_state():
    scenario = planagent.open(SCENE)
    first, later = scenario.observe(), scenario.observe(20)
    assert np.array_equal(later.ego.pose, scenario.expert[20, :3])
    assert later.time_s == pytest.approx(2.0) and first.time_s == 0.0
    assert len(later.history) == 22 and later.history[-1].ego == later.ego
    assert set(first.objects.dtype.names) >= {"token", "kind", "x", "vy"}
    assert first.objects["length"].min() > 0
    with pytest.raises(ValueError, match="iteration is 151; .* 0 to 150"):
        scenario.observe(151)


def test_pictures_are_arrays_that_can_be_written():
    observation = planagent.open(SCENE).observe()
    image = observation.image(96, 48.0)
    assert image.shape == (96, 96, 3) and image.dtype == np.uint8
    image[0, 0] = 7
    plain, planned = observation.render(200), observation.render(200, plan=observation.code())
    assert plain.shape == (200, 200, 3) and (plain != planned).any()
    with pytest.raises(ValueError, match="pixels"):
        observation.image(4)


def test_words_of_the_scene():
    observation = planagent.open(SCENE).observe()
    assert observation.lane_graph().startswith("Ego: ")
    assert observation.centerlines()[0] == "ego_lane"
    with pytest.raises(ValueError, match="ego_lane"):
        observation.code("no_lane")


@pytest.mark.parametrize("challenge", ["nonreactive", "reactive"])
@pytest.mark.parametrize("planner", ["idm", "pdm-closed", "log-replay", "plan-agent"])
def test_a_simulation_gives_what_a_run_gives(planner, challenge):
    simulation = planagent.Simulation(SCENE, challenge).run(planner)
    table = planagent.simulate(SCENE, planner, challenge=challenge).table().to_dict()
    score = simulation.score()
    assert table["error"] == [None]
    assert score.value == table["score"][0]
    for name, value in score.parts.items():
        assert table[name][0] == value


def test_steps_are_those_of_a_run():
    whole = planagent.Simulation(SCENE, "reactive").run("idm")
    stepped = planagent.Simulation(SCENE, "reactive")
    agent, observation = planagent.Agent(planner="idm"), stepped.reset()
    while not stepped.is_over:
        observation = stepped.step(agent.plan(observation))
    assert np.array_equal(whole.trail, stepped.trail)
    assert whole.score() == stepped.score()
    with pytest.raises(planagent.errors.SimulationError, match="over"):
        stepped.step(agent.plan(observation))


def test_a_clone_goes_its_own_way():
    simulation = planagent.Simulation(SCENE)
    simulation.run("idm", steps=20)
    other = simulation.clone()
    for _ in range(10):
        observation = other.observe()
        other.step(observation.code(speed=0.0))
    assert (simulation.iteration, other.iteration) == (20, 30)
    assert simulation.ego_states == other.ego_states[:21]
    assert other.observe().ego.speed < simulation.observe().ego.speed
    assert copy.deepcopy(other).observe().ego == other.observe().ego


def test_poses_and_trajectories_lead_to_the_same_place():
    one, two = planagent.Simulation(SCENE), planagent.Simulation(SCENE)
    poses = one.observe().code().poses[1:]
    assert one.step(one.observe().trajectory(poses)).ego == two.step(poses).ego
    assert two.reset().iteration == 0


def test_the_plan_of_a_code_begins_at_the_ego_and_heads_along_its_path():
    simulation = planagent.Simulation("generated/starting_left_turn/1")
    turns = []
    for _ in range(80):
        observation = simulation.observe()
        plan = observation.code()
        first, ego = plan.poses[0], observation.ego.pose
        assert plan.times_us[0] == observation.ego.time_us and np.array_equal(first[:2], ego[:2])
        turns.append(abs(first[2] - ego[2]))
        simulation.step(plan)
    assert 0.001 < max(turns) < 0.1


@pytest.mark.parametrize(
    "plan",
    [[[0.0, 0.0]], [0.0, 0.0, 0.0], np.zeros((0, 3)), [[np.nan, 0.0, 0.0]] * 3],
)
def test_a_wrong_plan_is_named(plan):
    with pytest.raises(ValueError, match="T x 3|NaN"):
        planagent.Simulation(SCENE).step(plan)


def test_a_score_needs_the_whole_simulation():
    simulation = planagent.Simulation(SCENE)
    with pytest.raises(RuntimeError, match="iteration 0 of 150"):
        simulation.score()


def test_trajectories_are_scored_by_their_faults():
    observation = planagent.open(SCENE).observe()
    x, y, heading = observation.ego.pose
    steps = np.arange(1, 41) * 0.1
    off = np.column_stack([x - 30 * steps * np.sin(heading), y + 30 * steps * np.cos(heading), np.full(40, heading)])
    stay = np.tile(observation.ego.pose, (40, 1))
    go = observation.code().poses[1:41]
    scores = observation.score([off, stay, go])
    assert scores.score.shape == (3,)
    assert scores.score[2] > max(scores.score[0], scores.score[1])
    assert scores.progress_m[2] > scores.progress_m[1]
    assert np.array_equal(scores.score[2:], observation.score(go[None]).score)
    with pytest.raises(ValueError, match="3 to 80"):
        observation.score(np.zeros((1, 2, 3)))


def test_names_that_stand_for_nothing():
    with pytest.raises(FileNotFoundError, match="nowhere"):
        planagent.open("nowhere/at/all")
    with pytest.raises(planagent.PlanAgentError):
        planagent.open("nowhere/at/all")
    with pytest.raises(ValueError):
        planagent.open("generated/no_such_type/1")
    with pytest.raises(ValueError, match="challenge"):
        planagent.Simulation(SCENE, "fast")
    with pytest.raises(ValueError, match="unknown planner"):
        planagent.Agent(planner="nobody")
    with pytest.raises(ValueError, match="max_exec"):
        planagent.Agent(settings={"reflection.max_exec": 0})


def test_values_are_pickled():
    simulation = planagent.Simulation(SCENE, "reactive").run("idm", steps=5)
    for value in (simulation.scenario, simulation.observe().code(), simulation, planagent.Agent(planner="idm")):
        again = pickle.loads(pickle.dumps(value))
        assert repr(again) == repr(value)
    again = pickle.loads(pickle.dumps(simulation))
    assert again.observe().ego == simulation.observe().ego


def test_an_agent_tells_its_calls():
    agent = planagent.Agent(seed=3, settings={"reflection": {"max_exec": 1}})
    agent.plan(planagent.open(SCENE).observe())
    (call,) = agent.calls
    assert len(call["attempts"]) == 1 and call["scene_text"]
    agent.reset()


def test_a_model_answers_within_its_choices():
    model = planagent.Model("nano")
    image = planagent.open(SCENE).observe().image()
    answer = model.ask(image, "Which lane?", choices=["left lane", "right lane"])
    assert answer.text in ("left lane", "right lane") and answer.milliseconds["total"] > 0
    assert model.about["image_size"] == 128 and model.count_tokens("left lane") > 0
    assert pickle.loads(pickle.dumps(model)).about == model.about
    with pytest.raises(ValueError, match="uint8"):
        model.ask(image / 255.0, "Which lane?")
    with pytest.raises(planagent.errors.ModelError):
        planagent.Model("no-such-model")
    with pytest.raises(planagent.errors.ModelError, match="no such adapter"):
        planagent.Model("nano", adapter="no-such-adapter")
