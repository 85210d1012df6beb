"""The model as it is trained: the arithmetic of Hugging Face's LLaVA with its overhead taken out.

Fused projections, no attention masks (rows are padded on the right and attention is causal, so no real token ever sees
padding), and the last decoder layer's MLP and the vocabulary projection only where there is a loss. `export.py` writes the
weights under the stock names and asserts that the stock model gives the same logits.

Shapes in the comments: B rows, L tokens, W decoder width, V vision width, P patches of an image.
"""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor, nn

from .shapes import Shape


#: Amplitude of the positions at the start, about that of a patch's embedding.
POSITION_SIZE = 0.5


class VisionBlock(nn.Module):
    """A pre-norm CLIP encoder layer (biases everywhere, GELU)."""

    def __init__(self, width: int, heads: int, mlp: int, eps: float) -> None:
        super().__init__()
        self.heads = heads
        self.norm1 = nn.LayerNorm(width, eps=eps)
        self.qkv = nn.Linear(width, 3 * width)
        self.out = nn.Linear(width, width)
        self.norm2 = nn.LayerNorm(width, eps=eps)
        self.fc1 = nn.Linear(width, mlp)
        self.fc2 = nn.Linear(mlp, width)

    def forward(self, x: Tensor) -> Tensor:
        """(B, 1 + P, V) to the same."""
        b, n, w = x.shape
        qkv = linear(norm(x, self.norm1), self.qkv).view(b, n, 3, self.heads, w // self.heads)
        q, k, v = qkv.permute(2, 0, 3, 1, 4).unbind(0)
        seen = attention(q, k, v, causal=False).transpose(1, 2).reshape(b, n, w)
        x = x + linear(seen, self.out)
        return x + linear(F.gelu(linear(norm(x, self.norm2), self.fc1)), self.fc2)


class VisionTower(nn.Module):
    """CLIP's vision transformer up to the last encoder layer's output; the post-norm belongs to the pooled vector only."""

    def __init__(self, shape: Shape) -> None:
        super().__init__()
        self.shape = shape
        width = shape.vision_width
        self.class_embedding = nn.Parameter(torch.randn(width) * 0.02)
        self.patch = nn.Linear(3 * shape.patch**2, width, bias=False)
        self.position = nn.Parameter(grid_positions(shape))
        self.pre_norm = nn.LayerNorm(width, eps=shape.norm_eps)
        self.blocks = nn.ModuleList(
            VisionBlock(width, shape.vision_heads, shape.vision_mlp, shape.norm_eps) for _ in range(shape.vision_layers)
        )

    def forward(self, patches: Tensor) -> Tensor:
        """(B, P, 3 * patch^2) normalised pixels to (B, P, V): the class token is dropped."""
        x = linear(patches, self.patch)
        start = self.class_embedding.to(x.dtype).expand(x.shape[0], 1, -1)
        x = torch.cat([start, x], dim=1) + self.position.to(x.dtype)
        x = norm(x, self.pre_norm)
        for block in self.blocks:
            x = block(x)
        return x[:, 1:]


class DecoderBlock(nn.Module):
    """A LLaMA layer: RMSNorm, rotary attention, SwiGLU, no biases."""

    def __init__(self, shape: Shape) -> None:
        super().__init__()
        width = shape.width
        self.heads = shape.heads
        self.norm1 = nn.RMSNorm(width, eps=shape.norm_eps)
        self.qkv = nn.Linear(width, 3 * width, bias=False)
        self.out = nn.Linear(width, width, bias=False)
        self.norm2 = nn.RMSNorm(width, eps=shape.norm_eps)
        self.gate_up = nn.Linear(width, 2 * shape.mlp, bias=False)
        self.down = nn.Linear(shape.mlp, width, bias=False)

    def attend(self, x: Tensor, cos: Tensor, sin: Tensor) -> Tensor:
        """Causal attention before the output projection, (B, L, W)."""
        b, n, w = x.shape
        q, k, v = self.project(x, cos, sin)
        return attention(q, k, v, causal=True).transpose(1, 2).reshape(b, n, w)

    def project(self, x: Tensor, cos: Tensor, sin: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Rotated queries and keys, and values, each (B, heads, L, W / heads)."""
        b, n, w = x.shape
        qkv = linear(norm(x, self.norm1), self.qkv).view(b, n, 3, self.heads, w // self.heads)
        q, k, v = qkv.permute(2, 0, 3, 1, 4).unbind(0)
        return rotate(q, cos, sin), rotate(k, cos, sin), v

    def finish(self, x: Tensor, seen: Tensor) -> Tensor:
        """Output projection and MLP for any selection of positions."""
        x = x + linear(seen, self.out)
        gate, up = linear(norm(x, self.norm2), self.gate_up).chunk(2, dim=-1)
        return x + linear(F.silu(gate) * up, self.down)

    def forward(self, x: Tensor, cos: Tensor, sin: Tensor) -> Tensor:
        """(B, L, W) to the same."""
        return self.finish(x, self.attend(x, cos, sin))


class NanoLlava(nn.Module):
    """Tower, projector and decoder; see the module's comment for what is left out of the arithmetic."""

    def __init__(self, shape: Shape, vocabulary: int) -> None:
        super().__init__()
        self.shape = shape
        self.vocabulary = vocabulary
        self.tower = VisionTower(shape)
        self.project1 = nn.Linear(shape.vision_width, shape.width)
        self.project2 = nn.Linear(shape.width, shape.width)
        self.embed = nn.Embedding(vocabulary, shape.width)
        self.blocks = nn.ModuleList(DecoderBlock(shape) for _ in range(shape.layers))
        self.norm = nn.RMSNorm(shape.width, eps=shape.norm_eps)
        self.head = nn.Linear(shape.width, vocabulary, bias=False)
        cos, sin = rotary(shape)
        # Colours as the dataset has them: the background becomes nearly zero, so that what is drawn stands out.
        self.register_buffer("image_mean", torch.full((3,), 0.5))
        self.register_buffer("image_std", torch.full((3,), 0.5))
        self.register_buffer("cos", cos, persistent=False)
        self.register_buffer("sin", sin, persistent=False)
        self.reset()

    def reset(self) -> None:
        """Normal weights of 0.02, residual outputs scaled down by depth, zero biases."""
        for name, module in self.named_modules():
            if isinstance(module, nn.Linear):
                depth = self.shape.vision_layers if name.startswith("tower") else self.shape.layers
                residual = name.endswith((".out", ".fc2", ".down"))
                nn.init.normal_(module.weight, std=0.02 / math.sqrt(2 * depth) if residual else 0.02)
                if module.bias is not None:
                    nn.init.zeros_(module.bias)
            elif isinstance(module, nn.Embedding):
                nn.init.normal_(module.weight, std=0.02)
        # The fan-in rule keeps a patch's embedding near the positions' size: what is where must survive the norm that follows.
        nn.init.normal_(self.tower.patch.weight, std=1 / math.sqrt(self.tower.patch.in_features))
        nn.init.normal_(self.project1.weight, std=1 / math.sqrt(self.project1.in_features))

    def image_features(self, images: Tensor, dtype: torch.dtype) -> Tensor:
        """uint8 images (B, pixels, pixels, 3) to the tower's outputs (B, P, V)."""
        return self.tower(patchify(images, self.shape, self.image_mean, self.image_std, dtype))

    def embeddings(self, ids: Tensor, features: Tensor, image_places: Tensor) -> Tensor:
        """Token embeddings (B, L, W) with the projected image features at `image_places` (flat indices into B * L, row by row)."""
        b, n = ids.shape
        text = self.embed(ids).to(features.dtype).view(b * n, -1)
        projected = linear(F.gelu(linear(features, self.project1)), self.project2)
        return text.index_copy(0, image_places, projected.reshape(-1, self.shape.width)).view(b, n, -1)

    def forward(
        self, ids: Tensor, images: Tensor, image_places: Tensor, wanted: Tensor, dtype: torch.dtype = torch.float32
    ) -> tuple[Tensor, Tensor]:
        """Logits (wanted, vocabulary) in f32 at the flat positions `wanted` of B * L, and the tower's outputs (B, P, V)."""
        features = self.image_features(images, dtype)
        x = self.embeddings(ids, features, image_places)
        cos, sin = self.cos[: ids.shape[1]].to(dtype), self.sin[: ids.shape[1]].to(dtype)
        for block in self.blocks[:-1]:
            x = block(x, cos, sin)
        last = self.blocks[-1]
        seen = last.attend(x, cos, sin).view(-1, self.shape.width)[wanted]
        x = last.finish(x.view(-1, self.shape.width)[wanted], seen)
        return linear(norm(x, self.norm), self.head).float(), features


def grid_positions(shape: Shape) -> Tensor:
    """Start of the learned positions, (1 + P, V): sines and cosines of row and column (zero for the class token).

    Random small positions drown in the patch's own embedding, and the tower then takes long to learn where anything is.
    """
    n, quarter = shape.image_pixels // shape.patch, shape.vision_width // 4
    rates = 1.0 / 100.0 ** (torch.arange(quarter, dtype=torch.float32) / quarter)
    waves = torch.outer(torch.arange(n, dtype=torch.float32), rates)
    along = torch.cat([waves.sin(), waves.cos()], dim=1)
    rows, columns = along[:, None].expand(n, n, -1), along[None, :].expand(n, n, -1)
    grid = torch.cat([rows, columns], dim=-1).reshape(n * n, 4 * quarter)
    return torch.cat([torch.zeros(1, 4 * quarter), grid]) * POSITION_SIZE


def patchify(images: Tensor, shape: Shape, mean: Tensor, std: Tensor, dtype: torch.dtype) -> Tensor:
    """uint8 (B, pixels, pixels, 3) to normalised (B, P, 3 * patch^2): channel, row, column, as CLIP's convolution has them."""
    b, p, n = images.shape[0], shape.patch, shape.image_pixels // shape.patch
    normal = ((images.float() / 255 - mean) / std).to(dtype)
    return normal.view(b, n, p, n, p, 3).permute(0, 1, 3, 5, 2, 4).reshape(b, n * n, 3 * p * p)


def linear(x: Tensor, layer: nn.Linear) -> Tensor:
    """The layer in the activations' precision; its master weights stay f32."""
    bias = None if layer.bias is None else layer.bias.to(x.dtype)
    return F.linear(x, layer.weight.to(x.dtype), bias)


def norm(x: Tensor, layer: nn.LayerNorm | nn.RMSNorm) -> Tensor:
    """Layer or RMS norm, statistics in f32, result in the activations' precision."""
    if isinstance(layer, nn.LayerNorm):
        return F.layer_norm(x.float(), layer.normalized_shape, layer.weight, layer.bias, layer.eps).to(x.dtype)
    y = x.float()
    return (y * torch.rsqrt(y.square().mean(-1, keepdim=True) + layer.eps) * layer.weight).to(x.dtype)


def attention(q: Tensor, k: Tensor, v: Tensor, *, causal: bool) -> Tensor:
    """Scaled dot-product attention over (B, heads, L, head).

    Written out on the CPU, where the fused kernel's backward pass in bf16 is slower than plain matrix products at these lengths.
    """
    if q.is_cuda:
        return F.scaled_dot_product_attention(q, k, v, is_causal=causal)
    scores = (q * q.shape[-1] ** -0.5) @ k.transpose(-1, -2)
    if causal:
        n = q.shape[-2]
        scores = scores + torch.full((n, n), float("-inf"), dtype=scores.dtype, device=scores.device).triu(1)
    return scores.softmax(-1) @ v


def rotary(shape: Shape) -> tuple[Tensor, Tensor]:
    """Cosines and sines (context, head / 2) of LLaMA's rotary embedding."""
    size = shape.width // shape.heads
    rates = 1.0 / shape.rope_theta ** (torch.arange(0, size, 2, dtype=torch.float32) / size)
    angles = torch.outer(torch.arange(shape.context, dtype=torch.float32), rates)
    return angles.cos(), angles.sin()


def rotate(x: Tensor, cos: Tensor, sin: Tensor) -> Tensor:
    """Rotates the halves of each head, as the Hugging Face layout has them."""
    a, b = x.chunk(2, dim=-1)
    return torch.cat([a * cos - b * sin, b * cos + a * sin], dim=-1)
