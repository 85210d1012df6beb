"""The whole pipeline on stand-in scenes with the tiny shape; fails unless every part does what it says."""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

from jinja2 import Environment

from . import corpus as corpora
from . import evaluate, export, shards, synthetic, train
from . import tokenizer as tokenizers
from .chat import BOS, EOS, TEMPLATE, render
from .loop import Recipe

#: Questions that the tiny shape must have learnt within the test: some from the text, some from the image.
LEARNT = ("light", "lane", "lon", "code.v0")
SEEN = ("lane",)


def run(folder: Path | None, seconds: float) -> None:
    """Runs it in `folder`, or in a temporary one."""
    if folder is None:
        with tempfile.TemporaryDirectory() as temporary:
            run(Path(temporary), seconds)
        return
    data, out = folder / "data", folder / "run"
    synthetic.write(data, train=4_000, validation=1_000, seed=1)
    train.prepare(data, out)
    check_text(data, out)
    recipe = Recipe(shape="tiny-ci", minutes=seconds / 60, batch=64, image_only=0.0, check_every=100)
    # Two legs: the second goes on where the first ended.
    train.run(recipe, out, "cpu", workers=1, leg_minutes=seconds / 120, resume=False)
    train.run(recipe, out, "cpu", workers=1, leg_minutes=1e9, resume=True)
    worst = export.write(out, folder / "model", "float32", folder / "reference")
    report = evaluate.run(out, 1_000)
    rows = {row["question"]: row for row in report["questions"]}
    for name in LEARNT:
        row = rows[name]
        assert row["low95"] > row["majority"], f"{name} is not above its majority: {row}"
    for name in SEEN:
        assert rows[name]["low95"] > rows[name]["shuffled_image"], f"{name} does not come from the image: {rows[name]}"
    assert report["without_grammar"]["valid_code"] > 0.9, report["without_grammar"]
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
        pieces, _, slots, _ = corpora.tokenise(tokenizer, state.conversation)
        assert pieces == ids, "pieces tokenise to something else than the whole"
        assert all(count == 1 for _, _, count in slots), "a value takes more than one token"
        part = template.render(messages=state.conversation[:2], bos_token=BOS, eos_token=EOS, add_generation_prompt=True)
        prompt = tokenizer.encode(part, add_special_tokens=False).ids
        assert ids[: len(prompt)] == prompt, "the prompt's tokens are not a prefix of the whole"
    strange = "Überholt! 1234.567 <b>\t\n\n x=-3"
    assert tokenizer.decode(tokenizer.encode(strange).ids) == strange, "the tokenizer loses text"
