"""Trains a language model on a dataset of `planagent dataset --for messages` with TRL, and writes a PEFT adapter.

    planagent dataset --for messages --out data/messages --states 2000 --validation 200 --model MODEL
    python examples/teach/train.py sft  --data data/messages --model FOLDER --out adapter
    python examples/teach/train.py dpo  --data data/messages --model FOLDER --out adapter
    python examples/teach/train.py grpo --data data/messages --model FOLDER --out adapter --steps 10
    planagent simulate --model FOLDER --adapter adapter

`sft` learns the answers of all rounds, `dpo` prefers accepted codes over refused ones, and `grpo` is rewarded by the simulator. A
model that reads text alone gets the chats without their pictures. Needs trl and peft; `grpo` also needs the Python package planagent.
"""

import argparse
from pathlib import Path

import datasets
from peft import LoraConfig
from transformers import AutoConfig, AutoModelForCausalLM, AutoModelForImageTextToText, AutoProcessor, AutoTokenizer
from trl import DPOConfig, DPOTrainer, GRPOConfig, GRPOTrainer, SFTConfig, SFTTrainer

#: Columns of each method, beside the pictures.
COLUMNS = {"sft": ("messages", ["messages"]), "dpo": ("preferences", ["prompt", "chosen", "rejected"]), "grpo": ("codes", ["prompt", "state"])}
#: The place of a picture in a prompt. TRL finds the place by itself.
PLACE = "<image>\n"


def opened(folder: Path, method: str, split: str, sees: bool) -> datasets.Dataset:
    """The rows that a method learns from, as TRL reads them."""
    file, columns = COLUMNS[method]
    rows = datasets.load_dataset("json", data_files={split: str(folder / file / split / "*.jsonl")}, split=split)
    if method == "grpo":
        # All tried codes of a state have one prompt.
        rows = rows.filter(lambda row: row["best"])
    has_pictures = sees and "images" in rows.column_names
    rows = rows.select_columns([*columns, *(["images"] if has_pictures else [])])

    def without_place(row: dict) -> dict:
        changed = {}
        for column in columns:
            if column != "state":
                changed[column] = [{**turn, "content": turn["content"].removeprefix(PLACE)} for turn in row[column]]
        if has_pictures:
            changed["images"] = [str(folder / path) for path in row["images"]]
        return changed

    rows = rows.map(without_place)
    return rows.cast_column("images", datasets.List(datasets.Image())) if has_pictures else rows


def simulator_reward(completions: list, state: list[dict], **_: object) -> list[float]:
    """The value of the search for each answer: what `planagent dataset` writes for a tried code."""
    import planagent

    answers = [turns[-1]["content"] if isinstance(turns, list) else turns for turns in completions]
    return planagent.reward(state, answers).value.tolist()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("method", choices=COLUMNS)
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--model", required=True, help="a folder of transformers")
    parser.add_argument("--out", type=Path, required=True, help="folder of the adapter")
    parser.add_argument("--steps", type=int, default=-1)
    parser.add_argument("--batch", type=int, default=4)
    parser.add_argument("--rate", type=float, default=2e-4)
    parser.add_argument("--rank", type=int, default=16)
    parser.add_argument("--cpu", action="store_true")
    chosen = parser.parse_args()
    sees = hasattr(AutoConfig.from_pretrained(chosen.model), "vision_config")
    model = (AutoModelForImageTextToText if sees else AutoModelForCausalLM).from_pretrained(chosen.model, dtype="float32")
    processor = (AutoProcessor if sees else AutoTokenizer).from_pretrained(chosen.model)
    shared = {
        "output_dir": str(chosen.out),
        "max_steps": chosen.steps,
        "num_train_epochs": 1,
        "per_device_train_batch_size": chosen.batch,
        "learning_rate": chosen.rate,
        "use_cpu": chosen.cpu,
        "bf16": not chosen.cpu,
        "logging_steps": 1,
        "save_strategy": "no",
        "report_to": [],
    }
    trained = {
        "model": model,
        "processing_class": processor,
        "train_dataset": opened(chosen.data, chosen.method, "train", sees),
        "peft_config": LoraConfig(r=chosen.rank, lora_alpha=2 * chosen.rank, target_modules="all-linear", task_type="CAUSAL_LM"),
    }
    if chosen.method == "sft":
        trainer = SFTTrainer(args=SFTConfig(max_length=None, **shared), **trained)
    elif chosen.method == "dpo":
        trainer = DPOTrainer(args=DPOConfig(max_length=None, **shared), **trained)
    else:
        of_grpo = GRPOConfig(num_generations=chosen.batch, max_completion_length=64, **shared)
        trainer = GRPOTrainer(args=of_grpo, reward_funcs=simulator_reward, **trained)
    trainer.train()
    trainer.save_model(chosen.out)


if __name__ == "__main__":
    main()
