"""The sizes a nano model can have.

Every shape is a stock `LlavaForConditionalGeneration`: CLIP ViT with a class token, two-layer projector, LLaMA decoder.
The patch is 16 pixels at 128 pixels, so the decoder sees 64 image tokens (the class token is dropped by the
"default" feature selection): the cheapest sight that learns, at about twice the steps of a finer patch.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass


@dataclass(frozen=True)
class Shape:
    """Sizes of tower, projector and decoder; attention heads are `width / heads` wide."""

    image_pixels: int = 128
    patch: int = 16
    vision_width: int = 192
    vision_layers: int = 4
    vision_heads: int = 3
    vision_mlp: int = 768
    width: int = 192
    layers: int = 4
    heads: int = 3
    mlp: int = 512
    context: int = 1024
    rope_theta: float = 10_000.0
    norm_eps: float = 1e-5

    @property
    def image_tokens(self) -> int:
        """Patches of an image: what replaces the `<image>` token in the decoder."""
        return (self.image_pixels // self.patch) ** 2

    def to_json(self) -> dict[str, int | float]:
        """The sizes as plain data, for the checkpoint."""
        return asdict(self)


SHAPES: dict[str, Shape] = {
    # Proves the pipeline in CI: learns the stand-in scenes on two cores in about a minute.
    "tiny-ci": Shape(
        vision_width=64, vision_layers=2, vision_heads=2, vision_mlp=256, width=64, layers=2, heads=2, mlp=192
    ),
    # What two CPU cores can train within an hour.
    "smallest": Shape(),
    # Wider decoder for an hour with idle neighbours or for a small GPU.
    "small": Shape(width=256, heads=4, mlp=688),
    # For a GPU: patch 8 (256 image tokens) sees small objects in half the steps.
    "full": Shape(
        patch=8,
        vision_width=256,
        vision_layers=6,
        vision_heads=4,
        vision_mlp=1024,
        width=384,
        layers=8,
        heads=6,
        mlp=1024,
    ),
}
