"""Runs of many simulations."""

from __future__ import annotations

import json
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

from . import _core
from ._planners import Bound, as_factory, name_of, settings_json
from ._scenario import Scenario
from .errors import ArgumentError, RunNotFoundError

if TYPE_CHECKING:
    import pandas
    import pyarrow

__all__ = ["Progress", "Results", "Table", "merge", "resume", "shard_of_environment", "simulate"]


@dataclass(frozen=True)
class Progress:
    """What a run has done so far.

    Attributes
    ----------
    done, total, failed : int
        Simulations that ended, that the run makes, and that failed. `total` is 0 before the first starts.
    steps : int
        Steps of 0.1 s that all simulations made.
    notes : list of str
        What the user should know; each comes once.
    """

    done: int
    total: int
    failed: int
    steps: int
    notes: list[str] = field(default_factory=list)


class Table:
    """A table of results. It has the Arrow PyCapsule interface, so pandas, polars, pyarrow and DuckDB read it.

    Examples
    --------
    >>> import planagent
    >>> table = planagent.simulate("generated/changing_lane/2", ["idm", "simple"]).table()
    >>> table.to_dict()["planner"]
    ['idm', 'simple']
    """

    __slots__ = ("_native",)
    _native: _core.Table

    def __init__(self) -> None:
        raise TypeError("tables come from Results.table")

    @classmethod
    def _of(cls, native: _core.Table) -> Table:
        made = cls.__new__(cls)
        made._native = native
        return made

    def __len__(self) -> int:
        return len(self._native)

    def __repr__(self) -> str:
        return f"Table({len(self)} rows, {len(self.columns)} columns)"

    @property
    def columns(self) -> list[str]:
        """Names of the columns."""
        return self._native.columns

    def to_dict(self) -> dict[str, list[Any]]:
        """The columns as lists; a missing value is `None`."""
        return self._native.to_dict()

    def __arrow_c_schema__(self) -> Any:
        """The schema as an Arrow capsule."""
        return self._native.__arrow_c_schema__()

    def __arrow_c_stream__(self, requested_schema: Any = None) -> Any:
        """The rows as an Arrow capsule."""
        return self._native.__arrow_c_stream__(requested_schema)

    def to_pyarrow(self) -> pyarrow.Table:
        """The table of pyarrow, which must be installed."""
        import pyarrow

        return pyarrow.table(self)

    def to_pandas(self) -> pandas.DataFrame:
        """The frame of pandas, which must be installed."""
        import pandas

        return pandas.DataFrame(self.to_dict())


class Results:
    """The results of a run.

    Attributes
    ----------
    folder : pathlib.Path or None
        The folder of the run; `None` for one whose files were not kept.
    missing : int
        How many scenarios of the splits the data lacks.
    """

    __slots__ = ("_native", "folder")

    def __init__(self, native: _core.RunResults, is_kept: bool) -> None:
        self._native = native
        self.folder = Path(native.folder) if is_kept else None

    def __repr__(self) -> str:
        place = f", folder={str(self.folder)!r}" if self.folder is not None else ""
        return f"Results({len(self.table())} simulations{place})"

    @property
    def missing(self) -> int:
        """How many scenarios of the splits the data lacks."""
        return self._native.missing

    def table(self) -> Table:
        """A row for each simulation: its score, the scores of the metrics, its error, and how it was planned."""
        return Table._of(self._native.table())

    def mean_scores(self) -> dict[tuple[str, str], float]:
        """The mean score of each planner in each challenge; simulations that failed do not count.

        Examples
        --------
        >>> import planagent
        >>> results = planagent.simulate("generated/changing_lane/2", "log-replay")
        >>> list(results.mean_scores())
        [('log-replay', 'nonreactive')]
        """
        columns = self.table().to_dict()
        scores: dict[tuple[str, str], list[float]] = {}
        for planner, challenge, score in zip(columns["planner"], columns["challenge"], columns["score"]):
            if score is not None:
                scores.setdefault((planner, challenge), []).append(score)
        return {key: sum(values) / len(values) for key, values in scores.items()}


def _words(values: str | os.PathLike[str] | Scenario | Iterable[Any]) -> list[str]:
    """Names of scenarios."""
    if isinstance(values, (str, os.PathLike, Scenario)):
        values = [values]
    words = []
    for value in values:
        if isinstance(value, Scenario):
            if value.name is None:
                raise ArgumentError(f"the scenario {value.id} has no name; a run needs names. Use Simulation, or export_nuplan")
            words.append(value.name)
        else:
            words.append(os.fspath(value))
    return words


def _texts(values: str | Iterable[str]) -> list[str]:
    return [values] if isinstance(values, str) else list(values)


class _Printer:
    """Shows progress in one line of a terminal or of a notebook."""

    def __init__(self, out: TextIO) -> None:
        self._out, self._width = out, 0

    def __call__(self, progress: Progress) -> None:
        for note in progress.notes:
            self._line(note)
            self._out.write("\n")
            self._width = 0
        failed = f", {progress.failed} failed" if progress.failed else ""
        self._line(f"{progress.done} of {progress.total} simulations{failed}")

    def _line(self, text: str) -> None:
        self._out.write("\r" + text + " " * max(0, self._width - len(text)))
        self._out.flush()
        self._width = len(text)

    def end(self) -> None:
        """Ends the line."""
        if self._width:
            self._out.write("\n")


def _callback(progress: bool | Callable[[Progress], None]) -> tuple[Any, Callable[[], None]]:
    """What the native half calls, and what ends it."""
    if progress is False:
        return None, lambda: None
    printer = _Printer(sys.stderr)
    show = printer if progress is True else progress
    end = printer.end if progress is True else lambda: None

    def call(done: int, total: int, failed: int, steps: int, notes: list[str]) -> None:
        show(Progress(done, total, failed, steps, notes))

    return call, end


def _planners(planners: Any) -> tuple[list[str], list[tuple[str, Callable[[], Bound]]]]:
    """Names of all planners, and those in Python."""
    if isinstance(planners, Mapping):
        pairs = [(str(name), planner) for name, planner in planners.items()]
    else:
        is_one = isinstance(planners, str) or not isinstance(planners, Iterable)
        pairs = [
            (planner if isinstance(planner, str) else name_of(planner), planner)
            for planner in ([planners] if is_one else planners)
        ]
    names: list[str] = []
    own = []
    for name, planner in pairs:
        if name in names:
            raise ArgumentError(f"two planners have the name {name}; give names by a dictionary")
        if isinstance(planner, str):
            # A dictionary may give a command a name: {"mine": "exec:python3 mine.py"}.
            word = planner if planner == name or "=" in planner else f"{name}={planner}"
            names.append(word)
        else:
            name_of(type("Named", (), {"name": name})())
            names.append(name)
            own.append((name, as_factory(planner)))
    return names, own


def shard_of_environment(environment: Mapping[str, str] | None = None) -> str | None:
    """The shard of this process in a SLURM array or on one of several nodes; `None` elsewhere.

    It is made of `SLURM_ARRAY_TASK_ID` with `SLURM_ARRAY_TASK_COUNT` and what else SLURM says of the array, else of `NODE_RANK`
    and `NUM_NODES`, the names of nuplan-devkit. `planagent simulate --shard auto` does the same.

    Examples
    --------
    >>> import planagent
    >>> planagent.shard_of_environment({"SLURM_ARRAY_TASK_ID": "5", "SLURM_ARRAY_TASK_MIN": "4", "SLURM_ARRAY_TASK_COUNT": "8"})
    '2/8'
    >>> planagent.shard_of_environment({"NODE_RANK": "0", "NUM_NODES": "2"})
    '1/2'
    """
    return _core.shard_of_environment(dict(os.environ if environment is None else environment))


def simulate(
    scenarios: str | os.PathLike[str] | Scenario | Sequence[Any] = (),
    planners: Any = "plan-agent",
    *,
    challenge: str | Sequence[str] = "nonreactive",
    out: str | os.PathLike[str] | None = None,
    splits: str | Sequence[str] = (),
    types: str | Sequence[str] = (),
    shuffle: bool = False,
    limit: int | None = None,
    shard: str | None = None,
    settings: Mapping[str, Any] | None = None,
    progress: bool | Callable[[Progress], None] = False,
) -> Results:
    """Simulates every scenario with every planner in every challenge, on all threads of `threads()`.

    A simulation that fails is recorded with its error and is no exception. Ctrl-C stops a run; `resume` simulates the rest.

    Parameters
    ----------
    scenarios
        Names as `open` takes them, folders, or scenarios that `open` gave.
    planners
        Names of `planners()`, commands (`exec:COMMAND`), and planners of your own (see `Planner`), also those of nuplan-devkit;
        one, a list, or a dictionary by name.
    challenge
        `nonreactive`, `reactive`, `open-loop`, or `both` for the first two; one or a list.
    out
        Folder of the run, which must not exist; it has what `planagent simulate --out` writes. Without one, no file is kept.
    splits, types, shuffle, limit, shard
        As the options of `planagent simulate`. `shard` is `I/N`; see `shard_of_environment`.
    settings
        Settings by the keys of `planagent.toml`.
    progress
        True shows a line on stderr, also in notebooks. A function is called with a `Progress`, in the calling thread.

    Examples
    --------
    >>> import planagent
    >>> def brake(observation):
    ...     return observation.code(speed=0.0)
    >>> results = planagent.simulate("generated/changing_lane/2", ["idm", brake], challenge="both")
    >>> [row for row in zip(results.table().to_dict()["planner"], results.table().to_dict()["challenge"])]
    [('idm', 'nonreactive'), ('idm', 'reactive'), ('brake', 'nonreactive'), ('brake', 'reactive')]
    """
    if out is not None:
        return _run(out, False, scenarios, planners, challenge, splits, types, shuffle, limit, shard, settings, progress)
    folder = tempfile.mkdtemp(prefix="planagent-")
    try:
        place = os.path.join(folder, "run")
        arguments = (scenarios, planners, challenge, splits, types, shuffle, limit, shard, settings, progress)
        return Results(_run(place, False, *arguments)._native, is_kept=False)
    finally:
        # Work that was interrupted may still write; TemporaryDirectory of Python 3.9 would fail then.
        shutil.rmtree(folder, ignore_errors=True)


def resume(
    out: str | os.PathLike[str],
    planners: Any = (),
    *,
    retry_failed: bool = False,
    progress: bool | Callable[[Progress], None] = False,
) -> Results:
    """Resumes a run that was stopped or killed. Its results are those of a run that was not.

    Parameters
    ----------
    out
        Folder of the run.
    planners
        All planners of the run, where one of them is in Python: the folder holds its name alone.
    retry_failed
        Whether simulations that failed are repeated.
    progress
        As `simulate` takes it.

    Raises
    ------
    RunNotFoundError
        Where the folder holds no run; it is also a `FileNotFoundError`.
    """
    if not Path(out, "manifest.toml").is_file():
        raise RunNotFoundError(f"{os.fspath(out)} holds no run: there is no manifest.toml")
    return _run(out, True, (), planners, (), (), (), False, None, None, None, progress, retry_failed)


def _run(
    out: str | os.PathLike[str],
    is_resumed: bool,
    scenarios: Any,
    planners: Any,
    challenge: str | Sequence[str],
    splits: str | Sequence[str],
    types: str | Sequence[str],
    shuffle: bool,
    limit: int | None,
    shard: str | None,
    settings: Mapping[str, Any] | None,
    progress: bool | Callable[[Progress], None],
    retry_failed: bool = False,
) -> Results:
    names, own = _planners(planners)
    asked = {
        "scenarios": _words(scenarios),
        "splits": _texts(splits),
        "types": _texts(types),
        "shuffle": shuffle,
        "limit": limit,
        "shard": shard,
        "planners": names,
        "challenges": _texts(challenge),
        "settings": None if settings is None else settings_json(dict(settings)),
        "retry_failed": retry_failed,
    }
    call, end = _callback(progress)
    try:
        native = _core.run(json.dumps(asked), os.fspath(out), is_resumed, own, call)
    finally:
        end()
    return Results(native, is_kept=True)


def merge(runs: Sequence[str | os.PathLike[str]], out: str | os.PathLike[str]) -> Results:
    """Merges the shards of a run into a new folder, which is that of a run without shards."""
    return Results(_core.merge([os.fspath(run) for run in runs], os.fspath(out)), is_kept=True)
