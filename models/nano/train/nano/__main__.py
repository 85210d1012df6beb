"""The command line: `python -m nano COMMAND`."""

from __future__ import annotations

import argparse
import os
import sys
from dataclasses import replace
from pathlib import Path

import torch

from . import synthetic, train
from .shapes import SHAPES


#: Training steps beside the plain labels; 0 leaves one out.
STEPS = {
    "text_drop": "share of samples without the scene text",
    "picture_drop": "share of samples with a picture of one color",
    "picture_questions": "share of samples that are questions on the picture alone",
    "contradict": "share of samples with a wrong neighbor in the text",
    "neighbor_mask": "share of neighbors of which the text says nothing",
    "tried_codes": "share of samples with one of the tried codes, by its chance, in place of the best one",
    "twin_weight": "weight of the hinge between twins",
    "twin_margin": "by how many nats a twin's own answers must be more probable",
    "occupancy_weight": "weight of the occupancy head's loss",
    "occupancy_positive": "weight of an occupied cell",
}


def arguments() -> argparse.ArgumentParser:
    """All commands and their options."""
    parser = argparse.ArgumentParser(prog="nano", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)

    made = commands.add_parser("synthetic", help="write a stand-in dataset (proves the pipeline, nothing more)")
    made.add_argument("--out", type=Path, required=True)
    made.add_argument("--train", type=int, default=20_000)
    made.add_argument("--validation", type=int, default=1_000)
    made.add_argument("--seed", type=int, default=1)

    for name, text in (("train", "train a leg"), ("run", "train, export, check, evaluate: the one command")):
        command = commands.add_parser(name, help=text)
        command.add_argument("--data", type=Path, required=True, help="dataset folder of `planagent dataset`")
        command.add_argument("--out", type=Path, required=True, help="run folder: tokenizer, arrays, checkpoint, log")
        command.add_argument("--shape", choices=SHAPES, default="smallest")
        command.add_argument("--minutes", type=float, default=0.0, help="budget of all legs together, minutes of training")
        command.add_argument("--steps", type=int, default=0, help="budget in steps instead: reproducible")
        command.add_argument("--leg-minutes", type=float, default=1e9, help="stop this leg after so many minutes")
        command.add_argument("--resume", action="store_true")
        command.add_argument("--device", default="cuda" if torch.cuda.is_available() else "cpu")
        command.add_argument("--workers", type=int, default=1, help="single-threaded worker processes (CPU): one a core")
        command.add_argument("--batch", type=int)
        command.add_argument("--micro", type=int)
        command.add_argument("--rate", type=float)
        command.add_argument("--start", help="folder of a trained nano to go on from; its tokenizer and colours are kept")
        command.add_argument("--image-only", type=float, help="share of the budget without the scene text")
        for step, meaning in STEPS.items():
            command.add_argument(f"--{step.replace('_', '-')}", type=float, help=meaning)
        command.add_argument("--twin-over", choices=["answers", "code"], help="what the hinge between twins compares")
        command.add_argument("--template-weight", type=float)
        command.add_argument("--precision", choices=["float32", "bfloat16"])
        command.add_argument("--compile", action=argparse.BooleanOptionalAction)
        command.add_argument("--seed", type=int)
        command.add_argument("--check-every", type=int)
        command.add_argument("--limit", type=int, help="use only so many states a split")
        if name == "run":
            command.add_argument("--model", type=Path, required=True, help="where the checkpoint folder is written")
            command.add_argument("--reference", type=Path, help="where the parity reference is written")
            command.add_argument("--dtype", choices=["float32", "float16", "bfloat16"], default="float32")

    export = commands.add_parser("export", help="write the Hugging Face folder and check it against transformers")
    export.add_argument("--out", type=Path, required=True, help="run folder")
    export.add_argument("--model", type=Path, required=True)
    export.add_argument("--dtype", choices=["float32", "float16", "bfloat16"], default="float32")
    export.add_argument("--reference", type=Path)

    average = commands.add_parser("average", help="the mean of a run's weights and those it started from; export it again")
    average.add_argument("--out", type=Path, required=True, help="run folder; keeps what was trained in trained.pt")
    average.add_argument("--start", type=Path, required=True, help="folder of the model that the run started from")
    average.add_argument("--share", type=float, default=0.5, help="of the start")

    evaluate = commands.add_parser("evaluate", help="per question, beside the majority and shuffled images")
    evaluate.add_argument("--out", type=Path, required=True, help="run folder; writes evaluation.json and evaluation.md")
    evaluate.add_argument("--states", type=int, default=2_000)

    chats = commands.add_parser("chats", help="the same questions to any chat model, from `planagent dataset --for messages`")
    chats.add_argument("--model", required=True, help="a folder of transformers, or a GGUF file")
    chats.add_argument("--adapter", type=Path, help="adapter of PEFT")
    chats.add_argument("--data", type=Path, required=True, help="dataset of messages, of the prompt set compact-2")
    chats.add_argument("--out", type=Path, required=True, help="writes evaluation.json and evaluation.md; the same command goes on")
    chats.add_argument("--states", type=int, default=200)
    chats.add_argument("--threads", type=int, default=os.cpu_count() or 1)
    chats.add_argument("--dtype", choices=["float32", "bfloat16"], default="float32")

    selftest = commands.add_parser("selftest", help="the whole pipeline on stand-in scenes; fails unless it learns")
    selftest.add_argument("--folder", type=Path, help="keep the files here")
    selftest.add_argument("--steps", type=int, default=250)

    bench = commands.add_parser("bench", help="states per second of a training step")
    bench.add_argument("--shape", choices=SHAPES, default="smallest")
    bench.add_argument("--micro", type=int, default=16)
    bench.add_argument("--precision", choices=["float32", "bfloat16"], default="bfloat16")
    bench.add_argument("--threads", type=int, default=1)
    bench.add_argument("--compile", action="store_true")
    bench.add_argument("--device", default="cpu")
    bench.add_argument("--prompt", type=int, default=120, help="text tokens before the first answer")
    bench.add_argument("--answers", type=int, default=70, help="answer tokens")
    return parser


def start_training(options: argparse.Namespace) -> None:
    """Prepares the data and trains a leg as the options say."""
    recipe = train.best_recipe(options.shape, options.device)
    names = (*STEPS, "twin_over", "minutes", "steps", "batch", "micro", "rate", "start", "image_only", "template_weight", "precision", "compile", "seed", "check_every")
    given = {name: getattr(options, name) for name in names if getattr(options, name) is not None}
    train.prepare(options.data, options.out, options.limit, options.start or "")
    train.run(replace(recipe, **given), options.out, options.device, options.workers, options.leg_minutes, options.resume)


def main() -> int:
    """Runs a command; 0 when it did what it says."""
    options = arguments().parse_args()
    # Threads that meet at every operation wait for the slowest; on a shared machine that costs more than it gives.
    torch.set_num_threads(1)
    if options.command == "synthetic":
        synthetic.write(options.out, options.train, options.validation, options.seed)
    elif options.command == "train":
        start_training(options)
    elif options.command == "run":
        from . import evaluate, export

        start_training(options)
        export.write(options.out, options.model, options.dtype, options.reference)
        evaluate.run(options.out, 2_000)
    elif options.command == "export":
        from . import export

        export.write(options.out, options.model, options.dtype, options.reference)
    elif options.command == "average":
        from . import average

        average.run(options.out, options.start, options.share)
    elif options.command == "evaluate":
        from . import evaluate

        evaluate.run(options.out, options.states)
    elif options.command == "chats":
        from . import chats

        chats.run(options.model, options.adapter, options.data, options.out, options.states, options.dtype, options.threads)
    elif options.command == "selftest":
        from . import selftest

        selftest.run(options.folder, options.steps)
    elif options.command == "bench":
        from . import bench

        bench.run(options)
    return 0


if __name__ == "__main__":
    sys.exit(main())
