"""Rewards a second on all cores: groups of eight answers to a state, as GRPO asks for them.

$ python python/benches/rewards.py
"""

import time

import planagent

#: States of a batch; each is the start of a generated scene.
STATES = 64
#: Answers to a state, with different target speeds.
GROUP = 8
#: Batches that are measured, after one that is not.
BATCHES = 5

kinds = planagent.scenario_types()


def batch(number):
    """States and answers of a batch; no two batches have a scene in common."""
    states, answers = [], []
    for index in range(STATES):
        seed = number * STATES + index
        kind = kinds[seed % len(kinds)]
        state = {
            "scenario": f"generated/{kind}/{seed}",
            "seed": seed,
            "time_s": 0.0,
            "challenge": "reactive",
            "scene_text": "paper",
            "driven": "",
        }
        states += [state] * GROUP
        answers += [
            f"Generate_IDM_Planner(c=ego_lane, la=None, v0={3 + 2 * answer}, acc=1.5, dec=3)"
            for answer in range(GROUP)
        ]
    return states, answers


for kind in ("search", "reflection"):
    rates = []
    for number in range(BATCHES + 1):
        states, answers = batch(number)
        begun = time.perf_counter()
        rewards = planagent.reward(states, answers, kind=kind)
        rates.append(len(answers) / (time.perf_counter() - begun))
        assert len(rewards.value) == len(answers)
    rates = sorted(rates[1:])
    print(f"{kind}: {rates[len(rates) // 2]:.0f} rewards/s ({rates[0]:.0f} to {rates[-1]:.0f})")
