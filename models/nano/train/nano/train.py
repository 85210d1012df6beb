"""Prepares the data and trains, with as many single-threaded workers as asked for.

On a CPU, several workers of one thread beat one worker of several threads: threads meet at every operation, and on a shared machine each meeting waits
for the slowest; workers meet once a step.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import tempfile
import time
from dataclasses import asdict, replace
from pathlib import Path

import torch
import torch.distributed as dist
import torch.multiprocessing as mp

from . import corpus as corpora
from . import shards, vocabulary, tokenizer as tokenizers
from .batches import Collator
from .chat import IMAGE
from .corpus import Corpus
from .loop import Leg, Recipe, Trainer
from .shapes import SHAPES

#: Exit status of a leg that was asked to end, as of a process that SIGTERM ends.
ENDED = 128 + signal.SIGTERM
#: How many of a dataset's shards show its words.
SHARDS_OF_WORDS = 200
#: File of a run that names the dataset's prompt set.
PROMPTS = "prompts.json"


def prepare(data: Path, out: Path, limit: int | None = None, start: str = "") -> None:
    """Builds tokenizer and arrays in `out` unless they are there; the tokenizer has the words of the model to start from, if any, first."""
    out.mkdir(parents=True, exist_ok=True)
    path = out / "tokenizer.json"
    if not path.exists():
        prompts, answers = [], []
        for shard in shards.shards(data, "train")[:SHARDS_OF_WORDS]:
            for state in shards.states(shard):
                tried = [answer for code in state.tried for answer in code["answers"]]
                for message in [*state.conversation, *tried]:
                    (answers if message["role"] == "assistant" else prompts).append(message["content"].replace(IMAGE, ""))
        old = tokenizers.load(Path(start) / "tokenizer.json") if start else None
        built = vocabulary.extend(old, prompts, answers) if old else tokenizers.build(prompts, answers, vocabulary.needed())
        outside = tokenizers.pieces_outside(built, [*prompts, *answers])
        print(f"vocabulary {built.get_vocab_size()}, pre-tokens spelt in bytes {sum(outside.values())}: {outside.most_common(8)}", file=sys.stderr)
        built.save(str(path))
    prompts_file = out / PROMPTS
    if not prompts_file.exists():
        # A stand-in dataset names no prompt set.
        prompts_file.write_text(json.dumps({"prompt_set": shards.meta(data).get("prompt_set")}) + "\n")
    tokenizer = tokenizers.load(path)
    for split in ("train", "validation"):
        cache = out / "cache" / split
        if (cache / "index.json").exists():
            continue
        began = time.monotonic()
        built_corpus = corpora.build(data, split, tokenizer, cache, limit)
        lengths = built_corpus.starts[1:] - built_corpus.starts[:-1]
        facts, twins = len(built_corpus.neighbors) / len(lengths), int((built_corpus.twins >= 0).sum()) // 2
        print(
            f"{split}: {len(built_corpus)} states, {lengths.min()}..{lengths.max()} tokens (image as one), "
            f"{len(built_corpus.slots) / len(lengths):.1f} questions and {facts:.1f} neighbors a state, "
            f"{len(built_corpus.tried)} tried codes, {twins} pairs of twins, {int(built_corpus.has_occupancy.sum())} with occupancy, {time.monotonic() - began:.0f} s",
            file=sys.stderr,
        )


def collator_of(recipe: Recipe, corpus: Corpus, tokenizer_path: Path) -> Collator:
    """The collator for a run's shape and tokenizer."""
    image = tokenizers.load(tokenizer_path).token_to_id(IMAGE)
    return Collator(corpus, image, SHAPES[recipe.shape].image_tokens, recipe.template_weight)


def colours_of(folder: Path) -> tuple[list[float], list[float]]:
    """Mean and deviation of the colours by which a trained model sees."""
    preprocessor = json.loads((folder / "preprocessor_config.json").read_text())
    return preprocessor["image_mean"], preprocessor["image_std"]


def worker(rank: int, world: int, meeting: str, recipe: Recipe, out: Path, device: str, leg_minutes: float, threads: int) -> None:
    """One worker process."""
    leg = Leg(leg_minutes)
    torch.set_num_threads(threads)
    if world > 1:
        dist.init_process_group("gloo", init_method=f"file://{meeting}", rank=rank, world_size=world)
    path = out / "tokenizer.json"
    train, check = corpora.load(out / "cache" / "train"), corpora.load(out / "cache" / "validation")
    tokenizer = tokenizers.load(path)
    colours = colours_of(Path(recipe.start)) if recipe.start else corpora.colours(train)
    trainer = Trainer(recipe, SHAPES[recipe.shape], tokenizer.get_vocab_size(), colours, rank, world, torch.device(device))
    if recipe.start:
        # transformers knows under which names it saved what.
        from transformers import LlavaForConditionalGeneration

        stock = LlavaForConditionalGeneration.from_pretrained(recipe.start).state_dict()
        trainer.start_from(stock, tokenizers.load(Path(recipe.start) / "tokenizer.json"), tokenizer)
    if (out / "checkpoint.pt").exists():
        trainer.restore(out / "checkpoint.pt")
    pair = (collator_of(recipe, train, path), collator_of(recipe, check, path))
    finished = trainer.train((train, check), pair, tokenizer, out, leg)
    if rank == 0:
        p = trainer.progress
        print(f"{'done' if finished else 'leg ended'}: {p.step} steps, {p.states} states, {p.seconds / 60:.1f} min", file=sys.stderr)
    if world > 1:
        dist.barrier()
        dist.destroy_process_group()
    elif leg.asked:
        raise SystemExit(ENDED)


def run(recipe: Recipe, out: Path, device: str, workers: int, leg_minutes: float, resume: bool, threads: int = 1) -> None:
    """Trains a leg; a started run goes on only with `resume` and only with the recipe it began with."""
    if not recipe.steps and not recipe.minutes:
        raise ValueError("a budget is needed: steps or minutes")
    if recipe.batch < recipe.micro * workers:
        raise ValueError(f"a batch of {recipe.batch} has too few micro-batches of {recipe.micro} for {workers} workers")
    recorded = out / "recipe.json"
    wanted = json.loads(json.dumps(asdict(recipe)))
    if (out / "checkpoint.pt").exists() and not resume:
        raise FileExistsError(f"{out / 'checkpoint.pt'} exists: resume it or choose another folder")
    if resume and recorded.exists():
        before = json.loads(recorded.read_text())
        changed = sorted(key for key in wanted if wanted[key] != before.get(key))
        if changed:
            raise ValueError(f"the run began with another recipe; changed: {', '.join(changed)}")
    recorded.write_text(json.dumps(wanted, indent=1) + "\n")
    if workers == 1:
        worker(0, 1, "", recipe, out, device, leg_minutes, threads)
        return
    with tempfile.TemporaryDirectory() as folder:
        spawned = mp.spawn(worker, (workers, f"{folder}/meeting", recipe, out, device, leg_minutes, threads), nprocs=workers, join=False)
        asked = []

        def pass_on(number: int, _: object) -> None:
            asked.append(number)
            for process in spawned.processes:
                if process.is_alive():
                    os.kill(process.pid, signal.SIGTERM)

        before = {number: signal.signal(number, pass_on) for number in (signal.SIGTERM, signal.SIGINT)}
        try:
            while not spawned.join():
                pass
        except mp.ProcessExitedException:
            # A worker that has not begun yet ends at once.
            if not asked:
                raise
        for number, handler in before.items():
            signal.signal(number, handler)
    if asked:
        raise SystemExit(ENDED)


def best_recipe(shape: str, device: str) -> Recipe:
    """The recipe for a device: micro-batches that fit the cache on a CPU, the whole batch at once on a GPU."""
    base = Recipe(shape=shape)
    return replace(base, batch=256, micro=256) if device.startswith("cuda") else base
