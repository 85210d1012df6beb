"""UrbanDriver in open loop with the parameter names of nuplan-devkit."""

import math

import torch
from torch import nn
from torch.nn import functional as F

from . import blocks

POSES, POINTS, COLUMNS, HEADS = 16, 20, 8, 8
# Rows of the table of kinds: ego, vehicle, and the layers of a dataset in their order.
EGO, VEHICLE, LAYERS = 0, 1, (4, 7, 8, 5, 6, 9)
# Time between two frames of the history, seconds.
FRAME_S = 0.4


class Positions(nn.Module):
    def __init__(self, width):
        super().__init__()
        angle = torch.arange(5000)[:, None] * torch.exp(-math.log(1e4) / width * torch.arange(0, width, 2))
        table = torch.stack([angle.sin(), angle.cos()], -1).flatten(1)
        self.register_buffer("static_embedding", table[:, None])

    def forward(self, x):
        return x + self.static_embedding[: x.shape[-2], 0]


class Kinds(nn.Module):
    def __init__(self, width):
        super().__init__()
        self.embedding = nn.Embedding(11, width)


class Local(nn.Module):
    def __init__(self, width):
        super().__init__()
        self.linear, self.norm = nn.Linear(width, width, bias=False), nn.LayerNorm(width)

    def forward(self, x):
        return F.relu(self.norm(self.linear(x)))


class SubLayer(nn.Module):
    def __init__(self, width):
        super().__init__()
        self.mlp, self.linear_remap = Local(width), nn.Linear(2 * width, width)

    def forward(self, x, hidden):
        x = self.mlp(x)
        largest = x.masked_fill(hidden[..., None], -torch.inf).max(-2, keepdim=True)[0]
        return sum(blocks.split_linear(self.linear_remap, x, largest))


class Subgraph(nn.Module):
    def __init__(self, width, layers):
        super().__init__()
        self.layers = nn.ModuleList(SubLayer(width) for _ in range(layers))

    def forward(self, x, hidden):
        for layer in self.layers:
            x = layer(x, hidden)
        return x.masked_fill(hidden[..., None], -torch.inf).max(-2)[0]


class Layers(nn.Module):
    def __init__(self, *widths):
        super().__init__()
        self.layers = nn.ModuleList(nn.Linear(a, b) for a, b in zip(widths, widths[1:]))

    def forward(self, x):
        for layer in self.layers[:-1]:
            x = F.relu(layer(x))
        return self.layers[-1](x)


class Head(nn.Module):
    def __init__(self, width):
        super().__init__()
        self.encoder = nn.MultiheadAttention(width, HEADS, batch_first=True)
        self.output_embed = Layers(width, 4 * width, 4 * width, 3 * POSES)


class Model(nn.Module):
    def __init__(self, width=256, layers=3):
        super().__init__()
        self.width = width
        self.feature_embedding = nn.Linear(COLUMNS, width)
        self.positional_embedding, self.type_embedding = Positions(width), Kinds(width)
        self.local_subgraph, self.global_head = Subgraph(width, layers), Head(width)

    def plan(self, points, available, kinds):
        """Of elements (B, E, 20, 8), their available points (B, E, 20) and kinds (B, E); the first is the ego."""
        x = self.positional_embedding(self.feature_embedding(points))
        seen = available.any(-1)
        # The network is run on elements that have points; the others stay zero.
        rows = self.local_subgraph(x[seen], ~available[seen])
        x = torch.zeros(*seen.shape, self.width, device=x.device).masked_scatter(seen[..., None], rows)
        x = F.normalize(x, dim=-1) * math.sqrt(self.width)
        keys = x + self.type_embedding.embedding(kinds)
        mixed, _ = self.global_head.encoder(x[:, :1], keys, x, key_padding_mask=~seen, need_weights=False)
        return self.global_head.output_embed(mixed.squeeze(1)).view(-1, POSES, 3)

    def forward(self, batch):
        return self.plan(*elements(batch))


def padded(x, dim, to):
    """With zeros behind, up to a length."""
    shape = list(x.shape)
    shape[dim] = to - shape[dim]
    return torch.cat([x, x.new_zeros(shape)], dim)


def elements(batch):
    """Elements of a batch of a dataset: ego, vehicles, map lines."""
    history = torch.cat([batch["ego"].flip(1)[:, None], torch.zeros_like(batch["ego"][:, None, :, :0])], -1)
    ego = padded(padded(history, 3, COLUMNS), 2, POINTS)
    agents = padded(batch["agent.frame"].flip(2), 2, POINTS)
    lines = padded(batch["map.point"], 3, COLUMNS)
    frames = batch["ego"].shape[1]
    first = torch.arange(POINTS, device=ego.device) < frames
    seen = batch["agent.present"][..., None] & first
    available = torch.cat([first.expand(len(ego), 1, -1), seen, batch["map.available"].bool()], 1)
    layer = torch.tensor(LAYERS, device=ego.device)[batch["map.layer"].long()]
    kinds = torch.cat([torch.full_like(layer[:, :1], EGO), torch.full_like(seen[..., 0].long(), VEHICLE), layer], 1)
    return torch.cat([ego, agents, lines], 1), available, kinds


def loss(model, batch):
    """Absolute errors, weighted by exp(-k / 16) for pose k from 0 on."""
    weights = torch.exp(-torch.arange(POSES, device=batch["target"].device) / POSES)[:, None]
    error = (model(batch) - batch["target"]).abs() * weights
    return error[..., :2].mean() + error[..., 2:].mean()


def augmented(batch, generator):
    """Half of the samples lose half of their vehicles; half get another present pose, to which their history leads smoothly."""
    batch = blocks.without_agents(batch, generator, "agent.present")
    count, device = len(batch["ego"]), batch["ego"].device
    low, high = torch.tensor([0.0, -2.0, -0.75]), torch.tensor([2.0, 2.0, 0.75])
    noise = (low + (high - low) * torch.rand(count, 3, generator=generator)).to(device)
    chosen = torch.rand(count, generator=generator).to(device) < 0.5
    bent = blocks.bent_history(batch["ego"], noise, chosen)
    fine = blocks.feasible(bent, FRAME_S)
    return {**batch, "ego": torch.where((fine & chosen)[:, None, None], bent, batch["ego"])}


def displacement(model, batch):
    return blocks.displacements(model(batch), batch)


def optimizer(model):
    return torch.optim.Adam(model.parameters(), lr=1e-4, weight_decay=5e-4)


learning_rate = blocks.steps(0.5, 0.75)
EPOCHS, BATCH, GRADIENT_NORM = 100, 64, None
