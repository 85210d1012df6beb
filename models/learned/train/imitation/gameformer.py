"""GameFormer with the parameter names of GameFormer-Planner."""

import torch
from torch import nn
from torch.nn import functional as F

from .actors import POSES, STEP_S, Block, MapEncoder, SceneEncoder, elu_head, without_attention_dropout
from .blocks import displacements

# The shape of `gameformer-small`.
SMALL = {"dim": 64, "layers": 2, "levels": 1, "attention_dropout": False}


class Gaussians(nn.Module):
    def __init__(self, dim):
        super().__init__()
        self.gaussian, self.score = elu_head(dim, 2 * dim, 4 * POSES, dropout=True), elu_head(dim, dim // 4, 1)

    def forward(self, content, current):
        futures = self.gaussian(content).view(*content.shape[:3], POSES, 4)
        start = F.pad(current[:, :, None, None, :2], (0, 2))
        return futures + start, self.score(content)[..., 0]


class Futures(nn.Module):
    def __init__(self, dim):
        super().__init__()
        self.mlp = nn.Sequential(nn.Linear(5, dim // 4), nn.ReLU(), nn.Linear(dim // 4, dim))

    def forward(self, futures, current):
        start = current[:, :, None, None, :2].expand(-1, -1, futures.shape[2], -1, -1)
        moved = torch.diff(torch.cat([start, futures], 3), dim=3)
        angle = torch.atan2(moved[..., 1], moved[..., 0].clamp(min=1e-6))[..., None]
        return self.mlp(torch.cat([futures, angle, moved / STEP_S], -1).detach()).max(3)[0]


class First(nn.Module):
    def __init__(self, dim, modes, actors):
        super().__init__()
        self.multi_modal_query_embedding, self.agent_query_embedding = nn.Embedding(modes, dim), nn.Embedding(actors, dim)
        self.query_encoder, self.predictor = Block("cross_attention", dim, 4 * dim), Gaussians(dim)
        self.register_buffer("modal", torch.arange(modes))
        self.register_buffer("agent", torch.arange(actors))

    def forward(self, current, tokens, hidden):
        actors, modes = len(self.agent), len(self.modal)
        embedding = self.multi_modal_query_embedding.weight + self.agent_query_embedding.weight[:, None]
        query = tokens[:, :actors, None] + embedding
        content = self.query_encoder(query.flatten(1, 2), tokens, hidden).view(len(tokens), actors, modes, -1)
        return content, *self.predictor(content, current)


class Stage(nn.Module):
    def __init__(self, dim, futures):
        super().__init__()
        self.interaction_encoder = Block("self_attention", dim, 4 * dim)
        self.query_encoder = Block("cross_attention", dim, 4 * dim)
        self.future_encoder, self.decoder = futures, Gaussians(dim)

    def forward(self, current, futures, scores, content, tokens, hidden):
        batch, actors, modes, dim = content.shape
        encoded = self.future_encoder(futures[..., :2], current)
        expected = (encoded * scores.softmax(-1)[..., None]).mean(2)
        interaction = self.interaction_encoder(expected, hidden=hidden[:, :actors])
        memory = torch.cat([interaction, tokens], 1)
        # Queries of an actor do not hear its own interaction.
        absent = torch.cat([hidden[:, :actors], hidden], 1)[:, None].repeat(1, actors, 1)
        absent[:, torch.arange(actors), torch.arange(actors)] = True
        query = (content + encoded).flatten(0, 1)
        of_actor = lambda x: x[:, None].expand(-1, actors, *x.shape[1:]).flatten(0, 1)
        content = self.query_encoder(query, of_actor(memory), absent.flatten(0, 1)).view(batch, actors, modes, dim)
        return content, *self.decoder(content, current)


class Decoder(nn.Module):
    def __init__(self, dim, modes, actors, levels):
        super().__init__()
        futures = Futures(dim)
        self.initial_predictor = First(dim, modes, actors)
        self.interaction_stage = nn.ModuleList(Stage(dim, futures) for _ in range(levels))

    def forward(self, current, tokens, hidden):
        current = current[:, : len(self.initial_predictor.agent)]
        content, futures, scores = self.initial_predictor(current, tokens, hidden)
        levels = [(futures, scores)]
        for stage in self.interaction_stage:
            content, futures, scores = stage(current, futures, scores, content, tokens, hidden)
            levels.append((futures, scores))
        return levels, content[:, 0]


class Planner(nn.Module):
    def __init__(self, dim):
        super().__init__()
        self.route_fusion, self.route_encoder = Block("cross_attention", dim, 4 * dim), MapEncoder(3, 50, dim)
        self.plan_decoder = elu_head(2 * dim, dim, 2 * POSES, dropout=True)

    def forward(self, ego, route, state):
        tokens, hidden = self.route_encoder(route)
        hidden[:, 0] = False
        fused = self.route_fusion(ego, tokens, hidden)
        controls = self.plan_decoder(torch.cat([ego, fused], -1).max(1)[0]).view(-1, POSES, 2)
        speed = torch.hypot(state[:, 3], state[:, 4])[:, None] + (controls[..., 0].clamp(-5, 5) * STEP_S).cumsum(1)
        speed = speed.clamp(min=0)
        angle = state[:, None, 2] + (controls[..., 1].clamp(-0.5, 0.5) * speed * STEP_S).cumsum(1)
        angle = torch.fmod(angle, 2 * torch.pi)
        x = state[:, None, 0] + (speed * angle.cos() * STEP_S).cumsum(1)
        y = state[:, None, 1] + (speed * angle.sin() * STEP_S).cumsum(1)
        return torch.stack([x, y, angle], -1)


class Model(nn.Module):
    def __init__(self, dim=256, layers=3, levels=2, modes=6, neighbors=10, attention_dropout=True):
        super().__init__()
        self.encoder = SceneEncoder(dim, layers)
        self.decoder, self.planner = Decoder(dim, modes, neighbors + 1, levels), Planner(dim)
        if not attention_dropout:
            without_attention_dropout(self)

    def forward(self, batch):
        current, tokens, hidden = self.encoder(batch)
        levels, ego = self.decoder(current, tokens, hidden)
        return levels, self.planner(ego, batch["route"], current[:, 0])


def level_loss(futures, scores, target, valid):
    """Gaussian likelihood of the mode nearest to the driver, and cross-entropy of its choice; `target` (B, N, 80, 3) begins with the
    ego, `valid` (B, N - 1, 80) masks the agents."""
    seen = torch.cat([torch.ones_like(valid[:, :1]), valid], 1)[:, :, None, :, None]
    futures = futures * seen
    best = (futures[..., :2] - target[:, :, None, :, :2]).norm(dim=-1).mean(-1).argmin(-1)
    chosen = futures.gather(2, best[..., None, None, None].expand(-1, -1, 1, POSES, 4))[:, :, 0]
    deviation = chosen[..., 2:].clamp(-2, 2)
    error = (target[..., :2] - chosen[..., :2]) / deviation.exp()
    likelihood = (deviation + 0.5 * error**2).sum(-1).mean()
    choice = F.cross_entropy(scores.transpose(1, 2), best, label_smoothing=0.2, reduction="none")
    return likelihood + (choice * (target[:, :, 0, 0] != 0)).mean()


def loss(model, batch):
    levels, plan = model(batch)
    target = torch.cat([batch["target"][:, None], batch["futures"]], 1)
    valid = (batch["futures"][..., 0] != 0).float()
    total = sum(level_loss(*level, target, valid) for level in levels)
    return total + F.smooth_l1_loss(plan, batch["target"]) + F.smooth_l1_loss(plan[:, -1], batch["target"][:, -1])


def augmented(batch, generator):
    return batch


def displacement(model, batch):
    return displacements(model(batch)[1], {**batch, "speed": batch["ego"][:, -1, 3]}, STEP_S)


def optimizer(model):
    return torch.optim.AdamW(model.parameters(), lr=1e-4)


def learning_rate(epoch, epochs):
    """Halved at epochs 10, 12, 14, 16 and 18 of 20."""
    return 0.5 ** sum(epoch >= epochs * milestone / 20 for milestone in (10, 12, 14, 16, 18))


EPOCHS, BATCH, GRADIENT_NORM = 20, 32, 5.0
