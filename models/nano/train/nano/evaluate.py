"""What the trained model answers on validation states, question by question.

Free-running: what the model answered stands in its context, not the truth. Each answer is the most probable of the question's values, as under
the grammar at inference. Beside it: the best constant answer (the majority, taken on the validation states themselves), and the same model with the image of
another drive. The probability of keeping the lane is held against what the labels do (`calibration.py`). A last pass decodes without any
constraint and counts valid code.
"""

from __future__ import annotations

import json
import re
import sys
import time
from collections import Counter
from pathlib import Path

import numpy as np
import torch
from tokenizers import Tokenizer

from . import corpus as corpora
from . import tokenizer as tokenizers
from .batches import Collator
from .calibration import calibrate, table_of
from .chat import ASSISTANT, EOS, IMAGE
from .corpus import Corpus
from .decode import Script, Value, answer, slots_of, speak, values_of
from .loop import load_model
from .model import NanoLlava
from .statistics import by_groups, wilson

ROWS = 128
_NUMBER = r"-?\d+(?:\.\d+)?"
CODE = re.compile(rf"Generate_IDM_Planner\(c=(\w+), la=(\w+), v0=({_NUMBER}), acc=({_NUMBER}), dec=({_NUMBER})\)")


def other_images(names: list[str], seed: int = 1) -> list[int]:
    """For each state, a state of another drive where there is one."""
    rng = np.random.default_rng(seed)
    drives = np.array([name.rpartition("@")[0] or name for name in names])
    if len(np.unique(drives)) < 2:
        raise ValueError("shuffled images need two drives")
    picks = rng.permutation(len(names))
    for i in range(len(names)):
        while drives[picks[i]] == drives[i]:
            picks[i] = rng.integers(len(names))
    return picks.tolist()


def truths(corpus: Corpus, row: int) -> dict[int, Value]:
    """The labelled answers of a row."""
    ids = corpus.row(row).tolist()
    return {question: tuple(ids[start : start + count]) for _, question, start, count in slots_of(corpus, row)}


def free_running(
    model: NanoLlava, corpus: Corpus, collator: Collator, rows: list[int], images_of: list[int], choices: dict[int, list[Value]], assistant: int
) -> list[Script]:
    """Answers of many rows, in groups."""
    out = []
    for start in range(0, len(rows), ROWS):
        part = slice(start, start + ROWS)
        out += answer(model, corpus, collator, rows[part], images_of[part], choices, assistant)
    return out


def unconstrained(model: NanoLlava, corpus: Corpus, collator: Collator, rows: list[int], tokenizer: Tokenizer) -> dict[str, float]:
    """Share of answers in the last round that are the planner code, and of all answers that equal the label's text."""
    assistant, end = tokenizer.token_to_id(ASSISTANT), tokenizer.token_to_id(EOS)
    valid = same_form = answers = 0
    for start in range(0, len(rows), ROWS):
        part = rows[start : start + ROWS]
        for row, said in zip(part, speak(model, corpus, collator, part, assistant, end), strict=True):
            valid += CODE.fullmatch(tokenizer.decode(said[-1])) is not None
            wanted = labelled_rounds(corpus.row(row).tolist(), assistant, end)
            answers += len(wanted)
            same_form += sum(len(a) == len(b) for a, b in zip(said, wanted, strict=False))
    return {"states": len(rows), "valid_code": round(valid / len(rows), 4), "answers_of_right_length": round(same_form / answers, 4)}


def labelled_rounds(ids: list[int], assistant: int, end: int) -> list[list[int]]:
    """The labelled answers' tokens."""
    out, i = [], 0
    while assistant in ids[i:]:
        start = ids.index(assistant, i) + 1
        i = ids.index(end, start)
        out.append(ids[start:i])
    return out


def score(
    corpus: Corpus, rows: list[int], found: list[Script], shuffled: list[Script], tokenizer: Tokenizer
) -> list[dict]:
    """A row of the table per question."""
    drives = np.array([corpus.names[row].rpartition("@")[0] for row in rows])
    labels = [truths(corpus, row) for row in rows]
    table = []
    code = tuple(i for i, name in enumerate(corpus.questions) if name.startswith("code."))
    # Beside the questions one by one, the code as a whole.
    asked_for = [(name, (i,)) for i, name in enumerate(corpus.questions)] + ([("code, all arguments", code)] if code else [])
    for name, parts in asked_for:
        asked = [i for i in range(len(rows)) if all(part in labels[i] for part in parts)]
        if not asked:
            continue
        hits = np.array([all(found[i].answers.get(p) == labels[i][p] for p in parts) for i in asked], float)
        without = np.array([all(shuffled[i].answers.get(p) == labels[i][p] for p in parts) for i in asked], float)
        counts = Counter(tuple(labels[i][p] for p in parts) for i in asked)
        common, times = counts.most_common(1)[0]
        value = " ".join(tokenizer.decode(list(tokens)) for tokens in common)
        low = min(wilson(int(hits.sum()), len(asked))[0], by_groups(hits, drives[asked])[0])
        high = max(wilson(int(hits.sum()), len(asked))[1], by_groups(hits, drives[asked])[1])
        table.append(
            {
                "question": name, "states": len(asked), "accuracy": round(float(hits.mean()), 4), "low95": round(low, 4), "high95": round(high, 4),
                "majority": round(times / len(asked), 4), "majority_value": value, "values": len(counts),
                "shuffled_image": round(float(without.mean()), 4), "above_both": bool(low > max(times / len(asked), without.mean())),
            }
        )  # fmt: skip
    return table


def markdown(report: dict) -> str:
    """The model card's table."""
    lines = [
        f"{report['states']} validation states of {report['drives']} drives, free-running, constrained to each question's values.",
        "The interval is the wider of Wilson's and a bootstrap over drives (95 %).",
        "",
        "| question | accuracy % | 95 % | majority % | shuffled image % | above both |",
        "|---|---|---|---|---|---|",
    ]
    for row in report["questions"]:
        lines.append(
            f"| {row['question']} | {row['accuracy'] * 100:.1f} | {row['low95'] * 100:.1f}-{row['high95'] * 100:.1f} | "
            f"{row['majority'] * 100:.1f} ({row['majority_value']}) | {row['shuffled_image'] * 100:.1f} | {'yes' if row['above_both'] else 'no'} |"
        )
    if report["keep_lane"]:
        lines += ["", *table_of(report["keep_lane"])]
    free = report["without_grammar"]
    lines += ["", f"Without a grammar, {free['valid_code'] * 100:.1f} % of {free['states']} greedy answers of the last round are valid planner code."]
    return "\n".join(lines) + "\n"


def run(out: Path, states: int) -> dict:
    """Evaluates the run folder's checkpoint and writes `evaluation.json` and `evaluation.md` there."""
    start = time.monotonic()
    model, state = load_model(out / "checkpoint.pt")
    tokenizer = tokenizers.load(out / "tokenizer.json")
    train, corpus = corpora.load(out / "cache" / "train"), corpora.load(out / "cache" / "validation")
    collator = Collator(corpus, tokenizer.token_to_id(IMAGE), model.shape.image_tokens, 0.0)
    # Drives in order would show few of them: an even stride takes them all.
    rows = np.unique(np.linspace(0, len(corpus) - 1, min(states, len(corpus))).astype(int)).tolist()
    known = values_of(train)
    choices = {i: known.get(question, []) for i, question in enumerate(corpus.questions)}
    unknown = [q for i, q in enumerate(corpus.questions) if not choices[i]]
    if unknown:
        raise ValueError(f"questions that training never asked: {', '.join(unknown)}")
    assistant = tokenizer.token_to_id(ASSISTANT)
    others = [rows[i] for i in other_images([corpus.names[row] for row in rows])]
    with torch.inference_mode():
        found = free_running(model, corpus, collator, rows, rows, choices, assistant)
        shuffled = free_running(model, corpus, collator, rows, others, choices, assistant)
        free = unconstrained(model, corpus, collator, rows[:512], tokenizer)
    table = score(corpus, rows, found, shuffled, tokenizer)
    report = {
        "states": len(rows), "drives": len({corpus.names[row].rpartition("@")[0] for row in rows}), "questions": table,
        "keep_lane": calibrate(corpus, rows, found, tokenizer), "without_grammar": free, "progress": state["progress"], "recipe": state["recipe"],
    }  # fmt: skip
    (out / "evaluation.json").write_text(json.dumps(report, indent=1) + "\n")
    (out / "evaluation.md").write_text(markdown(report))
    print(markdown(report) + f"({time.monotonic() - start:.0f} s)", file=sys.stderr)
    return report
