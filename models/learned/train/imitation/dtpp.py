"""DTPP with the parameter names of its authors."""

import torch
from torch import nn
from torch.nn import functional as F

from .actors import HEADS, POSES, STEP_S, Block, SceneEncoder, elu_head, without_attention_dropout
from .blocks import displacements

TOKENS, COLUMNS, FIRST, HIDDEN = 8, 6, 30, -1e9
# The shape of `dtpp-small`.
SMALL = {"dim": 64, "inner": 256, "layers": 2, "attention_dropout": False}


class AgentDecoder(nn.Module):
    def __init__(self, dim):
        super().__init__()
        self.traj_decoder = elu_head(2 * dim, dim // 2, 30)


class Scorer(nn.Module):
    def __init__(self, dim):
        super().__init__()
        self.dim = dim
        self.interaction_feature_encoder = nn.Sequential(nn.Linear(10, dim // 4), nn.ReLU(), nn.Linear(dim // 4, dim))
        self.interaction_feature_decoder, self.weights_decoder = elu_head(dim, dim // 4, 4), elu_head(dim, dim // 4, 8)

    def forward(self, tree, futures, states, steps):
        tree, futures = tree[:, :, :steps], futures[:, :, :, :steps]
        present = states.sum(-1) != 0
        speed, acceleration, curvature = tree[..., 3], tree[..., 4], tree[..., 5]
        jerk = torch.diff(acceleration, dim=-1) / STEP_S
        jerk = torch.cat([jerk[..., :1], jerk], -1)
        share = lambda x, bound: x.mean(-1).clamp(0, bound) / bound
        plain = [-share(speed, 15), share(acceleration.abs(), 4), share(jerk.abs(), 6)]
        plain.append(share((speed**2 * curvature).abs(), 5))
        ego = tree[:, :, None]
        turn = futures[..., 2] - ego[..., 2]
        turn = torch.atan2(turn.sin(), turn.cos())
        moved = torch.diff(futures[..., :2], dim=-2) / STEP_S
        moved = torch.cat([moved[..., :1, :], moved], -2)
        beside = [
            (futures[..., 0] - ego[..., 0]) * turn.cos(),
            (futures[..., 1] - ego[..., 1]) * turn.sin(),
            turn,
            (moved[..., 0] - ego[..., 3] * ego[..., 2].cos()) * turn.cos(),
            (moved[..., 1] - ego[..., 3] * ego[..., 2].sin()) * turn.sin(),
        ]
        size = states[:, None, :, None, 6:].expand(*turn.shape, -1)
        relative = torch.cat([torch.stack(beside, -1), size], -1) * present[:, None, :, None, None]
        latent = self.interaction_feature_encoder(relative).max(2)[0].mean(2)
        latent = self.interaction_feature_decoder(latent).sigmoid()
        weights = F.softplus(self.weights_decoder(torch.ones(len(tree), self.dim, device=tree.device)))
        cost = (torch.cat([torch.stack(plain, -1), latent], -1) * weights[:, None]).sum(-1)
        distance = (ego[..., :2] - futures[..., :2]).norm(dim=-1)
        near = ((-0.2 * distance**2).exp() * present[:, None, :, None]).sum((2, 3))
        return -cost - 10 * near, weights


class Decoder(nn.Module):
    def __init__(self, dim, inner, neighbors, branches):
        super().__init__()
        self.neighbors = neighbors
        self.environment_decoder = Block("cross_attention", dim, inner)
        self.ego_condition_decoder = Block("cross_attention", dim, inner)
        self.time_embed = nn.Embedding(TOKENS, dim)
        self.ego_traj_encoder = nn.Sequential(nn.Linear(COLUMNS, dim // 4), nn.ReLU(), nn.Linear(dim // 4, dim))
        self.agent_traj_decoder, self.ego_traj_decoder = AgentDecoder(dim), elu_head(dim, dim, 3 * POSES)
        self.scorer = Scorer(dim)
        causal = torch.block_diag(*[torch.tril(torch.ones(TOKENS, TOKENS))] * branches)
        self.register_buffer("casual_mask", causal)
        self.register_buffer("time_index", torch.arange(TOKENS).repeat(branches, 1))

    def forward(self, tokens, hidden, tree, states, steps):
        batch, branches = tree.shape[:2]
        encoded = self.ego_traj_encoder(tree)
        branch = encoded[:, :, steps - 1]
        pooled = encoded.view(batch, branches * TOKENS, POSES // TOKENS, -1).max(2)[0]
        embedded = (self.time_embed.weight + branch[:, :, None]).flatten(1, 2)
        used = (tree.sum(-1) != 0)[:, :, :: POSES // TOKENS].flatten(1)
        # The original repeats its masks so that in a batch, heads use those of other samples; here each sample has its own.
        bias = lambda mask: torch.where(mask, 0.0, HIDDEN).repeat_interleave(HEADS, 0)
        environment = bias(used[:, :, None] & ~hidden[:, None])
        condition = bias(used[:, :, None] & self.casual_mask.bool())
        futures = []
        states = states[:, : self.neighbors]
        for i in range(self.neighbors):
            query = tokens[:, i + 1, None] + embedded
            near = self.environment_decoder(query, tokens, bias=environment)
            own = self.ego_condition_decoder(query, pooled, bias=condition)
            moved = self.agent_traj_decoder.traj_decoder(torch.cat([near, own], -1)).view(batch, branches, POSES, 3)
            futures.append(moved + states[:, i, None, None, :3])
        futures = torch.stack(futures, 2)
        scores, weights = self.scorer(tree, futures, states, steps)
        scores = scores.masked_fill(tree.sum((2, 3)) == 0, -torch.inf)
        return futures, scores, self.ego_traj_decoder(tokens[:, 0]).view(batch, POSES, 3), weights


class Model(nn.Module):
    def __init__(self, dim=256, inner=1024, layers=3, neighbors=10, branches=30, attention_dropout=True):
        super().__init__()
        self.encoder, self.decoder = SceneEncoder(dim, layers), Decoder(dim, inner, neighbors, branches)
        if not attention_dropout:
            without_attention_dropout(self)

    def forward(self, batch, stages=(("first", FIRST), ("second", POSES))):
        _, tokens, hidden = self.encoder(batch)
        states = batch["neighbors"][:, :, -1]
        return [self.decoder(tokens, hidden, batch[name], states, steps) for name, steps in stages]


def stage_loss(futures, tree, ego, scores, weights, target, agents, valid):
    """The agents' poses under the driver's branch, the choice of that branch, the ego's own trajectory, small weights."""
    used = (tree[:, 0].sum(-1) != 0).float()
    error = F.smooth_l1_loss(futures[:, 0] * valid, agents, reduction="none") * used[:, None, :, None]
    own = F.smooth_l1_loss(ego, target, reduction="none") * used[..., None]
    choice = F.cross_entropy(scores, torch.zeros(len(scores), dtype=torch.long, device=scores.device))
    return error.sum() / used.sum() + choice + 0.1 * own.sum() / used.sum() + 0.01 * (weights**2).mean()


def loss(model, batch):
    agents = batch["futures"]
    total = 0.0
    for (name, factor), (futures, scores, ego, weights) in zip((("first", 1.0), ("second", 0.2)), model(batch)):
        # As in the original, a number that is exactly 0 counts as unknown.
        valid = (agents != 0).float()
        total = total + factor * stage_loss(futures, batch[name], ego, scores, weights, batch["target"], agents, valid)
    return total


def augmented(batch, generator):
    return batch


def displacement(model, batch):
    """Of the best branch of the second stage."""
    [(_, scores, _, _)] = model(batch, stages=(("second", POSES),))
    plan = batch["second"][torch.arange(len(scores)), scores.argmax(1)]
    return displacements(plan, {**batch, "speed": batch["ego"][:, -1, 3]}, STEP_S)


def optimizer(model):
    return torch.optim.AdamW(model.parameters(), lr=2e-4)


def clipped(model):
    """Gradients of both parts are clipped by themselves."""
    return [model.encoder, model.decoder]


def learning_rate(epoch, epochs):
    """Halved every five of 30 epochs."""
    return 0.5 ** (30 * epoch // epochs // 5)


EPOCHS, BATCH, GRADIENT_NORM = 30, 16, 5.0
