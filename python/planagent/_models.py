"""Vision-language models."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from . import _arguments as arguments
from . import _arrays, _core
from ._arguments import seconds, whole, wrong
from ._planners import settings_json
from .errors import ArgumentError

__all__ = ["Answer", "Model"]


#: Most tokens of an answer that can be asked for; the model's context ends it before.
MAX_TOKENS = 2**31 - 1
#: Most texts that an answer is chosen from; the grammar of an answer has room for about twice as many.
MAX_CHOICES = 1000


@dataclass(frozen=True)
class Answer:
    """An answer of a model.

    Attributes
    ----------
    text : str
        The answer.
    finish : str
        Why it ended: `end_of_sequence`, `complete`, `length` or `context_full`.
    tokens : dict
        Numbers of tokens: `text`, `image` and `cached` of the prompt, `sampled` and `fast_forwarded` of the answer.
    milliseconds : dict
        Wall times of the parts, `total` among them.
    log_probability : float or None
        The natural logarithm of the probability of what the model chose, among what `choices` or `regex` allowed and at
        temperature 1; `None` without either, and from a server.

    Examples
    --------
    >>> import planagent
    >>> observation = planagent.open("generated/changing_lane/2").observe()
    >>> answer = planagent.Model("nano").ask(observation.image(), "Which lane?", choices=["left", "right"])
    >>> answer.finish, str(answer) == answer.text, answer.milliseconds["total"] > 0
    ('complete', True, True)
    """

    text: str
    finish: str
    tokens: dict[str, int]
    milliseconds: dict[str, float]
    log_probability: float | None = None

    def __str__(self) -> str:
        return self.text


class Model:
    """A vision-language model.

    Parameters
    ----------
    name
        A name (`nano`), a folder as Hugging Face writes it, a GGUF file, a hub id, or a `.toml` file that describes one. It is
        loaded once in a process.
    adapter
        An adapter that is merged into its weights: a folder of PEFT, or a GGUF file of llama.cpp's LoRA.
    settings
        Other settings by the keys of `planagent.toml`, for example `{"mllm.quantize": "q8_0"}`.

    Raises
    ------
    ModelError
        Where there is no such model or it cannot be loaded.

    Examples
    --------
    >>> import planagent
    >>> model = planagent.Model("nano")
    >>> observation = planagent.open("generated/changing_lane/2").observe()
    >>> answer = model.ask(observation.image(), "Which lane?", choices=["left", "right"])
    >>> answer.text in ("left", "right")
    True
    """

    __slots__ = ("_arguments", "_native")

    def __init__(
        self,
        name: str | os.PathLike[str] = "nano",
        *,
        adapter: str | os.PathLike[str] | None = None,
        settings: Mapping[str, Any] | None = None,
    ) -> None:
        if not isinstance(name, (str, os.PathLike)):
            raise wrong("name", name, "expected the name of a model")
        if adapter is not None and not isinstance(adapter, (str, os.PathLike)):
            raise wrong("adapter", adapter, "expected the path of an adapter")
        name = arguments.word("name", os.fsdecode(name), "expected the name of a model")
        adapter = None if adapter is None else arguments.word("adapter", os.fsdecode(adapter), "expected the path of an adapter")
        self._native = _core.Model(settings_json(settings, mllm__model=name, mllm__adapter=adapter))
        self._arguments = (name, adapter, None if settings is None else dict(settings))

    def __reduce__(self) -> tuple[Any, tuple[Any, ...]]:
        return _model, self._arguments

    def __deepcopy__(self, memo: dict[int, Any]) -> Model:
        return self

    def __repr__(self) -> str:
        return f"Model({self._arguments[0]!r})"

    @property
    def about(self) -> dict[str, Any]:
        """Name, architecture, size, and the side of its pictures (`image_size`; `None` where it reads text alone)."""
        about: dict[str, Any] = json.loads(self._native.about())
        return about

    def count_tokens(self, text: str) -> int | None:
        """Number of tokens of a text; `None` for a model behind a server.

        Examples
        --------
        >>> import planagent
        >>> planagent.Model("nano").count_tokens("Which lane is free?") > 3
        True
        """
        return self._native.count_tokens(arguments.text("text", text))

    def ask(
        self,
        image: ArrayLike | None,
        text: str,
        *,
        system: str = "",
        max_tokens: int = 256,
        choices: str | Iterable[str] | None = None,
        regex: str | None = None,
        deadline_s: float | None = None,
        seed: int | None = None,
    ) -> Answer:
        """Puts a question, with a picture or without.

        Parameters
        ----------
        image
            Height x width x 3 numbers of type uint8, as `Observation.image` gives them, or `None`.
        text
            The question.
        system
            The system prompt.
        max_tokens
            Maximum tokens of the answer.
        choices, regex
            The answer is one of these texts (one or several), or matches this regular expression.
        deadline_s
            Time for the answer, seconds.
        seed
            Seed of samples; that of the settings by default.

        Examples
        --------
        >>> import planagent
        >>> observation = planagent.open("generated/changing_lane/2").observe()
        >>> planagent.Model("nano").ask(observation.image(), "How many?", regex="[0-9]").text.isdigit()
        True
        """
        picture = None
        if image is not None:
            array = np.ascontiguousarray(_arrays.array("image", image, "expected a picture of height x width x 3 uint8 numbers"))
            if array.dtype != np.uint8 or array.ndim != 3 or array.shape[2] != 3:
                raise ArgumentError(
                    f"expected a picture of height x width x 3 uint8 numbers, got {array.dtype} of shape {array.shape}"
                )
            picture = (array.tobytes(), array.shape[0], array.shape[1])
        wanted = None if choices is None else arguments.texts("choices", choices)
        if wanted is not None and not wanted:
            raise wrong("choices", choices, "there is nothing to choose from")
        if wanted is not None and len(wanted) > MAX_CHOICES:
            raise wrong("choices", choices, f"there are {len(wanted)} of them, and {MAX_CHOICES} are the limit")
        if wanted is not None and "" in wanted:
            raise wrong("choices", choices, "one of them is empty")
        asked = {
            "system": arguments.text("system", system),
            "max_tokens": whole("max_tokens", max_tokens, 1, MAX_TOKENS),
            "choices": wanted,
            "regex": None if regex is None else arguments.text("regex", regex),
            "deadline_s": None if deadline_s is None else seconds("deadline_s", deadline_s),
            "seed": None if seed is None else whole("seed", seed, 0, 2**64 - 1),
        }
        answer, finish, tokens, milliseconds, log = self._native.ask(arguments.text("text", text), picture, asked)
        return Answer(answer, finish, json.loads(tokens), json.loads(milliseconds), log)


def _model(name: str, adapter: str | None, settings: dict[str, Any] | None) -> Model:
    return Model(name, adapter=adapter, settings=settings)
