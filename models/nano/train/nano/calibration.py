"""How far the model's probability of keeping the lane can be believed.

The reason comes before the lateral instruction and decides it, so the probability is that of the reasons with which labels keep the lane.
Training weighs a decision by what hangs on it, so what the probability should agree with is the share of labels by that weight; the plain
share stands beside it.
"""

from __future__ import annotations

import numpy as np
from tokenizers import Tokenizer

from .corpus import Corpus
from .decode import Script
from .statistics import wilson

#: The question that decides, the instruction that follows from it, and the instruction that keeps the lane.
REASON, INSTRUCTION, KEEP = "lat_why", "lat", "keep"
#: Bounds of the groups of probabilities.
BOUNDS = (0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 0.99, 1.0)


def calibrate(corpus: Corpus, rows: list[int], scripts: list[Script], tokenizer: Tokenizer) -> list[dict]:
    """A group of states a row: the model's mean probability of keeping the lane, and the share of labels that do; none if nobody asks."""
    if not {REASON, INSTRUCTION} <= set(corpus.questions):
        return []
    reason, instruction = corpus.questions.index(REASON), corpus.questions.index(INSTRUCTION)
    slots = [{question: (start, count) for _, question, start, count in corpus.slots_of(row).tolist()} for row in rows]
    asked = [i for i, slot in enumerate(slots) if reason in slot and instruction in slot]
    first, kept, weights = [], [], []
    for i in asked:
        start, count = slots[i][instruction]
        kept.append(tokenizer.decode(corpus.row(rows[i])[start : start + count].tolist()).strip(" =") == KEEP)
        place = slots[i][reason][0]
        first.append(int(corpus.row(rows[i])[place]))
        weights.append(float(corpus.weights[corpus.starts[rows[i]] + place]))
    keeping = {token for token, keeps in zip(first, kept, strict=True) if keeps}
    said = np.array([sum(p for token, p in scripts[i].odds[reason].items() if token in keeping) for i in asked])
    groups = np.clip(np.searchsorted(BOUNDS, said, side="right") - 1, 0, len(BOUNDS) - 2)
    return [group(said[groups == g], np.array(kept)[groups == g], np.array(weights)[groups == g], g) for g in np.unique(groups).tolist()]


def group(said: np.ndarray, kept: np.ndarray, weights: np.ndarray, number: int) -> dict:
    """What the states of a group have in common."""
    low, high = wilson(int(kept.sum()), len(kept))
    return {
        "from": BOUNDS[number], "to": BOUNDS[number + 1], "states": len(said), "said": round(float(said.mean()), 4),
        "kept": round(float(kept.mean()), 4), "low95": round(low, 4), "high95": round(high, 4),
        "said_by_weight": round(float(np.average(said, weights=weights)), 4), "kept_by_weight": round(float(np.average(kept, weights=weights)), 4),
    }  # fmt: skip


def table_of(groups: list[dict]) -> list[str]:
    """The model card's table."""
    lines = [
        "| probability of keeping the lane, % | states | mean | labels that keep it, % (95 %) | mean by weight | labels by weight, % |",
        "|---|---|---|---|---|---|",
    ]
    for g in groups:
        lines.append(
            f"| {g['from'] * 100:.0f}-{g['to'] * 100:.0f} | {g['states']} | {g['said'] * 100:.1f} | "
            f"{g['kept'] * 100:.1f} ({g['low95'] * 100:.1f}-{g['high95'] * 100:.1f}) | {g['said_by_weight'] * 100:.1f} | {g['kept_by_weight'] * 100:.1f} |"
        )
    return lines
