"""States per second of forward and backward, on random rows of realistic lengths."""

from __future__ import annotations

import argparse
import os
import time

import torch
import torch.nn.functional as F

from .model import NanoLlava
from .shapes import SHAPES

ROUNDS = 8


def run(options: argparse.Namespace) -> None:
    """Prints one line."""
    torch.manual_seed(0)
    torch.set_num_threads(options.threads)
    device, shape, vocabulary = torch.device(options.device), SHAPES[options.shape], 768
    model = NanoLlava(shape, vocabulary).to(device)
    step = torch.compile(model) if options.compile else model
    rows, length = options.micro, options.prompt + shape.image_tokens + options.answers
    ids = torch.randint(0, vocabulary, (rows, length), device=device)
    images = torch.randint(0, 256, (rows, shape.image_pixels, shape.image_pixels, 3), dtype=torch.uint8, device=device)
    starts = torch.arange(rows, device=device)[:, None] * length
    places = (starts + 16 + torch.arange(shape.image_tokens, device=device)).flatten()
    wanted = (starts + length - options.answers - 1 + torch.arange(options.answers, device=device)).flatten()
    targets = torch.randint(0, vocabulary, (len(wanted),), device=device)
    times = []
    for _ in range(ROUNDS + 1):
        start = time.perf_counter()
        logits, _ = step(ids, images, places, wanted, getattr(torch, options.precision))
        F.cross_entropy(logits, targets).backward()
        if device.type == "cuda":
            torch.cuda.synchronize()
        times.append(time.perf_counter() - start)
    steady = sorted(times[1:])
    size = sum(p.numel() for p in model.parameters()) / 1e6
    print(
        f"{options.shape} {size:.1f} M, {length} positions, {options.precision}, {'compiled' if options.compile else 'eager'}, "
        f"{options.threads} threads, micro-batch {rows}: median {rows / steady[len(steady) // 2]:.1f}, best {rows / steady[0]:.1f} states/s "
        f"(load {os.getloadavg()[0]:.1f}, first {times[0]:.1f} s)"
    )
