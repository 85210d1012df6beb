"""What the measuring processes in Python share: requests on stdin, replies on stdout, each a line of JSON.

A process runs the same steps as PlanAgent's own, so only the engines differ. This text stands before that of an engine, which
has a class `Engine`, a `Sequence` that is made of a request to load. Fast-forwarded tokens are computed one by one, because the
grammar samplers of these engines take them one by one.
"""

import json
import os
import random
import sys
import time

# The libraries print to stderr, because stdout carries the replies.
REPLIES = os.fdopen(os.dup(1), "w")
os.dup2(2, 1)


class Problem(Exception):
    """A failure that the reply reports."""


def now_ms():
    return time.perf_counter() * 1e3


class StepTime:
    """Wall time of a step, milliseconds, and of its passes of several tokens and of one."""

    def __init__(self):
        self.start = now_ms()
        self.first_token_ms = None
        self.batch = [0, 0.0]
        self.single = [0, 0.0]

    def add_pass(self, tokens, ms):
        passes = self.single if tokens == 1 else self.batch
        passes[0] += tokens
        passes[1] += ms

    def chosen(self):
        if self.first_token_ms is None:
            self.first_token_ms = now_ms() - self.start

    def reply(self):
        return {
            "ms": now_ms() - self.start,
            "first_token_ms": self.first_token_ms,
            "batch": {"tokens": self.batch[0], "ms": self.batch[1]},
            "single": {"tokens": self.single[0], "ms": self.single[1]},
        }


def ramps(side):
    """The bytes of a square picture with a ramp in each channel."""
    return bytes(
        (x * (channel + 1) + y * (3 - channel)) * 255 // (4 * side)
        for y in range(side)
        for x in range(side)
        for channel in range(3)
    )


class Sequence:
    """A sequence of tokens whose steps are timed.

    An engine fills `vocabulary`, and has `describe`, `keep(tokens)`, `encode`, `append_image(step)`, `compute(step)` of the
    pending tokens, `likeliest` and `logits` of the last one, and `features_of(pixels, side)`: the numbers of each token.
    """

    def __init__(self, seed):
        self.words = random.Random(seed)
        self.vocabulary = 0
        self.pending = []

    def append(self, tokens):
        self.pending.extend(self.words.randrange(self.vocabulary) for _ in range(tokens))

    def sample(self, tokens, step):
        for _ in range(tokens):
            self.compute(step)
            self.pending = [self.likeliest()]
            step.chosen()

    def fast_forward(self, tokens, step):
        """Each fast-forwarded token is computed alone: it costs as much as a sampled one."""
        for _ in range(tokens):
            self.compute(step)
            self.append(1)

    def answer(self, prompt, count):
        """The logits behind a prompt that is computed alone, and the likeliest tokens that follow it."""
        self.keep(0)
        self.pending = list(prompt)
        step, logits, tokens = StepTime(), [], []
        for _ in range(count):
            self.compute(step)
            if not logits:
                logits = self.logits()
            tokens.append(self.likeliest())
            self.pending = tokens[-1:]
        self.keep(0)
        return {"logits": logits, "tokens": tokens}

    def encode_ramps(self, side, most):
        """The numbers of the tokens of a picture with a ramp in each channel, at even distances."""
        rows = self.features_of(ramps(side), side)
        tokens = len(rows)
        shown = min(tokens, most)
        places = (index * tokens // shown for index in range(shown))
        return {"tokens": tokens, "values": [value for place in places for value in rows[place]]}

    def run(self, step):
        name, count = next(iter(step.items())) if isinstance(step, dict) else (step, 0)
        timed = StepTime()
        if name == "keep":
            self.keep(count)
        elif name == "encode":
            self.encode()
        elif name == "image":
            self.append_image(timed)
        elif name == "text":
            self.append(count)
        elif name == "fast_forwarded":
            self.fast_forward(count, timed)
        elif name == "sampled":
            self.sample(count, timed)
        elif name == "compute":
            self.compute(timed)
        else:
            raise Problem(f"there is no step {name}")
        return timed.reply()


def prepare(request):
    """Writes the files that the engine reads. An engine that reads ours replaces this function."""
    raise Problem("this engine reads the files of others and writes none")


def main(engine):
    model = None
    for line in sys.stdin:
        try:
            request = json.loads(line)
            if "prepare" in request:
                prepare(request["prepare"])
                reply = "prepared"
            elif "load" in request:
                model = engine(request["load"])
                reply = {"loaded": model.describe()}
            elif "run" in request and model:
                reply = {"ran": [model.run(step) for step in request["run"]]}
            elif "answer" in request and model:
                reply = {"answered": model.answer(**request["answer"])}
            elif "features" in request and model:
                reply = {"encoded": model.encode_ramps(**request["features"])}
            else:
                reply = {"failed": "this cannot be asked of this engine, or not before a model is loaded"}
        except Problem as problem:
            reply = {"failed": str(problem)}
        except Exception as error:  # The asking process must hear of whatever it was.
            reply = {"failed": f"{type(error).__name__}: {error}"}
        REPLIES.write(json.dumps(reply) + "\n")
        REPLIES.flush()
