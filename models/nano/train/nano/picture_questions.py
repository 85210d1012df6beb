"""Questions that only the picture answers, with labels from the occupancy grid.

A conversation of its own, without scene text and with a question that planning never asks (`look?`). Places are those of the picture as it is
shown, which may have been turned: `turned` says which way the ego's front, up in an unturned picture, points.
"""

from __future__ import annotations

import re

import numpy as np

from .occupancy import CELLS

ASK = "look?"
KEYS = ("turned", "top_left", "top_right", "bottom_left", "bottom_right", "nearest", "side", "up", "up_later")
#: Where the ego's front points after so many quarter turns to the left.
TURNED = ("straight", "left", "back", "right")
#: Occupied cells of a quarter.
COUNTS = ((1, "none"), (3, "1-2"), (6, "3-5"), (CELLS**2, "6+"))
#: Cells (of 4 m) to the nearest occupied one.
DISTANCES = ((3.0, "near"), (5.0, "mid"), (CELLS, "far"))
SIDES = ("top", "left", "bottom", "right")

#: All words, in the byte-level alphabet.
WORDS = (
    "Ċlook", "turned=", *(f"Ġ{key}=" for key in KEYS[1:]), *TURNED, *SIDES, "none", "yes", "no",
    *(word for _, word in COUNTS), *(word for _, word in DISTANCES),
)  # fmt: skip


def answers(grids: np.ndarray, turns: int) -> dict[str, str]:
    """The answers of a state whose picture and grids (3, 16, 16) are turned to the left by so many quarters."""
    middle = CELLS // 2
    grids = np.rot90(grids, turns, (1, 2)).astype(bool)
    # The ego's own cells.
    now = grids[0].copy()
    now[middle - 1 : middle + 1, middle - 1 : middle + 1] = False
    top, bottom, left, right = slice(0, middle), slice(middle, CELLS), slice(0, middle), slice(middle, CELLS)
    quarters = {"top_left": now[top, left], "top_right": now[top, right], "bottom_left": now[bottom, left], "bottom_right": now[bottom, right]}
    out = {"turned": TURNED[turns]}
    out |= {name: next(word for bound, word in COUNTS if quarter.sum() < bound) for name, quarter in quarters.items()}
    rows, columns = np.nonzero(now)
    down, across = rows + 0.5 - middle, columns + 0.5 - middle
    if len(rows):
        distances = np.hypot(down, across)
        nearest = int(distances.argmin())
        out["nearest"] = next(word for bound, word in DISTANCES if distances[nearest] < bound)
        vertical = abs(down[nearest]) >= abs(across[nearest])
        out["side"] = ("top" if down[nearest] < 0 else "bottom") if vertical else ("left" if across[nearest] < 0 else "right")
    else:
        out["nearest"] = out["side"] = "none"
    strip = (slice(0, middle - 1), slice(middle - 1, middle + 1))
    out["up"] = "yes" if now[strip].any() else "no"
    out["up_later"] = "yes" if grids[2][strip].any() else "no"
    return out


def conversation(grids: np.ndarray, turns: int, system: str) -> list[dict]:
    """All questions in one answer: many a picture is what makes a tower learn."""
    found = answers(grids, turns)
    content = " ".join(f"{key}={found[key]}" for key in KEYS)
    learn = [[match.start(1), match.end(1)] for match in re.finditer(r"=(\S+)", content)]
    return [
        {"role": "system", "content": system},
        {"role": "user", "content": f"<image>\n{ASK}"},
        {"role": "assistant", "content": content, "learn": learn},
    ]
