"""One worker's training loop, its state on disk, and the schedule."""

from __future__ import annotations

import json
import math
import os
import signal
import sys
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path

import numpy as np
import torch
import torch.distributed as dist
import torch.nn.functional as F
from tokenizers import Tokenizer

from .batches import Batch, Collator, micro_batches, order
from .corpus import Corpus
from .model import NanoLlava
from .occupancy import TIMES, OccupancyHead, average_precision
from .samples import Sample, Sampler, Variation, plain, with_picture_of, without_text
from .shapes import Shape
from .twins import hinge
from .vocabulary import moved
from .weights import WORD_TABLES, from_stock


@dataclass(frozen=True)
class Recipe:
    """Everything that decides the weights besides the data; stands in the checkpoint and in the export.

    The budget is `steps`, or `minutes` of training wall time over all legs (then the number of steps depends on the machine).
    """

    shape: str = "smallest"
    steps: int = 0
    minutes: float = 0.0
    batch: int = 64
    micro: int = 16
    rate: float = 1e-3
    final_rate: float = 0.05
    warm_up: int = 100
    weight_decay: float = 0.05
    betas: tuple[float, float] = (0.9, 0.95)
    clip: float = 1.0
    template_weight: float = 0.05
    #: Folder of a trained nano whose weights, tokenizer and colours are the start; empty starts from scratch.
    start: str = ""
    #: Share of the budget in which every scene text is left out, so that the facts have to come from the image.
    image_only: float = 0.0
    #: Shares of samples, all through training: without scene text, without picture, questions on the picture alone, a wrong neighbor in the text;
    #: and the share of masked neighbors.
    text_drop: float = 0.25
    picture_drop: float = 0.1
    picture_questions: float = 0.05
    contradict: float = 0.05
    neighbor_mask: float = 0.15
    #: Share of samples with one of the codes that the search tried, drawn by its chance, in place of the best one.
    tried_codes: float = 0.0
    #: Weight of the hinge between twins beside an informative token's, 0 for none; the margin in nats; over all answers or the `code` alone.
    twin_weight: float = 1.0
    twin_margin: float = 2.0
    twin_over: str = "answers"
    #: Weight of the occupancy head's loss, 0 for none, and that of an occupied cell.
    occupancy_weight: float = 0.3
    occupancy_positive: float = 15.0
    seed: int = 1
    precision: str = "bfloat16"
    compile: bool = False
    check_every: int = 100
    check_states: int = 256


@dataclass
class Progress:
    """Where a run stands; seconds count training only, over all legs."""

    step: int = 0
    seconds: float = 0.0
    states: int = 0


def learning_rate(recipe: Recipe, step: int, done: float) -> float:
    """Linear warm-up by steps, cosine by the share of the budget that is done, to `final_rate` of the peak."""
    cosine = recipe.final_rate + (1 - recipe.final_rate) * 0.5 * (1 + math.cos(math.pi * min(done, 1.0)))
    return recipe.rate * min(1.0, (step + 1) / recipe.warm_up) * cosine


def share_done(recipe: Recipe, progress: Progress) -> float:
    """Share of the budget that is spent, 0 to 1."""
    if recipe.steps:
        return progress.step / recipe.steps
    return progress.seconds / (60 * recipe.minutes)


class Measured:
    """Means of what a step measured."""

    def __init__(self) -> None:
        self.sums: dict[str, tuple[float, int]] = {}

    def add(self, name: str, values: torch.Tensor) -> None:
        """Adds values to a mean."""
        total, count = self.sums.get(name, (0.0, 0))
        self.sums[name] = (total + float(values.detach().sum()), count + len(values))

    @staticmethod
    def means(of: list[Measured]) -> dict[str, float]:
        """Over several steps."""
        names = dict.fromkeys(name for measured in of for name in measured.sums)
        pairs = {name: [measured.sums[name] for measured in of if name in measured.sums] for name in names}
        return {name: round(sum(total for total, _ in found) / max(sum(count for _, count in found), 1), 4) for name, found in pairs.items()}


class Leg:
    """When a leg ends: its minutes are over, or somebody asked the process to end (SIGTERM, or SIGINT as when the parent has died)."""

    def __init__(self, minutes: float) -> None:
        self.start, self.seconds, self.asked = time.monotonic(), 60 * minutes, False
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self.ask)

    def begin(self) -> None:
        """Counts from now on: what came before was no training."""
        self.start = time.monotonic()

    def ask(self, *_: object) -> None:
        """Lets the step end, then the leg."""
        self.asked = True

    @property
    def elapsed(self) -> float:
        """Seconds since its start."""
        return time.monotonic() - self.start

    @property
    def over(self) -> bool:
        """Whether it ends before the next step."""
        return self.asked or self.elapsed >= self.seconds


class Trainer:
    """A worker: `rank` of `world`, each with its own copy of the weights and its share of every batch."""

    def __init__(
        self, recipe: Recipe, shape: Shape, vocabulary: int, colours: tuple[list[float], list[float]], rank: int, world: int, device: torch.device
    ) -> None:
        torch.manual_seed(recipe.seed)
        self.recipe, self.rank, self.world, self.device = recipe, rank, world, device
        self.model = NanoLlava(shape, vocabulary)
        mean, std = colours
        self.model.image_mean.copy_(torch.tensor(mean))
        self.model.image_std.copy_(torch.tensor(std))
        self.model.to(device)
        self.head = OccupancyHead(shape, recipe.occupancy_positive).to(device)
        self.forward = torch.compile(self.model) if recipe.compile else self.model
        self.dtype = getattr(torch, recipe.precision)
        self.progress = Progress()
        self.parameters = [*self.model.parameters(), *self.head.parameters()]
        decayed = [p for p in self.parameters if p.dim() > 1]
        others = [p for p in self.parameters if p.dim() <= 1]
        self.optimizer = torch.optim.AdamW(
            [{"params": decayed, "weight_decay": recipe.weight_decay}, {"params": others, "weight_decay": 0.0}],
            lr=recipe.rate, betas=recipe.betas, fused=True,
        )  # fmt: skip

    def train(self, data: tuple[Corpus, Corpus], collators: tuple[Collator, Collator], tokenizer: Tokenizer, out: Path, leg: Leg) -> bool:
        """Trains until the budget is spent or this leg ends; true when the whole budget is."""
        (corpus, check), (train_collator, check_collator) = data, collators
        seconds_before = self.progress.seconds
        log = (out / "log.jsonl").open("a") if self.rank == 0 else None
        recent: list[Measured] = []
        recipe = self.recipe
        shares = Variation(**{share.name: getattr(recipe, share.name) for share in fields(Variation)})
        usual = Sampler(corpus, tokenizer, shares, recipe.seed, recipe.twin_over if recipe.twin_weight else "")
        no_text = replace(usual, variation=Variation(text_drop=1.0))
        leg.begin()
        while True:
            self.progress.seconds = seconds_before + leg.elapsed
            done, stop = self.agree(share_done(recipe, self.progress), leg.over)
            if done >= 1.0 or stop:
                break
            drop_text = done < recipe.image_only
            rate = learning_rate(recipe, self.progress.step, done)
            recent.append(self.step(train_collator, no_text if drop_text else usual, rate))
            if self.progress.step % recipe.check_every == 0 and log is not None:
                row = self.report(check, check_collator, recent, rate, done, seconds_before + leg.elapsed, drop_text)
                log.write(json.dumps(row) + "\n")
                log.flush()
                recent = []
                self.save(out / "checkpoint.pt")
        if log is not None:
            log.close()
            self.save(out / "checkpoint.pt")
        return done >= 1.0

    def agree(self, done: float, stop: bool) -> tuple[float, bool]:
        """Rank 0's clock is everybody's; one that is asked to stop stops all."""
        if self.world == 1:
            return done, stop
        shared = torch.tensor([done if self.rank == 0 else 0.0, float(stop)], dtype=torch.float64)
        dist.all_reduce(shared, dist.ReduceOp.MAX)
        return float(shared[0]), bool(shared[1])

    def step(self, collator: Collator, sampler: Sampler, rate: float) -> Measured:
        """One optimizer step; what it measured over this worker's part."""
        rows = order(sampler.corpus.twins, self.recipe.batch, self.recipe.seed, self.progress.step)
        samples = {int(row): sampler.draw(int(row), self.progress.step) for row in rows}
        divisor = collator.weight(list(samples.values()))
        measured = Measured()
        for group, own in self.groups(sampler.corpus, samples):
            self.loss(collator.collate(group).to(self.device), own, len(rows), divisor, measured).backward()
        for p in self.parameters:
            # A worker without twins or grids in its part still meets the others.
            p.grad = torch.zeros_like(p) if p.grad is None else p.grad
        if self.world > 1:
            flat = torch.cat([p.grad.view(-1) for p in self.parameters])
            dist.all_reduce(flat)
            for p, part in zip(self.parameters, flat.split([p.numel() for p in self.parameters]), strict=True):
                p.grad.copy_(part.view_as(p))
        norm = torch.nn.utils.clip_grad_norm_(self.parameters, self.recipe.clip)
        if not torch.isfinite(norm):
            raise RuntimeError(f"the gradient is not finite at step {self.progress.step}")
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        self.optimizer.step()
        self.optimizer.zero_grad(set_to_none=True)
        self.progress.step += 1
        self.progress.states += len(rows)
        return measured

    def groups(self, corpus: Corpus, samples: dict[int, Sample]) -> Iterator[tuple[list[Sample], int]]:
        """This worker's micro-batches, and how many of their samples are the batch's own: of twins half, pairs side by side, before the same with
        each other's pictures."""
        twins = {row: int(corpus.twins[row]) for row, sample in samples.items() if sample.contrast is not None}
        singles = sorted((s for row, s in samples.items() if row not in twins), key=lambda s: (len(s), s.row))
        pairs = sorted(((samples[row], samples[twin]) for row, twin in twins.items() if row < twin), key=lambda pair: (len(pair[0]), pair[0].row))
        # Workers take turns by length.
        for group in micro_batches(singles[self.rank :: self.world], self.recipe.micro):
            yield group, len(group)
        mine, size = pairs[self.rank :: self.world], max(1, self.recipe.micro // 4)
        for start in range(0, len(mine), size):
            own = [sample for pair in mine[start : start + size] for sample in pair]
            yield own + [with_picture_of(sample, twins[sample.row]) for sample in own], len(own)

    def loss(self, batch: Batch, own: int, rows: int, divisor: float, measured: Measured) -> torch.Tensor:
        """What a micro-batch adds to the loss of a batch of so many rows and this sum of weights; samples after `own` count in the hinge alone."""
        recipe = self.recipe
        logits, features = self.forward(batch.ids, batch.images, batch.image_places, batch.wanted, self.dtype)
        losses = F.cross_entropy(logits, batch.targets, reduction="none")
        size = len(batch.ids)
        ordinary = batch.samples < own
        total = (losses * batch.weights)[ordinary].sum() / divisor
        if own < size:
            hinges = hinge(losses, batch, recipe.twin_margin)
            total = total + recipe.twin_weight * hinges.sum() / divisor
            measured.add("hinge", hinges)
        known = batch.has_occupancy & (torch.arange(size, device=self.device) < own)
        if recipe.occupancy_weight and bool(known.any()):
            occupied = self.head.loss(self.head(features[known]), batch.occupancy[known])
            total = total + recipe.occupancy_weight * occupied.sum() / rows
            measured.add("occupancy", occupied)
        counted = batch.informative & ordinary & (batch.weights > 0)
        measured.add("loss", losses[counted])
        measured.add("train", (logits.argmax(-1) == batch.targets)[counted].float())
        return total

    def report(self, check: Corpus, collator: Collator, recent: list[Measured], rate: float, done: float, elapsed: float, drop_text: bool) -> dict:
        """A log row: recent training losses and, teacher-forced, each question's accuracy on validation states."""
        accuracy, precision = teacher_forced(self.model, self.head, check, collator, self.recipe.check_states, self.dtype, self.device, drop_text)
        means = Measured.means(recent)
        row = {
            "step": self.progress.step, "states": self.progress.states, "seconds": round(elapsed, 1), "done": round(done, 4), "rate": rate,
            **means, "validation": accuracy, "occupancy_precision": precision,
            "states_per_second": round(self.progress.states / max(elapsed, 1e-9), 1), "text": not drop_text, "load": round(os.getloadavg()[0], 2),
        }  # fmt: skip
        line = " ".join(f"{q}:{a * 100:.0f}" for q, a in accuracy.items())
        print(
            f"{done * 100:5.1f}% step {row['step']} {' '.join(f'{k} {v:.3f}' for k, v in means.items())} "
            f"mean {sum(accuracy.values()) / max(len(accuracy), 1) * 100:.1f} {row['states_per_second']:.0f} states/s load {row['load']} | {line}"
            + (f" | occupancy {' '.join(f'{v:.2f}' for v in precision)}" if precision else ""),
            file=sys.stderr, flush=True,
        )  # fmt: skip
        return row

    def save(self, path: Path) -> None:
        """Weights, optimiser, progress and recipe, written whole or not at all."""
        state = {
            "model": self.model.state_dict(), "head": self.head.state_dict(), "optimizer": self.optimizer.state_dict(), "progress": asdict(self.progress),
            "recipe": asdict(self.recipe), "shape": self.model.shape.to_json(), "vocabulary": self.model.vocabulary,
        }  # fmt: skip
        torch.save(state, path.with_suffix(".part"))
        path.with_suffix(".part").replace(path)

    def start_from(self, stock: dict[str, torch.Tensor], old: Tokenizer, new: Tokenizer) -> None:
        """Takes weights over from a trained model of the same shape, token by token."""
        for name in WORD_TABLES:
            stock[name] = moved(stock[name].float(), old, new)
        self.model.load_state_dict(from_stock(stock, self.model.state_dict(), self.model.shape))

    def restore(self, path: Path) -> None:
        """Goes on where a leg ended."""
        state = torch.load(path, map_location=self.device, weights_only=True)
        self.model.load_state_dict(state["model"])
        self.head.load_state_dict(state["head"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.progress = Progress(**state["progress"])


@torch.no_grad()
def teacher_forced(
    model: NanoLlava, head: OccupancyHead, corpus: Corpus, collator: Collator, states: int, dtype: torch.dtype, device: torch.device, drop_text: bool = False
) -> tuple[dict[str, float], list[float]]:  # fmt: skip
    """Accuracy per question with the true answers before it, and the head's average precision now, +1 s and +2 s: quick, for watching;
    `evaluate.py` runs freely."""
    hits = np.zeros(len(corpus.questions))
    asked = np.zeros(len(corpus.questions))
    rows = range(min(states, len(corpus)))
    question_of = {(int(r), int(a) + i): int(q) for r, q, a, n in corpus.slots if r < len(rows) for i in range(int(n))}
    samples = [without_text(corpus, plain(corpus, row)) if drop_text else plain(corpus, row) for row in rows]
    scores, truth = [], []
    for group in micro_batches(samples, 32):
        batch = collator.collate(group).to(device)
        logits, features = model(batch.ids, batch.images, batch.image_places, batch.wanted, dtype)
        right = (logits.argmax(-1) == batch.targets)[batch.informative].cpu().numpy()
        # Informative tokens come row by row, in order: the same order as the row's slots.
        places = [(sample.row, place) for sample in group for place in informative_places(corpus, sample.row)]
        for key, hit in zip(places, right, strict=True):
            hits[question_of[key]] += hit
            asked[question_of[key]] += 1
        known = batch.has_occupancy
        scores.append(head(features[known]).cpu().numpy())
        truth.append(batch.occupancy[known].cpu().numpy())
    score, real = np.concatenate(scores), np.concatenate(truth)
    precision = [round(average_precision(score[:, t], real[:, t]), 4) for t in range(TIMES)] if len(real) and real.any((0, 2, 3)).all() else []
    return {q: round(float(h / n), 4) for q, h, n in zip(corpus.questions, hits, asked, strict=True) if n}, precision


def informative_places(corpus: Corpus, row: int) -> list[int]:
    """Places of a row's informative tokens."""
    roles = corpus.roles[corpus.starts[row] : corpus.starts[row + 1]]
    return np.flatnonzero(roles == 2).tolist()


def load_model(path: Path) -> tuple[NanoLlava, dict]:
    """The model of a checkpoint on the CPU, in f32, and the checkpoint's other contents."""
    state = torch.load(path, map_location="cpu", weights_only=True)
    model = NanoLlava(Shape(**state["shape"]), state["vocabulary"])
    model.load_state_dict(state.pop("model"))
    return model.eval(), state
