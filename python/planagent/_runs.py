"""Runs of many simulations."""

from __future__ import annotations

import atexit
import contextlib
import json
import os
import shutil
import tempfile
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, Protocol

from . import _core, _threads
from ._arguments import callback, many, path, seconds, text, texts, truth, whole, word, wrong
from ._planners import Bound, as_factory, is_planner, name_of, settings_json
from ._progress import Progress, printer_of
from ._results import Results
from ._scenario import Scenario
from .errors import ArgumentError, RunNotFoundError, RunStoppedError

__all__ = ["merge", "open_run", "resume", "shard_of_environment", "simulate"]

#: Longest time between two looks at signals and progress, seconds.
POLL_S = 0.02
#: Time that a stopped run has to end before it is left behind, seconds.
GRACE_S = 0.5


class Stop(Protocol):
    """What tells a run to stop, for example a `threading.Event`."""

    def is_set(self) -> bool:
        """Whether the run shall stop."""
        ...


def _words(values: Any) -> list[str]:
    """Names of scenarios."""
    words = []
    for value in many("scenarios", values, (str, os.PathLike, Scenario), "a Scenario or the name of one"):
        if isinstance(value, Scenario):
            if value.name is None:
                raise ArgumentError(f"the scenario {value.id} has no name; a run needs names. Use Simulation, or export_nuplan")
            words.append(value.name)
        else:
            words.append(word("scenarios", os.fsdecode(value), "expected the name of a scenario"))
    return words


def _planners(planners: Any) -> tuple[list[str], list[tuple[str, Callable[[], Bound]]]]:
    """Names of all planners, and those in Python."""
    if isinstance(planners, Mapping):
        for name in planners:
            if not isinstance(name, str):
                raise wrong("planners", planners, f"the name {name!r} is no text")
        pairs = list(planners.items())
    else:
        is_one = isinstance(planners, (str, bytes)) or is_planner(planners) or not isinstance(planners, Iterable)
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
    scenarios: str | os.PathLike[str] | Scenario | Iterable[str | os.PathLike[str] | Scenario] | None = None,
    planners: Any = "plan-agent",
    *,
    challenge: str | Iterable[str] = "nonreactive",
    out: str | os.PathLike[str] | None = None,
    splits: str | Iterable[str] | None = None,
    types: str | Iterable[str] | None = None,
    shuffle: bool = False,
    limit: int | None = None,
    shard: str | None = None,
    settings: Mapping[str, Any] | None = None,
    progress: bool | Callable[[Progress], None] = False,
    stop: Stop | None = None,
    agents: str | None = None,
    exec_timeout: float | None = None,
) -> Results:
    """Simulates every scenario with every planner in every challenge, on all threads of `threads()`.

    A simulation that fails is recorded with its error and is no exception; a warning counts them. Ctrl-C stops a run, in the main thread
    and in others; `resume` simulates the rest. The exception has what was completed as its attribute `results`.

    Parameters
    ----------
    scenarios
        Names as `open` takes them, folders, or scenarios that `open` gave; one or several. Each is simulated once, however often it is
        named. Without any, and without splits, the scene
        `generated/changing_lane/2`.
    planners
        Names of `planners()`, commands (`exec:COMMAND`), and planners of your own (see `Planner`), also those of nuplan-devkit;
        one, a list, or a dictionary by name.
    challenge
        `nonreactive`, `reactive`, `open-loop`, or `both` for the first two; one or a list.
    out
        Folder of the run, which must not exist; `open_run` reads it again. Without one, no file is kept.
    splits
        Names of suites and splits, or files of nuPlan's scenario filters.
    types
        Only scenarios of these types; see `scenario_types`.
    shuffle
        Whether the scenarios are taken in an order that the seed draws.
    limit
        Maximum number of scenarios, taken evenly from the types.
    shard
        `I/N`: only this part of the scenarios; see `shard_of_environment`.
    settings
        Settings by the keys of `planagent.toml`.
    progress
        True shows a line on stderr, also in notebooks, and lines where stderr is no terminal. A function is called with a `Progress`, in
        the calling thread.
    stop
        Stops the run from another thread once its `is_set()` is true, for example a `threading.Event`. Then `RunStoppedError` is raised.
    agents
        A command that controls the other agents, as `exec:COMMAND` or `NAME=exec:COMMAND`.
    exec_timeout
        Time that a command may take for a step, seconds; 10 by default.

    Raises
    ------
    ArgumentError
        Where an argument cannot be used, or what stands for a planner is none; it is also a `ValueError`.
    RunStoppedError
        Where `stop` was set.

    Examples
    --------
    >>> import planagent
    >>> def brake(observation):
    ...     return observation.code(speed=0.0)
    >>> results = planagent.simulate("generated/changing_lane/2", ["idm", brake], challenge="both")
    >>> [row for row in zip(results.table().to_dict()["planner"], results.table().to_dict()["challenge"])]
    [('idm', 'nonreactive'), ('idm', 'reactive'), ('brake', 'nonreactive'), ('brake', 'reactive')]
    """
    folder = None if out is None else path("out", out)
    arguments = {
        "scenarios": scenarios,
        "planners": planners,
        "challenge": challenge,
        "splits": splits,
        "types": types,
        "shuffle": shuffle,
        "limit": limit,
        "shard": shard,
        "settings": settings,
        "agents": agents,
        "exec_timeout": exec_timeout,
    }
    if folder is not None:
        return _run(folder, False, progress, stop, **arguments)
    asked = _asked(**arguments)
    temporary = tempfile.mkdtemp(prefix="planagent-")
    try:
        return _waited(os.path.join(temporary, "run"), False, progress, stop, asked, temporary)
    finally:
        # Work that was interrupted may still write; it removes the folder at its end.
        shutil.rmtree(temporary, ignore_errors=True)


def resume(
    out: str | os.PathLike[str],
    planners: Any = None,
    *,
    retry_failed: bool = False,
    accept_changes: bool = False,
    settings: Mapping[str, Any] | None = None,
    progress: bool | Callable[[Progress], None] = False,
    stop: Stop | None = None,
    agents: str | None = None,
    exec_timeout: float | None = None,
) -> Results:
    """Resumes a run that was stopped or killed. Its results are those of a run that was not.

    Parameters
    ----------
    out
        Folder of the run.
    planners
        All planners of the run, where one of them is in Python or a command: the folder holds its name alone.
    retry_failed
        Whether simulations that failed are repeated.
    accept_changes
        Whether the run is resumed although models, prompts or recordings changed; its manifest then says so.
    settings
        All settings of the run, where they name a server, a description, a model of the hub or a checkpoint: a folder may come from
        elsewhere and chooses none of these by itself. Without them, the settings are those of the folder.
    progress, stop, agents, exec_timeout
        As `simulate` takes them.

    Raises
    ------
    RunNotFoundError
        Where the folder holds no run; it is also a `FileNotFoundError`.

    Examples
    --------
    >>> import os, planagent, tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     out = os.path.join(folder, "run")
    ...     first = planagent.simulate("generated/changing_lane/2", "idm", out=out)
    ...     len(planagent.resume(out)) == len(first)
    True
    """
    folder = _existing(out)
    arguments = {"planners": planners, "retry_failed": retry_failed, "accept_changes": accept_changes, "settings": settings}
    return _run(folder, True, progress, stop, agents=agents, exec_timeout=exec_timeout, **arguments)


def open_run(folder: str | os.PathLike[str]) -> Results:
    """The results in the folder of a run, also of one that is not finished: then of what is completed.

    Examples
    --------
    >>> import os, planagent, tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     out = os.path.join(folder, "run")
    ...     results = planagent.simulate("generated/changing_lane/2", "idm", out=out)
    ...     planagent.open_run(out).table().to_dict() == results.table().to_dict()
    True
    """
    return Results(_core.read_run(_existing(folder, "folder")), is_kept=True)


def _existing(folder: Any, argument: str = "out") -> str:
    place = path(argument, folder)
    if not os.path.isfile(os.path.join(place, "manifest.toml")):
        raise RunNotFoundError(f"{place} holds no run: there is no manifest.toml")
    return place


def merge(runs: str | os.PathLike[str] | Iterable[str | os.PathLike[str]], out: str | os.PathLike[str]) -> Results:
    """Merges the shards of a run into a new folder, which is that of a run without shards.

    Examples
    --------
    >>> import os, planagent, tempfile
    >>> scenarios = ["generated/changing_lane/2", "generated/changing_lane/3"]
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     parts = [os.path.join(folder, name) for name in ("first", "second")]
    ...     for number, part in enumerate(parts, 1):
    ...         results = planagent.simulate(scenarios, "idm", shard=f"{number}/2", out=part)
    ...     len(planagent.merge(parts, os.path.join(folder, "all")))
    2
    """
    folders = [path("runs", run) for run in many("runs", runs, (str, os.PathLike), "the folder of a run")]
    if not folders:
        raise wrong("runs", folders, "there is no run to merge; name the folders of the shards")
    merged = Results(_core.merge(folders, path("out", out)), is_kept=True)
    merged.warn()
    return merged


class _Asked:
    """What a run is asked, checked."""

    def __init__(self, json_text: str, names: list[str], factories: list[Callable[[], Bound]]) -> None:
        self.json, self.names, self.factories = json_text, names, factories


def _asked(
    *,
    scenarios: Any = None,
    planners: Any = None,
    challenge: Any = None,
    splits: Any = None,
    types: Any = None,
    shuffle: Any = False,
    limit: Any = None,
    shard: Any = None,
    settings: Any = None,
    retry_failed: Any = False,
    accept_changes: Any = False,
    agents: Any = None,
    exec_timeout: Any = None,
) -> _Asked:
    words = [] if scenarios is None else _words(scenarios)
    named = _some("splits", splits)
    if scenarios is not None and not words and not named:
        raise wrong("scenarios", scenarios, "there is no scenario to simulate")
    names, own = ([], []) if planners is None else _planners(planners)
    if planners is not None and not names:
        raise wrong("planners", planners, "there is no planner to simulate")
    if shard is not None and not isinstance(shard, str):
        raise wrong("shard", shard, "expected a text I/N, for example '1/4'")
    asked = {
        "scenarios": words,
        "splits": named,
        "types": _some("types", types),
        "shuffle": truth("shuffle", shuffle),
        "limit": None if limit is None else whole("limit", limit, 1, 2**63 - 1),
        "shard": shard,
        "planners": names,
        "challenges": _some("challenge", challenge),
        "agents": None if agents is None else text("agents", agents),
        "exec_timeout": None if exec_timeout is None else seconds("exec_timeout", exec_timeout),
        "settings": None if settings is None else settings_json(settings),
        "retry_failed": truth("retry_failed", retry_failed),
        "accept_changes": truth("accept_changes", accept_changes),
    }
    return _Asked(json.dumps(asked), [name for name, _ in own], [make for _, make in own])


def _some(argument: str, values: Any) -> list[str]:
    """Texts; an empty list is no way to say that there is no choice."""
    if values is None:
        return []
    named = texts(argument, values)
    if not named:
        raise wrong(argument, values, "it names nothing; leave it out or name something")
    return named


def _run(folder: str, is_resumed: bool, progress: Any, stop: Any, **arguments: Any) -> Results:
    return _waited(folder, is_resumed, progress, stop, _asked(**arguments), None)


#: Runs in progress, which the end of the interpreter stops.
_running: set[_core.Run] = set()


@atexit.register
def _stop_all() -> None:
    """Stops the runs of daemon threads: commands are ended, folders unlocked."""
    running = list(_running)
    for run in running:
        run.stop()
    for run in running:
        _until_over(run)


def _forget_running() -> None:
    """The runs of the parent do not exist in a forked process."""
    _running.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_running)


def _waited(folder: str, is_resumed: bool, progress: Any, stop: Any, asked: _Asked, not_kept: str | None) -> Results:
    """Runs, and waits for the end."""
    shown = callback("progress", progress)
    if stop is not None and not callable(getattr(stop, "is_set", None)):
        raise wrong("stop", stop, "expected an object with a method is_set, for example a threading.Event")
    show, end = printer_of(shown) if isinstance(shown, bool) else (shown, lambda: None)
    tracebacks: dict[str, str] = {}
    run = _core.Run(asked.json, folder, is_resumed, asked.names, not_kept)
    _running.add(run)
    last = Progress(0, 0, 0, 0)
    try:
        while True:
            is_over, (done, total, failed, steps), notes, seats = run.wait(POLL_S)
            for seat in seats:
                _threads.serve(run, seat, asked.factories, tracebacks)
            now = Progress(done, total, failed, steps, notes)
            if show is not None and (notes or now != last):
                show(now)
                last = Progress(done, total, failed, steps)
            if is_over:
                break
            if stop is not None and stop.is_set():
                if not_kept is not None:
                    raise RunStoppedError("the run was stopped, and its files were not kept; with a folder by out, planagent.resume simulates the rest")
                raise RunStoppedError(f"the run in {folder} was stopped; planagent.resume simulates the rest")
        results = Results(run.result(), not_kept is None, tracebacks)
    except BaseException as error:
        if not run.is_stopped:
            run.stop()
        _until_over(run)
        with contextlib.suppress(AttributeError, TypeError):
            error.results = _so_far(run, folder, not_kept is None, tracebacks)  # type: ignore[attr-defined]
        raise
    finally:
        _running.discard(run)
        end()
    results.warn()
    return results


def _until_over(run: _core.Run) -> None:
    """Gives a stopped run a short time to end."""
    until = time.monotonic() + GRACE_S
    while time.monotonic() < until and not run.wait(POLL_S)[0]:
        pass


def _so_far(run: _core.Run, folder: str, is_kept: bool, tracebacks: dict[str, str]) -> Results | None:
    """What a stopped run has completed."""
    try:
        return Results(run.so_far() or _core.read_run(folder), is_kept, tracebacks)
    except Exception:
        # It had not begun.
        return None
