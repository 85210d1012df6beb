"""The reward of a model's answers, for trainers."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _arrays, _core
from ._arguments import real, text, wrong

__all__ = ["Rewards", "reward"]


@dataclass(frozen=True)
class Rewards:
    """Rewards of N answers.

    Attributes
    ----------
    value : numpy.ndarray
        The reward. With `kind="search"`: nuPlan's score of the next six seconds, 0 to 1, with the terms that break ties,
        as `planagent dataset` writes it for a tried code. With `kind="reflection"`: Reflection's score, 0 to 1.
    outcome : list of str
        `"scored"`: Reflection accepts the plan. `"refused"`: Reflection refuses it; it has a value all the same.
        `"unreadable"`: the answer has no planner code, or its code stands for no plan in the scene. `"failed"`: the plan
        cannot be simulated to the end of the six seconds.
    reason : list of str
        Why an answer is not scored; empty where it is.
    code : list of str or None
        The planner code as it was read.
    score : numpy.ndarray
        nuPlan's score of the next six seconds, 0 to 1; NaN without one, and with `kind="reflection"`.
    reflection : numpy.ndarray
        Reflection's score, 0 to 1; NaN without a plan.
    no_collision, drivable_area, driving_direction, progress, time_to_collision, comfort : numpy.ndarray
        The parts of Reflection's score, 0 to 1; NaN without a plan.

    Examples
    --------
    >>> import planagent
    >>> state = {"scenario": "generated/changing_lane/3", "seed": 0, "time_s": 0.0, "challenge": "reactive",
    ...          "scene_text": "paper", "driven": ""}
    >>> rewards = planagent.reward([state, state], ["Generate_IDM_Planner(ego_lane, None, 9, 1.5, 3)", "Stop!"])
    >>> rewards.outcome[1], bool(rewards.value[0] > rewards.value[1])
    ('unreadable', True)
    """

    value: NDArray[np.float64]
    outcome: list[str]
    reason: list[str]
    code: list[str | None]
    score: NDArray[np.float64]
    reflection: NDArray[np.float64]
    no_collision: NDArray[np.float64]
    drivable_area: NDArray[np.float64]
    driving_direction: NDArray[np.float64]
    progress: NDArray[np.float64]
    time_to_collision: NDArray[np.float64]
    comfort: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.outcome)


def _state(index: int, state: Any) -> str:
    if isinstance(state, str):
        return state
    if not isinstance(state, Mapping):
        raise wrong(f"states[{index}]", state, "expected the column `state` of a dataset: a mapping, or its JSON")
    try:
        return json.dumps(dict(state))
    except (TypeError, ValueError) as error:
        raise wrong(f"states[{index}]", state, f"it is no JSON: {error}") from None


def reward(
    states: Sequence[Mapping[str, Any] | str],
    answers: Sequence[str],
    *,
    kind: str = "search",
    without_plan: float | None = None,
) -> Rewards:
    """Rewards answers by the simulator, many at a time.

    An answer is the text of the last round, or a longer text whose last line of code counts. Equal states share the
    simulation that leads there, and states are computed in parallel.

    Parameters
    ----------
    states
        The column `state` of the files that `planagent dataset --for messages` writes.
    answers
        As many texts of a model.
    kind
        `"search"`: the value of the search that labels datasets, by six simulated seconds. `"reflection"`: Reflection's
        score, which is quicker.
    without_plan
        The value of an answer that is unreadable or failed: less than that of any plan by default, which is -5 with
        `"search"` and -1 with `"reflection"`.

    Examples
    --------
    >>> import planagent
    >>> state = {"scenario": "generated/changing_lane/3", "seed": 0, "time_s": 0.0, "challenge": "reactive",
    ...          "scene_text": "paper", "driven": ""}
    >>> line = "Generate_IDM_Planner(ego_lane, None, 9, 1.5, 3)"
    >>> rewards = planagent.reward([state], [line], kind="reflection")
    >>> bool(rewards.value[0] == rewards.reflection[0]), rewards.code
    (True, ['Generate_IDM_Planner(c=ego_lane, la=None, v0=9, acc=1.5, dec=3)'])
    """
    for name, value in (("states", states), ("answers", answers)):
        if isinstance(value, (str, bytes, Mapping)) or not isinstance(value, Sequence):
            raise wrong(name, value, "expected a list")
    if len(states) != len(answers):
        raise wrong("answers", answers, f"expected as many as states, {len(states)}, not {len(answers)}")
    texts = [text(f"answers[{i}]", answer) for i, answer in enumerate(answers)]
    packed, (outcome, reason, code) = _core.rewards([_state(i, state) for i, state in enumerate(states)], texts, text("kind", kind))
    columns = [column.copy() for column in _arrays.unpacked(packed, 9).T]
    if without_plan is not None:
        columns[0][[one in ("unreadable", "failed") for one in outcome]] = real("without_plan", without_plan)
    return Rewards(columns[0], outcome, reason, code, *columns[1:])
