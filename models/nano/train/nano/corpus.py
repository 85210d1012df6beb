"""A split as arrays: token ids, which tokens carry loss, where each question's answer stands, images.

Built once from the shards and kept beside the run as memory-mapped files, so that every leg and every worker starts at once and
shares one copy (an image is 48 KiB: 100,000 states are 4.9 GB on disk, of which memory holds what fits).
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from tokenizers import Tokenizer

from . import shards
from .chat import ASSISTANT, EOS, IMAGE, Piece, pieces
from .occupancy import BYTES, parse

#: Roles of a token in the loss.
PROMPT, TEMPLATE, INFORMATIVE = 0, 1, 2
#: What the scene text says of a place beside the ego: there is no lane, nobody is there, or an agent.
NO_LANE, FREE, AGENT = 0, 1, 2
_SAID = {"none": NO_LANE, "free": FREE}

_KEY = re.compile(r"([A-Za-z_][A-Za-z0-9_]*)\s*[=:]\s*$")
_CALL = re.compile(r"[A-Za-z_]\w*\(")
#: Of a compact scene text, the nine places with three words each.
_PLACES = re.compile(r" ego \S+ \S+ \S+(?: \S+ \S+ \S+ \S+)*(?= rest )")
_PLACE = re.compile(r" \S+( (\S+) \S+ \S+)")
_LEAD = re.compile(r", la=(\w+)")


@dataclass(frozen=True)
class Corpus:
    """Row i has the tokens `ids[starts[i]:starts[i + 1]]`, its `<image>` as one token.

    The states are the first rows. The others are states with a tried code in place of the label's.
    """

    ids: np.ndarray
    roles: np.ndarray
    #: Weight of each token in the loss where it is informative.
    weights: np.ndarray
    starts: np.ndarray
    #: (rows, 2): the scene text within the row.
    scene: np.ndarray
    #: (facts, 5): row, first token within the row, number of tokens, what is said, whether the code follows this agent.
    neighbors: np.ndarray
    #: (codes, 2): state, and row with this tried code; (codes): the chance of this row in expert iteration.
    tried: np.ndarray
    chances: np.ndarray
    #: (states): the state with the same text and another picture and code, or -1.
    twins: np.ndarray
    #: (states, 96): the occupancy grids in bits, and (states) whether the dataset has them.
    occupancy: np.ndarray
    has_occupancy: np.ndarray
    #: (slots, 4): row, question, first token within the row, number of tokens.
    slots: np.ndarray
    images: np.ndarray
    questions: list[str]
    names: list[str]

    def __len__(self) -> int:
        return len(self.names)

    def row(self, i: int) -> np.ndarray:
        """Token ids of a row."""
        return self.ids[self.starts[i] : self.starts[i + 1]]

    def slots_of(self, row: int) -> np.ndarray:
        """A row's slots; the array is sorted by row."""
        return of_row(self.slots, row)

    def tried_of(self, state: int) -> tuple[np.ndarray, np.ndarray]:
        """The rows of a state's tried codes, and their chances."""
        low, high = self.tried[:, 0].searchsorted([state, state + 1])
        return self.tried[low:high, 1], self.chances[low:high]

    def neighbors_of(self, row: int) -> np.ndarray:
        """A row's facts of places beside the ego."""
        return of_row(self.neighbors, row)


def of_row(table: np.ndarray, row: int) -> np.ndarray:
    """The part of a table that belongs to a row, by its first column."""
    low, high = table[:, 0].searchsorted([row, row + 1])
    return table[low:high]


def question_names(content: str, spans: tuple[tuple[int, int], ...], answer: int) -> list[str]:
    """What each informative span answers: the key before it.

    A repeated key is named after the key it stands beside (`why=.. lat=.. why=.. lon=..`: `lat_why`, `lon_why`); arguments of a
    call are `code.c`, `code.v0`, ...
    """
    keys = []
    for place, (start, _) in enumerate(spans):
        match = _KEY.search(content[:start])
        keys.append(match.group(1) if match else f"answer{answer}_{place}")
    prefix = "code." if _CALL.match(content) else ""
    own = [key for key in keys if keys.count(key) == 1]
    names = []
    for place, key in enumerate(keys):
        # A reason stands before what it explains or after it, throughout an answer.
        beside = keys[place:] if keys.count(keys[0]) > 1 else keys[place::-1]
        whose = next((k for k in beside if k in own), None) if keys.count(key) > 1 else None
        names.append(f"{prefix}{whose}_{key}" if whose else prefix + key)
    if len(set(names)) != len(names):
        names = [f"{name}.{i}" if names.count(name) > 1 else name for i, name in enumerate(names)]
    return names


@dataclass
class Row:
    """A conversation in tokens."""

    ids: list[int] = field(default_factory=list)
    roles: list[int] = field(default_factory=list)
    weights: list[float] = field(default_factory=list)
    #: Question, first token, number of tokens.
    slots: list[tuple[str, int, int]] = field(default_factory=list)
    #: Tokens of the scene text.
    scene: tuple[int, int] = (0, 0)
    #: First token, number of tokens, what is said, whether the code follows this agent.
    neighbors: list[tuple[int, int, int, int]] = field(default_factory=list)


def tokenise(tokenizer: Tokenizer, conversation: list[dict]) -> Row:
    """A conversation in tokens."""
    row = Row()
    lead = next((match.group(1) for message in conversation if (match := _LEAD.search(message["content"]))), None)
    for piece in pieces(conversation):
        first = len(row.ids)
        if piece.special:
            row.ids.append(tokenizer.token_to_id(piece.text))
            row.roles.append(TEMPLATE if piece.text == EOS else PROMPT)
            row.weights.append(1.0)
            continue
        encoded = tokenizer.encode(piece.text, add_special_tokens=False)
        row.ids += encoded.ids
        row.weights += [1.0] * len(encoded.ids)
        if piece.scene:
            # The question stands on a line of its own.
            end = piece.text.find("\n", 1)
            row.scene = (first, first + sum(1 for _, b in encoded.offsets if b <= end))
            row.neighbors = [(first + a, n, said, follows) for a, n, said, follows in neighbors_of(piece.text, encoded.offsets, lead)]
        if piece.answer < 0:
            row.roles += [PROMPT] * len(encoded.ids)
            continue
        informative = spans_of_tokens(piece, encoded.offsets)
        row.roles += [INFORMATIVE if any(a <= t < b for a, b in informative) else TEMPLATE for t in range(len(encoded.ids))]
        for (a, b), weight in zip(informative, piece.weights, strict=True):
            row.weights[first + a : first + b] = [weight] * (b - a)
        names = question_names(piece.text, piece.learn, piece.answer)
        row.slots += [(name, first + a, b - a) for name, (a, b) in zip(names, informative, strict=True)]
    return row


@dataclass
class Rows:
    """Rows that become the arrays of a corpus."""

    #: Index of each question, in the order in which they come.
    questions: dict[str, int] = field(default_factory=dict)
    rows: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = field(default_factory=list)
    scenes: list[tuple[int, int]] = field(default_factory=list)
    neighbors: list[tuple[int, ...]] = field(default_factory=list)
    slots: list[tuple[int, ...]] = field(default_factory=list)

    def add(self, row: Row) -> None:
        """Appends a row."""
        number = len(self.rows)
        self.rows.append((np.array(row.ids, np.int16), np.array(row.roles, np.uint8), np.array(row.weights, np.float32)))
        self.scenes.append(row.scene)
        self.neighbors += [(number, *fact) for fact in row.neighbors]
        self.slots += [(number, self.questions.setdefault(q, len(self.questions)), a, n) for q, a, n in row.slots]

    def save(self, cache: Path) -> None:
        """Writes the arrays."""
        for name, arrays in zip(("ids", "roles", "weights"), zip(*self.rows, strict=True), strict=True):
            np.save(cache / f"{name}.npy", np.concatenate(arrays))
        np.save(cache / "starts.npy", np.cumsum([0, *(len(ids) for ids, _, _ in self.rows)]).astype(np.int64))
        np.save(cache / "scene.npy", np.array(self.scenes, np.int32))
        np.save(cache / "neighbors.npy", np.array(self.neighbors, np.int32).reshape(-1, 5))
        np.save(cache / "slots.npy", np.array(self.slots, np.int32).reshape(-1, 4))


def neighbors_of(text: str, offsets: list[tuple[int, int]], lead: str | None) -> list[tuple[int, int, int, int]]:
    """What a compact scene text says of each place: its tokens, the kind of fact, and whether its agent is the code's lead."""
    places = _PLACES.search(text)
    out = []
    for match in _PLACE.finditer(places.group()) if places else ():
        start, end = (places.start() + place for place in match.span(1))
        touched = [t for t, (a, b) in enumerate(offsets) if a < end and b > start]
        name = match.group(2)
        out.append((touched[0], len(touched), _SAID.get(name, AGENT), int(name == lead)))
    return out


def spans_of_tokens(piece: Piece, offsets: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """The tokens that each of the piece's character spans touches."""
    out = []
    for start, end in piece.learn:
        touched = [t for t, (a, b) in enumerate(offsets) if a < end and b > start]
        if not touched:
            raise ValueError(f"the span {start}..{end} of {piece.text!r} holds no token")
        out.append((touched[0], touched[-1] + 1))
    return out


def build(folder: Path, split: str, tokenizer: Tokenizer, cache: Path, limit: int | None = None) -> Corpus:
    """Tokenises a split (its first `limit` states) into the cache folder and opens it."""
    pixels = int(shards.meta(folder)["image_pixels"])
    cache.mkdir(parents=True, exist_ok=True)
    rows, names = Rows(), []
    others: list[tuple[int, float, list[dict]]] = []
    grids: list[np.ndarray] = []
    known: list[bool] = []
    pairs: dict[str, list[int]] = {}
    with (cache / "images.u8").open("wb") as out:
        for shard in shards.shards(folder, split):
            if limit is not None and len(names) >= limit:
                break
            picture = shards.images(shard, pixels)
            for state in shards.states(shard):
                if limit is not None and len(names) >= limit:
                    break
                rows.add(tokenise(tokenizer, state.conversation))
                others += [(len(names), tried["chance"], state.conversation_of(tried)) for tried in state.tried]
                if state.twin is not None:
                    pairs.setdefault(state.twin, []).append(len(names))
                grids.append(parse(state.occupancy) if state.occupancy else np.zeros(BYTES, np.uint8))
                known.append(bool(state.occupancy))
                names.append(state.name)
                out.write(picture[state.image].tobytes())
    for _, _, conversation in others:
        rows.add(tokenise(tokenizer, conversation))
    rows.save(cache)
    np.save(cache / "tried.npy", np.array([(state, len(names) + i) for i, (state, _, _) in enumerate(others)], np.int32).reshape(-1, 2))
    np.save(cache / "chances.npy", np.array([chance for _, chance, _ in others], np.float64))
    np.save(cache / "twins.npy", twins_of(pairs, len(names)))
    np.save(cache / "occupancy.npy", np.stack(grids))
    np.save(cache / "has_occupancy.npy", np.array(known))
    (cache / "index.json").write_text(json.dumps({"questions": list(rows.questions), "names": names, "pixels": pixels}))
    return load(cache)


def twins_of(pairs: dict[str, list[int]], rows: int) -> np.ndarray:
    """Each row's twin; a limit on the states may have cut a pair apart."""
    twins = np.full(rows, -1, np.int32)
    for name, members in pairs.items():
        if len(members) > 2:
            raise ValueError(f"twin {name!r} has {len(members)} states; a pair has two")
        if len(members) == 2:
            twins[members] = members[::-1]
    return twins


#: The arrays of a cache folder.
ARRAYS = ("ids", "roles", "weights", "starts", "scene", "neighbors", "tried", "chances", "twins", "occupancy", "has_occupancy", "slots")


def load(cache: Path) -> Corpus:
    """Opens a cache folder, memory-mapped."""
    index = json.loads((cache / "index.json").read_text())
    pixels = index["pixels"]
    # The same memory without the cost of a memmap's every access.
    arrays = {name: np.asarray(np.load(cache / f"{name}.npy", mmap_mode="r")) for name in ARRAYS}
    images = np.memmap(cache / "images.u8", np.uint8, "r", shape=(len(index["names"]), pixels, pixels, 3))
    return Corpus(images=images, questions=index["questions"], names=index["names"], **arrays)


def special_ids(tokenizer: Tokenizer) -> dict[str, int]:
    """Ids of the added tokens that the training code needs by name."""
    return {token: tokenizer.token_to_id(token) for token in (IMAGE, ASSISTANT, EOS)}


def colours(corpus: Corpus, images: int = 500) -> tuple[list[float], list[float]]:
    """Mean and standard deviation of red, green and blue (0 to 1), rounded so that they stand exactly in JSON."""
    step = max(1, len(corpus) // images)
    pixels = corpus.images[::step].reshape(-1, 3).astype(np.float64) / 255
    return [round(float(v), 3) for v in pixels.mean(0)], [max(round(float(v), 3), 0.01) for v in pixels.std(0)]
