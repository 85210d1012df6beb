"""The environments of gymnasium."""

import warnings

import numpy as np
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
    with pytest.raises(ValueError, match="none of"):
        environment.reset(options={"scenario": "generated/changing_lane/3"})
    with pytest.raises(ValueError, match="needs a scenario"):
        envs.CodeEnv([])
    with pytest.raises(ValueError, match="1 to 39 steps"):
        envs.TrajectoryEnv(SCENES[:1], steps=40)
