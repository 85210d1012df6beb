"""Checks of arguments. Each error names the argument and its value."""

from __future__ import annotations

import math
import operator
import os
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from .errors import ArgumentError

#: Longest shown value, characters.
SHOWN = 80
#: Longest time that can be asked for, seconds: thirty years. The native half counts microseconds.
MAX_SECONDS = 1e9


def wrong(name: str, value: object, expected: str) -> ArgumentError:
    """The error of an argument."""
    try:
        shown = repr(value)
    except Exception:
        shown = f"a {type(value).__name__} that cannot be shown"
    if len(shown) > SHOWN:
        shown = shown[: SHOWN - 3] + "..."
    return ArgumentError(f"{name} is {shown}; {expected}")


def whole(name: str, value: Any, least: int = 0, most: int | None = None) -> int:
    """A whole number, also of numpy."""
    expected = f"expected a whole number from {least} {'on' if most is None else f'to {most}'}"
    try:
        number = operator.index(value)
    except TypeError:
        raise wrong(name, value, expected) from None
    if isinstance(value, (bool, np.bool_)) or number < least or (most is not None and number > most):
        raise wrong(name, value, expected)
    return number


def real(name: str, value: Any, least: float = -math.inf, *, above: bool = False, most: float = math.inf) -> float:
    """A finite number, also of numpy; at least `least`, or above it, and at most `most`."""
    bound = "" if least == -math.inf else f" {'greater than' if above else 'of at least'} {least:g}"
    bound += "" if most == math.inf else f", at most {most:g}"
    expected = f"expected a finite number{bound}"
    if isinstance(value, (str, bytes, bool, np.bool_)):
        raise wrong(name, value, expected)
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        raise wrong(name, value, expected) from None
    if not math.isfinite(number) or number < least or (above and number == least) or number > most:
        raise wrong(name, value, expected)
    return number


def seconds(name: str, value: Any) -> float:
    """A time greater than 0."""
    return real(name, value, 0.0, above=True, most=MAX_SECONDS)


def truth(name: str, value: Any) -> bool:
    """True or False, also of numpy."""
    if not isinstance(value, (bool, np.bool_)):
        raise wrong(name, value, "expected True or False")
    return bool(value)


def text(name: str, value: Any) -> str:
    """A text."""
    if not isinstance(value, str):
        raise wrong(name, value, "expected a text")
    return unicode(name, str(value))


def unicode(name: str, value: str) -> str:
    """A text without halves of characters, which names of files that are no UTF-8 have."""
    try:
        value.encode()
    except UnicodeEncodeError:
        raise wrong(name, value, "it is no text of Unicode") from None
    return value


def word(name: str, value: str, expected: str) -> str:
    """A text that can name a file."""
    if not value or "\0" in value:
        raise wrong(name, value, expected)
    return unicode(name, value)


def path(name: str, value: Any) -> str:
    """An absolute path: a later change of the working directory does not move it."""
    try:
        place = os.fspath(value)
    except TypeError:
        raise wrong(name, value, "expected a path") from None
    if isinstance(place, bytes):
        place = os.fsdecode(place)
    if not place or "\0" in place:
        raise wrong(name, value, "expected a path")
    try:
        # Path.absolute leaves `..` behind a link as it is.
        return str(Path(place).absolute())
    except OSError as error:
        raise wrong(name, value, f"a relative path needs a working directory, and that cannot be found: {error}") from None


def many(name: str, value: Any, kind: type | tuple[type, ...], expected: str) -> list[Any]:
    """One value of a kind, or any number of them in a list, a generator or another iterable."""
    if isinstance(value, kind):
        return [value]
    if isinstance(value, (bytes, Mapping)) or not isinstance(value, Iterable):
        raise wrong(name, value, f"expected {expected}, or several")
    values = list(value)
    for position, one in enumerate(values):
        if not isinstance(one, kind):
            raise wrong(f"{name}[{position}]", one, f"expected {expected}")
    return values


def texts(name: str, value: Any) -> list[str]:
    """One text or several."""
    return [unicode(name, str(one)) for one in many(name, value, str, "a text")]


def callback(name: str, value: Any) -> bool | Callable[[Any], Any]:
    """A truth value or a function; `None` is False."""
    if value is None:
        return False
    if isinstance(value, (bool, np.bool_)):
        return bool(value)
    if not callable(value):
        raise wrong(name, value, "expected True, False or a function of a Progress")
    return value  # type: ignore[no-any-return]
