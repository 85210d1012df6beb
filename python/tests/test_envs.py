"""The environments of gymnasium."""

import warnings

import numpy as np
import planagent
import pytest

gymnasium = pytest.importorskip("gymnasium")
envs = pytest.importorskip("planagent.envs")

SCENES = ["generated/changing_lane/2", "generated/stopping_with_lead/2"]


@pytest.mark.parametrize("name", ["planagent/Trajectory-v0", "planagent/Code-v0"])
def test_the_checker_of_gymnasium_passes(name):
    from gymnasium.utils.env_checker import check_env

    with warnings.catch_warnings():
        # The checker asks for bounded observations and symmetric actions, which meters are not.
        warnings.filterwarnings("ignore", message=".*(infinity|symmetric|unbounded).*")
        check_env(gymnasium.make(name, scenarios=SCENES, render_mode="rgb_array").unwrapped)


def test_an_episode_of_codes_follows_the_lane_to_its_end():
    environment = gymnasium.make("planagent/Code-v0", scenarios=SCENES)
    observation, info = environment.reset(seed=0, options={"scenario": SCENES[0]})
    assert info["scenario"] == SCENES[0] and observation.shape == (97,)
    rewards = []
    while True:
        action = {"centerline": 0, "speed": 10, "accelerations": 0}
        observation, reward, terminated, truncated, _ = environment.step(action)
        rewards.append(reward)
        if terminated or truncated:
            break
    assert truncated and not terminated and sum(rewards) > 5
    with pytest.raises(gymnasium.error.ResetNeeded):
        environment.step(action)


def test_leaving_the_road_ends_an_episode():
    environment = gymnasium.make("planagent/Trajectory-v0", scenarios=SCENES[:1])
    environment.reset(seed=0)
    left = np.array([[3.0 * i, 8.0 * i, 1.2] for i in range(1, 9)], dtype=np.float32)
    for _ in range(100):
        _, reward, terminated, truncated, _ = environment.step(left)
        if terminated:
            break
    assert terminated and not truncated and reward < -5


def test_many_episodes_are_those_of_one():
    vector = gymnasium.make_vec(
        "planagent/Trajectory-v0", num_envs=3, vectorization_mode="vector_entry_point", scenarios=SCENES
    )
    first, _ = vector.reset(seed=5)
    straight = np.array([[5.0 * i, 0.0, 0.0] for i in range(1, 9)], dtype=np.float32)
    singles = []
    for seed in (5, 6, 7):
        environment = gymnasium.make("planagent/Trajectory-v0", scenarios=SCENES)
        singles.append((environment, environment.reset(seed=seed)[0]))
    assert np.array_equal(first, np.stack([observation for _, observation in singles]))
    for _ in range(20):
        observations, rewards, terminated, truncated, _ = vector.step(np.stack([straight] * 3))
        for i, (environment, _) in enumerate(singles):
            observation, reward, end, cut, _ = environment.step(straight)
            assert np.array_equal(observation, observations[i])
            assert (reward, end, cut) == (rewards[i], terminated[i], truncated[i])
        if terminated.any() or truncated.any():
            break
    assert vector.observation_space.shape == (3, 97)


def test_an_episode_that_ended_begins_again_at_the_next_step():
    vector = envs.CodeVectorEnv(2, scenarios=SCENES[:1], steps=75)
    first, _ = vector.reset(seed=1)
    actions = {"centerline": [0, 0], "speed": [10, 0], "accelerations": [0, 0]}
    assert not vector.step(actions)[3].any()
    assert vector.step(actions)[3].all()
    again, rewards, terminated, truncated, _ = vector.step(actions)
    assert np.array_equal(again, first) and not rewards.any() and not (terminated | truncated).any()


def test_the_observation_is_that_of_the_scene():
    environment = envs.TrajectoryEnv(SCENES[:1])
    vector, _ = environment.reset(seed=0)
    scene = environment.observe()
    assert vector[0] * 20 == pytest.approx(scene.ego.vx, abs=1e-5)
    near = np.hypot(scene.objects["x"] - scene.ego.x, scene.objects["y"] - scene.ego.y)
    assert np.hypot(*vector[26:28]) * 50 == pytest.approx(near.min(), rel=0.3)
    assert environment.render() is None and envs.TrajectoryEnv(SCENES[:1], render_mode="rgb_array").metadata


def test_wrong_actions_are_named():
    environment = envs.CodeEnv(SCENES[:1])
    environment.reset(seed=0)
    with pytest.raises(ValueError, match="is no code"):
        environment.step({"centerline": 7, "speed": 0, "accelerations": 0})
    with pytest.raises(ValueError, match="expected one of"):
        environment.reset(options={"scenario": "generated/changing_lane/3"})
    with pytest.raises(ValueError, match="needs a scenario"):
        envs.CodeEnv([])
    with pytest.raises(ValueError, match="1 to 39 steps"):
        envs.TrajectoryEnv(SCENES[:1], steps=40)


@pytest.mark.parametrize("count", [1, 3, 4])
def test_a_batch_of_another_size_is_an_error(count):
    straight = np.array([[5.0 * i, 0.0, 0.0] for i in range(1, 9)])
    poses = envs.TrajectoryVectorEnv(2, SCENES[0])
    with pytest.raises(ValueError, match=r"shape \(2, 8, 3\)"):
        poses.step(np.stack([straight] * count))
    codes = envs.CodeVectorEnv(2, SCENES[0])
    with pytest.raises(ValueError, match=r"shape \(2,\)"):
        codes.step({"centerline": [0] * count, "speed": [5] * count, "accelerations": [0] * count})
    one = envs.TrajectoryEnv(SCENES[0])
    one.reset(seed=0)
    with pytest.raises(ValueError, match=r"shape \(8, 3\)"):
        one.step(straight[:count])


@pytest.mark.parametrize(
    ("key", "value"),
    [("centerline", -1), ("centerline", 0.9), ("speed", -1), ("speed", 11), ("accelerations", -3), ("accelerations", "a"), ("speed", np.nan)],
)
def test_what_is_no_code_is_an_error(key, value):
    environment = envs.CodeEnv(SCENES[0])
    environment.reset(seed=0)
    with pytest.raises(ValueError, match=key):
        environment.step({"centerline": 0, "speed": 5, "accelerations": 0, key: value})
    with pytest.raises(ValueError, match="keys"):
        environment.step({"centerline": 0, "speed": 5})


def test_unknown_arguments_are_errors():
    for name in ("scenario", "render_mode", "step"):
        with pytest.raises(TypeError):
            gymnasium.make_vec("planagent/Code-v0", num_envs=2, vectorization_mode="vector_entry_point", **{name: SCENES[0]})
    with pytest.raises(ValueError, match="render_mode is 'human'"):
        envs.CodeEnv(SCENES[0], render_mode="human")
    with pytest.raises(ValueError, match="actions is 'box'"):
        envs.CodeEnv(SCENES[0], actions="box")
    with pytest.raises(ValueError, match="num_envs is 0"):
        envs.CodeVectorEnv(0, SCENES[0])
    with pytest.raises(ValueError, match="seed is"):
        envs.CodeVectorEnv(2, SCENES[0]).reset(seed=[1, 2, 3])


def test_the_numbers_of_an_observation_have_names_and_scales():
    environment = envs.TrajectoryEnv(SCENES[0])
    vector, info = environment.reset(seed=0)
    named = {feature.name: number * feature.scale for feature, number in zip(envs.FEATURES, vector)}
    assert len(envs.FEATURES) == len(named) == 97 == environment.observation_space.shape[0]
    scene = environment.observe()
    assert named["ego_speed"] == pytest.approx(scene.ego.vx, abs=1e-4) and info["speed"] == pytest.approx(scene.ego.vx)
    assert named["ego_acceleration"] == pytest.approx(scene.ego.ax, abs=1e-4)
    near = scene.objects[np.argmin(np.hypot(scene.objects["x"] - scene.ego.x, scene.objects["y"] - scene.ego.y))]
    present = [name for name in named if name.endswith("_present") and named[name] == 1.0]
    assert len(present) == min(8, len(scene.objects))
    widths = [named[f"object_{number}_width"] for number in range(len(present))]
    assert any(width == pytest.approx(near["width"], abs=1e-4) for width in widths)
    assert named["path_0_x"] == pytest.approx(5.0, abs=3.0)


@pytest.mark.parametrize("actions", ["multi", "discrete"])
def test_all_forms_of_codes_are_the_same(actions):
    codes = [(0, 10, 0), (1, 3, 2), (2, 0, 3)]
    one, other = envs.CodeEnv(SCENES[0]), envs.CodeEnv(SCENES[0], actions=actions)
    many = envs.CodeVectorEnv(2, SCENES[0], actions=actions)
    one.reset(seed=1), other.reset(seed=1), many.reset(seed=[1, 1])
    for code in codes:
        action = np.array(code) if actions == "multi" else (code[0] * 11 + code[1]) * 4 + code[2]
        assert other.action_space.contains(action if actions == "multi" else np.int64(action))
        expected = one.step(dict(zip(("centerline", "speed", "accelerations"), code)))
        found, batch = other.step(action), many.step(np.stack([action, action]))
        assert np.array_equal(found[0], expected[0]) and np.array_equal(batch[0][1], expected[0])
        if expected[2] or expected[3]:
            break


def test_the_info_of_an_end_has_collision_and_score():
    environment = envs.CodeEnv(SCENES[0])
    _, info = environment.reset(seed=0)
    assert info["collision"] is False and info["off_road"] is False and info["score"] is None and info["iteration"] == 0
    truncated = terminated = False
    while not (terminated or truncated):
        _, _, terminated, truncated, info = environment.step({"centerline": 0, "speed": 10, "accelerations": 0})
    assert truncated and 0.0 <= info["score"] <= 1.0 and info["iteration"] == 150
    leaving = envs.TrajectoryEnv(SCENES[0])
    leaving.reset(seed=0)
    left = np.array([[3.0 * i, 8.0 * i, 1.2] for i in range(1, 9)])
    terminated = False
    while not terminated:
        _, _, terminated, _, info = leaving.step(left)
    assert info["off_road"] or info["collision"]


def test_environments_without_a_seed_differ():
    scenes = [f"generated/changing_lane/{seed}" for seed in range(8)]
    drawn = {tuple(envs.CodeVectorEnv(4, scenes).reset()[1]["scenario"]) for _ in range(4)}
    assert len(drawn) > 1
    again = [envs.CodeVectorEnv(4, scenes).reset(seed=5)[1]["scenario"] for _ in range(2)]
    assert again[0] == again[1]


def test_wrong_seeds_options_and_counts_are_named():
    environment = envs.CodeEnv(SCENES[0])
    for arguments, said in [
        ({"seed": 2**70}, "seed is"),
        ({"seed": -1}, "seed is -1"),
        ({"seed": True}, "seed is True"),
        ({"options": {"scenarios": SCENES[0]}}, "'scenarios' is unknown"),
        ({"options": {"scenario": "nowhere"}}, "options\\['scenario'\\] is 'nowhere'"),
        ({"options": [1]}, "options is"),
    ]:
        with pytest.raises(planagent.errors.ArgumentError, match=said):
            environment.reset(**arguments)
        with pytest.raises(planagent.errors.ArgumentError, match=said):
            envs.CodeVectorEnv(1, SCENES[0]).reset(**arguments)
    several = envs.CodeEnv(SCENES[0], actions="multi")
    several.reset()
    with pytest.raises(planagent.errors.ArgumentError, match="the action is"):
        several.step([[1, 2], [3]])
    for count in (10**7, 10**30):
        with pytest.raises(planagent.errors.ArgumentError, match="num_envs is"):
            envs.CodeVectorEnv(count, SCENES[0])
    chosen = planagent.open(SCENES[0])
    assert environment.reset(options={"scenario": chosen})[1]["scenario"] == chosen.id
