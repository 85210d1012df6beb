"""What the trained model answers on validation states, question by question.

Free-running: what the model answered stands in its context, not the truth. Each answer is the most probable of the question's values, as under
the grammar at inference. Beside it: the best constant answer (the majority, taken on the validation states themselves), and the same model with the image of
another drive, with a picture of one color (the text alone), and without the scene text (the picture alone). Twins, where the dataset has them,
are right when both are. The probability of keeping the lane is held against what the labels do (`calibration.py`). A last pass decodes without
any constraint and counts valid code.
"""

from __future__ import annotations

import json
import re
import sys
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np
import torch
from tokenizers import Tokenizer

from . import corpus as corpora
from . import tokenizer as tokenizers
from .batches import Collator
from .calibration import calibrate, table_of
from .chat import ASSISTANT, EOS, IMAGE
from .corpus import Corpus
from .decode import Script, Value, answer, speak, values_of
from .loop import load_model
from .model import NanoLlava
from .samples import Sample, plain, with_picture_of, without_picture, without_text
from .statistics import by_groups, wilson

#: A question and an answer: numbers and tokens in a corpus, words in chats.
Question, Answer = TypeVar("Question"), TypeVar("Answer")
ROWS = 128
#: What a state is shown with, and the report's name of how often the answers are right then.
COLUMNS = {"both": "accuracy", "shuffled": "shuffled_image", "text": "text_only", "picture": "picture_only"}
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
    return {question: tuple(ids[start : start + count]) for _, question, start, count in corpus.slots_of(row).tolist()}


def free_running(
    model: NanoLlava, corpus: Corpus, collator: Collator, samples: list[Sample], choices: dict[int, list[Value]], assistant: int
) -> list[Script]:
    """Answers of many samples, in groups."""
    out = []
    for start in range(0, len(samples), ROWS):
        out += answer(model, corpus, collator, samples[start : start + ROWS], choices, assistant)
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


def code_of(corpus: Corpus) -> tuple[int, ...]:
    """The questions of the planner code."""
    return tuple(i for i, name in enumerate(corpus.questions) if name.startswith("code."))


def score(
    asked_for: list[tuple[str, tuple[Question, ...]]],
    drives: list[str],
    labels: list[dict[Question, Answer]],
    found: dict[str, list[dict[Question, Answer]]],
    text_of: Callable[[Answer], str],
) -> list[dict]:
    """A row of the table for each name and its questions, from the answers to the states as they stand (`both`) and under each control."""
    table = []
    for name, parts in asked_for:
        asked = [i for i in range(len(labels)) if all(part in labels[i] for part in parts)]
        if not asked:
            continue
        hits = {
            how: np.array([all(answers[i].get(p) == labels[i][p] for p in parts) for i in asked], float) for how, answers in found.items()
        }
        counts = Counter(tuple(labels[i][p] for p in parts) for i in asked)
        common, times = counts.most_common(1)[0]
        row = {
            "question": name, "states": len(asked), "majority": round(times / len(asked), 4),
            "majority_value": " ".join(map(text_of, common)), "values": len(counts),
        }  # fmt: skip
        groups = np.array([drives[i] for i in asked])
        for how, right in hits.items():
            low, high = (pick(a, b) for pick, a, b in zip((min, max), wilson(int(right.sum()), len(asked)), by_groups(right, groups), strict=True))
            row |= {COLUMNS[how]: round(float(right.mean()), 4), f"{COLUMNS[how]}_95": [round(low, 4), round(high, 4)]}
        row["above_both"] = bool(row["accuracy_95"][0] > max(times / len(asked), row.get("shuffled_image", 0.0)))
        table.append(row)
    return table


def twins_of(corpus: Corpus, limit: int) -> list[tuple[int, int]]:
    """Pairs of states with the same text, at most so many states."""
    return [(row, int(twin)) for row, twin in enumerate(corpus.twins) if row < twin][: limit // 2]


def score_twins(corpus: Corpus, pairs: list[tuple[int, int]], scripts: list[Script]) -> dict:
    """Pairs of which both codes are right, in all arguments and in those that differ; two guesses are both right in a quarter."""
    of = dict(zip((row for pair in pairs for row in pair), scripts, strict=True))
    right = {"all_arguments": 0, "differing_arguments": 0}
    for pair in pairs:
        labels = [truths(corpus, row) for row in pair]
        code = code_of(corpus)
        differing = [q for q in code if labels[0].get(q) != labels[1].get(q)]
        for name, questions in (("all_arguments", code), ("differing_arguments", differing)):
            right[name] += all(of[row].answers.get(q) == label.get(q) for row, label in zip(pair, labels, strict=True) for q in questions)
    share = {name: {"right": round(hits / len(pairs), 4), "95": [round(v, 4) for v in wilson(hits, len(pairs))]} for name, hits in right.items()}
    return {"pairs": len(pairs), **share}


def between(interval: list[float]) -> str:
    """An interval in percent."""
    return f"{interval[0] * 100:.1f}-{interval[1] * 100:.1f}"


def markdown(report: dict) -> str:
    """The model card's table."""
    lines = [
        f"{report['states']} validation states of {report['drives']} drives, free-running, constrained to each question's values.",
        "The intervals are the wider of Wilson's and a bootstrap over drives (95 %).",
        "",
        "| question | accuracy % | 95 % | majority % | shuffled image % | text only % (95 %) | picture only % (95 %) | above majority and shuffled |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for row in report["questions"]:
        blind = " | ".join(f"{row[name] * 100:.1f} ({between(row[f'{name}_95'])})" if name in row else "–" for name in ("text_only", "picture_only"))
        shuffled = f"{row['shuffled_image'] * 100:.1f}" if "shuffled_image" in row else "–"
        lines.append(
            f"| {row['question']} | {row['accuracy'] * 100:.1f} | {between(row['accuracy_95'])} | {row['majority'] * 100:.1f} ({row['majority_value']}) | "
            f"{shuffled} | {blind} | {'yes' if row['above_both'] else 'no'} |"
        )
    if twins := report["twins"]:
        lines += ["", "| both codes of a pair of twins right | pairs | % | 95 % |", "|---|---|---|---|"]
        for how in ("all_arguments", "differing_arguments"):
            lines.append(f"| {how.replace('_', ' ')} | {twins['pairs']} | {twins[how]['right'] * 100:.1f} | {between(twins[how]['95'])} |")
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
    states_as_they_are = [plain(corpus, row) for row in rows]
    blank = tuple(round(255 * value) for value in model.image_mean.tolist())
    shown = {
        "both": states_as_they_are,
        "shuffled": [with_picture_of(sample, other) for sample, other in zip(states_as_they_are, others, strict=True)],
        "text": [without_picture(sample, blank) for sample in states_as_they_are],
        "picture": [without_text(corpus, sample) for sample in states_as_they_are],
    }
    pairs = twins_of(corpus, states)
    with torch.inference_mode():
        found = {how: free_running(model, corpus, collator, samples, choices, assistant) for how, samples in shown.items()}
        twins = free_running(model, corpus, collator, [plain(corpus, row) for pair in pairs for row in pair], choices, assistant)
        free = unconstrained(model, corpus, collator, rows[:512], tokenizer)
    code = code_of(corpus)
    # Beside the questions one by one, the code as a whole.
    asked_for = [(name, (i,)) for i, name in enumerate(corpus.questions)] + ([("code, all arguments", code)] if code else [])
    drives = [corpus.names[row].rpartition("@")[0] for row in rows]
    answered = {how: [script.answers for script in scripts] for how, scripts in found.items()}
    table = score(asked_for, drives, [truths(corpus, row) for row in rows], answered, lambda tokens: tokenizer.decode(list(tokens)))
    report = {
        "states": len(rows), "drives": len(set(drives)), "questions": table,
        "twins": score_twins(corpus, pairs, twins) if pairs else None, "keep_lane": calibrate(corpus, rows, found["both"], tokenizer),
        "without_grammar": free, "progress": state["progress"], "recipe": state["recipe"],
    }  # fmt: skip
    (out / "evaluation.json").write_text(json.dumps(report, indent=1) + "\n")
    (out / "evaluation.md").write_text(markdown(report))
    print(markdown(report) + f"({time.monotonic() - start:.0f} s)", file=sys.stderr)
    return report
