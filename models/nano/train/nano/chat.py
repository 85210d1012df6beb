"""How a conversation becomes tokens: the chat template and the same thing in pieces.

`<s>{system}\\nUSER: <image>\\n{text}\\nASSISTANT: {answer}</s>\\nUSER: ...`

Boundary rule: the role markers, `<image>`, `<s>` and `</s>` are added tokens, and the tokenizer cuts the text at them before
anything else. So tokens of pieces that are cut at these marks, joined, are the tokens of the whole; inference may
append an answer to a prompt. Inside an answer the rule holds at every pre-token boundary: before a key (the key's token carries its
leading separator) and after `=`, `(` or `:`.
"""

from __future__ import annotations

from dataclasses import dataclass

PAD, BOS, EOS, IMAGE, USER, ASSISTANT = "<pad>", "<s>", "</s>", "<image>", "\nUSER: ", "\nASSISTANT: "
#: Added tokens in the order of their ids.
SPECIAL = (PAD, BOS, EOS, IMAGE, USER, ASSISTANT)

_CONTENT = (
    "{% if message['content'] is string %}{{ message['content'] }}{% else %}"
    "{% for part in message['content'] %}{% if part['type'] == 'image' %}{{ '<image>\\n' }}"
    "{% else %}{{ part['text'] }}{% endif %}{% endfor %}{% endif %}"
)
#: Jinja, as `chat_template.jinja` of the checkpoint holds it.
TEMPLATE = (
    "{{ bos_token }}{% for message in messages %}"
    "{% if message['role'] == 'user' %}{{ '\\nUSER: ' }}" + _CONTENT + "{% elif message['role'] == 'assistant' %}"
    "{{ '\\nASSISTANT: ' }}" + _CONTENT + "{{ eos_token }}{% else %}" + _CONTENT + "{% endif %}{% endfor %}"
    "{% if add_generation_prompt %}{{ '\\nASSISTANT: ' }}{% endif %}"
)


@dataclass(frozen=True)
class Piece:
    """A stretch between two added tokens, or (`special`) such a token; `learn` are character spans of an answer, `weights` theirs in the loss."""

    text: str
    special: bool = False
    answer: int = -1
    learn: tuple[tuple[int, int], ...] = ()
    weights: tuple[float, ...] = ()
    scene: bool = False


def pieces(conversation: list[dict]) -> list[Piece]:
    """The rendered conversation, cut at its added tokens; `answer` numbers the assistant's rounds from 0.

    `scene` marks the first user text after the image: what the image-only first stage leaves out. Each `</s>` belongs to its answer.
    """
    out = [Piece(BOS, special=True)]
    answer, seen_image = 0, False
    for message in conversation:
        role, content = message["role"], message["content"]
        if role == "assistant":
            spans = tuple((int(a), int(b)) for a, b in message.get("learn", []))
            weights = tuple(float(w) for w in message.get("weights", [1.0] * len(spans)))
            if len(weights) != len(spans):
                raise ValueError(f"{len(weights)} weights for {len(spans)} spans")
            out += [Piece(ASSISTANT, special=True), Piece(content, answer=answer, learn=spans, weights=weights)]
            out.append(Piece(EOS, special=True, answer=answer))
            answer += 1
            continue
        if role == "user":
            out.append(Piece(USER, special=True))
        if IMAGE not in content:
            out.append(Piece(content))
            continue
        if seen_image or content.count(IMAGE) != 1:
            raise ValueError("a conversation has one image")
        seen_image = True
        before, after = content.split(IMAGE)
        out += [Piece(before), Piece(IMAGE, special=True), Piece(after, scene=True)]
    if not seen_image:
        raise ValueError("a conversation needs the mark <image> once")
    return [piece for piece in out if piece.text]


def render(conversation: list[dict]) -> str:
    """The whole text; equals the template's (asserted by the tests)."""
    return "".join(piece.text for piece in pieces(conversation))
