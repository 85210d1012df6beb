"""A state as the model is shown it: as it stands, or with something left out, contradicted or asked, so that looking pays.

What happens to a state is drawn again each time it comes, from the seed, the step and the state alone: every worker and every later leg draws the
same. Where a sample does not tell what a label says, the label has no weight: guessing is not to be learnt.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from tokenizers import Tokenizer

from .corpus import AGENT, FREE, INFORMATIVE, Corpus, tokenise
from .occupancy import BYTES, grids_of
from .picture_questions import conversation

#: Answers that the scene text tells and no picture shows; the limit is a question of the stand-in scenes.
TEXT_ONLY = frozenset({"light", "turn", "limit", "code.la", "code.v0"})
#: Answers that the scene text tells, in part beside the picture.
TEXT_TELLS = frozenset({"light", "turn", "limit", "ego_speed", "lead_distance", "lead_speed", "left_lane", "right_lane"})
#: Answers that depend on the goal's lane, which stands in the text only.
GOAL_TELLS = frozenset({"lat_why", "lat", "code.c"})
#: The word before the goal's lane, in the byte-level alphabet.
GOAL = "Ġgoal"
#: The name of the lead agent in a code stands in the text only.
LEAD = "code.la"
#: A neighbor of which the text says nothing, and a place without an agent.
MASKED, EMPTY = " - - -", " free - -"


@dataclass(frozen=True)
class Sample:
    """Tokens with their roles and weights, `<image>` as one token, and a picture."""

    row: int
    ids: np.ndarray
    roles: np.ndarray
    weights: np.ndarray
    #: State whose picture is shown.
    image: int
    #: The one color of a picture that shows nothing, in place of the state's.
    blank: tuple[int, int, int] | None = None
    #: Quarter turns of the picture to the left.
    turns: int = 0
    #: Tokens by which this state's answers differ from its twin's; none without a twin.
    contrast: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.ids)


@dataclass(frozen=True)
class Variation:
    """Shares of samples, each by its own chance except that what leaves out the text, the picture or both rounds excludes the others."""

    text_drop: float = 0.0
    picture_drop: float = 0.0
    neighbor_mask: float = 0.0
    contradict: float = 0.0
    picture_questions: float = 0.0
    tried_codes: float = 0.0


def plain(corpus: Corpus, row: int) -> Sample:
    """A state as it stands."""
    return shown(corpus, row, row)


def shown(corpus: Corpus, row: int, state: int) -> Sample:
    """A row with the picture of a state."""
    tokens = slice(corpus.starts[row], corpus.starts[row + 1])
    return Sample(row, corpus.ids[tokens], corpus.roles[tokens], corpus.weights[tokens], state)


def without_text(corpus: Corpus, sample: Sample) -> Sample:
    """Without the scene text; for evaluation, so the weights stay."""
    start, end = corpus.scene[sample.row]
    parts = (np.concatenate([array[:start], array[end:]]) for array in (sample.ids, sample.roles, sample.weights))
    ids, roles, weights = parts
    contrast = None if sample.contrast is None else np.concatenate([sample.contrast[:start], sample.contrast[end:]])
    return replace(sample, ids=ids, roles=roles, weights=weights, contrast=contrast)


def without_picture(sample: Sample, color: tuple[int, int, int]) -> Sample:
    """With a picture of one color."""
    return replace(sample, blank=color)


def with_picture_of(sample: Sample, row: int) -> Sample:
    """With the picture of another state."""
    return replace(sample, image=row)


def weighted(corpus: Corpus, sample: Sample, without: frozenset[str] | None = None, only: frozenset[str] | None = None) -> Sample:
    """No weight for some questions, or for all but some, and no contrast to a twin; the tokens are still those of the row."""
    weights = np.array(sample.weights)
    contrast = None if sample.contrast is None else np.array(sample.contrast)
    for _, question, start, count in corpus.slots_of(sample.row):
        name = corpus.questions[question]
        if (without is not None and name in without) or (only is not None and name not in only):
            weights[start : start + count] = 0.0
            if contrast is not None:
                contrast[start : start + count] = False
    return replace(sample, weights=weights, contrast=contrast)


@dataclass
class Sampler:
    """Draws what happens to each state of a step."""

    corpus: Corpus
    tokenizer: Tokenizer
    variation: Variation
    seed: int
    #: The answers over which twins are contrasted, `answers` (all) or `code`; empty for none. Both then get the same text and their own pictures.
    twins: str = ""
    _agents: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        self._agents = np.flatnonzero(self.corpus.neighbors[:, 3] == AGENT)
        self._masked, self._empty = (np.array(self.tokenizer.encode(text).ids, np.int64) for text in (MASKED, EMPTY))
        # Every conversation begins with the same system prompt.
        first = self.corpus.row(0).tolist()
        end = next(i for i, token in enumerate(first) if i and token in self._marks())
        self._system = self.tokenizer.decode(first[1:end])

    def _marks(self) -> set[int]:
        return set(self.tokenizer.get_added_tokens_decoder())

    def draw(self, row: int, step: int) -> Sample:
        """The state as this step shows it."""
        corpus, shares = self.corpus, self.variation
        twin = int(corpus.twins[row]) if self.twins else -1
        rng = np.random.default_rng((self.seed, step, row if twin < 0 else min(row, twin)))
        sample = plain(corpus, row)
        if shares.tried_codes and twin < 0 and rng.random() < shares.tried_codes:
            sample = self.tried(row, rng)
        if twin >= 0:
            sample = replace(sample, contrast=differing(corpus, row, twin, "code." if self.twins == "code" else ""))
        which = rng.random()
        if which < shares.text_drop:
            return without_text(corpus, weighted(corpus, sample, without=TEXT_ONLY | self.goal_tells(row)))
        which -= shares.text_drop
        # A twin without its picture has no label.
        if which < shares.picture_drop and twin < 0:
            color = tuple(int(c) for c in rng.integers(0, 256, 3))
            return without_picture(weighted(corpus, sample, only=TEXT_TELLS), color)
        which -= shares.picture_drop
        if which < shares.picture_questions and twin < 0 and corpus.has_occupancy[row]:
            return self.question(row, rng)
        return self.changed(sample, rng)

    def goal_tells(self, row: int) -> frozenset[str]:
        """The answers of a state that the goal's lane in its text tells."""
        start, end = self.corpus.scene[row]
        goal = self.tokenizer.token_to_id(GOAL)
        return GOAL_TELLS if goal is not None and goal in self.corpus.row(row)[start:end] else frozenset()

    def tried(self, state: int, rng: np.random.Generator) -> Sample:
        """The state with one of its tried codes, drawn by their chances; with the label's where there are none."""
        rows, chances = self.corpus.tried_of(state)
        return shown(self.corpus, int(rng.choice(rows, p=chances)), state) if len(rows) else plain(self.corpus, state)

    def question(self, row: int, rng: np.random.Generator) -> Sample:
        """The picture alone, with questions on it; half of the pictures are turned."""
        turns = int(rng.integers(0, 4)) if rng.random() < 0.5 else 0
        made = tokenise(self.tokenizer, conversation(grids_of(np.array(self.corpus.occupancy[row])), turns, self._system))
        return Sample(row, np.array(made.ids), np.array(made.roles, np.uint8), np.array(made.weights, np.float32), row, turns=turns)

    def changed(self, sample: Sample, rng: np.random.Generator) -> Sample:
        """With some neighbors masked and perhaps one contradicted in the text; the labels stay those of the picture."""
        corpus, shares = self.corpus, self.variation
        facts = corpus.neighbors_of(sample.row)
        masked = rng.random(len(facts)) < shares.neighbor_mask
        new: dict[int, np.ndarray] = {int(i): self._masked for i in np.flatnonzero(masked)}
        if rng.random() < shares.contradict:
            # A lane that is not there is a fact of the road.
            candidates = [i for i, (_, _, _, kind, _) in enumerate(facts) if kind in (AGENT, FREE)]
            if candidates and len(self._agents):
                i = candidates[int(rng.integers(len(candidates)))]
                new[i] = self.wrong(sample.row, facts[i], rng)
        if not new:
            return sample
        if any(facts[i][4] for i in new):
            sample = weighted(corpus, sample, without=frozenset({LEAD}))
        arrays = {"ids": sample.ids, "roles": sample.roles, "weights": sample.weights}
        if sample.contrast is not None:
            arrays["contrast"] = sample.contrast
        # From the back, so that earlier places stay.
        for i in sorted(new, reverse=True):
            _, start, count, _, _ = (int(v) for v in facts[i])
            filler = {"ids": new[i], "roles": np.zeros(len(new[i]), np.uint8), "weights": np.ones(len(new[i]), np.float32)}
            filler["contrast"] = np.zeros(len(new[i]), bool)
            arrays = {name: np.concatenate([array[:start], filler[name], array[start + count :]]) for name, array in arrays.items()}
        return replace(sample, **arrays)

    def wrong(self, row: int, fact: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Another fact for a neighbor: nobody where somebody is, or somebody of another state."""
        if fact[3] == AGENT and rng.random() < 0.5:
            return self._empty
        other, start, count, _, _ = self.corpus.neighbors[self._agents[int(rng.integers(len(self._agents)))]]
        begin = int(self.corpus.starts[other]) + int(start)
        return np.array(self.corpus.ids[begin : begin + int(count)])


def differing(corpus: Corpus, row: int, twin: int, prefix: str = "") -> np.ndarray:
    """The tokens of the answers that a state has otherwise than its twin, to questions with this prefix."""
    tokens, others = corpus.row(row), corpus.row(twin)
    theirs = {int(q): tuple(others[a : a + n].tolist()) for _, q, a, n in corpus.slots_of(twin)}
    out = np.zeros(len(tokens), bool)
    for _, question, start, count in corpus.slots_of(row):
        same_kind = corpus.questions[question].startswith(prefix)
        if same_kind and theirs.get(int(question)) != tuple(tokens[start : start + count].tolist()):
            out[start : start + count] = True
    return out & (corpus.roles[corpus.starts[row] : corpus.starts[row + 1]] == INFORMATIVE)


def occupancy_of(corpus: Corpus, samples: list[Sample]) -> tuple[np.ndarray, np.ndarray]:
    """The grids of samples as their pictures are turned, and of which samples they are known and to be seen."""
    known = np.array([bool(corpus.has_occupancy[s.image]) and s.blank is None for s in samples])
    packed = np.stack([np.array(corpus.occupancy[s.image]) if k else np.zeros(BYTES, np.uint8) for s, k in zip(samples, known, strict=True)])
    grids = [np.rot90(grid, s.turns, (1, 2)) for grid, s in zip(grids_of(packed), samples, strict=True)]
    return np.stack(grids), known
