"""Puts the vision tower of a LLaVA before a language model, with a new projector between them, as a folder of LLaVA.

    python examples/teach/llava.py --model SmolLM2-135M-Instruct.Q4_1.gguf --tower models/nano --out smolllava
    python examples/teach/lora.py --data data/messages --model smolllava --out adapter

The projector's numbers are random until it is trained. A special token of the language model that chats do not use becomes the place of
the picture. Needs torch and transformers, and gguf and accelerate for a GGUF file.
"""

import argparse
import json
from pathlib import Path

import torch
from transformers import AutoImageProcessor, AutoModelForCausalLM, AutoTokenizer, LlavaConfig, LlavaForConditionalGeneration, LlavaProcessor

#: The place of the picture.
PLACE = "<image>"
#: What a part of a turn becomes: the template of a language model knows texts alone.
PARTS = (
    "{% if message['content'] is string %}{{ message['content'] }}{% else %}{% for part in message['content'] %}"
    "{% if part['type'] == 'image' %}{{ '<image>\n' }}{% else %}{{ part['text'] }}{% endif %}{% endfor %}{% endif %}"
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--model", required=True, help="a folder of transformers, or a GGUF file")
    parser.add_argument("--tower", type=Path, required=True, help="a folder of LLaVA with the vision tower")
    parser.add_argument("--unused", default="<filename>", help="special token that becomes the place of the picture")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seed", type=int, default=0)
    chosen = parser.parse_args()
    torch.manual_seed(chosen.seed)
    if chosen.model.endswith(".gguf"):
        source, more = str(Path(chosen.model).parent), {"gguf_file": Path(chosen.model).name}
    else:
        source, more = chosen.model, {}
    tokenizer = AutoTokenizer.from_pretrained(source, **more)
    decoder = AutoModelForCausalLM.from_pretrained(source, dtype=torch.float32, **more)
    tower = LlavaForConditionalGeneration.from_pretrained(chosen.tower, dtype=torch.float32)
    place = tokenizer.convert_tokens_to_ids(chosen.unused)
    if place is None or place == tokenizer.unk_token_id:
        raise SystemExit(f"--unused {chosen.unused}: the tokenizer has no such token; name one of its special tokens")
    # The decoder's numbers are dense by now, whatever its file stores.
    if hasattr(decoder.config, "quantization_config"):
        del decoder.config.quantization_config
    seen = tower.config
    config = LlavaConfig(
        vision_config=seen.vision_config,
        text_config=decoder.config,
        image_token_index=place,
        projector_hidden_act=seen.projector_hidden_act,
        vision_feature_layer=seen.vision_feature_layer,
        vision_feature_select_strategy=seen.vision_feature_select_strategy,
        image_seq_length=seen.image_seq_length,
        tie_word_embeddings=decoder.config.tie_word_embeddings,
    )
    model = LlavaForConditionalGeneration(config)
    model.model.vision_tower.load_state_dict(tower.model.vision_tower.state_dict())
    model.model.language_model.load_state_dict(decoder.model.state_dict())
    model.lm_head.load_state_dict(decoder.lm_head.state_dict())
    model.tie_weights()
    chosen.out.mkdir(parents=True, exist_ok=True)
    model.save_pretrained(chosen.out)
    tokenizer.save_pretrained(chosen.out)
    # The token keeps its number and takes another name.
    for file in ("tokenizer.json", "tokenizer_config.json", "special_tokens_map.json"):
        path = chosen.out / file
        if path.exists():
            path.write_text(path.read_text().replace(json.dumps(chosen.unused), json.dumps(PLACE)))
    tokenizer = AutoTokenizer.from_pretrained(chosen.out)
    template = tokenizer.chat_template
    if "message['content']" not in template:
        raise SystemExit("the chat template has no message['content'] that could take a picture")
    template = template.replace("+ message['content'] +", "}}" + PARTS + "{{")
    processor = LlavaProcessor(
        image_processor=AutoImageProcessor.from_pretrained(chosen.tower),
        tokenizer=tokenizer,
        patch_size=seen.vision_config.patch_size,
        vision_feature_select_strategy=seen.vision_feature_select_strategy,
        image_token=PLACE,
        chat_template=template,
        num_additional_image_tokens=1,
    )
    processor.save_pretrained(chosen.out)
    tokenizer.chat_template = template
    tokenizer.save_pretrained(chosen.out)
    print(f"{chosen.out}: {sum(weight.numel() for weight in model.parameters()) / 1e6:.1f} million parameters")


if __name__ == "__main__":
    main()
