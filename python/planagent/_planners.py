"""Planners: those of the library, and your own."""

from __future__ import annotations

import copy
import inspect
import json
import math
import os
import re
import types
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from . import _core
from ._arguments import text, unicode, whole, wrong
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
        """The trajectory from now on: a `Trajectory`, or poses as `Simulation.step` takes them.

        Examples
        --------
        >>> import planagent
        >>> class Slow:
        ...     def plan(self, observation):
        ...         return observation.code(speed=0.5)
        >>> isinstance(Slow(), planagent.Planner)
        True
        """
        ...


class Bound:
    """A planner in Python for one simulation, as a run calls it."""

    def __init__(self, planner: Any) -> None:
        self._planner = planner
        plan = getattr(planner, "plan", planner)
        if not callable(plan):
            raise _no_planner("planners", planner, "it has no method plan and cannot be called")
        #: What plans.
        self.function: Callable[[Observation], Any] = plan

    def reset(self) -> None:
        """Called before the first step."""
        reset = getattr(self._planner, "reset", None)
        if reset is not None:
            reset()

    def plan(self, native: _core.Observation) -> _core.Trajectory:
        """Called at each step."""
        observation = Observation._of(native)
        planned = self.function(observation)
        if planned is None:
            raise ArgumentError("the planner returned None; it must return a Trajectory or an array of T x 3 poses")
        return observation.trajectory(planned)._native


def as_factory(planner: Any, argument: str = "planners") -> Callable[[], Bound]:
    """What makes a planner of one simulation. What is no planner is refused here, before a run begins."""
    if _is_of_nuplan(planner):
        from .nuplan import adapted

        return adapted(planner)
    if inspect.isclass(planner):
        _check_call(argument, planner, "a class", 0)
        plan = getattr(planner, "plan", None) or (planner.__call__ if "__call__" in _members(planner) else None)
        if plan is not None:
            if callable(plan):
                _check_call(argument, plan, "its method plan", 2 if _is_of_instances(planner, plan) else 1)
            elif not isinstance(plan, property) and not hasattr(plan, "__get__"):
                raise _no_planner(argument, planner, "its attribute plan cannot be called")
            return lambda: Bound(planner())
        # Only an object shows whether it has a method plan.
        return _one_after_the_other([Bound(planner())], lambda: Bound(planner()))
    if planner is None or isinstance(planner, (str, bytes, Mapping)):
        raise _no_planner(argument, planner, "expected a name, a function, a class or an object with a method plan")
    plan = getattr(planner, "plan", planner)
    if not callable(plan):
        raise _no_planner(argument, planner, "it has no method plan and cannot be called")
    _check_call(argument, plan, "the function" if plan is planner else "its method plan", 1)
    owner = getattr(planner, "__self__", None)
    if inspect.ismethod(planner) and not inspect.isclass(owner):
        # The object of a method is copied as any other.
        function = planner.__func__
        return _copies(argument, owner, lambda own: Bound(types.MethodType(function, own)))
    if inspect.isroutine(planner):
        return lambda: Bound(planner)
    return _copies(argument, planner, Bound)


def _copies(argument: str, planner: Any, bound: Callable[[Any], Bound]) -> Callable[[], Bound]:
    """A copy of an object for each simulation."""
    try:
        first = bound(copy.deepcopy(planner))
    except Exception as error:
        raise _no_planner(
            argument, planner, f"an object is copied for each simulation, and copy.deepcopy fails: {error}; give the class or a function"
        ) from error
    return _one_after_the_other([first], lambda: bound(copy.deepcopy(planner)))


def _one_after_the_other(first: list[Bound], make: Callable[[], Bound]) -> Callable[[], Bound]:
    """What tried a planner out serves its first simulation."""

    def next_one() -> Bound:
        try:
            return first.pop()
        except IndexError:
            return make()

    return next_one


def _members(kind: type) -> set[str]:
    return {name for base in kind.__mro__[:-1] for name in vars(base)}


def _is_of_instances(kind: type, plan: Any) -> bool:
    """Whether a function of a class takes the object first."""
    own = inspect.getattr_static(kind, getattr(plan, "__name__", "plan"), None)
    return inspect.isfunction(own)


def _check_call(argument: str, function: Any, what: str, arguments: int) -> None:
    """Refuses what cannot be called with so many arguments, where its signature is known."""
    kinds = (inspect.iscoroutinefunction, inspect.isgeneratorfunction, inspect.isasyncgenfunction)
    if any(is_of_kind(function) for is_of_kind in kinds):
        raise _no_planner(argument, function, f"{what} is a coroutine or a generator, and a plan is returned")
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):
        return
    try:
        signature.bind(*[None] * arguments)
    except TypeError as error:
        taken = "no argument" if arguments == 0 else "an observation"
        raise _no_planner(argument, function, f"{what} is called with {taken}: {error}") from None


def _no_planner(argument: str, planner: Any, why: str) -> ArgumentError:
    return wrong(argument, planner, f"this is no planner: {why}")


def is_planner(value: Any) -> bool:
    """Whether a value is one planner rather than a list of them."""
    return callable(value) or hasattr(value, "plan") or _is_of_nuplan(value)


def _is_of_nuplan(planner: Any) -> bool:
    return callable(getattr(planner, "compute_planner_trajectory", None))


def name_of(planner: Any) -> str:
    """The name of a planner in tables and files."""
    if isinstance(planner, Agent):
        raise ArgumentError(
            f"an Agent has the name of a planner of the library ({planner.name}); give it another one by a dictionary: "
            f"planners={{'my-{planner.name}': agent}}"
        )
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


def nested(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Settings with keys such as `reflection.max_exec` as nested dictionaries."""
    whole: dict[str, Any] = {}
    for key, value in settings.items():
        if not isinstance(key, str):
            raise wrong("settings", settings, f"the key {key!r} is no text, such as 'reflection.max_exec'")
        *sections, last = key.split(".")
        place = whole
        for section in sections:
            place = place.setdefault(section, {})
            if not isinstance(place, dict):
                raise ArgumentError(f"settings[{key!r}] lies in {section}, which is no section")
        value = nested(value) if isinstance(value, Mapping) else _plain(key, value)
        if isinstance(value, dict) and isinstance(place.get(last), dict):
            place[last].update(value)
        else:
            place[last] = value
    return whole


def _plain(key: str, value: Any) -> Any:
    """A value of a setting as TOML has it: numpy's numbers and paths are taken."""
    if isinstance(value, (np.generic, np.ndarray)):
        value = value.tolist()
    if isinstance(value, os.PathLike):
        return _plain(key, os.fspath(value))
    if isinstance(value, (list, tuple)):
        return [_plain(key, one) for one in value]
    if not isinstance(value, (bool, int, float, str)):
        raise wrong(f"settings[{key!r}]", value, "expected a number, a text, a truth value or a list of these")
    if isinstance(value, float) and not math.isfinite(value):
        raise wrong(f"settings[{key!r}]", value, "expected a finite number")
    if isinstance(value, int) and not -(2**63) <= value < 2**63:
        raise wrong(f"settings[{key!r}]", value, "expected a number of 64 bits")
    return unicode(f"settings[{key!r}]", value) if isinstance(value, str) else value


def settings_json(settings: Mapping[str, Any] | None, **known: Any) -> str:
    """Settings for the native half; `None` leaves a value at its default."""
    if settings is not None and not isinstance(settings, Mapping):
        raise wrong("settings", settings, "expected a dictionary by the keys of planagent.toml")
    whole = nested(settings or {})
    given = {key.replace("__", "."): value for key, value in known.items() if value is not None}
    for key, value in given.items():
        section, _, last = key.rpartition(".")
        other = (whole.get(section, {}) if section else whole).get(last, value)
        if other != value:
            raise wrong(f"settings[{key!r}]", other, f"the argument for it is {value!r}; leave one of them out")
    for key, value in nested(given).items():
        if isinstance(value, dict):
            whole.setdefault(key, {}).update(value)
        else:
            whole[key] = value
    return json.dumps(whole)


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
        model: str | os.PathLike[str] | None = None,
        *,
        planner: str = "plan-agent",
        seed: int | None = None,
        settings: Mapping[str, Any] | None = None,
        scenario: Scenario | None = None,
    ) -> None:
        if scenario is not None:
            from ._scenario import Scenario

            if not isinstance(scenario, Scenario):
                raise wrong("scenario", scenario, "expected a Scenario, which planagent.open gives")
        model = None if model is None else text("model", os.fspath(model) if isinstance(model, os.PathLike) else model)
        seed = None if seed is None else whole("seed", seed, 0, 2**63 - 1)
        text("planner", planner)
        merged = settings_json(settings, seed=seed, mllm__model=model)
        self._arguments = {
            "model": model,
            "planner": planner,
            "seed": seed,
            "settings": None if settings is None else dict(settings),
            "scenario": scenario,
        }
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
        """Discards all state.

        Examples
        --------
        >>> import planagent
        >>> agent = planagent.Agent(planner="idm")
        >>> plan = agent.plan(planagent.open("generated/changing_lane/2").observe())
        >>> agent.reset()
        >>> agent.calls
        []
        """
        self._native.reset()

    def plan(self, observation: Observation) -> Trajectory:
        """The trajectory from an observation on. Call it at growing times.

        Examples
        --------
        >>> import planagent
        >>> observation = planagent.open("generated/changing_lane/2").observe()
        >>> planagent.Agent(planner="pdm-closed").plan(observation)
        Trajectory(81 states over 8 s)
        """
        return Trajectory._of(self._native.plan(native_observation(observation)))

    @property
    def calls(self) -> list[dict[str, Any]]:
        """The planning calls since the last reset, as `docs/schema` describes them: prompts, answers, reflection, decision."""
        return [json.loads(call) for call in self._native.calls()]


def _agent(arguments: dict[str, Any]) -> Agent:
    return Agent(**arguments)
