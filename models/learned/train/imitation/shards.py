"""Shards of `planagent dataset --for imitation`, whole in memory."""

from pathlib import Path

import torch
from safetensors.torch import load_file


def load(folder, split, limit=None):
    """The tensors of all shards of a split, one behind the other; without generated splits, those of listed logs."""
    names = sorted(Path(folder).glob(f"{split}-*.safetensors"))
    if not names and split == "train":
        names = sorted(Path(folder).glob("listed-*.safetensors"))
    shards = [shard for shard in map(load_file, names) if shard]
    if not shards:
        raise SystemExit(f"error: {folder} has no {split} samples; `planagent dataset --for imitation` writes them")
    return {name: torch.cat([shard[name] for shard in shards]) for name in shards[0]}


class Flat:
    """Samples with one row in each tensor."""

    def __init__(self, tensors):
        self.tensors = tensors
        self.count = len(tensors["target"])

    def batch(self, places):
        return {name: tensor[places] for name, tensor in self.tensors.items()}


class Ragged:
    """Samples with agents and polygons of different numbers: those tensors whose names begin with `agent.` or `map.` have a row an agent or polygon."""

    def __init__(self, tensors):
        self.tensors = tensors
        self.count = len(tensors["target"])
        self.starts, self.counts = {}, {}
        for kind, counter in (("agent", "agents"), ("map", "polygons")):
            counts = tensors[counter].long()
            self.counts[kind] = counts
            self.starts[kind] = counts.cumsum(0) - counts

    def batch(self, places):
        made = {}
        for name, tensor in self.tensors.items():
            kind = name.split(".")[0]
            if kind not in self.starts or "." not in name:
                made[name] = tensor[places]
                continue
            starts, counts = self.starts[kind][places], self.counts[kind][places]
            rows = max(int(counts.max()), 1)
            index = torch.arange(rows)[None].expand(len(places), rows)
            mask = index < counts[:, None]
            taken = tensor[(starts[:, None] + index.clamp(max=rows)).clamp(max=len(tensor) - 1)]
            made[name] = torch.where(mask.view(*mask.shape, *[1] * (taken.dim() - 2)), taken, torch.zeros_like(taken))
            if kind == "agent":
                made["agent.present"] = mask
        return made
