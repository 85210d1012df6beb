"""The mean of a run's weights and those that it started from.

A run that goes on from trained weights, on a few new states, forgets a little of what the former states taught and learns some of the new ones by
heart; the mean keeps more of both (Wortsman et al., Model soups, 2022).
"""

from __future__ import annotations

from pathlib import Path

import torch

from . import tokenizer as tokenizers
from .shapes import Shape
from .vocabulary import moved
from .weights import WORD_TABLES, from_stock

#: What the run had trained, kept beside the checkpoint.
TRAINED = "trained.pt"


def run(out: Path, start: Path, share: float) -> None:
    """Replaces the weights of the run's checkpoint by (1 - share) of them and `share` of the start's; what was trained stays as `trained.pt`."""
    from transformers import LlavaForConditionalGeneration

    if not 0.0 < share < 1.0:
        raise ValueError(f"a share of {share}: it lies between 0 and 1")
    checkpoint, trained = out / "checkpoint.pt", out / TRAINED
    if trained.exists():
        raise FileExistsError(f"{trained} exists: the run has been averaged already; to start again, put it back as {checkpoint.name}")
    old, new = (tokenizers.load(folder / "tokenizer.json") for folder in (start, out))
    lost = {word for word in set(old.get_vocab()) - set(new.get_vocab()) if not word.startswith("<unused")}
    if lost:
        raise ValueError(f"{out} has no token for {len(lost)} words of {start}, for example {min(lost)!r}: their weights have no mean")
    state = torch.load(checkpoint, map_location="cpu", weights_only=True)
    stock = LlavaForConditionalGeneration.from_pretrained(start).state_dict()
    stock |= {name: moved(stock[name].float(), old, new) for name in WORD_TABLES}
    former = from_stock(stock, state["model"], Shape(**state["shape"]))
    state["model"] = {name: torch.lerp(weight, former[name], share) for name, weight in state["model"].items()}
    # What was trained is the last to be put aside, so that an interrupted call can be made again.
    torch.save(state, checkpoint.with_suffix(".part"))
    checkpoint.replace(trained)
    checkpoint.with_suffix(".part").replace(checkpoint)
