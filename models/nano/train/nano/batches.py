"""Micro-batches: samples of similar length, padded on the right, with the flat places of image and loss."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from .corpus import INFORMATIVE, TEMPLATE, Corpus
from .samples import Sample, occupancy_of


@dataclass(frozen=True)
class Batch:
    """`targets[k]` is the token after flat position `wanted[k]`, `weights[k]` its share in the loss, `samples[k]` whose it is."""

    ids: Tensor
    images: Tensor
    image_places: Tensor
    wanted: Tensor
    targets: Tensor
    weights: Tensor
    samples: Tensor
    #: Which of `wanted` predict an informative token.
    informative: Tensor
    #: Which of `wanted` predict a token by which a state differs from its twin.
    contrast: Tensor
    #: (B, 3, 16, 16) and (B): the occupancy grids, and of which samples they are known.
    occupancy: Tensor
    has_occupancy: Tensor

    def to(self, device: torch.device) -> Batch:
        """The batch on another device."""
        return Batch(**{name: value.to(device, non_blocking=True) for name, value in vars(self).items()})


@dataclass(frozen=True)
class Collator:
    """What is needed to turn samples into a batch."""

    corpus: Corpus
    image_id: int
    image_tokens: int
    template_weight: float

    def length(self, sample: Sample) -> int:
        """Decoder positions of a sample."""
        return len(sample) + self.image_tokens - 1

    def weight(self, samples: list[Sample]) -> float:
        """Sum of the loss weights: the divisor that makes micro-batches add up to the batch's mean."""
        total = 0.0
        for sample in samples:
            total += float(sample.weights[sample.roles == INFORMATIVE].sum())
            total += self.template_weight * float((sample.roles == TEMPLATE).sum())
        return total

    def collate(self, samples: list[Sample]) -> Batch:
        """Samples to a batch."""
        longest = max(self.length(sample) for sample in samples)
        ids = np.zeros((len(samples), longest), np.int64)
        roles = np.zeros((len(samples), longest), np.uint8)
        weights = np.zeros((len(samples), longest), np.float32)
        contrast = np.zeros((len(samples), longest), bool)
        places = np.zeros((len(samples), self.image_tokens), np.int64)
        for i, sample in enumerate(samples):
            image = int(np.flatnonzero(sample.ids == self.image_id)[0])
            after = image + self.image_tokens
            end = after + len(sample) - image - 1
            ids[i, : image + 1] = sample.ids[: image + 1]
            ids[i, image:after] = self.image_id
            ids[i, after:end] = sample.ids[image + 1 :]
            roles[i, after:end] = sample.roles[image + 1 :]
            weights[i, after:end] = sample.weights[image + 1 :]
            if sample.contrast is not None:
                contrast[i, after:end] = sample.contrast[image + 1 :]
            places[i] = i * longest + np.arange(image, after)
        target_row, target_place = np.nonzero(roles)
        chosen = roles[target_row, target_place]
        grids, known = occupancy_of(self.corpus, samples)
        return Batch(
            ids=torch.from_numpy(ids),
            images=torch.from_numpy(np.stack([self.picture(sample) for sample in samples])),
            image_places=torch.from_numpy(places.reshape(-1)),
            wanted=torch.from_numpy(target_row * longest + target_place - 1),
            targets=torch.from_numpy(ids[target_row, target_place]),
            weights=torch.from_numpy(np.where(chosen == INFORMATIVE, weights[target_row, target_place], self.template_weight).astype(np.float32)),
            samples=torch.from_numpy(target_row),
            informative=torch.from_numpy(chosen == INFORMATIVE),
            contrast=torch.from_numpy(contrast[target_row, target_place]),
            occupancy=torch.from_numpy(grids),
            has_occupancy=torch.from_numpy(known),
        )

    def picture(self, sample: Sample) -> np.ndarray:
        """The picture that a sample shows."""
        image = self.corpus.images[sample.image]
        if sample.blank is not None:
            return np.broadcast_to(np.array(sample.blank, np.uint8), image.shape)
        return np.rot90(image, sample.turns)


@lru_cache(maxsize=1)
def epoch_batches(twins: bytes, batch: int, seed: int, epoch: int) -> list[np.ndarray]:
    """The rows of an epoch's steps, in a fresh order; both states of a pair stand in one batch."""
    twin_of = np.frombuffer(twins, np.int32)
    order = np.random.default_rng((seed, epoch)).permutation(len(twin_of))
    units = [[int(row)] if twin_of[row] < 0 else [int(row), int(twin_of[row])] for row in order if twin_of[row] < 0 or row < twin_of[row]]
    even = batch // 2 * 2
    out: list[list[int]] = [[]]
    late: list[int] = []
    for unit in units:
        if len(out[-1]) + len(unit) > batch:
            # A pair for which one place is left waits for the next batch.
            late += unit
            continue
        out[-1] += unit
        while len(out[-1]) == batch:
            out.append(late[:even])
            late = late[even:]
    out += [late[start : start + even] for start in range(0, len(late), even)]
    return [np.array(rows) for rows in out if rows]


def order(twins: np.ndarray, batch: int, seed: int, step: int) -> np.ndarray:
    """The rows of a step: a fresh permutation each epoch, a function of seed and step only, so that a resumed run goes on."""
    epoch, place = divmod(step, max(1, len(twins) // batch))
    return epoch_batches(np.asarray(twins, np.int32).tobytes(), batch, seed, epoch)[place]


def micro_batches(samples: list[Sample], size: int) -> Iterator[list[Sample]]:
    """The samples cut into groups of similar length."""
    by_length = sorted(samples, key=lambda sample: (len(sample), sample.row))
    for start in range(0, len(by_length), size):
        yield by_length[start : start + size]
