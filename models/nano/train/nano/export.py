"""Writes the trained weights as a Hugging Face folder, and proves that stock transformers computes the same.

The folder opens with `LlavaForConditionalGeneration.from_pretrained` and `AutoProcessor.from_pretrained`. `vision_feature_layer` is -1: the last
encoder layer's output without CLIP's post-norm (which only ever touches the pooled class token), as the tower here computes it.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import torch
from PIL import Image
from safetensors.torch import save_file
from tokenizers import Tokenizer
from transformers import AutoProcessor, CLIPVisionConfig, GenerationConfig, LlamaConfig, LlavaConfig, LlavaForConditionalGeneration

from . import corpus as corpora
from . import tokenizer as tokenizers
from .batches import Collator
from .chat import ASSISTANT, BOS, EOS, IMAGE, PAD, TEMPLATE
from .loop import load_model
from .model import NanoLlava
from .samples import plain
from .shapes import Shape
from .train import PROMPTS
from .weights import to_stock

#: Largest difference of logits between this code and transformers, as a share of the largest logit.
TOLERANCE = 1e-5
#: Longest answers of the compact prompt sets, tokens a round, with room.
LONGEST_ANSWERS = {"understanding": 96, "instruction": 32, "code": 48}
#: Largest file that may ship, bytes.
LARGEST_FILE = 95 * 1024 * 1024


def config_of(shape: Shape, tokenizer: Tokenizer) -> LlavaConfig:
    """The stock configuration of a shape."""
    vision = CLIPVisionConfig(
        hidden_size=shape.vision_width, intermediate_size=shape.vision_mlp, num_hidden_layers=shape.vision_layers,
        num_attention_heads=shape.vision_heads, image_size=shape.image_pixels, patch_size=shape.patch,
        projection_dim=shape.vision_width, hidden_act="gelu", layer_norm_eps=shape.norm_eps, attention_dropout=0.0,
    )  # fmt: skip
    ids = {name: tokenizer.token_to_id(token) for name, token in (("bos_token_id", BOS), ("eos_token_id", EOS), ("pad_token_id", PAD))}
    text = LlamaConfig(
        hidden_size=shape.width, intermediate_size=shape.mlp, num_hidden_layers=shape.layers, num_attention_heads=shape.heads,
        num_key_value_heads=shape.heads, head_dim=shape.width // shape.heads, vocab_size=tokenizer.get_vocab_size(),
        max_position_embeddings=shape.context, rms_norm_eps=shape.norm_eps, rope_theta=shape.rope_theta,
        tie_word_embeddings=False, attention_bias=False, mlp_bias=False, **ids,
    )  # fmt: skip
    image = tokenizer.token_to_id(IMAGE)
    return LlavaConfig(
        vision_config=vision, text_config=text, image_token_id=image, image_token_index=image, projector_hidden_act="gelu",
        vision_feature_layer=-1, vision_feature_select_strategy="default", image_seq_length=shape.image_tokens,
        multimodal_projector_bias=True, tie_word_embeddings=False, **ids,
    )  # fmt: skip


def write_processing(folder: Path, model: NanoLlava, tokenizer: Tokenizer) -> None:
    """Tokenizer, chat template and image processor files."""
    shape = model.shape
    mean, std = ([round(v, 3) for v in buffer.tolist()] for buffer in (model.image_mean, model.image_std))
    tokenizer.save(str(folder / "tokenizer.json"))
    files = {
        "tokenizer_config.json": {
            "tokenizer_class": "PreTrainedTokenizerFast", "bos_token": BOS, "eos_token": EOS, "pad_token": PAD, "image_token": IMAGE,
            "add_bos_token": False, "add_prefix_space": False, "clean_up_tokenization_spaces": False, "padding_side": "left",
            "model_max_length": shape.context, "processor_class": "LlavaProcessor", "chat_template": TEMPLATE,
        },
        "preprocessor_config.json": {
            "image_processor_type": "CLIPImageProcessor", "processor_class": "LlavaProcessor", "do_convert_rgb": True,
            "do_resize": True, "size": {"height": shape.image_pixels, "width": shape.image_pixels}, "resample": 3,
            # The resize is exact, so there is nothing to crop.
            "do_center_crop": False, "crop_size": {"height": shape.image_pixels, "width": shape.image_pixels},
            "do_rescale": True, "rescale_factor": 1 / 255, "do_normalize": True, "image_mean": mean, "image_std": std,
        },
        "processor_config.json": {
            "processor_class": "LlavaProcessor", "patch_size": shape.patch, "image_token": IMAGE,
            # The class token, which the "default" selection drops again.
            "num_additional_image_tokens": 1, "vision_feature_select_strategy": "default",
        },
    }  # fmt: skip
    for name, content in files.items():
        (folder / name).write_text(json.dumps(content, indent=2) + "\n")
    (folder / "chat_template.jinja").write_text(TEMPLATE)


def write_asking(out: Path, folder: Path) -> None:
    """How planagent asks the model: with the prompts of its dataset. A stand-in dataset names none."""
    prompts = out / PROMPTS
    name = json.loads(prompts.read_text())["prompt_set"] if prompts.exists() else None
    if name is None:
        return
    asking = {"prompt_set": name}
    if name in ("compact", "compact-2"):
        asking["generation"] = {"max_new_tokens": LONGEST_ANSWERS, "sampling": "greedy"}
    (folder / "planagent.json").write_text(json.dumps(asking, indent=2) + "\n")


def write(out: Path, folder: Path, dtype: str, reference: Path | None) -> float:
    """Exports the run folder's checkpoint, checks it, and writes the parity reference if asked; the largest difference of logits."""
    model, _ = load_model(out / "checkpoint.pt")
    tokenizer = tokenizers.load(out / "tokenizer.json")
    folder.mkdir(parents=True, exist_ok=True)
    config = config_of(model.shape, tokenizer)
    stored = getattr(torch, dtype)
    weights = {name: weight.to(stored) for name, weight in to_stock(model.state_dict(), model.shape).items()}
    stock = LlavaForConditionalGeneration(config)
    missing = stock.load_state_dict({name: weight.float() for name, weight in weights.items()}, strict=True)
    assert not missing.missing_keys and not missing.unexpected_keys
    stock.to(stored).save_pretrained(folder, max_shard_size="90MB")
    GenerationConfig(
        bos_token_id=config.text_config.bos_token_id, eos_token_id=config.text_config.eos_token_id,
        pad_token_id=config.text_config.pad_token_id, do_sample=False, max_new_tokens=128,
    ).save_pretrained(folder)  # fmt: skip
    write_processing(folder, model, tokenizer)
    write_asking(out, folder)
    for file in folder.iterdir():
        # safetensors makes files that only their owner can read.
        file.chmod(0o644)
    large = [file.name for file in folder.iterdir() if file.stat().st_size > LARGEST_FILE]
    if large:
        raise ValueError(f"too large to ship: {', '.join(large)}")
    return check(out, folder, model, tokenizer, stored, reference)


@torch.no_grad()
def check(out: Path, folder: Path, model: NanoLlava, tokenizer: Tokenizer, stored: torch.dtype, reference: Path | None) -> float:
    """Opens the folder with stock transformers: text, image and logits must be what training used."""
    processor = AutoProcessor.from_pretrained(folder)
    stock = LlavaForConditionalGeneration.from_pretrained(folder, dtype=torch.float32).eval()
    for parameter in model.parameters():
        parameter.copy_(parameter.to(stored).float())
    corpus = corpora.load(out / "cache" / "validation")
    collator = Collator(corpus, tokenizer.token_to_id(IMAGE), model.shape.image_tokens, 1.0)
    worst = 0.0
    for row in range(min(3, len(corpus))):
        text = tokenizer.decode(corpus.row(row).tolist(), skip_special_tokens=False)
        picture = Image.fromarray(corpus.images[row])
        given = processor(images=picture, text=text, return_tensors="pt")
        batch = collator.collate([plain(corpus, row)])
        assert given["input_ids"].tolist() == batch.ids.tolist(), "transformers' processor gives other tokens"
        theirs = stock(**given).logits[0]
        mine, _ = model(batch.ids, batch.images, batch.image_places, torch.arange(batch.ids.shape[1]))
        worst = max(worst, float((theirs - mine).abs().max() / theirs.abs().max()))
        if reference is not None and row == 0:
            write_reference(reference, picture, given["input_ids"][0], given["pixel_values"], theirs, tokenizer)
    print(f"transformers' logits differ by {worst:.2e} of the largest", file=sys.stderr)
    assert worst <= TOLERANCE, f"transformers' logits differ by {worst:.2e} of the largest"
    return worst


def write_reference(folder: Path, picture: Image.Image, ids: Tensor, pixels: Tensor, logits: Tensor, tokenizer: Tokenizer) -> None:
    """What another implementation needs to compare itself: image, ids, and transformers' logits at the last positions.

    `last` are the positions of the last 16 tokens' logits; `first_answer` the position whose logits choose the first answer's token.
    """
    folder.mkdir(parents=True, exist_ok=True)
    picture.save(folder / "image.png")
    last = torch.arange(len(ids) - 16, len(ids))
    first = torch.tensor([ids.tolist().index(tokenizer.token_to_id(ASSISTANT))])
    tensors = {
        "input_ids": ids.to(torch.int64), "last": last, "logits": logits[last].float(), "first_answer": first,
        "first_answer_logits": logits[first].float(), "pixel_corner": pixels[0, :, :4, :4].float(),
    }  # fmt: skip
    save_file({name: tensor.contiguous() for name, tensor in tensors.items()}, folder / "reference.safetensors")
