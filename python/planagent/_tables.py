"""Plain tables as the numbers of a scenario."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ._arguments import wrong
from ._arrays import KINDS, array
from .errors import ScenarioError

#: Length and width of an object where its table has none, meters: those of the library.
SIZES = {
    "vehicle": (4.6, 1.9),
    "bicycle": (1.8, 0.7),
    "pedestrian": (0.7, 0.7),
    "traffic_cone": (0.4, 0.4),
}
OTHER_SIZE = (2.0, 0.6)
#: Width of a lane where its table has none, meters.
LANE_WIDTH = 3.5
#: Time between two frames, and how far one may be off, seconds.
STEP_S, JITTER_S = 0.1, 0.02
#: Largest coordinate (meters), speed and acceleration: products of larger ones overflow.
MAX_NUMBER = 1e9
#: Latest time, seconds: also that of the clock of a computer.
MAX_TIME = 1e11
#: Largest width of a lane and side of an object, meters, and largest speed limit, m/s.
MAX_SIDE, MAX_LIMIT = 1e3, 1e3


class _Table:
    """The columns of a table."""

    def __init__(self, name: str, source: Any) -> None:
        columns = source.keys() if isinstance(source, Mapping) else getattr(source, "columns", None)
        if columns is None or isinstance(columns, (str, bytes)):
            argument = name.split()[-1]
            raise wrong(argument, source, "expected a table: of pandas, of polars, or a dictionary of columns")
        self._name = name
        self._columns = {str(column): array(f"the column {column} of {name}", source[column], "expected a value a row") for column in columns}
        lengths = {len(column) for column in self._columns.values()}
        if len(lengths) > 1:
            raise ScenarioError(f"the columns of the table of {name} have different lengths: {sorted(lengths)}")
        self.rows = lengths.pop() if lengths else 0

    def __contains__(self, column: str) -> bool:
        return column in self._columns

    def values(self, column: str, default: Any = None) -> NDArray[Any]:
        if column in self._columns:
            return self._columns[column]
        if default is None:
            known = ", ".join(self._columns)
            raise ScenarioError(f"the table of {self._name} has no column {column}; it has {known}")
        return np.full(self.rows, default)

    def numbers(
        self, column: str, default: float | None = None, *, above: float = -MAX_NUMBER, most: float = MAX_NUMBER
    ) -> NDArray[np.float64]:
        """Numbers between two bounds; one that is missing is NaN."""
        numbers = self._floats(column, default)
        beyond = (numbers <= above) | (numbers > most)
        if beyond.any():
            row = int(np.argmax(beyond))
            expected = f"greater than {above:g} and at most {most:g}"
            raise ScenarioError(
                f"the column {column} of the table of {self._name} has {numbers[row]:g} in row {row}; it must be {expected}"
            )
        return numbers

    def truths(self, column: str) -> NDArray[np.bool_]:
        """Truth values, also as 0 and 1; false without the column."""
        values = self.values(column, False)
        if values.dtype.kind == "O":
            values = np.array([False if value is None else value for value in values])
        if values.dtype.kind not in "biuf" or not np.isin(values, (0, 1)).all():
            raise ScenarioError(f"the column {column} of the table of {self._name} holds no truth values")
        return values.astype(np.bool_)

    def _floats(self, column: str, default: float | None) -> NDArray[np.float64]:
        values = self.values(column, default)
        try:
            return values.astype(np.float64)
        except (TypeError, ValueError) as error:
            raise ScenarioError(f"the column {column} of the table of {self._name} holds no numbers: {error}") from None


def _frame_of(times: NDArray[np.float64], frames: NDArray[np.float64], name: str) -> NDArray[np.int64]:
    """The frame of each time."""
    nearest = np.clip(np.searchsorted(frames, times - STEP_S / 2), 0, len(frames) - 1)
    off = np.abs(frames[nearest] - times) > STEP_S / 2
    if off.any():
        raise ScenarioError(f"the table of {name} has the time {times[off][0]:g} s, at which the ego has no row")
    return nearest.astype(np.int64)


def _ego(ego: _Table) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Times (s) and x, y, heading, vx, vy, ax, ay of the ego."""
    times = ego.numbers("time_s", above=-MAX_TIME, most=MAX_TIME)
    if len(times) < 2:
        raise ScenarioError("the table of the ego has fewer than two rows")
    steps = np.diff(times)
    if (np.abs(steps - STEP_S) > JITTER_S).any():
        row = int(np.argmax(np.abs(steps - STEP_S) > JITTER_S))
        raise ScenarioError(f"the rows {row} and {row + 1} of the ego are {steps[row]:g} s apart; they must be 0.1 s apart")
    x, y, heading = (ego.numbers(column) for column in ("x", "y", "heading"))
    heading = np.unwrap(heading)
    if "vx" in ego:
        vx, vy = ego.numbers("vx"), ego.numbers("vy", 0.0)
    else:
        east, north = np.gradient(x, times), np.gradient(y, times)
        vx = east * np.cos(heading) + north * np.sin(heading)
        vy = north * np.cos(heading) - east * np.sin(heading)
    if "ax" in ego:
        ax, ay = ego.numbers("ax"), ego.numbers("ay", 0.0)
    else:
        ax, ay = np.gradient(vx, times), np.gradient(vy, times)
    return times, np.column_stack([x, y, heading, vx, vy, ax, ay])


def _agents(agents: _Table, frames: NDArray[np.float64]) -> list[list[tuple[int, int, list[float]]]]:
    """The objects of each frame."""
    rows: list[list[tuple[int, int, list[float]]]] = [[] for _ in frames]
    if agents.rows == 0:
        return rows
    places = _frame_of(agents.numbers("time_s", above=-MAX_TIME, most=MAX_TIME), frames, "agents")
    tokens = [str(token) for token in agents.values("token")]
    numbers = {token: number for number, token in enumerate(dict.fromkeys(tokens))}
    kinds = [str(kind) for kind in agents.values("kind", "vehicle")]
    unknown = next((kind for kind in kinds if kind not in KINDS), None)
    if unknown is not None:
        raise ScenarioError(f"the table of agents has the kind {unknown}; kinds are {', '.join(KINDS)}")
    x, y, heading = (agents.numbers(column) for column in ("x", "y", "heading"))
    sizes = np.array([SIZES.get(kind, OTHER_SIZE) for kind in kinds])
    length = agents.numbers("length", above=0.0, most=MAX_SIDE) if "length" in agents else sizes[:, 0]
    width = agents.numbers("width", above=0.0, most=MAX_SIDE) if "width" in agents else sizes[:, 1]
    if "vx" in agents:
        vx, vy = agents.numbers("vx"), agents.numbers("vy")
    else:
        vx, vy = _velocities(np.array([numbers[token] for token in tokens]), frames[places], x, y)
    values = np.column_stack([x, y, heading, length, width, vx, vy])
    seen: set[tuple[int, int]] = set()
    for place, token, kind, row in zip(places, tokens, kinds, values):
        number = numbers[token]
        if (int(place), number) in seen:
            raise ScenarioError(f"the table of agents has {token} twice at {frames[place]:g} s")
        seen.add((int(place), number))
        rows[int(place)].append((number, KINDS.index(kind), row.tolist()))
    return rows


def _velocities(
    tracks: NDArray[Any], times: NDArray[np.float64], x: NDArray[np.float64], y: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Velocities in the map frame from the positions of each track."""
    vx, vy = np.zeros_like(x), np.zeros_like(y)
    for track in np.unique(tracks):
        own = np.flatnonzero(tracks == track)
        own = own[np.argsort(times[own])]
        if len(own) > 1 and (np.diff(times[own]) > 0).all():
            vx[own], vy[own] = np.gradient(x[own], times[own]), np.gradient(y[own], times[own])
    return vx, vy


def _lanes(lanes: _Table) -> tuple[dict[str, int], list[dict[str, Any]]]:
    """Numbers of the lanes by name, and their rows."""
    names = [str(name) for name in lanes.values("lane")]
    numbers = {name: number for number, name in enumerate(dict.fromkeys(names))}
    points = np.column_stack([lanes.numbers("x"), lanes.numbers("y")])
    places = np.array([numbers[name] for name in names])
    width = lanes.numbers("width", LANE_WIDTH, above=0.0, most=MAX_SIDE)
    limit = lanes.numbers("speed_limit", np.nan, above=0.0, most=MAX_LIMIT)
    connector, light = lanes.truths("connector"), lanes.truths("light")
    left = lanes.values("left", "").astype(object)
    rows = []
    for name, number in numbers.items():
        own = np.flatnonzero(places == number)
        first = int(own[0])
        neighbor = left[first]
        is_none = neighbor is None or neighbor == "" or neighbor != neighbor
        if not is_none and str(neighbor) not in numbers:
            raise ScenarioError(f"lane {name} has {neighbor} to its left, which the table of lanes lacks")
        rows.append(
            {
                "centerline": np.ascontiguousarray(points[own]).tobytes(),
                "width": float(width[first]),
                "speed_limit": None if np.isnan(limit[first]) else float(limit[first]),
                "connector": bool(connector[first]),
                "left": None if is_none else numbers[str(neighbor)],
                "light": bool(light[first]),
            }
        )
    return numbers, rows


def native_arguments(
    ego: Any,
    agents: Any,
    lanes: Any,
    lights: Any,
    names: tuple[str, str],
    history_s: float,
    route: list[Any] | None,
) -> tuple[Any, ...]:
    """The arguments of the native function."""
    times, states = _ego(_Table("the ego", ego))
    numbers, lane_rows = _lanes(_Table("lanes", lanes))

    def lane(name: Any) -> int:
        if str(name) not in numbers:
            raise ScenarioError(f"there is no lane {name} in the table of lanes")
        return numbers[str(name)]

    colors: list[list[tuple[int, str]]] = [[] for _ in times]
    if lights is not None:
        table = _Table("lights", lights)
        places = _frame_of(table.numbers("time_s", above=-MAX_TIME, most=MAX_TIME), times, "lights")
        for place, name, status in zip(places, table.values("lane"), table.values("status")):
            colors[int(place)].append((lane(name), str(status)))
    micros = [round(float(time) * 1e6) for time in times]
    objects = _agents(_Table("agents", agents), times)
    start = round(history_s / STEP_S)
    lanes_of_route = None if route is None else [lane(name) for name in route]
    packed = np.ascontiguousarray(states).tobytes()
    return names, lane_rows, micros, packed, objects, colors, start, lanes_of_route
