"""Twins: two states with the same text, other pictures and other codes. Only a model that looks answers both rightly."""

from __future__ import annotations

import torch
from torch import Tensor

from .batches import Batch


def hinge(losses: Tensor, batch: Batch, margin: float) -> Tensor:
    """A value for each state of a micro-batch of twins, 0 where both margins are kept.

    The first half of the samples are pairs side by side, the second half the same with each other's pictures. A state's own answers must be more
    probable, by `margin` nats, than its twin's under this picture, and than they are under the twin's picture. `losses` are minus log-probabilities.
    """
    sums = torch.zeros(len(batch.ids), device=losses.device, dtype=losses.dtype)
    sums = sums.index_add(0, batch.samples, -losses * batch.contrast)
    own, swapped = sums.chunk(2)
    # Under this state's picture, its twin's answers: those of the neighbor in the second half.
    twins_answers = swapped.view(-1, 2).flip(1).reshape(-1)
    over_twins_answers = torch.relu(margin - (own - twins_answers))
    over_twins_picture = torch.relu(margin - (own - swapped))
    return (over_twins_answers + over_twins_picture) / 2
