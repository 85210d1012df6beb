"""Answers without the truth in the context: every row walks its own script, token by token, over one shared cache.

A script is the conversation with holes. Outside the holes the tokens are given (prompts, keys: what a grammar forces at inference); in a
hole the model chooses among the question's values, and what it chose is what it reads afterwards.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from .batches import Collator
from .corpus import Corpus
from .model import NanoLlava, linear, norm
from .samples import Sample, plain

#: A value's tokens.
Value = tuple[int, ...]


class Decoder:
    """Prefill and single steps with keys and values kept, each row at its own length."""

    def __init__(self, model: NanoLlava, rows: int, room: int) -> None:
        shape = model.shape
        size = shape.width // shape.heads
        self.model = model
        self.lengths = torch.zeros(rows, dtype=torch.long)
        self.keys = [torch.zeros(rows, shape.heads, room, size) for _ in model.blocks]
        self.values = [torch.zeros(rows, shape.heads, room, size) for _ in model.blocks]

    def prefill(self, ids: Tensor, images: Tensor, image_places: Tensor, lengths: Tensor) -> Tensor:
        """Logits (rows, vocabulary) after each row's last prompt token; the prompt is padded on the right."""
        model, n = self.model, ids.shape[1]
        x = model.embeddings(ids, model.image_features(images, torch.float32), image_places)
        cos, sin = model.cos[:n], model.sin[:n]
        for layer, block in enumerate(model.blocks):
            q, k, v = block.project(x, cos, sin)
            self.keys[layer][:, :, :n], self.values[layer][:, :, :n] = k, v
            seen = F.scaled_dot_product_attention(q, k, v, is_causal=True).transpose(1, 2).reshape(x.shape)
            x = block.finish(x, seen)
        self.lengths = lengths.clone()
        return self.logits(x[torch.arange(len(x)), lengths - 1])

    def step(self, tokens: Tensor) -> Tensor:
        """Logits after one more token a row. Keys beyond a row's length are leftovers of padding and are masked."""
        model, rows = self.model, torch.arange(len(tokens))
        x = model.embed(tokens)[:, None]
        cos, sin = model.cos[self.lengths][:, None, None], model.sin[self.lengths][:, None, None]
        reach = int(self.lengths.max()) + 1
        mask = (torch.arange(reach)[None] <= self.lengths[:, None])[:, None, None]
        for layer, block in enumerate(model.blocks):
            q, k, v = block.project(x, cos, sin)
            self.keys[layer][rows, :, self.lengths], self.values[layer][rows, :, self.lengths] = k[:, :, 0], v[:, :, 0]
            seen = F.scaled_dot_product_attention(q, self.keys[layer][:, :, :reach], self.values[layer][:, :, :reach], attn_mask=mask)
            x = block.finish(x, seen.transpose(1, 2).reshape(x.shape))
        self.lengths = self.lengths + 1
        return self.logits(x[:, 0])

    def logits(self, x: Tensor) -> Tensor:
        """The head over (rows, W)."""
        return linear(norm(x, self.model.norm), self.model.head)


@dataclass
class Script:
    """What a row still has to say: `parts` are given tokens or (question, values) holes."""

    parts: list[list[int] | tuple[int, Sequence[Value]]]
    answers: dict[int, Value] = field(default_factory=dict)
    #: Of each question: how probable the model finds each token with which an answer may begin; they add up to 1.
    odds: dict[int, dict[int, float]] = field(default_factory=dict)
    _part: int = 0
    _said: tuple[int, ...] = ()

    def next(self, logits: Tensor) -> int | None:
        """The next token of the row, chosen where the script leaves a choice; None at the end."""
        while self._part < len(self.parts):
            part = self.parts[self._part]
            if isinstance(part, list):
                if len(self._said) < len(part):
                    token = part[len(self._said)]
                    self._said += (token,)
                    return token
            else:
                question, values = part
                said = self._said
                going = [v for v in values if v[: len(said)] == said]
                allowed = {v[len(said)] for v in going if len(v) > len(said)}
                ended = said in going
                follow = self._following() if ended else None
                if allowed:
                    tokens = sorted(allowed | ({follow} if follow is not None else set()))
                    if not said:
                        self.odds[question] = dict(zip(tokens, logits[tokens].float().softmax(0).tolist(), strict=True))
                    token = tokens[int(logits[tokens].argmax())]
                    if token in allowed:
                        self._said += (token,)
                        return token
                self.answers[question] = said
            self._part, self._said = self._part + 1, ()
        return None

    def _following(self) -> int | None:
        """The first given token after the present hole."""
        after = self.parts[self._part + 1] if self._part + 1 < len(self.parts) else []
        return after[0] if isinstance(after, list) and after else None


def scripts(corpus: Corpus, row: int, choices: dict[int, list[Value]], first: int) -> Script:
    """The row's script from its token `first` on."""
    ids = corpus.row(row).tolist()
    parts: list[list[int] | tuple[int, Sequence[Value]]] = []
    at = first
    for _, question, start, count in sorted(corpus.slots_of(row).tolist(), key=lambda slot: slot[2]):
        parts.append(ids[at:start])
        parts.append((question, choices[question]))
        at = start + count
    parts.append(ids[at:])
    return Script(parts)


def values_of(corpus: Corpus, limit: int = 20_000) -> dict[str, list[Value]]:
    """The values that each question takes in a split (its first `limit` states), sorted."""
    found: dict[str, set[Value]] = {question: set() for question in corpus.questions}
    for row, question, start, count in corpus.slots:
        if row >= limit:
            break
        begin = corpus.starts[row] + start
        found[corpus.questions[question]].add(tuple(corpus.ids[begin : begin + count].tolist()))
    return {question: sorted(values) for question, values in found.items()}


@torch.no_grad()
def prefill_rows(model: NanoLlava, collator: Collator, samples: list[Sample], assistant: int, room: int) -> tuple[Decoder, Tensor]:
    """Prefills each sample's tokens up to its first answer."""
    batch = collator.collate(samples)
    lengths = torch.tensor([first_answer(sample.ids, assistant) + collator.image_tokens - 1 for sample in samples])
    longest = int(lengths.max())
    decoder = Decoder(model, len(samples), batch.ids.shape[1] + room)
    full = batch.ids.shape[1]
    places = batch.image_places // full * longest + batch.image_places % full
    return decoder, decoder.prefill(batch.ids[:, :longest], batch.images, places, lengths)


def first_answer(ids: np.ndarray, assistant: int) -> int:
    """Place of the first token that the model says."""
    return ids.tolist().index(assistant) + 1


@torch.no_grad()
def answer(
    model: NanoLlava, corpus: Corpus, collator: Collator, samples: list[Sample], choices: dict[int, list[Value]], assistant: int
) -> list[Script]:
    """Each sample's script with its answers, decided in order and read back by the model."""
    decoder, logits = prefill_rows(model, collator, samples, assistant, room=32)
    rows = [sample.row for sample in samples]
    firsts = [first_answer(corpus.row(row), assistant) for row in rows]
    running = [scripts(corpus, row, choices, first) for row, first in zip(rows, firsts, strict=True)]
    while True:
        tokens = [script.next(logits[i]) for i, script in enumerate(running)]
        if all(token is None for token in tokens):
            return running
        # A row that is done repeats padding; nobody reads it.
        logits = decoder.step(torch.tensor([0 if token is None else token for token in tokens]))


@torch.no_grad()
def speak(
    model: NanoLlava, corpus: Corpus, collator: Collator, rows: list[int], assistant: int, end: int, longest_answer: int = 64
) -> list[list[list[int]]]:
    """Each row's answers by unconstrained greedy decoding, the user's turns given: tokens of every round, without the end mark."""
    turns = [user_turns(corpus.row(row).tolist(), assistant, end) for row in rows]
    rounds = max(len(t) for t in turns) + 1
    room = rounds * longest_answer + sum(len(t) for t in turns[0]) + 64
    decoder, logits = prefill_rows(model, collator, [plain(corpus, row) for row in rows], assistant, room)
    said: list[list[list[int]]] = [[[]] for _ in rows]
    given: list[list[int]] = [[] for _ in rows]
    finished = [False] * len(rows)
    while not all(finished):
        tokens = []
        for i in range(len(rows)):
            if finished[i]:
                tokens.append(0)
            elif given[i]:
                tokens.append(given[i].pop(0))
            else:
                token = int(logits[i].argmax())
                if token == end or len(said[i][-1]) >= longest_answer:
                    round_ = len(said[i])
                    if round_ > len(turns[i]):
                        finished[i] = True
                    else:
                        given[i] = list(turns[i][round_ - 1])
                        said[i].append([])
                    token = end
                else:
                    said[i][-1].append(token)
                tokens.append(token)
        logits = decoder.step(torch.tensor(tokens))
    return said


def user_turns(ids: list[int], assistant: int, end: int) -> list[list[int]]:
    """The tokens between an answer's end and the next answer's start, the mark included."""
    turns, i = [], ids.index(assistant)
    while True:
        stop = ids.index(end, i)
        if assistant not in ids[stop:]:
            return turns
        i = ids.index(assistant, stop)
        turns.append(ids[stop + 1 : i + 1])
