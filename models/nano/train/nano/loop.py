"""One worker's training loop, its state on disk, and the schedule."""

from __future__ import annotations

import json
import math
import os
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
import torch.distributed as dist
import torch.nn.functional as F

from .batches import Collator, micro_batches, order
from .corpus import Corpus
from .model import NanoLlava
from .shapes import Shape
from .weights import from_stock


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
    #: Share of the budget in which the scene text is left out, so that the facts have to come from the image.
    image_only: float = 0.0
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
        self.forward = torch.compile(self.model) if recipe.compile else self.model
        self.dtype = getattr(torch, recipe.precision)
        self.progress = Progress()
        decayed = [p for p in self.model.parameters() if p.dim() > 1]
        plain = [p for p in self.model.parameters() if p.dim() <= 1]
        self.optimizer = torch.optim.AdamW(
            [{"params": decayed, "weight_decay": recipe.weight_decay}, {"params": plain, "weight_decay": 0.0}],
            lr=recipe.rate, betas=recipe.betas, fused=True,
        )  # fmt: skip

    def train(self, corpus: Corpus, check: Corpus, collators: tuple[Collator, Collator], out: Path, leg_minutes: float) -> bool:
        """Trains until the budget or this leg's minutes are spent; true when the whole budget is."""
        train_collator, check_collator = collators
        leg_start, seconds_before = time.monotonic(), self.progress.seconds
        log = (out / "log.jsonl").open("a") if self.rank == 0 else None
        recent: list[tuple[float, float]] = []
        while True:
            self.progress.seconds = seconds_before + time.monotonic() - leg_start
            done, stop = self.agree(share_done(self.recipe, self.progress), time.monotonic() - leg_start >= 60 * leg_minutes)
            if done >= 1.0 or stop:
                break
            drop_text = done < self.recipe.image_only
            rate = learning_rate(self.recipe, self.progress.step, done)
            recent.append(self.step(corpus, train_collator, rate, drop_text))
            if self.progress.step % self.recipe.check_every == 0 and log is not None:
                elapsed = seconds_before + time.monotonic() - leg_start
                row = self.report(check, check_collator, recent, rate, done, elapsed, drop_text)
                log.write(json.dumps(row) + "\n")
                log.flush()
                recent = []
                self.save(out / "checkpoint.pt")
        if log is not None:
            log.close()
            self.save(out / "checkpoint.pt")
        return done >= 1.0

    def agree(self, done: float, stop: bool) -> tuple[float, bool]:
        """Rank 0's clock is everybody's."""
        if self.world == 1:
            return done, stop
        shared = torch.tensor([done, float(stop)], dtype=torch.float64)
        dist.broadcast(shared, 0)
        return float(shared[0]), bool(shared[1])

    def step(self, corpus: Corpus, collator: Collator, rate: float, drop_text: bool) -> tuple[float, float]:
        """One optimiser step; (loss on informative tokens, share of them right) over this worker's part."""
        rows = order(len(corpus), self.recipe.batch, self.recipe.seed, self.progress.step)
        divisor = collator.weight(rows)
        groups = list(micro_batches(collator, rows, self.recipe.micro, drop_text))
        # Workers take turns from both ends of the lengths.
        mine = [group for i, group in enumerate(groups) if i % self.world == self.rank]
        loss_sum = right = count = 0.0
        for group in mine:
            batch = collator.collate(group, drop_text).to(self.device)
            logits = self.forward(batch.ids, batch.images, batch.image_places, batch.wanted, self.dtype)
            losses = F.cross_entropy(logits, batch.targets, reduction="none")
            ((losses * batch.weights).sum() / divisor).backward()
            known = batch.informative
            loss_sum += float(losses.detach()[known].sum())
            right += float((logits.detach().argmax(-1) == batch.targets)[known].sum())
            count += float(known.sum())
        parameters = [p for p in self.model.parameters() if p.grad is not None]
        if self.world > 1:
            flat = torch.cat([p.grad.view(-1) for p in parameters])
            dist.all_reduce(flat)
            for p, part in zip(parameters, flat.split([p.numel() for p in parameters]), strict=True):
                p.grad.copy_(part.view_as(p))
        norm = torch.nn.utils.clip_grad_norm_(parameters, self.recipe.clip)
        if not torch.isfinite(norm):
            raise RuntimeError(f"the gradient is not finite at step {self.progress.step}")
        for group in self.optimizer.param_groups:
            group["lr"] = rate
        self.optimizer.step()
        self.optimizer.zero_grad(set_to_none=True)
        self.progress.step += 1
        self.progress.states += len(rows)
        return loss_sum / max(count, 1.0), right / max(count, 1.0)

    def report(
        self, check: Corpus, collator: Collator, recent: list[tuple[float, float]], rate: float, done: float, elapsed: float, drop_text: bool
    ) -> dict:
        """A log row: recent training loss and, teacher-forced, each question's accuracy on validation states."""
        accuracy = teacher_forced(self.model, check, collator, self.recipe.check_states, self.dtype, self.device, drop_text)
        mean = lambda values: sum(values) / max(len(values), 1)  # noqa: E731
        row = {
            "step": self.progress.step, "states": self.progress.states, "seconds": round(elapsed, 1), "done": round(done, 4),
            "rate": rate, "loss": round(mean([r[0] for r in recent]), 4), "train": round(mean([r[1] for r in recent]), 4),
            "validation": accuracy, "states_per_second": round(self.progress.states / max(elapsed, 1e-9), 1),
            "text": not drop_text, "load": round(os.getloadavg()[0], 2),
        }  # fmt: skip
        line = " ".join(f"{q}:{a * 100:.0f}" for q, a in accuracy.items())
        print(
            f"{done * 100:5.1f}% step {row['step']} loss {row['loss']:.3f} mean {mean(list(accuracy.values())) * 100:.1f} "
            f"{row['states_per_second']:.0f} states/s load {row['load']} | {line}",
            file=sys.stderr, flush=True,
        )  # fmt: skip
        return row

    def save(self, path: Path) -> None:
        """Weights, optimiser, progress and recipe, written whole or not at all."""
        state = {
            "model": self.model.state_dict(), "optimizer": self.optimizer.state_dict(), "progress": asdict(self.progress),
            "recipe": asdict(self.recipe), "shape": self.model.shape.to_json(), "vocabulary": self.model.vocabulary,
        }  # fmt: skip
        torch.save(state, path.with_suffix(".part"))
        path.with_suffix(".part").replace(path)

    def start_from(self, stock: dict[str, torch.Tensor]) -> None:
        """Takes weights over from a trained model of the same shape and vocabulary."""
        self.model.load_state_dict(from_stock(stock, self.model.state_dict(), self.model.shape))

    def restore(self, path: Path) -> None:
        """Goes on where a leg ended."""
        state = torch.load(path, map_location=self.device, weights_only=True)
        self.model.load_state_dict(state["model"])
        self.optimizer.load_state_dict(state["optimizer"])
        self.progress = Progress(**state["progress"])


@torch.no_grad()
def teacher_forced(
    model: NanoLlava, corpus: Corpus, collator: Collator, states: int, dtype: torch.dtype, device: torch.device, drop_text: bool = False
) -> dict[str, float]:
    """Accuracy per question with the true answers before it: quick, for watching; `evaluate.py` runs freely."""
    hits = np.zeros(len(corpus.questions))
    asked = np.zeros(len(corpus.questions))
    rows = np.arange(min(states, len(corpus)))
    question_of = {(int(r), int(a) + i): int(q) for r, q, a, n in corpus.slots if r < len(rows) for i in range(int(n))}
    for group in micro_batches(collator, rows, 32, drop_text):
        batch = collator.collate(group, drop_text).to(device)
        logits = model(batch.ids, batch.images, batch.image_places, batch.wanted, dtype)
        right = (logits.argmax(-1) == batch.targets)[batch.informative].cpu().numpy()
        # Informative tokens come row by row, in order: the same order as the row's slots.
        places = [(int(row), place) for row in group for place in informative_places(corpus, int(row))]
        for key, hit in zip(places, right, strict=True):
            hits[question_of[key]] += hit
            asked[question_of[key]] += 1
    return {q: round(float(h / n), 4) for q, h, n in zip(corpus.questions, hits, asked, strict=True) if n}


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
