"""The same weights under two sets of names: this code's, with fused projections, and stock transformers'."""

from __future__ import annotations

import torch
from torch import Tensor

from .shapes import Shape

TOWER = "model.vision_tower."
#: Stock tensors with a row for each token.
WORD_TABLES = ("model.language_model.embed_tokens.weight", "lm_head.weight")


def names(shape: Shape) -> list[tuple[str, list[str]]]:
    """Each of our tensors with the stock ones that it is made of, one below the other."""
    table = [
        ("tower.class_embedding", [TOWER + "embeddings.class_embedding"]),
        ("tower.patch.weight", [TOWER + "embeddings.patch_embedding.weight"]),
        ("tower.position", [TOWER + "embeddings.position_embedding.weight"]),
        ("embed.weight", ["model.language_model.embed_tokens.weight"]),
        ("norm.weight", ["model.language_model.norm.weight"]),
        ("head.weight", ["lm_head.weight"]),
    ]
    for part in ("weight", "bias"):
        # transformers spells it so.
        table.append((f"tower.pre_norm.{part}", [f"{TOWER}pre_layrnorm.{part}"]))
        for layer in range(shape.vision_layers):
            mine, theirs = f"tower.blocks.{layer}.", f"{TOWER}encoder.layers.{layer}."
            for source, name in (("norm1", "layer_norm1"), ("norm2", "layer_norm2"), ("out", "self_attn.out_proj"), ("fc1", "mlp.fc1"), ("fc2", "mlp.fc2")):
                table.append((f"{mine}{source}.{part}", [f"{theirs}{name}.{part}"]))
            table.append((f"{mine}qkv.{part}", [f"{theirs}self_attn.{name}.{part}" for name in ("q_proj", "k_proj", "v_proj")]))
        for number in (1, 2):
            table.append((f"project{number}.{part}", [f"model.multi_modal_projector.linear_{number}.{part}"]))
    for layer in range(shape.layers):
        mine, theirs = f"blocks.{layer}.", f"model.language_model.layers.{layer}."
        for source, name in (("norm1", "input_layernorm"), ("norm2", "post_attention_layernorm"), ("out", "self_attn.o_proj"), ("down", "mlp.down_proj")):
            table.append((f"{mine}{source}.weight", [f"{theirs}{name}.weight"]))
        table.append((f"{mine}qkv.weight", [f"{theirs}self_attn.{name}.weight" for name in ("q_proj", "k_proj", "v_proj")]))
        table.append((f"{mine}gate_up.weight", [f"{theirs}mlp.{name}.weight" for name in ("gate_proj", "up_proj")]))
    return table


def to_stock(ours: dict[str, Tensor], shape: Shape) -> dict[str, Tensor]:
    """Our weights under transformers' names, fused projections cut apart."""
    out: dict[str, Tensor] = {}
    for mine, theirs in names(shape):
        out.update(zip(theirs, ours[mine].chunk(len(theirs)), strict=True))
    patch = TOWER + "embeddings.patch_embedding.weight"
    out[patch] = out[patch].view(-1, 3, shape.patch, shape.patch)
    # Unused at feature layer -1, but part of the stock layout: the identity.
    out[TOWER + "post_layernorm.weight"] = torch.ones(shape.vision_width)
    out[TOWER + "post_layernorm.bias"] = torch.zeros(shape.vision_width)
    return {name: weight.clone() for name, weight in out.items()}


def from_stock(stock: dict[str, Tensor], like: dict[str, Tensor], shape: Shape) -> dict[str, Tensor]:
    """Stock weights under our names, in the forms and precision of `like`, a state of our model whose other tensors are kept."""
    out = dict(like)
    for mine, theirs in names(shape):
        joined = torch.cat([stock[name].float() for name in theirs])
        out[mine] = joined.reshape(like[mine].shape)
    return out
