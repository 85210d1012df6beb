"""Scenarios."""

from __future__ import annotations

import os
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from . import _arrays, _core
from ._arguments import path, real, text, truth, whole, word, wrong
from ._observation import Lane, Observation
from .errors import ScenarioError

if TYPE_CHECKING:
    from ._simulation import Simulation

__all__ = ["Scenario", "find", "open", "scenario_types"]


class Scenario:
    """A recorded or generated scenario: map, logged agents, traffic lights, route and expert.

    `open` gives one by name, `Scenario.of_tables` one from tables of your own. It pickles by its name.

    Examples
    --------
    >>> import planagent
    >>> scenario = planagent.open("generated/changing_lane/2")
    >>> scenario.id, scenario.log_name, scenario.expert.shape
    ('generated/changing_lane/2', 'generated-2', (151, 7))
    """

    __slots__ = ("_made_of", "_native")
    _native: _core.Scenario
    _made_of: tuple[Any, ...] | None

    def __init__(self) -> None:
        raise TypeError("scenarios come from planagent.open and Scenario.of_tables")

    @classmethod
    def _of(cls, native: _core.Scenario, made_of: tuple[Any, ...] | None = None) -> Scenario:
        made = cls.__new__(cls)
        made._native, made._made_of = native, made_of
        return made

    def __reduce__(self) -> tuple[Any, tuple[Any, ...]]:
        word = self._native.word
        if word is not None:
            return open, (word,)
        if self._made_of is None:
            raise ScenarioError(f"the scenario {self.id} has no name to pickle")
        return _again, (self._made_of,)

    def __repr__(self) -> str:
        return f"Scenario({self.id!r}, type={self.scenario_type!r}, iterations={self.iterations})"

    @property
    def id(self) -> str:
        """Unique within its source: a Waymo scenario id, a nuPlan token, the name of a generated scenario."""
        return self._native.id

    @property
    def name(self) -> str | None:
        """The word that names it from any working directory; `None` for a scenario of tables."""
        return self._native.word

    @property
    def scenario_type(self) -> str:
        """nuPlan's scenario type."""
        return self._native.scenario_type

    @property
    def log_name(self) -> str:
        """Name of the source log."""
        return self._native.log_name

    @property
    def iterations(self) -> int:
        """Number of iterations, 0.1 s apart."""
        return self._native.iterations

    @property
    def expert(self) -> NDArray[np.float64]:
        """The recorded ego: a row of x, y, heading, vx, vy, ax, ay for each iteration."""
        _, data = self._native.expert()
        return _arrays.unpacked(data, 11)[:, :7].copy()

    def lanes(self) -> list[Lane]:
        """All lanes of the map; the n-th has the number n.

        Examples
        --------
        >>> import planagent
        >>> any(lane.on_route for lane in planagent.open("generated/changing_lane/2").lanes())
        True
        """
        return [Lane._of(lane) for lane in self._native.lanes()]

    def observe(self, iteration: int = 0) -> Observation:
        """The recorded scene of an iteration.

        Examples
        --------
        >>> import planagent
        >>> planagent.open("generated/changing_lane/2").observe(20).time_s
        2.0
        """
        return Observation._of(self._native.observe(whole("iteration", iteration, 0, self.iterations - 1)))

    def simulation(self, challenge: str = "nonreactive") -> Simulation:
        """A simulation of this scenario; see `Simulation`.

        Examples
        --------
        >>> import planagent
        >>> planagent.open("generated/changing_lane/2").simulation("reactive")
        Simulation('generated/changing_lane/2', 'reactive', iteration=0 of 150)
        """
        from ._simulation import Simulation

        return Simulation(self, challenge)

    def export_nuplan(self, folder: str | os.PathLike[str], stand_in_maps: bool = True) -> tuple[str, str]:
        """Writes the scenario as a nuPlan log with its map into a new folder.

        Parameters
        ----------
        folder
            The folder, which must not exist.
        stand_in_maps
            Whether to add stand-ins for nuPlan's maps that the scenario does not use; nuplan-devkit asks for all of them.

        Returns
        -------
        tuple of str
            The folders that `NUPLAN_DATA_ROOT` and `NUPLAN_MAPS_ROOT` shall name.

        Examples
        --------
        >>> import os, planagent, tempfile
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     scenario = planagent.open("generated/changing_lane/2")
        ...     data, maps = scenario.export_nuplan(os.path.join(folder, "nuplan"), stand_in_maps=False)
        ...     os.path.basename(data), os.path.basename(maps)
        ('data', 'maps')
        """
        data, maps = self._native.export_nuplan(path("folder", folder), truth("stand_in_maps", stand_in_maps))
        return os.fspath(data), os.fspath(maps)

    @classmethod
    def of_tables(
        cls,
        ego: Any,
        agents: Any,
        lanes: Any,
        lights: Any = None,
        *,
        id: str = "table",
        scenario_type: str = "unknown",
        history_s: float = 0.0,
        route: Iterable[Any] | None = None,
    ) -> Scenario:
        """A scenario from tables: of pandas, of polars, or dictionaries of columns.

        Parameters
        ----------
        ego
            A row every 0.1 s: `time_s`, and `x`, `y`, `heading` of the rear axle in the map frame. Optional: `vx`, `vy`, `ax`,
            `ay` in the body frame; else they are derived.
        agents
            A row for each object at each time of the ego: `time_s`, `token` (any text or number), `x`, `y`, `heading` of the
            box's center. Optional: `kind` (one of `planagent.KINDS`), `length`, `width`, `vx`, `vy` in the map frame.
        lanes
            A row for each point of a centerline in driving direction: `lane` (any text or number), `x`, `y`. Optional, the same
            for all points of a lane: `width`, `speed_limit`, `connector`, `left` (the lane to its left), `light`.
        lights
            A row for each state of a traffic light: `time_s`, `lane`, `status`.
        id, scenario_type
            Names of the scenario.
        history_s
            Seconds before iteration 0.
        route
            The lanes of the route by their names; else those under the recorded ego.

        Examples
        --------
        >>> import planagent
        >>> times = [0.1 * i for i in range(60)]
        >>> ego = {"time_s": times, "x": [10 * t for t in times], "y": [0.0] * 60, "heading": [0.0] * 60}
        >>> agents = {"time_s": times, "token": ["truck"] * 60, "x": [50.0] * 60, "y": [0.0] * 60, "heading": [0.0] * 60}
        >>> lanes = {"lane": ["main", "main"], "x": [-20.0, 200.0], "y": [0.0, 0.0]}
        >>> scenario = planagent.Scenario.of_tables(ego, agents, lanes)
        >>> scenario.iterations
        60
        """
        from ._tables import STEP_S, native_arguments

        history_s = real("history_s", history_s, 0.0)
        if abs(history_s / STEP_S - round(history_s / STEP_S)) > 1e-6:
            raise wrong("history_s", history_s, f"expected a multiple of {STEP_S} s")
        id, scenario_type = text("id", id), text("scenario_type", scenario_type)
        if route is not None:
            route = [route] if isinstance(route, (str, bytes)) else list(route)
            if not route:
                raise wrong("route", route, "name a lane, or leave it out")
        arguments = native_arguments(ego, agents, lanes, lights, (id, scenario_type), history_s, route)
        return _again(arguments)


def _again(arguments: tuple[Any, ...]) -> Scenario:
    return Scenario._of(_core.scenario_of_tables(*arguments), arguments)


def open(name: str | os.PathLike[str]) -> Scenario:
    """Opens the scenario of a name, as the command line does.

    Parameters
    ----------
    name
        A generated scenario (`generated/changing_lane/2`), a Waymo TFRecord file of one scenario, a nuPlan log with a token
        (`LOG.db#TOKEN`), a folder of an Argoverse 2 scenario.

    Raises
    ------
    ScenarioNotFoundError
        Where there is no such file; it is also a `FileNotFoundError`.
    ScenarioError
        Where the name stands for no scenario or for several; it is also a `ValueError`.

    Examples
    --------
    >>> import planagent
    >>> planagent.open("generated/changing_lane/2")
    Scenario('generated/changing_lane/2', type='changing_lane', iterations=151)
    """
    return Scenario._of(_core.open(_word(name)))


def _word(name: Any) -> str:
    if not isinstance(name, (str, os.PathLike)):
        raise wrong("name", name, "expected the name of a scenario")
    return word("name", os.fsdecode(name), "expected the name of a scenario")


def opened(argument: str, scenario: Any) -> Scenario:
    """A scenario, or the one that a name stands for."""
    if isinstance(scenario, Scenario):
        return scenario
    if not isinstance(scenario, (str, os.PathLike)):
        raise wrong(argument, scenario, "expected a Scenario or the name of one")
    return open(scenario)


def find(name: str | os.PathLike[str]) -> list[str]:
    """The names of all scenarios that a name stands for, for example those of a folder.

    Examples
    --------
    >>> import planagent
    >>> planagent.find("generated/changing_lane/2")
    ['generated/changing_lane/2']
    """
    return _core.find(_word(name))


def scenario_types() -> list[str]:
    """The scenario types of the generator; `generated/TYPE/SEED` names a scene of one.

    Examples
    --------
    >>> import planagent
    >>> "changing_lane" in planagent.scenario_types()
    True
    """
    return _core.scenario_types()
