"""Byte-level BPE tokenizer with a closed vocabulary: every key, value and code piece is one token.

The scene text and the answers use a few hundred words at fixed places, so the vocabulary is the pre-tokens themselves, looked
up whole (`ignore_merges`), above the 256 bytes, which keep it lossless for any other text. One informative word is then one
decision of the model: easiest to learn and cheapest to decode.

A pre-token is a word with the separator before it and the `=`, `(` or `:` after it (`, la=`, ` lat=`, `Generate_IDM_Planner(`), a number or range (`12`, `1.5`, `3-5`, `6+`), one
punctuation mark or one whitespace character. Integers up to two digits are always single tokens. Decimals are single tokens while they are few
(a quantised grid); otherwise the fraction is split off.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from pathlib import Path

from tokenizers import AddedToken, Regex, Tokenizer, decoders, models, pre_tokenizers

from .chat import SPECIAL

#: Upper bound of the vocabulary, added tokens and bytes included.
VOCABULARY = 1024
#: More distinct decimals than this and the fraction becomes tokens of its own.
WHOLE_DECIMALS = 256
#: A word must be this frequent to get a token, unless an answer uses it.
RARE = 5

_WORD = r"(?:, ?|; ?| |\n)?[A-Za-z_][A-Za-z0-9_]*[=(:]?"
_MARK = r" ?[^A-Za-z0-9_\s]|\s"
_RANGE = r"[0-9]{1,2}-[0-9]{1,2}|[0-9]{1,2}\+"
_WHOLE = rf"{_WORD}|{_RANGE}| ?-?[0-9]{{1,3}}(?:\.[0-9]{{1,2}})?|{_MARK}"
_SPLIT = rf"{_WORD}|{_RANGE}| ?-?[0-9]{{1,2}}|{_MARK}"


def pre_tokenizer(pattern: str) -> pre_tokenizers.PreTokenizer:
    """Cuts by the pattern, then writes each piece in the byte-level alphabet."""
    return pre_tokenizers.Sequence(
        [
            pre_tokenizers.Split(Regex(pattern), behavior="isolated"),
            pre_tokenizers.ByteLevel(add_prefix_space=False, use_regex=False),
        ]
    )


def count(texts: Iterable[str], pattern: str) -> Counter[str]:
    """Pre-tokens of the corpus in the byte-level alphabet."""
    cut = pre_tokenizer(pattern)
    whole = Counter(texts)
    out: Counter[str] = Counter()
    for text, times in whole.items():
        for piece, _ in cut.pre_tokenize_str(text):
            out[piece] += times
    return out


def build(prompts: Iterable[str], answers: Iterable[str], more: Iterable[str]) -> Tokenizer:
    """Makes the tokenizer from the corpus and `more` words in the byte-level alphabet; the same corpus gives the same ids."""
    prompts, answers = list(prompts), list(answers)
    pattern = _WHOLE
    in_answers = count(answers, pattern)
    in_all = in_answers + count(prompts, pattern)
    if sum(1 for piece in in_all if _is_decimal(piece)) > WHOLE_DECIMALS:
        pattern = _SPLIT
        in_answers = count(answers, pattern)
        in_all = in_answers + count(prompts, pattern)

    alphabet = sorted(pre_tokenizers.ByteLevel.alphabet())
    words = [str(number) for number in range(100)]
    if any(piece.startswith("Ġ") and piece[1:].isdigit() for piece in in_all):
        words += [f"Ġ{number}" for number in range(100)]
    words += [*sorted(in_answers), *more]
    words += [w for w, n in sorted(in_all.items(), key=lambda item: (-item[1], item[0])) if n >= RARE]
    room = VOCABULARY - len(SPECIAL) - len(alphabet)
    # dict keeps the first occurrence: an answer's word never loses its place to a frequent prompt word.
    kept = [word for word in dict.fromkeys(words) if word not in set(alphabet)][:room]
    # The added tokens stand behind the model's own, which are all spelt in the byte-level alphabet.
    vocabulary = {token: i for i, token in enumerate([*alphabet, *kept])}
    # Matrix kernels like a multiple of 16.
    unused = [f"<unused{i}>" for i in range(-(len(vocabulary) + len(SPECIAL)) % 16)]

    tokenizer = Tokenizer(models.BPE(vocab=vocabulary, merges=[], ignore_merges=True))
    tokenizer.pre_tokenizer = pre_tokenizer(pattern)
    tokenizer.decoder = decoders.ByteLevel()
    tokenizer.add_special_tokens([AddedToken(t, special=True, normalized=False) for t in [*SPECIAL, *unused]])
    return tokenizer


def load(path: Path) -> Tokenizer:
    """Reads `tokenizer.json`."""
    return Tokenizer.from_file(str(path))


def pieces_outside(tokenizer: Tokenizer, texts: Iterable[str]) -> Counter[str]:
    """Pre-tokens that are spelt in bytes because the vocabulary lacks them: should be none or rare."""
    vocabulary = tokenizer.get_vocab()
    out: Counter[str] = Counter()
    for text, times in Counter(texts).items():
        for piece, _ in tokenizer.pre_tokenizer.pre_tokenize_str(text):
            if piece not in vocabulary:
                out[piece] += times
    return out


def _is_decimal(piece: str) -> bool:
    digits = piece.removeprefix("Ġ").removeprefix("-")
    return "." in digits and digits.replace(".", "", 1).isdigit()
