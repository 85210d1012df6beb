"""Trains a LoRA adapter on chats of `planagent dataset --for messages` with PyTorch, transformers and PEFT alone.

    planagent dataset --for messages --out data/messages --states 10000 --validation 500 --model nano --prompt-set brief \
        --agents gpt-driver,dilu
    python examples/teach/lora.py --data data/messages --model SmolLM2-135M-Instruct.Q4_1.gguf --out adapter
    planagent simulate --model SmolLM2-135M-Instruct.Q4_1.gguf --prompt-set brief --adapter adapter

Only the answers are learned. The command resumes a run that was interrupted. A folder of LLaVA also learns from the pictures, and its
projector is trained whole; `llava.py` makes such a folder of a language model and a vision tower. A model that reads text alone gets the
chats without their picture and its legend. Needs torch, transformers, peft and safetensors, and gguf for a GGUF file.
"""

import argparse
import json
import math
import re
import time
import types
from dataclasses import dataclass
from pathlib import Path

import torch
from peft import LoraConfig, get_peft_model, get_peft_model_state_dict, set_peft_model_state_dict
from peft.tuners.lora import Linear as LoraLinear
from safetensors.torch import load_file, save_file
from transformers import AutoConfig, AutoModelForCausalLM, AutoModelForImageTextToText, AutoProcessor, AutoTokenizer

#: The place of a picture in a prompt of the dataset.
PLACE = "<image>\n"
#: What the system prompt says of the picture, which a model without one is not told.
LEGEND = re.compile(r" The picture shows it from above: .*? the longer, the faster\.")
#: Label of a token that is not learned.
IGNORED = -100
#: Share of the steps in which the rate grows.
WARM_UP = 0.05
#: Seconds between two checkpoints.
CHECKPOINT_S = 60.0
#: Layers that get an adapter: all linear ones of the decoder.
LAYERS = r".*(q_proj|k_proj|v_proj|o_proj|gate_proj|up_proj|down_proj)"
#: The part of a LLaVA that is trained whole.
PROJECTOR = "multi_modal_projector"


@dataclass
class Chat:
    """The tokens of a chat, which of them are learned, its picture, and how much it counts."""

    ids: list[int]
    labels: list[int]
    picture: Path | None
    weight: float = 1.0


def opened(path: str, attention: str, dtype: torch.dtype):
    """The model, what makes tokens of text, and what makes pixels of a picture. The base has numbers of `dtype` and does
    not change; those of the adapter are of 32 bits."""
    if path.endswith(".gguf"):
        folder, file = str(Path(path).parent), Path(path).name
        tokenizer = AutoTokenizer.from_pretrained(folder, gguf_file=file)
        model = AutoModelForCausalLM.from_pretrained(folder, gguf_file=file, dtype=dtype, attn_implementation=attention)
        return model, tokenizer, None
    if hasattr(AutoConfig.from_pretrained(path), "vision_config"):
        processor = AutoProcessor.from_pretrained(path)
        model = AutoModelForImageTextToText.from_pretrained(path, dtype=dtype, attn_implementation=attention)
        return model, processor.tokenizer, processor
    model = AutoModelForCausalLM.from_pretrained(path, dtype=dtype, attn_implementation=attention)
    return model, AutoTokenizer.from_pretrained(path), None


def chats(data: Path, name: str, split: str, tokenizer, processor, limit: int | None) -> list[Chat]:
    """The chats of a split in the order of its files."""
    lines = [line for file in sorted((data / name / split).glob("*.jsonl")) for line in file.read_text().splitlines()]
    place = PLACE
    if processor is not None:
        # One token of the place stands for each vector of the picture.
        place = processor.image_token * processor_tokens(processor) + "\n"
    found = []
    for line in lines[:limit]:
        row = json.loads(line)
        messages = row["messages"]
        if processor is None:
            messages[0]["content"] = LEGEND.sub("", messages[0]["content"])
        for turn in messages:
            turn["content"] = turn["content"].replace(PLACE, place if processor is not None else "")
        picture = data / row["images"][0] if processor is not None and row.get("images") else None
        chat = tokens(messages, tokenizer, picture)
        # A lesson counts as its chance among those of the state, and as what its decisions gain.
        chat.weight = row.get("chance", 1.0) * row.get("weight", 1.0)
        found.append(chat)
    return found


def processor_tokens(processor) -> int:
    """Vectors of a picture behind the projector."""
    side = processor.image_processor.size
    side = side.get("height") or side["shortest_edge"]
    return (side // processor.patch_size) ** 2


def tokens(messages: list[dict], tokenizer, picture: Path | None) -> Chat:
    """A chat as the model reads it: the template's text up to each answer is not learned, the answer with its end is."""
    ids, labels, done = [], [], ""
    for index, turn in enumerate(messages):
        if turn["role"] != "assistant":
            continue
        before = tokenizer.apply_chat_template(messages[:index], tokenize=False, add_generation_prompt=True)
        after = tokenizer.apply_chat_template(messages[: index + 1], tokenize=False)
        if not (before.startswith(done) and after.startswith(before)):
            raise SystemExit("the chat template changes earlier turns, so answers have no place of their own")
        asked = tokenizer(before[len(done) :], add_special_tokens=False)["input_ids"]
        # Behind the end of an answer some templates write a line break, which the model never writes.
        answer = tokenizer(after[len(before) :].rstrip("\n"), add_special_tokens=False)["input_ids"]
        ids += asked + answer
        labels += [IGNORED] * len(asked) + answer
        done = after[: len(after.rstrip("\n"))]
    return Chat(ids, labels, picture)


def batch(rows: list[Chat], processor, device: str, dtype: torch.dtype) -> dict:
    """Chats side by side. What is added stands behind them, where a causal model cannot see it."""
    width = max(len(row.ids) for row in rows)
    pad = [(row, width - len(row.ids)) for row in rows]
    made = {
        "input_ids": torch.tensor([row.ids + [0] * more for row, more in pad], device=device),
        "labels": torch.tensor([row.labels + [IGNORED] * more for row, more in pad], device=device),
        "weights": torch.tensor([row.weight for row in rows], device=device),
    }
    if processor is not None:
        from PIL import Image

        pictures = [Image.open(row.picture) for row in rows]
        made["pixel_values"] = processor.image_processor(pictures, return_tensors="pt")["pixel_values"].to(device, dtype)
    return made


def weight_of(rows: list[Chat]) -> float:
    """Sum of the weights of all learned tokens."""
    return max(1e-6, sum(row.weight * sum(label != IGNORED for label in row.labels[1:]) for row in rows))


def loss_of(model, made: dict, weight: float) -> torch.Tensor:
    """Weighted cross entropy of the learned tokens over a weight. The output layer sees these tokens alone, since its
    vocabulary is large."""
    labels = made["labels"]
    inner = model.get_base_model()
    inputs = {key: value for key, value in made.items() if key not in ("labels", "weights")}
    hidden = inner.model(**inputs, use_cache=False).last_hidden_state
    learned = labels[:, 1:] != IGNORED
    logits = inner.lm_head(hidden[:, :-1][learned])
    losses = torch.nn.functional.cross_entropy(logits.float(), labels[:, 1:][learned], reduction="none")
    weights = made["weights"][:, None].expand(-1, learned.shape[1])[learned]
    return (losses * weights).sum() / weight


def batches(rows: list[Chat], size: int, seed: int, epoch: int) -> list[list[Chat]]:
    """The batches of an epoch, in the same order in each run. Chats of one batch are about equally long."""
    random = torch.Generator().manual_seed(seed * 1000 + epoch)
    order = torch.randperm(len(rows), generator=random).tolist()
    group = 32 * size
    made = []
    for start in range(0, len(order), group):
        part = sorted(order[start : start + group], key=lambda row: len(rows[row].ids))
        made += [[rows[row] for row in part[at : at + size]] for at in range(0, len(part), size)]
    return [made[at] for at in torch.randperm(len(made), generator=random).tolist()]


def parts(rows: list[Chat], size: int) -> list[list[Chat]]:
    return [rows[at : at + size] for at in range(0, len(rows), size)]


def adapted(layer, x: torch.Tensor) -> torch.Tensor:
    """A layer with its adapter, in the base's numbers: PEFT's own layer would make 32-bit copies of all activations."""
    base, low, high = layer.base_layer, layer.lora_A["default"].weight, layer.lora_B["default"].weight
    change = torch.nn.functional.linear(torch.nn.functional.linear(x, low.to(x.dtype)), high.to(x.dtype))
    return torch.nn.functional.linear(x, base.weight, base.bias) + layer.scaling["default"] * change


def rate_at(step: int, steps: int, rate: float) -> float:
    """Grows, then falls to nothing along a half cosine."""
    warm = max(1, int(WARM_UP * steps))
    if step < warm:
        return rate * (step + 1) / warm
    return rate * 0.5 * (1.0 + math.cos(math.pi * (step - warm) / max(1, steps - warm)))


def evaluated(model, rows: list[Chat], size: int, processor, device: str, dtype: torch.dtype) -> float:
    model.eval()
    with torch.no_grad():
        whole = weight_of(rows)
        loss = sum(loss_of(model, batch(part, processor, device, dtype), whole).item() for part in parts(rows, size))
    model.train()
    return loss


def saved(model, base: str, out: Path) -> None:
    """The adapter as PEFT writes it, in 16 bits."""
    out.mkdir(parents=True, exist_ok=True)
    config = model.peft_config["default"]
    # transformers knows the folder of a GGUF file alone.
    config.base_model_name_or_path = base
    config.save_pretrained(out)
    state = {key: value.detach().to("cpu", torch.float16).contiguous() for key, value in get_peft_model_state_dict(model).items()}
    save_file(state, out / "adapter_model.safetensors", metadata={"format": "pt"})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--chats", default="messages", help="folder of the chats: messages, lessons, or that of another agent")
    parser.add_argument("--model", required=True, help="a folder of transformers, or a GGUF file")
    parser.add_argument("--from-adapter", type=Path, help="adapter to go on from")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--states", type=int, help="chats to learn from, at most")
    parser.add_argument("--validation", type=int, default=200, help="chats to say the loss of, at most")
    parser.add_argument("--epochs", type=int, default=2)
    parser.add_argument("--batch", type=int, default=32, help="chats of a step")
    parser.add_argument("--together", type=int, help="chats computed at a time: less memory, the same step (a GPU: all, else 4)")
    parser.add_argument("--dtype", choices=["float32", "bfloat16"], help="numbers of the base; bfloat16 on a GPU, else float32")
    parser.add_argument("--rate", type=float, default=5e-4)
    parser.add_argument("--rank", type=int, default=8)
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args()
    torch.manual_seed(chosen.seed)
    device = "cuda" if torch.cuda.is_available() else "cpu"
    together = chosen.together or (chosen.batch if device == "cuda" else 4)
    dtype = getattr(torch, chosen.dtype or ("bfloat16" if device == "cuda" else "float32"))
    base, tokenizer, processor = opened(chosen.model, "sdpa", dtype)
    train = chats(chosen.data, chosen.chats, "train", tokenizer, processor, chosen.states)
    validation = chats(chosen.data, chosen.chats, "validation", tokenizer, processor, chosen.validation)
    config = LoraConfig(
        r=chosen.rank,
        lora_alpha=2 * chosen.rank,
        target_modules=LAYERS if processor is None else r".*language_model" + LAYERS,
        modules_to_save=None if processor is None else [PROJECTOR],
        task_type="CAUSAL_LM",
    )
    model = get_peft_model(base, config).to(device)
    if chosen.from_adapter:
        set_peft_model_state_dict(model, load_file(chosen.from_adapter / "adapter_model.safetensors"))
    for module in model.modules():
        if isinstance(module, LoraLinear):
            module.forward = types.MethodType(adapted, module)
    learned = [weight for weight in model.parameters() if weight.requires_grad]
    optimizer = torch.optim.AdamW(learned, lr=chosen.rate, weight_decay=0.0)
    per_epoch = math.ceil(len(train) / chosen.batch)
    steps, step = chosen.epochs * per_epoch, 0
    checkpoint = chosen.out / "checkpoint.pt"
    history, seconds, before = [], 0.0, None
    if checkpoint.exists():
        state = torch.load(checkpoint, weights_only=True)
        step, history, seconds, before = state["step"], state["history"], state["seconds"], state["before"]
        set_peft_model_state_dict(model, state["adapter"])
        optimizer.load_state_dict(state["optimizer"])
    else:
        before = evaluated(model, validation, together, processor, device, dtype)
    print(f"{len(train)} chats, {sum(len(row.ids) for row in train)} tokens, {steps} steps; validation loss {before}", flush=True)
    began = last = time.monotonic()
    while step < steps:
        epoch, at = divmod(step, per_epoch)
        for rows in batches(train, chosen.batch, chosen.seed, epoch)[at:]:
            for group in optimizer.param_groups:
                group["lr"] = rate_at(step, steps, chosen.rate)
            whole, loss = weight_of(rows), 0.0
            for part in parts(rows, together):
                share = loss_of(model, batch(part, processor, device, dtype), whole)
                share.backward()
                loss += share.item()
            torch.nn.utils.clip_grad_norm_(learned, 1.0)
            optimizer.step()
            optimizer.zero_grad(set_to_none=True)
            step += 1
            if step % 20 == 0:
                history.append([step, round(loss, 4)])
                print(f"step {step} of {steps}: loss {history[-1][1]}, {time.monotonic() - began:.0f} s", flush=True)
            if time.monotonic() - last > CHECKPOINT_S:
                last = time.monotonic()
                chosen.out.mkdir(parents=True, exist_ok=True)
                torch.save(
                    {
                        "step": step,
                        "history": history,
                        "seconds": seconds + last - began,
                        "before": before,
                        "adapter": get_peft_model_state_dict(model),
                        "optimizer": optimizer.state_dict(),
                    },
                    checkpoint,
                )
    after = evaluated(model, validation, together, processor, device, dtype)
    saved(model, chosen.model, chosen.out)
    report = {
        "arguments": {key: str(value) for key, value in vars(chosen).items()},
        "chats": len(train),
        "tokens": sum(len(row.ids) for row in train),
        "learned_tokens": sum(label != IGNORED for row in train for label in row.labels),
        "steps": steps,
        "seconds": round(seconds + time.monotonic() - began, 1),
        "device": torch.cuda.get_device_name() if device == "cuda" else "cpu",
        "validation_loss": {"before": before, "after": after},
        "history": history,
    }
    (chosen.out / "training.json").write_text(json.dumps(report, indent=1) + "\n")
    checkpoint.unlink(missing_ok=True)
    print(f"validation loss {before} to {after} in {report['seconds']} s", flush=True)


if __name__ == "__main__":
    main()
