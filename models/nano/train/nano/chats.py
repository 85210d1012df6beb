"""What any chat model answers on validation states, question by question.

`evaluate.py` does this for a run of this folder. Here the model is a folder of transformers or a GGUF file, with an adapter or without, and the
states are chats of `planagent dataset --for messages` whose answers have the form `key=value`. The report is the same. States that were asked
stay in a file, so that an interrupted evaluation goes on.
"""

from __future__ import annotations

import json
import re
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from transformers import AutoConfig, AutoModelForCausalLM, AutoModelForImageTextToText, AutoProcessor, AutoTokenizer

from .evaluate import CODE, markdown, other_images, score

if TYPE_CHECKING:
    from PIL import Image

#: The place of a picture in a prompt of the dataset.
PLACE = "<image>\n"
#: An answer's key and value.
SLOT = re.compile(r"(\w+)=([^\s,()]+)")
#: Names of the rounds, the last of which is the planner code.
ROUNDS = ("scene", "instruction", "code")
#: Stands for the value of a hole while the chat template is applied.
HOLE = "\u241e"


@dataclass
class State:
    """A chat with holes: given texts, and between them the question of each hole. `labels` are the answers of the search."""

    name: str
    texts: list[str]
    questions: list[str]
    labels: dict[str, str]
    picture: Path | None


@dataclass
class Reader:
    """A model, its tokenizer, and what makes pixels of a picture where it sees."""

    model: torch.nn.Module
    tokenizer: object
    processor: object | None

    @classmethod
    def open(cls, path: str, adapter: Path | None, dtype: torch.dtype) -> Reader:
        """Opens a folder of transformers or a GGUF file, and merges an adapter of PEFT."""
        more = {"gguf_file": Path(path).name} if path.endswith(".gguf") else {}
        source = str(Path(path).parent) if more else path
        sees = not more and hasattr(AutoConfig.from_pretrained(source), "vision_config")
        kind = AutoModelForImageTextToText if sees else AutoModelForCausalLM
        model = kind.from_pretrained(source, dtype=dtype, **more)
        if adapter is not None:
            from peft import PeftModel

            model = PeftModel.from_pretrained(model, adapter).merge_and_unload()
        processor = AutoProcessor.from_pretrained(source) if sees else None
        tokenizer = processor.tokenizer if processor is not None else AutoTokenizer.from_pretrained(source, **more)
        return cls(model.to(dtype).eval(), tokenizer, processor)

    def ids(self, text: str) -> list[int]:
        """The tokens of a text, with one place for each vector of the picture."""
        shown = ""
        if self.processor is not None:
            size = self.processor.image_processor.size
            side = (size.get("height") or size["shortest_edge"]) // self.processor.patch_size
            shown = self.processor.image_token * side**2 + "\n"
        return self.tokenizer(text.replace(PLACE, shown), add_special_tokens=False)["input_ids"]

    def check_pieces(self, state: State) -> None:
        """Values are asked for as tokens of their own, so those of the whole chat must be the same."""
        values = [state.labels[question] for question in state.questions] + [""]
        pieces = [self.ids(text) + self.ids(value) for text, value in zip(state.texts, values, strict=True)]
        whole = "".join(text + value for text, value in zip(state.texts, values, strict=True))
        if self.ids(whole) != sum(pieces, []):
            raise ValueError("this tokenizer joins values with the text beside them, so they cannot be asked for one by one")

    def pixels(self, picture: Image.Image) -> torch.Tensor:
        """The picture as the vision tower takes it, (1, 3, height, width)."""
        return self.processor.image_processor([picture], return_tensors="pt")["pixel_values"].to(self.model.dtype)

    @torch.inference_mode()
    def answers(self, state: State, texts: list[str], picture: Image.Image | None, choices: dict[str, list[str]]) -> dict[str, str]:
        """The most probable value of each question, behind the model's own earlier answers."""
        seen = {"pixel_values": self.pixels(picture)} if picture is not None else {}
        given = [self.ids(text) for text in texts]
        out = self.model(torch.tensor([given[0]]), **seen, use_cache=True, logits_to_keep=1)
        found = {}
        for hole, question in enumerate(state.questions):
            values = choices[question]
            rows = [self.ids(value) for value in values]
            follow = given[hole + 1][0]
            said: list[int] = []
            read = 0
            # Token by token, as under the grammar: among the values that may still come, and the text behind those that have ended.
            while True:
                going = [row for row in rows if row[: len(said)] == said]
                tokens = sorted({row[len(said)] if len(row) > len(said) else follow for row in going})
                if len(tokens) > 1 and read < len(said):
                    out, read = self.step(out, said[read:]), len(said)
                token = tokens[int(out.logits[0, -1][tokens].argmax())] if len(tokens) > 1 else tokens[0]
                if said in going and token == follow:
                    break
                said.append(token)
            found[question] = values[rows.index(said)]
            out = self.step(out, said[read:] + given[hole + 1])
        return found

    def step(self, out, tokens: list[int]):
        """The output behind further tokens, with the keys and values of all before."""
        return self.model(torch.tensor([tokens]), past_key_values=out.past_key_values, use_cache=True, logits_to_keep=1)

    @torch.inference_mode()
    def writes_code(self, state: State, picture: Image.Image | None) -> bool:
        """Whether the greedy answer of the last round is planner code, behind the search's answers to the rounds before."""
        first = state.questions.index("code.c")
        said = "".join(text + state.labels[question] for text, question in zip(state.texts, state.questions[:first], strict=False))
        opening = state.texts[first]
        said += opening[: opening.rindex("Generate_IDM_Planner")]
        seen = {"pixel_values": self.pixels(picture)} if picture is not None else {}
        ids = torch.tensor([self.ids(said)])
        out = self.model.generate(ids, attention_mask=torch.ones_like(ids), **seen, max_new_tokens=48, do_sample=False)
        return CODE.fullmatch(self.tokenizer.decode(out[0, ids.shape[1] :], skip_special_tokens=True).strip()) is not None


def states(data: Path, split: str, tokenizer) -> list[State]:
    """The chats of a split, in the order of its files."""
    lines = [line for file in sorted((data / "messages" / split).glob("*.jsonl")) for line in file.read_text().splitlines()]
    found = []
    for line in lines:
        row = json.loads(line)
        labels, questions, turns = {}, [], []
        answers = iter(ROUNDS)
        for turn in row["messages"]:
            content = turn["content"]
            if turn["role"] == "assistant":
                names = questions_of(content, next(answers))
                questions += names
                labels |= dict(zip(names, (value for _, value in SLOT.findall(content)), strict=True))
                content = SLOT.sub(lambda slot: f"{slot[1]}={HOLE}", content)
            turns.append({"role": turn["role"], "content": content})
        if not questions or not questions[-1].startswith("code."):
            raise ValueError(f"{data}: the answers of {row['state']} have no key=value; write the dataset with --prompt-set compact-2")
        texts = tokenizer.apply_chat_template(turns, tokenize=False).split(HOLE)
        picture = data / row["images"][0] if row.get("images") else None
        found.append(State(json.dumps(row["state"]), texts, questions, labels, picture))
    return found


def questions_of(answer: str, round_name: str) -> list[str]:
    """The names of an answer's questions. A key that stands twice belongs to the key after it: `why=clear lat=keep` asks `lat_why`."""
    keys = [key for key, _ in SLOT.findall(answer)]
    prefix = "code." if round_name == "code" else ""
    return [prefix + (f"{keys[i + 1]}_{key}" if keys.count(key) > 1 else key) for i, key in enumerate(keys)]


def without_scene(texts: list[str]) -> list[str]:
    """The chat without the scene text: of the first prompt, the picture and the question stay."""
    opening, place, prompt = texts[0].partition(PLACE)
    scene, line, rest = prompt.partition("\nscene?")
    if not place or not line:
        raise ValueError("the first prompt is no picture, scene text and `scene?`")
    return [opening + place + line[1:] + rest, *texts[1:]]


def ways_to_show(reader: Reader, row: State, other: State) -> dict[str, tuple[list[str], Image.Image | None]]:
    """The texts and the picture of a state: as they are and, where the model sees, under each control of the report."""
    if reader.processor is None:
        return {"both": (row.texts, None)}
    from PIL import Image

    own, others = (Image.open(state.picture).convert("RGB") for state in (row, other))
    blank = Image.new("RGB", own.size, tuple(round(255 * value) for value in reader.processor.image_processor.image_mean))
    return {"both": (row.texts, own), "shuffled": (row.texts, others), "text": (row.texts, blank), "picture": (without_scene(row.texts), own)}


def run(model: str, adapter: Path | None, data: Path, out: Path, count: int, dtype: str, threads: int) -> dict:
    """Asks `count` validation states and writes `evaluation.json` and `evaluation.md`."""
    start = time.monotonic()
    torch.set_num_threads(threads)
    out.mkdir(parents=True, exist_ok=True)
    reader = Reader.open(model, adapter, getattr(torch, dtype))
    choices: dict[str, set[str]] = {}
    for state in states(data, "train", reader.tokenizer):
        for question, value in state.labels.items():
            choices.setdefault(question, set()).add(value)
    values = {question: sorted(known) for question, known in choices.items()}
    every = states(data, "validation", reader.tokenizer)
    rows = [every[i] for i in np.unique(np.linspace(0, len(every) - 1, min(count, len(every))).astype(int))]
    scenes = [json.loads(row.name)["scenario"] for row in rows]
    others = other_images([f"{scene}@{i}" for i, scene in enumerate(scenes)])
    kept = out / "answers.jsonl"
    asked = [json.loads(line) for line in kept.read_text().splitlines()] if kept.exists() else []
    if [a["state"] for a in asked] != [row.name for row in rows[: len(asked)]]:
        raise ValueError(f"{kept} has answers at other states; name an empty --out")
    with kept.open("a") as file:
        for at in range(len(asked), len(rows)):
            row = rows[at]
            reader.check_pieces(row)
            shown = ways_to_show(reader, row, rows[others[at]])
            record = {"state": row.name, **{how: reader.answers(row, texts, picture, values) for how, (texts, picture) in shown.items()}}
            record["valid_code"] = reader.writes_code(row, shown["both"][1])
            asked.append(record)
            file.write(json.dumps(record) + "\n")
            file.flush()
            print(f"\r{at + 1} of {len(rows)} states, {time.monotonic() - start:.0f} s", end="", file=sys.stderr)
    found = {how: [record[how] for record in asked] for how in ("both", "shuffled", "text", "picture") if how in asked[0]}
    code = tuple(question for question in rows[0].questions if question.startswith("code."))
    report = {
        "states": len(rows), "drives": len(set(scenes)), "model": model, "adapter": str(adapter) if adapter else None,
        "questions": score([(q, (q,)) for q in values] + [("code, all arguments", code)], scenes, [row.labels for row in rows], found, str),
        "twins": None, "keep_lane": None,
        "without_grammar": {"states": len(rows), "valid_code": round(sum(record["valid_code"] for record in asked) / len(rows), 4)},
    }  # fmt: skip
    (out / "evaluation.json").write_text(json.dumps(report, indent=1) + "\n")
    (out / "evaluation.md").write_text(markdown(report))
    print("\n" + markdown(report), file=sys.stderr)
    return report
