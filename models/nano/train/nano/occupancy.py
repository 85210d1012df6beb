"""Where objects are now, in one second and in two: the grid of a state, and the head that predicts it while training.

The head sits on the tower's image positions, so that the tower has to see what stands where and how it moves. It is no part of the exported model.
"""

from __future__ import annotations

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from .shapes import Shape

#: Cells a side of the view.
CELLS = 16
#: Grids of a state: now, +1 s, +2 s.
TIMES = 3
#: Bytes of a state's grids.
BYTES = TIMES * CELLS * CELLS // 8


def parse(grids: list[str]) -> np.ndarray:
    """The dataset's three strings of hex digits as bytes; row 0 is the top of the picture, the most significant bit comes first."""
    packed = bytes.fromhex("".join(grids))
    if len(grids) != TIMES or any(len(grid) != BYTES * 2 // TIMES for grid in grids):
        raise ValueError(f"occupancy wants {TIMES} strings of {BYTES * 2 // TIMES} hex digits")
    return np.frombuffer(packed, np.uint8)


def grids_of(packed: np.ndarray) -> np.ndarray:
    """Bytes (..., 96) to cells (..., 3, 16, 16)."""
    return np.unpackbits(packed, axis=-1).reshape(*packed.shape[:-1], TIMES, CELLS, CELLS)


def hexadecimal(grids: np.ndarray) -> list[str]:
    """Cells (3, 16, 16) as the dataset writes them."""
    return [np.packbits(grid.astype(np.uint8)).tobytes().hex() for grid in grids]


class OccupancyHead(nn.Module):
    """A linear map of each image position to the cells that it covers."""

    def __init__(self, shape: Shape, positive: float) -> None:
        super().__init__()
        self.side = shape.image_pixels // shape.patch
        if CELLS % self.side:
            raise ValueError(f"{self.side} patches a side do not divide {CELLS} cells")
        self.cells = CELLS // self.side
        self.positive = positive
        self.linear = nn.Linear(shape.vision_width, TIMES * self.cells**2)
        nn.init.normal_(self.linear.weight, std=0.02)
        nn.init.zeros_(self.linear.bias)

    def forward(self, features: Tensor) -> Tensor:
        """Tower outputs (B, P, V) to logits (B, 3, 16, 16)."""
        x = F.layer_norm(features.float(), features.shape[-1:])
        x = self.linear(x).view(len(features), self.side, self.side, TIMES, self.cells, self.cells)
        return x.permute(0, 3, 1, 4, 2, 5).reshape(len(features), TIMES, CELLS, CELLS)

    def loss(self, logits: Tensor, grids: Tensor) -> Tensor:
        """Each state's mean cross-entropy; occupied cells, which are few, weigh more."""
        weight = torch.tensor(self.positive, device=logits.device)
        return F.binary_cross_entropy_with_logits(logits, grids.float(), pos_weight=weight, reduction="none").mean((1, 2, 3))


def average_precision(scores: np.ndarray, truth: np.ndarray) -> float:
    """Area under the precision-recall curve over all cells; a head that sees nothing has the share of occupied cells."""
    hits = truth.ravel()[np.argsort(-scores.ravel(), kind="stable")].astype(np.float64)
    if not hits.any():
        return float("nan")
    precision = np.cumsum(hits) / np.arange(1, len(hits) + 1)
    return float((precision * hits).sum() / hits.sum())
