"""Runs on a cluster of Ray.

The run folder is the state: each part of a run is a folder of its own, which a worker resumes after it, its node or the driver was
killed. At the end the parts are merged to the run that one process would have made. All nodes must share the folder.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import ray

from . import _runs
from ._runs import Progress, Results
from .errors import ArgumentError, RunError

__all__ = ["simulate"]

#: Parts in flight for each worker: while one is simulated, the next one waits.
IN_FLIGHT = 2
#: Parts for each worker, so that the last ones end together.
PARTS_EACH = 8
#: Folder of the parts, beside the run.
PARTS = ".parts"


class _Worker:
    """Simulates parts, with one thread."""

    def part(self, folder: str, arguments: dict[str, Any]) -> tuple[int, int]:
        """Simulates or resumes a part; gives its simulations, and how many of them failed."""
        from . import set_threads

        set_threads(1)
        place = Path(folder)
        if (place / "manifest.toml").is_file():
            results = _runs.resume(place, arguments["planners"])
        else:
            # A worker that was killed before its manifest was whole left no results.
            shutil.rmtree(place, ignore_errors=True)
            results = _runs.simulate(out=place, **arguments)
        errors = results.table().to_dict()["error"]
        return len(errors), sum(error is not None for error in errors)


def simulate(
    scenarios: Any = (),
    planners: Any = "plan-agent",
    *,
    out: str | os.PathLike[str],
    challenge: str | Sequence[str] = "nonreactive",
    splits: str | Sequence[str] = (),
    types: str | Sequence[str] = (),
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
        Into how many parts the run is divided; by default eight for each worker. It must be the same when the run is resumed.
    progress
        Is called after each part.
    """
    folder = Path(out).absolute()
    if (folder / "summary.json").is_file():
        return _runs.resume(folder, planners)
    if folder.exists() and any(folder.iterdir()):
        raise RunError(f"the folder {folder} is not empty; name another one")
    if not ray.is_initialized():
        ray.init()
    count = workers or int(ray.cluster_resources().get("CPU", 1))
    divided = _divided(folder, parts or PARTS_EACH * count, parts is not None)
    arguments = {
        "scenarios": scenarios,
        "planners": planners,
        "challenge": challenge,
        "splits": splits,
        "types": types,
        "shuffle": shuffle,
        "limit": limit,
        "settings": settings,
    }
    numbers = list(range(1, divided + 1))
    folders = [folder.with_name(folder.name + PARTS) / f"{number:05}" for number in numbers]
    actor = ray.remote(num_cpus=1, max_restarts=-1, max_task_retries=-1)(_Worker)
    pool = [actor.remote() for _ in range(min(count, divided))]
    waiting = list(zip(numbers, folders))[::-1]
    running: dict[Any, Any] = {}

    def submit(worker: Any) -> None:
        if waiting:
            number, part = waiting.pop()
            shard = {"shard": f"{number}/{divided}"} if divided > 1 else {}
            running[worker.part.remote(str(part), {**arguments, **shard})] = worker

    for _ in range(IN_FLIGHT):
        for worker in pool:
            submit(worker)
    done, failed, ended = 0, 0, 0
    while running:
        (ready, *_), _ = ray.wait(list(running))
        worker = running.pop(ready)
        simulations, failures = ray.get(ready)
        done, failed, ended = done + simulations, failed + failures, ended + 1
        submit(worker)
        if progress is not None:
            # The size of the parts that are left is estimated.
            progress(Progress(done, round(done * divided / ended), failed, 0))
    for worker in pool:
        ray.kill(worker)
    merged = _runs.merge(folders, folder)
    shutil.rmtree(folder.with_name(folder.name + PARTS))
    return merged


def _divided(folder: Path, parts: int, is_given: bool) -> int:
    """The number of parts: that of a run that is resumed, else the wanted one."""
    place = folder.with_name(folder.name + PARTS)
    record = place / "parts"
    if not record.is_file():
        place.mkdir(parents=True, exist_ok=True)
        unfinished = record.with_suffix(".tmp")
        unfinished.write_text(str(parts))
        os.replace(unfinished, record)
        return parts
    known = int(record.read_text())
    if is_given and known != parts:
        raise ArgumentError(f"the run was begun with {known} parts; it cannot be resumed with {parts}")
    return known
