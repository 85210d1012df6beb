"""The threads on which planners in Python run.

A run simulates on threads of its own, which hold nothing of Python. What they ask of planners in Python, threads of Python answer: one for
each of them. So a planner has the stack and the thread-local state of any thread of Python, and Python ends it at exit as any other. A thread
that has served a run waits for the next one.
"""

from __future__ import annotations

import inspect
import os
import queue
import sysconfig
import threading
import traceback
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from . import _core
from ._arguments import whole

if TYPE_CHECKING:
    from ._planners import Bound

#: Most threads of a pool.
MAX_THREADS = 512

_PACKAGE = os.path.dirname(os.path.abspath(__file__)) + os.sep
_LIBRARIES = tuple({os.path.abspath(place) + os.sep for place in sysconfig.get_paths().values()})

#: Threads that wait for a run, the last one first.
_idle: list[_Thread] = []
_idle_lock = threading.Lock()


class _Thread(threading.Thread):
    """Serves one run after the other."""

    def __init__(self) -> None:
        super().__init__(name="planagent-planner", daemon=True)
        self._work: queue.SimpleQueue[_Serving] = queue.SimpleQueue()

    def serve(self, serving: _Serving) -> None:
        self._work.put(serving)

    def run(self) -> None:
        while True:
            serving = self._work.get()
            try:
                serving.run()
            except BaseException as error:
                # Nothing may leave the run waiting for an answer.
                serving.give_up(error)
            del serving
            with _idle_lock:
                _idle.append(self)


class _Serving:
    """Answers what one thread of a run asks."""

    def __init__(
        self, run: _core.Run, seat: int, planners: Sequence[Callable[[], Bound]], tracebacks: dict[str, str]
    ) -> None:
        self._run, self._seat, self._planners, self._tracebacks = run, seat, planners, tracebacks

    def run(self) -> None:
        run, seat = self._run, self._seat
        made: dict[int, Bound] = {}
        while True:
            asked = run.question(seat)
            if asked is None:
                return
            what, simulation, argument = asked
            if what == "drop":
                made.pop(simulation, None)
                continue
            plan: _core.Trajectory | None = None
            try:
                if what == "make":
                    made[simulation] = self._planners[argument]()
                elif what == "reset":
                    made[simulation].reset()
                else:
                    plan = made[simulation].plan(argument)
            except BaseException as error:
                planner = made.get(simulation)
                run.fail(seat, self._text(error, None if planner is None else planner.function))
            else:
                run.answer(seat, plan)
            del asked, argument

    def give_up(self, error: BaseException) -> None:
        """Fails what the run asks and goes on asking."""
        run, seat = self._run, self._seat
        run.fail(seat, _printable(f"{type(error).__name__} in the thread of the planner"))
        while (asked := run.question(seat)) is not None:
            if asked[0] != "drop":
                run.fail(seat, "the thread of the planner failed before")

    def _text(self, error: BaseException, function: Any) -> str:
        """An exception in a line, with the place in the planner. Its traceback is kept."""
        try:
            said = "".join(traceback.format_exception_only(type(error), error)).strip()
            place = _place(error, function)
            line = _printable(said if place is None else f"{said} ({place})")
            told = "".join(traceback.format_exception(type(error), error, error.__traceback__))
            self._tracebacks[line] = _printable(told)
        except BaseException:
            # An exception that cannot be shown, or no stack left to show it.
            return _printable(f"{type(error).__name__}: it has no text")
        return line


def _printable(text: str) -> str:
    """A text without halves of characters, which the native half does not take."""
    return text.encode("utf-8", "backslashreplace").decode("utf-8")


def _is_of_library(file: str) -> bool:
    """Whether a file is of Python or of an installed package; both make code that has no file."""
    return os.path.abspath(file).startswith(_LIBRARIES) or file.startswith(("<frozen ", "<__array_function__ "))


def _place(error: BaseException, function: Any) -> str | None:
    """File and line in the planner where an exception was raised: the innermost outside of libraries."""
    frames = [
        (frame.f_code.co_filename, line)
        for frame, line in traceback.walk_tb(error.__traceback__)
        if not os.path.abspath(frame.f_code.co_filename).startswith(_PACKAGE)
    ]
    own = [place for place in frames if not _is_of_library(place[0])]
    if own or frames:
        file, line = own[-1] if own else frames[0]
        return f"{file}, line {line}"
    # What it returned is no trajectory: no frame of it is left.
    code = getattr(inspect.unwrap(function) if callable(function) else None, "__code__", None)
    code = code or getattr(getattr(function, "__func__", None), "__code__", None)
    return None if code is None else f"{code.co_filename}, line {code.co_firstlineno}"


def serve(run: _core.Run, seat: int, planners: Sequence[Callable[[], Bound]], tracebacks: dict[str, str]) -> None:
    """Gives a thread of a run its thread of Python."""
    with _idle_lock:
        thread = _idle.pop() if _idle else None
    if thread is None:
        thread = _Thread()
        thread.start()
    thread.serve(_Serving(run, seat, planners, tracebacks))


def threads() -> int:
    """Number of threads that simulations and models use.

    Examples
    --------
    >>> import planagent
    >>> planagent.threads() >= 1
    True
    """
    return _core.threads()


def set_threads(count: int | None = None) -> None:
    """Sets the number of threads; `None` restores the default. Work in progress keeps the old ones.

    Examples
    --------
    >>> import planagent
    >>> planagent.set_threads(1)
    >>> planagent.threads()
    1
    >>> planagent.set_threads(None)
    """
    _core.set_threads(None if count is None else whole("count", count, 1, MAX_THREADS))


def _after_fork_in_child() -> None:
    """A forked process has none of the threads, and a lock that one of them held stays locked."""
    global _idle_lock
    _idle_lock = threading.Lock()
    _idle.clear()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(before=_core.before_fork, after_in_parent=_core.after_fork, after_in_child=_core.after_fork)
    os.register_at_fork(after_in_child=_after_fork_in_child)
