"""What GameFormer and DTPP share: the encoder of a scene and the blocks of their decoders."""

import math

import torch
from torch import nn

HEADS, POSES, STEP_S = 8, 80, 0.1


class Actor(nn.Module):
    def __init__(self, columns, dim):
        super().__init__()
        self.motion = nn.LSTM(columns, dim, 2, batch_first=True)

    def forward(self, x):
        return self.motion(x)[0][:, -1]


class PositionEncoding(nn.Module):
    def __init__(self, dim, points):
        super().__init__()
        angle = torch.arange(points)[:, None] * torch.exp(torch.arange(0, dim, 2) * (-math.log(1e4) / dim))
        self.register_buffer("pe", torch.stack([angle.sin(), angle.cos()], -1).flatten(1)[None])
        self.dropout = nn.Dropout(0.1)

    def forward(self, x):
        return self.dropout(x + self.pe)


class MapEncoder(nn.Module):
    def __init__(self, columns, points, dim):
        super().__init__()
        inner = [nn.Linear(columns, dim // 4), nn.ReLU(), nn.Linear(dim // 4, dim // 2), nn.ReLU()]
        self.point_net = nn.Sequential(*inner, nn.Linear(dim // 2, dim))
        self.position_encode = PositionEncoding(dim, points)

    def forward(self, lines):
        """Tokens of ten points each (B, T, dim), and which are hidden."""
        batch, count, points, _ = lines.shape
        x = self.position_encode(self.point_net(lines))
        x = x.view(batch, count * points // 10, 10, -1).max(2)[0]
        return x, (lines[..., 0] == 0).view(batch, -1, 10).any(-1)


class SceneEncoder(nn.Module):
    def __init__(self, dim, layers):
        super().__init__()
        self.agent_encoder, self.ego_encoder = Actor(11, dim), Actor(7, dim)
        self.lane_encoder, self.crosswalk_encoder = MapEncoder(7, 50, dim), MapEncoder(3, 30, dim)
        layer = nn.TransformerEncoderLayer(dim, HEADS, 4 * dim, 0.1, nn.functional.gelu, batch_first=True)
        self.fusion_encoder = nn.TransformerEncoder(layer, layers, enable_nested_tensor=False)

    def forward(self, batch):
        """Present states (B, 1 + A, 5), tokens, and which are hidden."""
        ego, others = batch["ego"], batch["neighbors"]
        count = others.shape[1]
        encoded = self.agent_encoder(others.flatten(0, 1)).view(len(ego), count, -1)
        actors = torch.cat([self.ego_encoder(ego)[:, None], encoded], 1)
        current = torch.cat([ego[:, None, -1, :5], others[:, :, -1, :5]], 1)
        lanes, no_lanes = self.lane_encoder(batch["lanes"])
        crosswalks, no_crosswalks = self.crosswalk_encoder(batch["crosswalks"])
        hidden = torch.cat([current.sum(-1) == 0, no_lanes, no_crosswalks], 1)
        # Attention without any key is not defined; the original has no such samples.
        hidden[:, 0] &= ~hidden[:, : 1 + count].all(1)
        tokens = self.fusion_encoder(torch.cat([actors, lanes, crosswalks], 1), src_key_padding_mask=hidden)
        return current, tokens, hidden


class Block(nn.Module):
    """Attention and a feed-forward part; without a residual around the attention where queries and keys differ."""

    def __init__(self, name, dim, inner):
        super().__init__()
        self.name = name
        setattr(self, name, nn.MultiheadAttention(dim, HEADS, 0.1, batch_first=True))
        self.norm_1, self.norm_2 = nn.LayerNorm(dim), nn.LayerNorm(dim)
        self.ffn = nn.Sequential(nn.Linear(dim, inner), nn.GELU(), nn.Dropout(0.1), nn.Linear(inner, dim), nn.Dropout(0.1))

    def forward(self, query, memory=None, hidden=None, bias=None):
        own = memory is None
        memory = query if own else memory
        heard, _ = getattr(self, self.name)(query, memory, memory, key_padding_mask=hidden, attn_mask=bias, need_weights=False)
        x = self.norm_1(heard + query if own else heard)
        return self.norm_2(self.ffn(x) + x)


def without_attention_dropout(model):
    """Attention without dropout is computed in one kernel: on a CPU several times as fast."""
    for module in model.modules():
        if isinstance(module, nn.MultiheadAttention):
            module.dropout = 0.0


def elu_head(inputs, inner, outputs, dropout=False):
    middle = [nn.Dropout(0.1)] if dropout else []
    return nn.Sequential(nn.Linear(inputs, inner), nn.ELU(), *middle, nn.Linear(inner, outputs))
