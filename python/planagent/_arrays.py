"""Packed bytes as numpy arrays, and back."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ._arguments import wrong
from .errors import ArgumentError

#: Fields of an object; `kind` is a number of `KINDS`.
OBJECT = np.dtype(
    [
        ("token", np.uint32),
        ("kind", np.uint8),
        ("unused", np.uint8, (3,)),
        ("x", np.float64),
        ("y", np.float64),
        ("heading", np.float64),
        ("length", np.float64),
        ("width", np.float64),
        ("vx", np.float64),
        ("vy", np.float64),
    ]
)

#: nuPlan's object types, in the order of their numbers.
KINDS = (
    "vehicle",
    "pedestrian",
    "bicycle",
    "traffic_cone",
    "barrier",
    "czone_sign",
    "generic_object",
)


def unpacked(data: bytearray | bytes, width: int) -> NDArray[np.float64]:
    """Rows of numbers."""
    return np.frombuffer(data, dtype=np.float64).reshape(-1, width)


def objects(data: bytearray) -> NDArray[np.void]:
    """Objects as a structured array."""
    return np.frombuffer(data, dtype=OBJECT)


def image(picture: tuple[bytearray, int, int]) -> NDArray[np.uint8]:
    """A picture: height x width x 3."""
    data, height, width = picture
    return np.frombuffer(data, dtype=np.uint8).reshape(height, width, 3)


def array(name: str, values: Any, expected: str) -> NDArray[Any]:
    """An array of any type; lists of different lengths make none."""
    try:
        made: NDArray[Any] = np.asarray(values)
    except (TypeError, ValueError, Warning) as error:
        raise wrong(name, values, f"{expected}: {error}") from None
    return made


def poses(values: ArrayLike, dimensions: int = 2) -> NDArray[np.float64]:
    """Poses x, y, heading as contiguous numbers, checked.

    Parameters
    ----------
    values
        The last dimension holds x, y and heading.
    dimensions
        Number of dimensions that the array must have.
    """
    try:
        # numpy before 1.24 makes an array of lists of these, with a warning.
        if isinstance(values, (list, tuple)) and len({len(row) for row in values if isinstance(row, (list, tuple))}) > 1:
            raise TypeError("its rows have different lengths")
        given = np.asanyarray(values)
        if given.dtype.kind not in "fiuO" or values is None:
            raise TypeError(f"it is {'None' if values is None else f'of type {given.dtype}'}")
        if np.ma.is_masked(given):
            raise TypeError("some of its numbers are masked")
        array = np.ascontiguousarray(given, dtype=np.float64)
    except (TypeError, ValueError, Warning) as error:
        raise ArgumentError(f"expected an array of poses (x, y, heading), got what is no array of numbers: {error}") from None
    if array.ndim != dimensions or array.shape[-1] != 3 or 0 in array.shape:
        shape = " x ".join(["N"] * (dimensions - 2) + ["T", "3"])
        raise ArgumentError(
            f"expected an array of {shape} numbers (x, y, heading), got the shape {array.shape}"
        )
    return array
