"""The whole pipeline on stand-in scenes with the tiny shape; fails unless every part does what it says."""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

import torch
from jinja2 import Environment

from . import corpus as corpora
from . import average, evaluate, export, shards, synthetic, train
from . import tokenizer as tokenizers
from .chat import BOS, EOS, TEMPLATE, render
from .loop import Recipe, load_model

#: Questions that the tiny shape must have learnt within the test; without the right image they fall back.
SEEN = ("scene", "lanes", "lane")
#: Learnt from the text.
READ = ("light",)
#: Minutes after which the first leg ends.
FIRST_LEG = 0.1


def run(folder: Path | None, steps: int) -> None:
    """Runs it in `folder`, or in a temporary one."""
    if folder is None:
        with tempfile.TemporaryDirectory() as temporary:
            run(Path(temporary), steps)
        return
    data, out = folder / "data", folder / "run"
    synthetic.write(data, train=4_000, validation=500, seed=1)
    train.prepare(data, out)
    check_text(data, out)
    recipe = Recipe(shape="tiny-ci", steps=steps, batch=64, check_every=100)
    # Two legs: the second goes on where the first ended.
    train.run(recipe, out, "cpu", workers=1, leg_minutes=FIRST_LEG, resume=False)
    train.run(recipe, out, "cpu", workers=1, leg_minutes=1e9, resume=True)
    worst = export.write(out, folder / "model", "float32", folder / "reference")
    report = evaluate.run(out, 500)
    rows = {row["question"]: row for row in report["questions"]}
    for name in SEEN:
        assert rows[name]["above_both"], f"{name} is not read from the image: {rows[name]}"
    for name in READ:
        assert rows[name]["low95"] > rows[name]["majority"], f"{name} is not read from the text: {rows[name]}"
    assert sum(group["states"] for group in report["keep_lane"]) == report["states"], "each state has a probability of keeping the lane"
    before = load_model(out / "checkpoint.pt")[0].state_dict()
    average.run(out, folder / "model", 0.5)
    after = load_model(out / "checkpoint.pt")[0].state_dict()
    assert all(torch.allclose(before[name], after[name], atol=1e-6) for name in before), "the mean of equal weights is something else"
    print(f"selftest passed: logits within {worst:.1e}, load {os.getloadavg()[0]:.1f}", file=sys.stderr)


def check_text(data: Path, out: Path) -> None:
    """Tokenizer and template: lossless, whole equals pieces, one token a value."""
    tokenizer = tokenizers.load(out / "tokenizer.json")
    template = Environment(trim_blocks=True, lstrip_blocks=True).from_string(TEMPLATE)
    for state in list(shards.states(shards.shards(data, "validation")[0]))[:50]:
        whole = render(state.conversation)
        templated = template.render(messages=state.conversation, bos_token=BOS, eos_token=EOS, add_generation_prompt=False)
        assert whole == templated, "the template renders something else"
        ids = tokenizer.encode(whole, add_special_tokens=False).ids
        assert tokenizer.decode(ids, skip_special_tokens=False) == whole, "the tokenizer loses text"
        row = corpora.tokenise(tokenizer, state.conversation)
        assert row.ids == ids, "pieces tokenise to something else than the whole"
        assert all(count == 1 for _, _, count in row.slots), "a value takes more than one token"
        part = template.render(messages=state.conversation[:2], bos_token=BOS, eos_token=EOS, add_generation_prompt=True)
        prompt = tokenizer.encode(part, add_special_tokens=False).ids
        assert ids[: len(prompt)] == prompt, "the prompt's tokens are not a prefix of the whole"
    strange = "Überholt! 1234.567 <b>\t\n\n x=-3"
    assert tokenizer.decode(tokenizer.encode(strange).ids) == strange, "the tokenizer loses text"
