"""The reward is the value that a dataset has for a tried code."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import planagent
import pytest

PARTS = ("no_collision", "drivable_area", "driving_direction", "progress", "time_to_collision", "comfort")
HERE = {
    "scenario": "generated/changing_lane/3",
    "seed": 0,
    "time_s": 0.0,
    "challenge": "reactive",
    "scene_text": "paper",
    "driven": "",
}
LINE = "Generate_IDM_Planner(c=ego_lane, la=None, v0=9, acc=1.5, dec=3)"


@pytest.fixture(scope="module")
def codes(tmp_path_factory):
    """The tried codes of a small dataset with modified scenes."""
    folder = tmp_path_factory.mktemp("dataset")
    command = [sys.executable, "-m", "planagent", "dataset", "--for", "messages", "--out", str(folder / "data")]
    options = ["--states", "1", "--validation", "0", "--modified", "0.5", "--model", "nano", "--quiet"]
    subprocess.run([*command, *options], check=True)
    lines = (folder / "data/codes/train/00000.jsonl").read_text().splitlines()
    return [json.loads(line) for line in lines]


def test_the_reward_of_a_tried_code_is_its_value_to_the_bit(codes):
    rows = codes[:: max(1, len(codes) // 60)] + [row for row in codes if row["outcome"] == "refused"][:20]
    rewards = planagent.reward([row["state"] for row in rows], [row["answer"] for row in rows])
    assert len(rewards) == len(rows)
    for i, row in enumerate(rows):
        assert (rewards.value[i], rewards.score[i]) == (row["value"], row["score"]), row
        assert (rewards.outcome[i], rewards.reason[i]) == (row["outcome"], row["reason"])
        assert rewards.reflection[i] == row["reflection"] and rewards.code[i] == row["answer"]
        assert {part: getattr(rewards, part)[i] for part in PARTS} == row["parts"]
    assert {row["outcome"] for row in rows} == {"scored", "refused"}
    assert any(row["state"]["driven"] for row in rows) and any("~" in row["state"]["scenario"] for row in rows)
    reflected = planagent.reward([row["state"] for row in rows], [row["answer"] for row in rows], kind="reflection")
    assert np.array_equal(reflected.value, rewards.reflection)


def test_answers_without_a_plan_are_told_apart():
    answers = [LINE, "I would stop.", LINE.replace("ego_lane", "up"), f"The scene: a road.\n{LINE}"]
    rewards = planagent.reward([HERE] * 3 + [json.dumps(HERE)], answers, without_plan=-9)
    assert rewards.outcome[1:3] == ["unreadable", "unreadable"] and rewards.code[1:3] == [None, None]
    assert list(rewards.value[1:3]) == [-9, -9] and rewards.value[0] == rewards.value[3] > -5
    assert np.isnan(rewards.score[1]) and np.isnan(rewards.comfort[1]) and all(rewards.reason[1:3])
    assert len(planagent.reward([], [])) == 0


@pytest.mark.parametrize(
    ("states", "answers", "options", "message"),
    [
        ([HERE], [], {}, "as many as states"),
        ([HERE], "text", {}, "expected a list"),
        ([3], [LINE], {}, r"states\[0\] is 3"),
        ([HERE], [3], {}, r"answers\[0\]"),
        ([HERE], [LINE], {"kind": "luck"}, "search, reflection"),
        ([HERE], [LINE], {"without_plan": "low"}, "without_plan"),
        ([{**HERE, "time_s": 2.0}], [LINE], {}, r"states\[0\]: time_s is 2"),
        ([{**HERE, "scenario": str(Path.home())}], [LINE], {}, "not generated"),
        ([{**HERE, "extra": 1}], [LINE], {}, "extra"),
        (["{"], [LINE], {}, r"states\[0\]"),
    ],
)
def test_wrong_arguments_are_named(states, answers, options, message):
    with pytest.raises(planagent.errors.ArgumentError, match=message):
        planagent.reward(states, answers, **options)
