"""The whole pipeline on stand-in scenes with the tiny shape; fails unless every part does what it says."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import torch
from jinja2 import Environment

from . import corpus as corpora
from . import average, evaluate, export, picture_questions, samples, shards, synthetic, train, vocabulary
from . import tokenizer as tokenizers
from .chat import ASSISTANT, BOS, EOS, TEMPLATE, render
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
    synthetic.write(data, train=3_000, validation=300, seed=1)
    train.prepare(data, out)
    check_text(data, out)
    check_samples(out)
    recipe = Recipe(shape="tiny-ci", steps=steps, batch=64, micro=32, check_every=80)
    # Two legs: the second goes on where the first ended.
    train.run(recipe, out, "cpu", workers=1, leg_minutes=FIRST_LEG, resume=False)
    train.run(recipe, out, "cpu", workers=1, leg_minutes=1e9, resume=True)
    worst = export.write(out, folder / "model", "float32", folder / "reference")
    check_losses(out)
    report = evaluate.run(out, 500)
    rows = {row["question"]: row for row in report["questions"]}
    for name in SEEN:
        assert rows[name]["above_both"], f"{name} is not read from the image: {rows[name]}"
    for name in READ:
        assert rows[name]["accuracy_95"][0] > rows[name]["majority"], f"{name} is not read from the text: {rows[name]}"
    assert rows["scene"]["picture_only_95"][0] > rows["scene"]["majority"], f"scene is not read from the picture alone: {rows['scene']}"
    assert rows["light"]["text_only_95"][0] > rows["light"]["majority"], f"light is not read from the text alone: {rows['light']}"
    assert report["twins"]["pairs"] > 30, "the validation states have twins"
    assert sum(group["states"] for group in report["keep_lane"]) == report["states"], "each state has a probability of keeping the lane"
    before = load_model(out / "checkpoint.pt")[0].state_dict()
    check_vocabulary(out, folder / "model")
    check_ended_leg(data, folder / "model", folder / "second")
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


def check_samples(out: Path) -> None:
    """What a step shows: each variation leaves the answers' tokens as they are, but not their weights, and twins get the same text."""
    tokenizer, corpus = tokenizers.load(out / "tokenizer.json"), corpora.load(out / "cache" / "train")
    light, scene = (corpus.questions.index(name) for name in ("light", "scene"))
    mask = tokenizer.token_to_id("Ġ-")

    def drawn(row: int, **shares: float) -> samples.Sample:
        return samples.Sampler(corpus, tokenizer, samples.Variation(**shares), 1, "answers").draw(row, 0)

    def weight(sample: samples.Sample, question: int) -> float:
        start = next(a for _, q, a, _ in corpus.slots_of(sample.row) if q == question)
        return float(sample.weights[start - (len(corpus.row(sample.row)) - len(sample))])

    single = int(np.flatnonzero(corpus.twins < 0)[0])
    pair = int(np.flatnonzero(corpus.twins >= 0)[0])
    whole = samples.plain(corpus, single)
    assert (drawn(single).ids == whole.ids).all() and (drawn(single).weights == whole.weights).all(), "without variation a state stands as it is"
    for sample, blind, seen in ((drawn(single, text_drop=1.0), light, scene), (drawn(single, picture_drop=1.0), scene, light)):
        assert weight(sample, blind) == 0.0 and weight(sample, seen) == 1.0, "only what is shown is learnt"
    text = tokenizer.decode(drawn(single, text_drop=1.0).ids, skip_special_tokens=False)
    assert " limit " not in text and text.count("scene?") == 1, f"the question stays when the text goes: {text}"
    masked = drawn(single, neighbor_mask=1.0)
    assert len(masked) == len(whole) and (masked.ids == mask).sum() >= 27, "nine masked neighbors"
    wrong = drawn(single, contradict=1.0)
    assert 1 <= (wrong.ids != whole.ids).sum() <= 3 and (wrong.ids != whole.ids).nonzero()[0].max() < corpus.scene[single][1], "one wrong neighbor"
    tried, chances = corpus.tried_of(single)
    draws = [samples.Sampler(corpus, tokenizer, samples.Variation(tried_codes=1.0), 1).draw(single, step) for step in range(200)]
    assert {draw.row for draw in draws} == set(tried.tolist()) and {draw.image for draw in draws} == {single}, "tried codes stand in the state's picture"
    assert abs(sum(draw.row == tried[0] for draw in draws) / 200 - chances[0]) < 0.1, "tried codes come by their chances"
    assert (drawn(pair, tried_codes=1.0).ids == samples.plain(corpus, pair).ids).all(), "a twin keeps its label"
    red = [tokenizer.decode(corpus.row(row).tolist()).count("red_light") for row in (single, *tried.tolist())]
    assert red[2] == max(red) > 0 and red[0] == red[1], f"the tried answers stand in place of the label's: {red}"
    question = tokenizer.decode(drawn(single, picture_questions=1.0).ids, skip_special_tokens=False)
    assert "look?" in question and " limit " not in question and "turned=" in question, question
    assert not tokenizers.pieces_outside(tokenizer, [question.partition("ASSISTANT: ")[2].removesuffix("</s>")]), "picture questions have their tokens"
    first, second = (drawn(row, neighbor_mask=0.3, contradict=0.3, text_drop=0.3) for row in (pair, int(corpus.twins[pair])))
    upto = first.ids.tolist().index(tokenizer.token_to_id(ASSISTANT))
    assert (first.ids[:upto] == second.ids[:upto]).all() and first.contrast.any() and second.contrast.any(), "twins have one text and two answers"
    up = picture_questions.answers(np.eye(1, 256, 2 * 16 + 7).reshape(1, 16, 16).repeat(3, 0).astype(np.uint8), 0)
    left = picture_questions.answers(np.eye(1, 256, 2 * 16 + 7).reshape(1, 16, 16).repeat(3, 0).astype(np.uint8), 1)
    assert (up["side"], up["up"], up["top_left"], up["nearest"]) == ("top", "yes", "1-2", "far"), up
    assert (left["side"], left["up"], left["bottom_left"], left["turned"]) == ("left", "no", "1-2", "left"), left


def check_losses(out: Path) -> None:
    """The hinge between twins fell, and the head sees more than that few cells are occupied."""
    log = [json.loads(line) for line in (out / "log.jsonl").read_text().splitlines()]
    assert log[-1]["hinge"] < log[0]["hinge"], f"the hinge between twins did not fall: {log[0]['hinge']} to {log[-1]['hinge']}"
    share = np.unpackbits(np.array(corpora.load(out / "cache" / "validation").occupancy)).mean()
    assert min(log[-1]["occupancy_precision"]) > 3 * share, f"the occupancy is not seen: {log[-1]['occupancy_precision']}, {share} of the cells"


def check_vocabulary(out: Path, model: Path) -> None:
    """New words get ids behind the old ones, which keep theirs and their weights."""
    old = tokenizers.load(out / "tokenizer.json")
    new = vocabulary.extend(old, ["\nmotto speed"] * tokenizers.RARE, ["slogan=vehicle1"])
    before, after = old.get_vocab(False), new.get_vocab(False)
    assert all(after[word] == place for word, place in before.items()), "an old word changed its id"
    assert min(after["slogan="], after["Ċmotto"]) >= len(before) and new.token_to_id(EOS) >= len(after), "new words stand behind the old ones"
    assert new.decode(new.encode("slogan=vehicle1</s>").ids, skip_special_tokens=False) == "slogan=vehicle1</s>", "the new tokenizer loses text"
    rows = torch.randn(old.get_vocab_size(), 4)
    moved = vocabulary.moved(rows, old, new)
    for token in ("vehicle1", ASSISTANT, EOS):
        assert torch.equal(moved[new.token_to_id(token)], rows[old.token_to_id(token)]), f"{token!r} lost its weights"
    spelt = torch.stack([rows[old.token_to_id(piece)] for piece in vocabulary.spelling("slogan=", old.get_vocab())]).mean(0)
    assert torch.allclose(moved[new.token_to_id("slogan=")], spelt), "a new word starts as the mean of its pieces"


def check_ended_leg(data: Path, model: Path, out: Path) -> None:
    """A leg of two workers that SIGTERM ends leaves a checkpoint from which the next one goes on."""
    command = [
        sys.executable, "-m", "nano", "train", "--data", str(data), "--out", str(out), "--start", str(model), "--shape", "tiny-ci", "--steps", "100000",
        "--batch", "32", "--check-every", "3", "--workers", "2", "--limit", "300", "--device", "cpu",
    ]  # fmt: skip
    package = Path(__file__).parents[1]
    leg = subprocess.Popen(command, cwd=package)
    while leg.poll() is None and not (out / "checkpoint.pt").exists():
        time.sleep(0.2)
    leg.terminate()
    assert leg.wait(60) == train.ENDED, f"a leg that was asked to end gave {leg.returncode}"
    reached = load_model(out / "checkpoint.pt")[1]["progress"]["step"]
    subprocess.run([*command, "--resume", "--leg-minutes", "0.02"], cwd=package, check=True)
    resumed = load_model(out / "checkpoint.pt")[1]["progress"]["step"]
    assert resumed > reached > 0, f"the second leg went from step {reached} to {resumed}"
