"""Planners: those of the library, and your own."""

from __future__ import annotations

import copy
import inspect
import json
import re
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

from numpy.typing import ArrayLike

from . import _core
from ._observation import Observation, Trajectory, native_observation
from .errors import ArgumentError

if TYPE_CHECKING:
    from ._scenario import Scenario

__all__ = ["Agent", "Planner", "planners"]

#: What a name of a planner may hold; it becomes part of file names.
NAME = re.compile(r"[a-z0-9_-]{1,40}")


@runtime_checkable
class Planner(Protocol):
    """What a planner of your own offers.

    A class is made once for each simulation; an object is copied (`copy.deepcopy`) for each. A plain function of an observation
    is a planner too. Optional are `name`, the name in tables, and `reset(self)`, called before each simulation.

    Examples
    --------
    >>> import numpy as np, planagent
    >>> class Straight:
    ...     def plan(self, observation):
    ...         x, y, heading = observation.ego.pose
    ...         ahead = 5.0 * 0.1 * np.arange(1, 41)
    ...         return np.column_stack([x + ahead * np.cos(heading), y + ahead * np.sin(heading), np.full(40, heading)])
    >>> simulation = planagent.Simulation("generated/changing_lane/2").run(Straight)
    >>> simulation.is_over
    True
    """

    def plan(self, observation: Observation) -> Trajectory | ArrayLike:
        """The trajectory from now on: a `Trajectory`, or poses as `Simulation.step` takes them."""
        ...


class Bound:
    """A planner in Python for one simulation, as the native half calls it."""

    def __init__(self, planner: Any) -> None:
        self._planner = planner
        plan = getattr(planner, "plan", planner)
        if not callable(plan):
            raise ArgumentError(f"{type(planner).__name__} is no planner: it has no method plan and cannot be called")
        self._plan = plan

    def reset(self) -> None:
        """Called before the first step."""
        reset = getattr(self._planner, "reset", None)
        if reset is not None:
            reset()

    def plan(self, native: _core.Observation) -> _core.Trajectory:
        """Called at each step."""
        observation = Observation._of(native)
        planned = self._plan(observation)
        if planned is None:
            raise ArgumentError("the planner returned None; it must return a Trajectory or an array of T x 3 poses")
        return observation.trajectory(planned)._native


def as_factory(planner: Any) -> Callable[[], Bound]:
    """What makes a planner of one simulation."""
    if _is_of_nuplan(planner):
        from .nuplan import adapted

        return adapted(planner)
    if inspect.isclass(planner):
        return lambda: Bound(planner())
    if inspect.isroutine(planner) or not hasattr(planner, "plan"):
        return lambda: Bound(planner)
    return lambda: Bound(copy.deepcopy(planner))


def _is_of_nuplan(planner: Any) -> bool:
    return callable(getattr(planner, "compute_planner_trajectory", None))


def name_of(planner: Any) -> str:
    """The name of a planner in tables and files."""
    name = getattr(planner, "name", None)
    if callable(name) and not inspect.isclass(planner):
        name = name()
    if not isinstance(name, str):
        kind = planner if inspect.isclass(planner) or inspect.isroutine(planner) else type(planner)
        words = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", "-", kind.__name__)
        name = re.sub(r"[^a-z0-9_-]+", "-", words.lower().replace("_", "-")).strip("-")
    if not NAME.fullmatch(name):
        raise ArgumentError(
            f"{name!r} cannot name a planner; a name has lowercase letters, digits, minuses and underscores, at most 40. "
            "Set the attribute `name` of the planner"
        )
    return name


def nested(settings: dict[str, Any]) -> dict[str, Any]:
    """Settings with keys such as `reflection.max_exec` as nested dictionaries."""
    whole: dict[str, Any] = {}
    for key, value in settings.items():
        *sections, last = key.split(".")
        place = whole
        for section in sections:
            place = place.setdefault(section, {})
            if not isinstance(place, dict):
                raise ArgumentError(f"the setting {key} lies in {section}, which is no section")
        value = nested(value) if isinstance(value, dict) else value
        if isinstance(value, dict) and isinstance(place.get(last), dict):
            place[last].update(value)
        else:
            place[last] = value
    return whole


def settings_json(settings: dict[str, Any] | None, **known: Any) -> str:
    """Settings for the native half; `None` leaves a value at its default."""
    whole = nested(settings or {})
    for key, value in nested({k.replace("__", "."): v for k, v in known.items() if v is not None}).items():
        if isinstance(value, dict):
            whole.setdefault(key, {}).update(value)
        else:
            whole[key] = value
    try:
        return json.dumps(whole)
    except TypeError as error:
        raise ArgumentError(f"the settings: {error}") from None


def planners() -> dict[str, str]:
    """The planners of the library: their names, and a line about each.

    Examples
    --------
    >>> import planagent
    >>> planagent.planners()["pdm-closed"]
    'PDM-Closed'
    """
    return {name: summary for name, summary, _ in _core.planners()}


class Agent:
    """A planner of the library, by default the agent of the paper with the model that ships.

    It holds the state of one simulation. Another map than the last one starts it again, and so does `reset`.

    Parameters
    ----------
    model
        A name (`nano`), a folder as Hugging Face writes it, a GGUF file, a hub id, or a `.toml` file that describes one. It is
        loaded once in a process, when the first agent needs it.
    planner
        One of `planners()`.
    seed
        Seed of the model's samples.
    settings
        Other settings by the keys of `planagent.toml`, for example `{"reflection.max_exec": 2}`.
    scenario
        Makes the planner exactly as a run makes it for this scenario: its name enters the seed, and `log-replay` gets its
        recording.

    Examples
    --------
    >>> import planagent
    >>> agent = planagent.Agent()
    >>> observation = planagent.open("generated/changing_lane/2").observe()
    >>> len(agent.plan(observation)) > 40
    True
    >>> agent.calls[0]["iteration"]
    0
    """

    __slots__ = ("_arguments", "_native")

    def __init__(
        self,
        model: str | None = None,
        *,
        planner: str = "plan-agent",
        seed: int | None = None,
        settings: dict[str, Any] | None = None,
        scenario: Scenario | None = None,
    ) -> None:
        self._arguments = {
            "model": model,
            "planner": planner,
            "seed": seed,
            "settings": settings,
            "scenario": scenario,
        }
        merged = settings_json(settings, seed=seed, mllm__model=model)
        self._native = _core.Planner(planner, merged, None if scenario is None else scenario._native)

    def __reduce__(self) -> tuple[Any, tuple[Any, ...]]:
        return _agent, (self._arguments,)

    def __deepcopy__(self, memo: dict[int, Any]) -> Agent:
        return _agent(self._arguments)

    def __repr__(self) -> str:
        return f"Agent(planner={self.name!r})"

    @property
    def name(self) -> str:
        """Name of the planner."""
        return self._native.name

    def reset(self) -> None:
        """Discards all state."""
        self._native.reset()

    def plan(self, observation: Observation) -> Trajectory:
        """The trajectory from an observation on. Call it at growing times."""
        return Trajectory._of(self._native.plan(native_observation(observation)))

    @property
    def calls(self) -> list[dict[str, Any]]:
        """The planning calls since the last reset, as `docs/schema` describes them: prompts, answers, reflection, decision."""
        return [json.loads(call) for call in self._native.calls()]


def _agent(arguments: dict[str, Any]) -> Agent:
    return Agent(**arguments)
