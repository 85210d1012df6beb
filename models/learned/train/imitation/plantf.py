"""PlanTF with the parameter names of jchengai/planTF, for training."""

import math

import torch
from torch import nn
from torch.nn import functional as F

from . import blocks

HISTORY, POSES = 21, 80
WHEEL_BASE, WIDTH, LENGTH, TO_CENTER = 3.089, 2.297, 5.176, 1.461
EPOCHS, BATCH, GRADIENT_NORM = 25, 128, 5.0
# Three of 25 epochs.
WARM_UP = 3 / 25
RATE, MIN_RATE = 1e-3, 1e-6
PERTURBATION = (1.0, 0.75, 0.35, 1.0, 0.5, 0.2, 0.1)


class DropPath(nn.Module):
    def __init__(self, share):
        super().__init__()
        self.share = share

    def forward(self, x):
        if not self.training or self.share == 0:
            return x
        keep = torch.rand(x.shape[0], *[1] * (x.dim() - 1), device=x.device) >= self.share
        return x * keep / (1 - self.share)


class Mlp(nn.Module):
    def __init__(self, width, inner):
        super().__init__()
        self.fc1, self.fc2 = nn.Linear(width, inner), nn.Linear(inner, width)

    def forward(self, x):
        return self.fc2(F.gelu(self.fc1(x)))


class NeighborhoodAttention(nn.Module):
    def __init__(self, width, heads, window):
        super().__init__()
        self.heads, self.window = heads, window
        self.rpb = nn.Parameter(torch.zeros(heads, 2 * window - 1))
        nn.init.trunc_normal_(self.rpb, std=0.02)
        self.qkv, self.proj = nn.Linear(width, 3 * width), nn.Linear(width, width)

    def forward(self, x):
        batch, length, width = x.shape
        q, k, v = self.qkv(x).view(batch, length, 3, self.heads, width // self.heads).permute(2, 0, 3, 1, 4)
        queries, keys = torch.arange(length, device=x.device)[:, None], torch.arange(length, device=x.device)[None]
        start = (queries - self.window // 2).clamp(0, length - self.window)
        inside = (keys >= start) & (keys < start + self.window)
        offset = (keys - queries + self.window - 1).clamp(0, 2 * self.window - 2)
        bias = self.rpb[:, offset].masked_fill(~inside, -math.inf)
        logits = q @ k.transpose(-1, -2) / math.sqrt(q.shape[-1]) + bias
        return self.proj((logits.softmax(-1) @ v).transpose(1, 2).reshape(batch, length, width))


class HistoryBlock(nn.Module):
    def __init__(self, width, heads, window, drop):
        super().__init__()
        self.norm1, self.attn = nn.LayerNorm(width), NeighborhoodAttention(width, heads, window)
        self.norm2, self.mlp, self.drop_path = nn.LayerNorm(width), Mlp(width, 3 * width), DropPath(drop)

    def forward(self, x):
        x = x + self.drop_path(self.attn(self.norm1(x)))
        return x + self.drop_path(self.mlp(self.norm2(x)))


class Downsample(nn.Module):
    def __init__(self, width):
        super().__init__()
        self.reduction = nn.Conv1d(width, 2 * width, 3, 2, 1, bias=False)
        self.norm = nn.LayerNorm(2 * width)

    def forward(self, x):
        return self.norm(self.reduction(x.transpose(1, 2)).transpose(1, 2))


class HistoryLevel(nn.Module):
    def __init__(self, width, heads, window, drops, last):
        super().__init__()
        self.blocks = nn.ModuleList(HistoryBlock(width, heads, window, drop) for drop in drops)
        self.downsample = None if last else Downsample(width)


class Embed(nn.Module):
    def __init__(self, width):
        super().__init__()
        self.proj = nn.Conv1d(9, width, 3, 1, 1)

    def forward(self, x):
        return self.proj(x).transpose(1, 2)


class HistoryEncoder(nn.Module):
    def __init__(self, dim):
        super().__init__()
        widths = [dim // 4, dim // 2, dim]
        drops = torch.linspace(0, 0.2, 6).tolist()
        self.embed = Embed(widths[0])
        shapes = zip(widths, (2, 4, 8), (3, 3, 5))
        self.levels = nn.ModuleList(
            HistoryLevel(width, heads, window, drops[2 * i : 2 * i + 2], i == 2) for i, (width, heads, window) in enumerate(shapes)
        )
        for i, width in enumerate(widths):
            self.add_module(f"norm{i}", nn.LayerNorm(width))
        self.lateral_convs = nn.ModuleList(nn.Conv1d(width, dim, 3, padding=1) for width in widths)
        self.fpn_conv = nn.Conv1d(dim, dim, 3, padding=1)

    def forward(self, steps):
        x, scales = self.embed(steps.transpose(1, 2)), []
        for i, level in enumerate(self.levels):
            for block in level.blocks:
                x = block(x)
            scales.append(self.lateral_convs[i](getattr(self, f"norm{i}")(x).transpose(1, 2)))
            if level.downsample is not None:
                x = level.downsample(x)
        joined = scales[2]
        for scale in (scales[1], scales[0]):
            joined = scale + F.interpolate(joined, size=scale.shape[-1], mode="linear", align_corners=False)
        return self.fpn_conv(joined)[:, :, -1]


class StateAttention(nn.Module):
    def __init__(self, dim):
        super().__init__()
        self.pos_embed = nn.Parameter(torch.empty(1, 6, dim))
        self.query = nn.Parameter(torch.empty(1, 1, dim))
        nn.init.normal_(self.pos_embed, std=0.02)
        nn.init.normal_(self.query, std=0.02)
        self.linears = nn.ModuleList(nn.Linear(1, dim) for _ in range(6))
        self.attn = nn.MultiheadAttention(dim, 4, batch_first=True)

    def forward(self, state):
        embedded = torch.stack([linear(state[:, i : i + 1]) for i, linear in enumerate(self.linears)], 1) + self.pos_embed
        mask = None
        if self.training:
            mask = torch.zeros(state.shape, dtype=torch.bool, device=state.device)
            mask[:, 3:] = torch.rand(state.shape[0], 3, device=state.device) < 0.75
        query = self.query.expand(state.shape[0], -1, -1)
        return self.attn(query, embedded, embedded, key_padding_mask=mask)[0][:, 0]


class AgentEncoder(nn.Module):
    def __init__(self, dim):
        super().__init__()
        self.history_encoder, self.ego_state_emb = HistoryEncoder(dim), StateAttention(dim)
        self.type_emb = nn.Embedding(4, dim)

    def forward(self, batch):
        valid = batch["agent.valid"].bool()
        both = (valid[..., 1:] & valid[..., :-1])[..., None].float()
        step = lambda x: (x[:, :, 1:] - x[:, :, :-1]) * both
        turn = step(batch["agent.heading"][..., None])
        columns = [step(batch["agent.position"]), step(batch["agent.velocity"]), turn.cos(), turn.sin(), batch["agent.shape"][:, :, 1:], both]
        steps, seen = torch.cat(columns, -1).flatten(0, 1), valid.any(-1).flatten()
        encoded = torch.zeros(len(steps), self.type_emb.embedding_dim, device=steps.device)
        encoded[seen] = self.history_encoder(steps[seen])
        encoded = encoded.view(*valid.shape[:2], -1)
        ego = self.ego_state_emb(batch["current_state"][:, :6])
        return torch.cat([ego[:, None], encoded[:, 1:]], 1) + self.type_emb(batch["agent.category"].long())


class PointsEncoder(nn.Module):
    def __init__(self, dim):
        super().__init__()
        self.first_mlp = nn.Sequential(nn.Linear(6, 128), nn.BatchNorm1d(128), nn.ReLU(), nn.Linear(128, 256))
        self.second_mlp = nn.Sequential(nn.Linear(512, 256), nn.BatchNorm1d(256), nn.ReLU(), nn.Linear(256, dim))

    def forward(self, x, mask):
        places = mask.flatten().nonzero()[:, 0]

        def spread(rows):
            return rows.new_zeros(mask.numel(), rows.shape[-1]).index_copy(0, places, rows).view(*mask.shape, -1)

        rows = self.first_mlp(x.flatten(0, 1)[places])
        own, largest = blocks.split_linear(self.second_mlp[0], rows, spread(rows).max(1)[0])
        return spread(self.second_mlp[1:](own + largest.repeat_interleave(mask.sum(1), 0))).max(1)[0]


class MapEncoder(nn.Module):
    def __init__(self, dim):
        super().__init__()
        self.polygon_encoder = PointsEncoder(dim)
        self.speed_limit_emb = nn.Sequential(nn.Linear(1, dim), nn.ReLU(), nn.Linear(dim, dim))
        self.type_emb, self.on_route_emb = nn.Embedding(3, dim), nn.Embedding(2, dim)
        self.traffic_light_emb, self.unknown_speed_emb = nn.Embedding(4, dim), nn.Embedding(1, dim)

    def forward(self, batch, center):
        angle = batch["map.orientation"]
        offset = batch["map.point"] - center[..., None, :2]
        features = torch.cat([offset, batch["map.vector"], angle.cos()[..., None], angle.sin()[..., None]], -1)
        mask = batch["map.valid"].bool()
        x = self.polygon_encoder(features.flatten(0, 1), mask.flatten(0, 1)).view(*mask.shape[:2], -1)
        limited = batch["map.has_speed_limit"].bool()[..., None]
        limit = torch.where(limited, self.speed_limit_emb(batch["map.speed_limit"][..., None]), self.unknown_speed_emb.weight)
        kinds = ((self.type_emb, "kind"), (self.on_route_emb, "on_route"), (self.traffic_light_emb, "light"))
        return x + limit + sum(table(batch[f"map.{name}"].long()) for table, name in kinds)


class Layer(nn.Module):
    def __init__(self, dim, heads, drop):
        super().__init__()
        self.norm1, self.attn = nn.LayerNorm(dim), nn.MultiheadAttention(dim, heads, batch_first=True)
        self.norm2, self.mlp, self.drop_path = nn.LayerNorm(dim), Mlp(dim, 4 * dim), DropPath(drop)

    def forward(self, x, hidden):
        y = self.norm1(x)
        x = x + self.drop_path(self.attn(y, y, y, key_padding_mask=hidden, need_weights=False)[0])
        return x + self.drop_path(self.mlp(self.norm2(x)))


def head(inputs, inner, outputs, bias=True):
    return nn.Sequential(nn.Linear(inputs, inner, bias=bias), nn.LayerNorm(inner), nn.ReLU(), nn.Linear(inner, outputs))


class Decoder(nn.Module):
    def __init__(self, dim, modes):
        super().__init__()
        self.modes = modes
        self.multimodal_proj = nn.Linear(dim, modes * dim)
        self.loc, self.pi = head(dim, 2 * dim, 4 * POSES), head(dim, 2 * dim, 1)

    def forward(self, x):
        x = self.multimodal_proj(x).view(len(x), self.modes, -1)
        return self.loc(x).view(*x.shape[:2], POSES, 4), self.pi(x).squeeze(-1)


class Model(nn.Module):
    def __init__(self, dim=128, depth=4, heads=8, modes=6):
        super().__init__()
        self.pos_emb = nn.Sequential(nn.Linear(4, dim), nn.ReLU(), nn.Linear(dim, dim))
        self.agent_encoder, self.map_encoder = AgentEncoder(dim), MapEncoder(dim)
        self.encoder_blocks = nn.ModuleList(Layer(dim, heads, drop) for drop in torch.linspace(0, 0.2, depth).tolist())
        self.norm, self.trajectory_decoder = nn.LayerNorm(dim), Decoder(dim, modes)
        self.agent_predictor = head(dim, 2 * dim, 2 * POSES, bias=False)
        self.apply(start)

    def forward(self, batch):
        middle = batch["map.point"].shape[2] // 2
        center = torch.cat([batch["map.point"][:, :, middle], batch["map.orientation"][:, :, middle, None]], -1)
        place = torch.cat([batch["agent.position"][:, :, -1], center[..., :2]], 1)
        angle = torch.cat([batch["agent.heading"][:, :, -1], center[..., 2]], 1)[..., None]
        hidden = ~torch.cat([batch["agent.valid"].bool().any(-1), batch["map.valid"].bool().any(-1)], 1)
        x = torch.cat([self.agent_encoder(batch), self.map_encoder(batch, center)], 1)
        x = x + self.pos_emb(torch.cat([place, angle.cos(), angle.sin()], -1))
        for block in self.encoder_blocks:
            x = block(x, hidden)
        x = self.norm(x)
        agents = batch["agent.valid"].shape[1]
        trajectory, probability = self.trajectory_decoder(x[:, 0])
        return trajectory, probability, self.agent_predictor(x[:, 1:agents]).view(len(x), agents - 1, POSES, 2)


def start(module):
    if isinstance(module, nn.Linear):
        nn.init.xavier_uniform_(module.weight)
        if module.bias is not None:
            nn.init.zeros_(module.bias)
    elif isinstance(module, nn.Embedding):
        nn.init.normal_(module.weight, std=0.02)


def loss(model, batch):
    trajectory, probability, prediction = model(batch)
    target = batch["target"]
    goal = torch.cat([target[..., :2], target[..., 2:].cos(), target[..., 2:].sin()], -1)
    nearest = (trajectory[..., :2] - goal[:, None, :, :2]).norm(dim=-1).sum(-1).argmin(1)
    best = trajectory[torch.arange(len(trajectory)), nearest]
    total = F.smooth_l1_loss(best, goal) + F.cross_entropy(probability, nearest)
    seen = batch["agent.target_valid"][:, 1:].bool()
    if seen.any():
        total = total + F.smooth_l1_loss(prediction[seen], batch["agent.target"][:, 1:, :, :2][seen])
    return total


def turned(points, angle):
    """Points (B, …, 2) in a frame that is turned by an angle (B)."""
    cos, sin = (value.view(-1, *[1] * (points.dim() - 2)) for value in (angle.cos(), angle.sin()))
    x, y = points[..., 0], points[..., 1]
    return torch.stack([x * cos + y * sin, y * cos - x * sin], -1)


def corners(center, heading, length, width):
    """Corners (…, 4, 2) of boxes."""
    forward = torch.stack([heading.cos(), heading.sin()], -1)
    left = torch.stack([-forward[..., 1], forward[..., 0]], -1)
    signs = torch.tensor([[1, 1], [-1, 1], [-1, -1], [1, -1]], device=center.device, dtype=center.dtype) / 2
    along = signs[:, :1] * (length[..., None, None] * forward[..., None, :])
    return center[..., None, :] + along + signs[:, 1:] * (width[..., None, None] * left[..., None, :])


def overlap(one, other):
    """Whether boxes (…, 4, 2) overlap, by separating axes."""
    apart = torch.zeros(one.shape[:-2], dtype=torch.bool, device=one.device)
    for box in (one, other):
        for i in (0, 1):
            axis = box[..., i, :] - box[..., i + 1, :]
            a, b = ((corner * axis[..., None, :]).sum(-1) for corner in (one, other))
            apart |= (a.max(-1)[0] < b.min(-1)[0]) | (b.max(-1)[0] < a.min(-1)[0])
    return ~apart


def augmented(batch, generator):
    """State perturbation of half of the samples; one that would touch one of the ten nearest agents stays as it is."""
    state, count = batch["current_state"], len(batch["current_state"])
    bounds = torch.tensor(PERTURBATION, device=state.device)
    noise = (2 * torch.rand(count, 7, generator=generator).to(state.device) - 1) * bounds
    chosen = torch.rand(count, generator=generator).to(state.device) < 0.5
    moved = state + noise
    moved[:, 3] = moved[:, 3].clamp(min=0)
    place, angle = moved[:, :2], moved[:, 2]
    center = place + TO_CENTER * torch.stack([angle.cos(), angle.sin()], -1)
    ones = torch.ones(count, 1, device=state.device)
    ego = corners(center[:, None], angle[:, None], LENGTH * ones, WIDTH * ones)
    near = slice(1, 11)
    shape = batch["agent.shape"][:, near, -1]
    others = corners(batch["agent.position"][:, near, -1], batch["agent.heading"][:, near, -1], shape[..., 1], shape[..., 0])
    touched = (overlap(ego.expand_as(others), others) & batch["agent.valid"][:, near, -1].bool()).any(1)
    chosen &= ~touched
    place, angle = place * chosen[:, None], angle * chosen
    made = dict(batch)
    made["current_state"] = torch.where(chosen[:, None], moved, state).clone()
    made["current_state"][:, :3] = 0
    position, heading = batch["agent.position"].clone(), batch["agent.heading"].clone()
    position[:, 0, -1], heading[:, 0, -1] = place, angle
    velocity = batch["agent.velocity"].clone()
    shift = lambda points: turned(points - place.view(count, *[1] * (points.dim() - 2), 2), angle)
    bend = lambda angles: angles - angle.view(count, *[1] * (angles.dim() - 1))
    made["agent.position"], made["agent.heading"] = shift(position), bend(heading)
    made["agent.velocity"] = turned(velocity, angle)
    made["map.point"], made["map.vector"] = shift(batch["map.point"]), turned(batch["map.vector"], angle)
    made["map.orientation"] = bend(batch["map.orientation"])
    # Targets count from the present pose: the ego's has moved, those of the others have not.
    own = batch["target"]
    made["target"] = torch.cat([shift(own[..., :2]), bend(own[..., 2])[..., None]], -1)
    others = batch["agent.target"]
    made["agent.target"] = torch.cat([turned(others[..., :2], angle), others[..., 2:]], -1)
    return made


def displacement(model, batch):
    """Mean distance between plan and driver over the poses, of the model and of constant velocity, meters."""
    trajectory, probability, _ = model(batch)
    plan = trajectory[torch.arange(len(trajectory)), probability.argmax(1)][..., :2]
    target = batch["target"][..., :2]
    times = 0.1 * torch.arange(1, POSES + 1, device=plan.device)
    speed = batch["current_state"][:, 3:4]
    straight = torch.stack([speed * times, torch.zeros_like(speed) * times], -1)
    return (plan - target).norm(dim=-1).mean(1), (straight - target).norm(dim=-1).mean(1)


def optimizer(model):
    decayed, plain = [], []
    for module in model.modules():
        for name, parameter in module.named_parameters(recurse=False):
            matrix = isinstance(module, (nn.Linear, nn.Conv1d, nn.MultiheadAttention)) and name.endswith("weight")
            (decayed if matrix else plain).append(parameter)
    groups = [{"params": decayed, "weight_decay": 1e-4}, {"params": plain, "weight_decay": 0.0}]
    return torch.optim.AdamW(groups, lr=RATE)


def learning_rate(epoch, epochs):
    """Factor of an epoch from 0 on."""
    warm_up = round(WARM_UP * epochs)
    if epoch < warm_up:
        return (epoch + 1) / warm_up
    share = (epoch - warm_up) / max(epochs - warm_up, 1)
    return (MIN_RATE + 0.5 * (RATE - MIN_RATE) * (1 + math.cos(math.pi * share))) / RATE
