"""How far a run is, and how it is shown."""

from __future__ import annotations

import contextlib
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TextIO

__all__ = ["Progress"]

#: Where stderr is no terminal, a line comes after this share of the run, or this time in seconds.
LINE_SHARE, LINE_S = 0.1, 30.0


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

    Examples
    --------
    >>> import planagent
    >>> seen = []
    >>> results = planagent.simulate("generated/changing_lane/2", "idm", progress=seen.append)
    >>> seen[-1].done, seen[-1].total, seen[-1].failed
    (1, 1, 0)
    """

    done: int
    total: int
    failed: int
    steps: int
    notes: list[str] = field(default_factory=list)


class _Line:
    """Shows progress in one line of a terminal or of a notebook."""

    def __init__(self, out: TextIO) -> None:
        self._out, self._width = out, 0

    def __call__(self, progress: Progress) -> None:
        for note in progress.notes:
            self._write(note)
            _put(self._out, "\n")
            self._width = 0
        self._write(_said(progress))

    def _write(self, text: str) -> None:
        _put(self._out, "\r" + text + " " * max(0, self._width - len(text)))
        self._width = len(text)

    def end(self) -> None:
        """Ends the line."""
        if self._width:
            _put(self._out, "\n")


class _Lines:
    """Writes lines to a file or a pipe, now and then."""

    def __init__(self, out: TextIO) -> None:
        self._out = out
        self._last: Progress | None = None
        self._said_at, self._shown = 0.0, -1

    def __call__(self, progress: Progress) -> None:
        for note in progress.notes:
            self._write(note)
        self._last = progress
        now = time.monotonic()
        if progress.done - max(self._shown, 0) >= max(1.0, LINE_SHARE * progress.total) or now - self._said_at >= LINE_S:
            self._say(progress, now)

    def _say(self, progress: Progress, now: float) -> None:
        self._write(_said(progress))
        self._said_at, self._shown = now, progress.done

    def _write(self, text: str) -> None:
        _put(self._out, text + "\n")

    def end(self) -> None:
        """Says how far the run got."""
        if self._last is not None and self._last.done != self._shown:
            self._say(self._last, time.monotonic())


def _put(out: TextIO, text: str) -> None:
    """Writes at once. A stderr that is full, closed or without a reader is no reason to stop a run."""
    with contextlib.suppress(OSError, ValueError):
        out.write(text)
        out.flush()


def _said(progress: Progress) -> str:
    failed = f", {progress.failed} failed" if progress.failed else ""
    return f"{progress.done} of {progress.total} simulations{failed}"


def _is_terminal(out: TextIO) -> bool:
    try:
        return out.isatty()
    except (OSError, ValueError):
        # It is closed.
        return False


def printer_of(is_shown: bool) -> tuple[Callable[[Progress], None] | None, Callable[[], None]]:
    """What shows progress on stderr, and what ends it."""
    out = sys.stderr
    if not is_shown or out is None:
        return None, lambda: None
    is_notebook = type(out).__module__.startswith("ipykernel")
    printer = _Line(out) if is_notebook or _is_terminal(out) else _Lines(out)
    return printer, printer.end
