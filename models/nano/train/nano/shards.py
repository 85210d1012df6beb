"""Reads the dataset folder that `planagent dataset` writes (format 1).

`meta.json`, and per shard `<split>-NNNNN.jsonl` (a labelled state a line) beside `<split>-NNNNN.png` (the shard's images one
below the other). A line: `state` ("<scenario>@<time>"), `image` (row number in the PNG), `conversation`, `facts`. An answer of the
conversation has in `learn` the spans of characters that the model chooses, and in `weights`, if any, theirs in the loss. `twin` names a pair of states with the same text,
other pictures and other codes. `tried` are codes of a state for expert iteration: `chance`, `value`, and `answers` in place of the last two of
the conversation. `refused` are codes that Reflection refuses, with value, scores and reason; training does not read them.
`occupancy` are three grids of where objects are, now and in one and two seconds (`occupancy.py`).
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

# A shard is one tall picture, not an attack.
Image.MAX_IMAGE_PIXELS = None

FORMAT = 1


@dataclass(frozen=True)
class State:
    """One labelled state."""

    name: str
    image: int
    conversation: list[dict]
    twin: str | None = None
    occupancy: list[str] | None = None
    tried: tuple[dict, ...] = ()

    @property
    def scenario(self) -> str:
        """The drive that the state is cut from: states of one drive are not independent."""
        return self.name.rpartition("@")[0] or self.name

    def conversation_of(self, tried: dict) -> list[dict]:
        """The conversation that ends in a tried code: its answers stand in place of the last ones."""
        answers = [i for i, message in enumerate(self.conversation) if message["role"] == "assistant"]
        own = dict(zip(answers[-len(tried["answers"]) :], tried["answers"], strict=True))
        return [own.get(i, message) for i, message in enumerate(self.conversation)]


def meta(folder: Path) -> dict:
    """The dataset's `meta.json`, its format checked."""
    data = json.loads((folder / "meta.json").read_text())
    if data.get("format") != FORMAT:
        raise ValueError(f"{folder / 'meta.json'}: format {data.get('format')!r}, this program reads {FORMAT}")
    return data


def shards(folder: Path, split: str) -> list[Path]:
    """The split's JSONL files in order; at least one."""
    found = sorted(folder.glob(f"{split}-*.jsonl"))
    if not found:
        raise FileNotFoundError(f"{folder}: no {split}-*.jsonl")
    return found


def states(shard: Path) -> Iterator[State]:
    """The shard's states in file order."""
    with shard.open() as lines:
        for number, line in enumerate(lines, 1):
            try:
                row = json.loads(line)
                yield State(row["state"], int(row["image"]), row["conversation"], row.get("twin"), row.get("occupancy"), tuple(row.get("tried", ())))
            except (ValueError, KeyError, TypeError) as error:
                raise ValueError(f"{shard}:{number}: {error!r}") from error


def images(shard: Path, pixels: int) -> np.ndarray:
    """The shard's images, uint8 (n, pixels, pixels, 3)."""
    path = shard.with_suffix(".png")
    with Image.open(path) as picture:
        data = np.asarray(picture.convert("RGB"))
    if data.shape[1] != pixels or data.shape[0] % pixels:
        raise ValueError(f"{path}: {data.shape[1]} x {data.shape[0]}, wanted a column of {pixels}-pixel squares")
    return data.reshape(-1, pixels, pixels, 3)
