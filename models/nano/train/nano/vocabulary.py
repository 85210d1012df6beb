"""A trained model's words and those of new prompts in one vocabulary.

Words keep their ids; new ones follow; the added tokens stand behind all of them, as a byte-level model needs it, and take their weights along.
"""

from __future__ import annotations

import json
from collections.abc import Iterable

import torch
from tokenizers import AddedToken, Tokenizer
from torch import Tensor

from .chat import SPECIAL
from .picture_questions import WORDS
from .tokenizer import RARE, VOCABULARY, count

#: Classes of agents in the lane-graph text, with how many of each have a token.
AGENTS = {"vehicle": 20, "bicycle": 4, "pedestrian": 6, "obstacle": 12}
#: Further words of the prompt sets `compact` and `compact-2`, and of codes, that a small dataset may lack.
RARE_WORDS = (
    "Ġ~", "Ġoncoming", "Ġcrossing", "Ġyellow", "Ġunread", "4+", "roundabout", "oncoming_lane", "Ġgoal", "goal_lane", "change_left", "change_right",
    "Ġcrossing_vehicle=", "Ġoncoming_vehicle=", "Ġperson_on_path=",
)  # fmt: skip


def needed() -> list[str]:
    """Words that every vocabulary has, in the byte-level alphabet: agents' names in text and code, scores of a refused plan, rare answers,
    picture questions."""
    names = [f"{space}{kind}{i}" for kind, last in AGENTS.items() for i in range(1, last + 1) for space in ("Ġ", "")]
    scores = [f"{hundredth / 100:.2f}" for hundredth in range(101)]
    return [*names, *scores, *RARE_WORDS, *WORDS]


def extend(old: Tokenizer, prompts: Iterable[str], answers: Iterable[str]) -> Tokenizer:
    """The tokenizer with the words of these texts too: all of answers, and those of prompts that are not rare."""
    spec = json.loads(old.to_str())
    pattern = spec["pre_tokenizer"]["pretokenizers"][0]["pattern"]["Regex"]
    vocabulary = spec["model"]["vocab"]
    special = [token["content"] for token in spec["added_tokens"] if token["content"] in SPECIAL]
    in_answers, in_prompts = count(answers, pattern), count(prompts, pattern)
    frequent = [word for word, times in sorted(in_prompts.items(), key=lambda item: (-item[1], item[0])) if times >= RARE]
    for word in dict.fromkeys([*sorted(in_answers), *needed(), *frequent]):
        if len(vocabulary) + len(special) < VOCABULARY:
            vocabulary.setdefault(word, len(vocabulary))
    spec["added_tokens"] = []
    tokenizer = Tokenizer.from_str(json.dumps(spec))
    unused = [f"<unused{i}>" for i in range(-(len(vocabulary) + len(special)) % 16)]
    tokenizer.add_special_tokens([AddedToken(token, special=True, normalized=False) for token in [*special, *unused]])
    return tokenizer


def moved(rows: Tensor, old: Tokenizer, new: Tokenizer) -> Tensor:
    """Rows of an embedding or a head for the new vocabulary: a known token's own, else the mean of the longest known pieces that spell it."""
    known = old.get_vocab()
    out = torch.zeros(new.get_vocab_size(), rows.shape[1])
    for token, place in new.get_vocab().items():
        pieces = [token] if token in known else spelling(token, known)
        if pieces:
            out[place] = rows[[known[piece] for piece in pieces]].mean(0)
    return out


def spelling(token: str, known: dict[str, int]) -> list[str]:
    """The longest known pieces, from the left; single bytes are always known. An unused place has none."""
    if token.startswith("<unused"):
        return []
    pieces, rest = [], token
    while rest:
        length = next((n for n in range(len(rest), 0, -1) if rest[:n] in known), 0)
        if not length:
            raise ValueError(f"{token!r} has a character outside the byte-level alphabet")
        pieces.append(rest[:length])
        rest = rest[length:]
    return pieces
