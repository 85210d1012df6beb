"""Micro-batches: rows of similar length, padded on the right, with the flat places of image and loss."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from .corpus import INFORMATIVE, TEMPLATE, Corpus


@dataclass(frozen=True)
class Batch:
    """`targets[k]` is the token after flat position `wanted[k]`, `weights[k]` its share in the loss."""

    ids: Tensor
    images: Tensor
    image_places: Tensor
    wanted: Tensor
    targets: Tensor
    weights: Tensor
    #: Which of `wanted` predict an informative token.
    informative: Tensor

    def to(self, device: torch.device) -> Batch:
        """The batch on another device."""
        return Batch(**{name: value.to(device, non_blocking=True) for name, value in vars(self).items()})


@dataclass(frozen=True)
class Collator:
    """What is needed to turn rows into a batch."""

    corpus: Corpus
    image_id: int
    image_tokens: int
    template_weight: float

    def length(self, row: int, drop_text: bool) -> int:
        """Decoder positions of a row."""
        start, end = self.corpus.scene[row]
        count = int(self.corpus.starts[row + 1] - self.corpus.starts[row]) + self.image_tokens - 1
        return count - int(end - start) if drop_text else count

    def weight(self, rows: np.ndarray) -> float:
        """Sum of the loss weights of whole rows: the divisor that makes micro-batches add up to the batch's mean."""
        total = 0.0
        for row in rows:
            tokens = slice(self.corpus.starts[row], self.corpus.starts[row + 1])
            roles, weights = self.corpus.roles[tokens], self.corpus.weights[tokens]
            total += float(weights[roles == INFORMATIVE].sum()) + self.template_weight * float((roles == TEMPLATE).sum())
        return total

    def collate(self, rows: np.ndarray, drop_text: bool = False, images_of: np.ndarray | None = None) -> Batch:
        """Rows to a batch; `images_of` takes the images of other rows (the shuffled-image control)."""
        longest = max(self.length(row, drop_text) for row in rows)
        ids = np.zeros((len(rows), longest), np.int64)
        roles = np.zeros((len(rows), longest), np.uint8)
        weights = np.zeros((len(rows), longest), np.float32)
        places = np.zeros((len(rows), self.image_tokens), np.int64)
        for i, row in enumerate(rows):
            a, b = self.corpus.starts[row], self.corpus.starts[row + 1]
            row_ids, row_roles, row_weights = self.corpus.ids[a:b], self.corpus.roles[a:b], self.corpus.weights[a:b]
            if drop_text:
                start, end = self.corpus.scene[row]
                row_ids = np.concatenate([row_ids[:start], row_ids[end:]])
                row_roles = np.concatenate([row_roles[:start], row_roles[end:]])
                row_weights = np.concatenate([row_weights[:start], row_weights[end:]])
            image = int(np.flatnonzero(row_ids == self.image_id)[0])
            after = image + self.image_tokens
            ids[i, : image + 1] = row_ids[: image + 1]
            ids[i, image:after] = self.image_id
            ids[i, after : after + len(row_ids) - image - 1] = row_ids[image + 1 :]
            roles[i, after : after + len(row_ids) - image - 1] = row_roles[image + 1 :]
            weights[i, after : after + len(row_ids) - image - 1] = row_weights[image + 1 :]
            places[i] = i * longest + np.arange(image, after)
        target_row, target_place = np.nonzero(roles)
        chosen = roles[target_row, target_place]
        images = self.corpus.images[rows if images_of is None else images_of]
        return Batch(
            ids=torch.from_numpy(ids),
            images=torch.from_numpy(np.ascontiguousarray(images)),
            image_places=torch.from_numpy(places.reshape(-1)),
            wanted=torch.from_numpy(target_row * longest + target_place - 1),
            targets=torch.from_numpy(ids[target_row, target_place]),
            weights=torch.from_numpy(np.where(chosen == INFORMATIVE, weights[target_row, target_place], self.template_weight).astype(np.float32)),
            informative=torch.from_numpy(chosen == INFORMATIVE),
        )


def order(size: int, batch: int, seed: int, step: int) -> np.ndarray:
    """The rows of a step: a fresh permutation each epoch, a function of seed and step only, so that a resumed run goes on."""
    per_epoch = max(1, size // batch)
    epoch, place = divmod(step, per_epoch)
    permutation = np.random.default_rng((seed, epoch)).permutation(size)
    return permutation[place * batch : (place + 1) * batch]


def micro_batches(collator: Collator, rows: np.ndarray, size: int, drop_text: bool) -> Iterator[np.ndarray]:
    """The rows cut into groups of similar length."""
    by_length = sorted(rows.tolist(), key=lambda row: (collator.length(row, drop_text), row))
    for start in range(0, len(by_length), size):
        yield np.array(by_length[start : start + size])
