"""Steps of 0.1 s in a second of one core by the environments, beside highway-env.

Time is CPU time of this process, which has one thread at work, so other work on the machine hardly matters.

$ pip install highway-env
$ python python/benches/steps.py
"""

import sys
import time

import gymnasium
import numpy as np
import planagent
import planagent.envs

SECONDS = float(sys.argv[1]) if len(sys.argv) > 1 else 5.0
SCENE = "generated/changing_lane/2"
#: Episodes of an environment that step together.
EPISODES = 64
#: Poses of a drive straight on.
STRAIGHT = np.array([[4.0 * i, 0.0, 0.0] for i in range(1, 9)], dtype=np.float32)


def rate(step, steps=1):
    """Steps a second of a function that makes some at each call."""
    step()
    begun, calls = time.process_time(), 0
    while time.process_time() - begun < SECONDS:
        step()
        calls += 1
    return calls * steps / (time.process_time() - begun)


def crowd(agents):
    """A straight road of four lanes with so many cars, 28 m apart, all at 8 m/s."""
    times = np.arange(170) * 0.1
    starts = -300.0 + 28.0 * (np.arange(agents) // 4)
    rows = len(times)
    return planagent.Scenario.of_tables(
        {"time_s": times, "x": 14.0 + 8.0 * times, "y": np.zeros(rows), "heading": np.zeros(rows)},
        {
            "time_s": np.tile(times, agents),
            "token": np.repeat(np.arange(agents), rows),
            "x": np.repeat(starts, rows) + 8.0 * np.tile(times, agents),
            "y": np.repeat(3.5 * (np.arange(agents) % 4), rows),
            "heading": np.zeros(agents * rows),
        },
        {"lane": np.repeat(["a", "b", "c", "d"], 2), "x": [-400, 900] * 4, "y": np.repeat(3.5 * np.arange(4), 2)},
        id=f"crowd of {agents}",
    )


def together(scenario):
    """A step of many episodes with IDM traffic."""
    many = gymnasium.make_vec(
        "planagent/Trajectory-v0", num_envs=EPISODES, vectorization_mode="vector_entry_point", scenarios=[scenario]
    )
    many.reset(seed=0)
    actions = np.tile(STRAIGHT, (EPISODES, 1, 1))
    return lambda: many.step(actions)


def single(sees):
    """A step of one episode with IDM traffic, and what is asked of its observation."""
    one = gymnasium.make("planagent/Trajectory-v0", scenarios=[SCENE]).unwrapped
    one.reset(seed=0)

    def step():
        _, _, terminated, truncated, _ = one.step(STRAIGHT)
        sees(one)
        if terminated or truncated:
            one.reset()

    return step


def highway():
    """A step of highway-env as it is delivered, but at 10 Hz: 50 vehicles, a vector observation."""
    import highway_env

    gymnasium.register_envs(highway_env)
    settings = {"simulation_frequency": 10, "policy_frequency": 10, "duration": 15}
    environment = gymnasium.make("highway-v0", config=settings)
    environment.reset(seed=0)

    def step():
        _, _, terminated, truncated, _ = environment.step(1)
        if terminated or truncated:
            environment.reset()

    return step


def main():
    planagent.set_threads(1)
    rows = [
        (f"`{SCENE}`, {EPISODES} episodes together", rate(together(SCENE), EPISODES)),
        (f"the same, {EPISODES} episodes with 100 agents", rate(together(crowd(100)), EPISODES)),
        ("one episode through gymnasium", rate(single(lambda one: None))),
        ("the same with the model's picture", rate(single(lambda one: one.observe().image()))),
        ("highway-env `highway-v0`, 50 vehicles, at 10 Hz", rate(highway())),
    ]
    print("| | steps a second of a core |\n|---|---:|")
    for name, steps in rows:
        print(f"| {name} | {steps:,.0f} |")


if __name__ == "__main__":
    main()
