"""Runs on a cluster of Ray.

The run folder is the state: each part of a run is a folder of its own, which another worker resumes when its worker, a node or the
driver was killed. At the end the parts are merged to the run that one process would have made. All nodes must share the folder.
"""

from __future__ import annotations

import math
import os
import shutil
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from . import _runs
from ._extras import installed
from ._progress import Progress
from ._results import Results
from .errors import ArgumentError, RunError, RunLockedError

installed("ray", "planagent.ray")
import ray  # noqa: E402

__all__ = ["simulate"]

#: Batches in flight for each worker: while one is simulated, the next one waits.
IN_FLIGHT = 2
#: Parts for each worker, so that the last ones end together.
PARTS_EACH = 16
#: Least work of a batch, seconds; small parts are sent together.
BATCH_S = 0.5
#: How often a part may end its worker until the run is given up.
TRIES = 10
#: How long a worker waits for the one that is still at its part, for example on a node that was cut off, seconds.
LOCK_S = 120.0
#: Ending of the name of the folder of the parts, beside the run.
PARTS = ".parts"
#: Variables of these names are those of the driver in all workers.
VARIABLES = ("PLANAGENT_", "NUPLAN_")


class _Worker:
    """Simulates parts, with one thread."""

    def __init__(self, place: str) -> None:
        from . import set_threads

        set_threads(1)
        # Names of recordings may be relative to the driver's folder.
        if os.path.isdir(place):
            os.chdir(place)

    def ready(self) -> bool:
        """Answers once the worker has its place."""
        return True

    def simulate(self, batch: Sequence[tuple[str, str | None]], arguments: dict[str, Any]) -> list[tuple[int, int, float]]:
        """Simulates or resumes parts (folder, shard); gives simulations, failures and seconds of each."""
        return [_part(Path(folder), shard, arguments) for folder, shard in batch]


def _part(folder: Path, shard: str | None, arguments: dict[str, Any]) -> tuple[int, int, float]:
    begun = time.monotonic()
    while True:
        is_resumed = (folder / "manifest.toml").is_file()
        try:
            # Settings of None would be those of the folder.
            native = _runs._run(str(folder), is_resumed, False, None, shard=shard, **arguments)
            break
        except RunLockedError:
            if time.monotonic() - begun > LOCK_S:
                raise
            time.sleep(0.5)
    errors = native.table().to_dict()["error"]
    return len(errors), sum(error is not None for error in errors), time.monotonic() - begun


def simulate(
    scenarios: Any = None,
    planners: Any = "plan-agent",
    *,
    out: str | os.PathLike[str],
    challenge: str | Iterable[str] = "nonreactive",
    splits: str | Iterable[str] | None = None,
    types: str | Iterable[str] | None = None,
    shuffle: bool = False,
    limit: int | None = None,
    settings: Mapping[str, Any] | None = None,
    workers: int | None = None,
    parts: int | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> Results:
    """As `planagent.simulate`, on the workers of Ray. Called again with the same arguments, it resumes.

    Parameters
    ----------
    scenarios, planners, challenge, splits, types, shuffle, limit, settings
        As `planagent.simulate` takes them. Planners in Python must pickle.
    out
        Folder of the run, on a file system that all nodes share. Beside it lies the folder of its parts while it is made.
    workers
        Number of workers, each with one CPU; by default one for each CPU of the cluster.
    parts
        Into how many parts the run is divided; by default sixteen for each worker. It must be the same when the run is resumed.
    progress
        Is called after each batch. The total is estimated until the end.

    Raises
    ------
    RunError
        Where a part cannot be simulated, or the folder holds something else. A simulation that fails is recorded instead.
    """
    folder = Path(out).absolute()
    place = folder.with_name(folder.name + PARTS)
    if (folder / "summary.json").is_file():
        shutil.rmtree(place, ignore_errors=True)
        return _runs.resume(folder, planners)
    if folder.exists() and any(folder.iterdir()):
        raise RunError(f"the folder {folder} is not empty; name another one")
    if not ray.is_initialized():
        ray.init()
    count = workers or int(ray.cluster_resources().get("CPU", 1))
    divided = _divided(place, parts or PARTS_EACH * count, parts is not None)
    arguments = {
        "scenarios": scenarios,
        "planners": planners,
        "challenge": challenge,
        "splits": splits,
        "types": types,
        "shuffle": shuffle,
        "limit": limit,
        "settings": settings or {},
    }
    folders = [str(place / f"{number:05}") for number in range(1, divided + 1)]
    shards = [f"{number}/{divided}" if divided > 1 else None for number in range(1, divided + 1)]
    pool = _Pool(arguments, list(zip(folders, shards)), count, progress)
    try:
        pool.run()
    finally:
        pool.end()
    # A merge that was killed is begun again; the run is there at once or not at all.
    whole = place / "whole"
    shutil.rmtree(whole, ignore_errors=True)
    merged = _runs.merge(folders, whole)
    os.replace(whole, folder)
    merged.folder = folder
    shutil.rmtree(place)
    return merged


class _Pool:
    """Workers and the parts that they simulate."""

    def __init__(
        self,
        arguments: dict[str, Any],
        parts: list[tuple[str, str | None]],
        workers: int,
        progress: Callable[[Progress], None] | None,
    ) -> None:
        variables = {name: value for name, value in os.environ.items() if name.startswith(VARIABLES)}
        self._actor = ray.remote(num_cpus=1, max_restarts=0, runtime_env={"env_vars": variables})(_Worker)
        # Large planners are sent to each node once.
        self._arguments = ray.put(arguments)
        self._parts, self._progress = parts, progress
        self._waiting = list(range(len(parts)))[::-1]
        self._tries = [0] * len(parts)
        #: Workers that have no place yet, by what tells that they have one.
        self._starting: dict[Any, Any] = {}
        #: Batches in flight: worker and parts.
        self._running: dict[Any, tuple[Any, list[int]]] = {}
        self._idle: list[Any] = []
        self._count = min(workers, len(parts))
        self._done = self._failed = self._ended = 0
        self._seconds = 0.0
        for _ in range(self._count):
            self._start()

    def _start(self) -> None:
        worker = self._actor.remote(os.getcwd())
        self._starting[worker.ready.remote()] = worker

    def _submit(self, worker: Any) -> None:
        """Gives a worker its next batch. Towards the end batches get smaller, so that workers end together."""
        if not self._waiting:
            if all(other is not worker for other, _ in self._running.values()):
                self._idle.append(worker)
            return
        wanted = math.ceil(BATCH_S * self._ended / self._seconds) if self._seconds > 0.0 else 1
        fair = math.ceil(len(self._waiting) / (IN_FLIGHT * self._count))
        batch = [self._waiting.pop() for _ in range(min(wanted, fair))]
        sent = worker.simulate.remote([self._parts[part] for part in batch], self._arguments)
        self._running[sent] = (worker, batch)

    def run(self) -> None:
        """Simulates all parts. Those of a worker that was lost go to another one."""
        while self._waiting or self._running:
            (ready, *_), _ = ray.wait([*self._starting, *self._running])
            try:
                result = ray.get(ready)
            except ray.exceptions.RayActorError as error:
                self._lost(ready, error)
                continue
            if ready in self._starting:
                worker = self._starting.pop(ready)
                for _ in range(IN_FLIGHT):
                    self._submit(worker)
                continue
            worker, batch = self._running.pop(ready)
            self._ended += len(batch)
            for simulations, failures, seconds in result:
                self._done, self._failed, self._seconds = self._done + simulations, self._failed + failures, self._seconds + seconds
            self._submit(worker)
            if self._progress is not None:
                self._progress(Progress(self._done, round(self._done * len(self._parts) / self._ended), self._failed, 0))

    def _lost(self, sent: Any, error: Exception) -> None:
        """Takes back the parts of a worker that ended, and starts another one."""
        if sent in self._starting:
            del self._starting[sent]
            self._start()
            return
        worker, batch = self._running.pop(sent)
        self._waiting += batch[::-1]
        for part in batch:
            self._tries[part] += 1
            if self._tries[part] == TRIES:
                raise RunError(f"{self._parts[part][0]} ended its worker {TRIES} times: {error}") from error
        # The other batch of the worker comes back by itself.
        if all(other is not worker for other, _ in self._running.values()):
            self._start()
        # Its node may never come back; then the new one finds no place.
        while self._waiting and self._idle:
            self._submit(self._idle.pop())

    def end(self) -> None:
        """Ends the workers."""
        of_batches = [worker for worker, _ in self._running.values()]
        for worker in [*self._starting.values(), *self._idle, *of_batches]:
            ray.kill(worker)


def _divided(place: Path, parts: int, is_given: bool) -> int:
    """The number of parts: that of a run that is resumed, else the wanted one."""
    record = place / "parts"
    if not record.is_file():
        place.mkdir(parents=True, exist_ok=True)
        unfinished = place / "parts.tmp"
        unfinished.write_text(str(parts))
        os.replace(unfinished, record)
        return parts
    known = int(record.read_text())
    if is_given and known != parts:
        raise ArgumentError(f"the run was begun with {known} parts; it cannot be resumed with {parts}")
    return known
