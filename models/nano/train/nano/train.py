"""Prepares the data and trains, with as many single-threaded workers as asked for.

On a CPU, several workers of one thread beat one worker of several threads: threads meet at every operation, and on a shared machine each meeting waits
for the slowest; workers meet once a step.
"""

from __future__ import annotations

import json
import shutil
import sys
import tempfile
import time
from dataclasses import asdict, replace
from pathlib import Path

import torch
import torch.distributed as dist
import torch.multiprocessing as mp

from . import corpus as corpora
from . import shards, tokenizer as tokenizers
from .batches import Collator
from .chat import IMAGE
from .corpus import Corpus
from .loop import Recipe, Trainer
from .shapes import SHAPES

#: File of a run that names the dataset's prompt set.
PROMPTS = "prompts.json"


def prepare(data: Path, out: Path, limit: int | None = None, start: str = "") -> None:
    """Builds tokenizer and arrays in `out` unless they are there; the tokenizer is that of the model to start from, if any."""
    out.mkdir(parents=True, exist_ok=True)
    path = out / "tokenizer.json"
    if start and not path.exists():
        shutil.copyfile(Path(start) / "tokenizer.json", path)
    if not path.exists():
        prompts, answers = [], []
        for shard in shards.shards(data, "train")[:20]:
            for state in shards.states(shard):
                for message in state.conversation:
                    (answers if message["role"] == "assistant" else prompts).append(message["content"].replace(IMAGE, ""))
        built = tokenizers.build(prompts, answers)
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
        start = time.monotonic()
        built_corpus = corpora.build(data, split, tokenizer, cache, limit)
        lengths = built_corpus.starts[1:] - built_corpus.starts[:-1]
        print(
            f"{split}: {len(built_corpus)} states, {lengths.min()}..{lengths.max()} tokens (image as one), "
            f"{len(built_corpus.slots) / len(built_corpus):.1f} questions a state, {time.monotonic() - start:.0f} s",
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
    torch.set_num_threads(threads)
    if world > 1:
        dist.init_process_group("gloo", init_method=f"file://{meeting}", rank=rank, world_size=world)
    path = out / "tokenizer.json"
    train, check = corpora.load(out / "cache" / "train"), corpora.load(out / "cache" / "validation")
    vocabulary = tokenizers.load(path).get_vocab_size()
    colours = colours_of(Path(recipe.start)) if recipe.start else corpora.colours(train)
    trainer = Trainer(recipe, SHAPES[recipe.shape], vocabulary, colours, rank, world, torch.device(device))
    if recipe.start:
        # transformers knows under which names it saved what.
        from transformers import LlavaForConditionalGeneration

        trainer.start_from(LlavaForConditionalGeneration.from_pretrained(recipe.start).state_dict())
    if (out / "checkpoint.pt").exists():
        trainer.restore(out / "checkpoint.pt")
    pair = (collator_of(recipe, train, path), collator_of(recipe, check, path))
    finished = trainer.train(train, check, pair, out, leg_minutes)
    if rank == 0:
        p = trainer.progress
        print(f"{'done' if finished else 'leg ended'}: {p.step} steps, {p.states} states, {p.seconds / 60:.1f} min", file=sys.stderr)
    if world > 1:
        dist.barrier()
        dist.destroy_process_group()


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
        mp.spawn(worker, (workers, f"{folder}/meeting", recipe, out, device, leg_minutes, threads), nprocs=workers)


def best_recipe(shape: str, device: str) -> Recipe:
    """The recipe for a device: micro-batches that fit the cache on a CPU, the whole batch at once on a GPU."""
    base = Recipe(shape=shape)
    return replace(base, batch=256, micro=256) if device.startswith("cuda") else base
