"""The models that openvino.py loads: exported by optimum-intel, their weights compressed by nncf.

A model without files in Hugging Face's layout first gets them: random weights of its configuration, or those of a GGUF file.
"""

import importlib.metadata
import logging
import pathlib
import shutil
import warnings

RECIPE = "planagent.json"
# The models of an export.
PARTS = {
    "openvino_model.xml",
    "openvino_language_model.xml",
    "openvino_text_embeddings_model.xml",
    "openvino_vision_embeddings_model.xml",
    "openvino_vision_embeddings_merger_model.xml",
    "openvino_vision_embeddings_pos_model.xml",
}
# Sizes of groups of 4-bit weights: OpenVINO's own choice first.
GROUPS = (128, 64, 32)
# Kinds of models whose pictures openvino.py can show, and what it must know of their towers.
TOWERS = {
    "llava": lambda vision: {},
    "smolvlm": lambda vision: {"patches": vision.patch_size},
    "idefics3": lambda vision: {"patches": vision.patch_size},
    "qwen3_vl": lambda vision: {
        "axes": 3,
        "deep": len(vision.deepstack_visual_indexes),
        "frames": vision.temporal_patch_size,
        "head": vision.hidden_size // vision.num_heads,
        "merged": vision.spatial_merge_size,
        "patches": vision.patch_size,
        "places": vision.num_position_embeddings,
    },
}
PACKAGES = "openvino optimum-intel nncf gguf accelerate 'transformers<5'"


def runtime():
    """The packages openvino, which all need, and numpy."""
    global np
    try:
        import numpy as np
        import openvino
        import openvino.opset13
    except (ImportError, OSError) as error:
        raise missing("openvino", error) from error
    return openvino


def missing(package, error):
    problem = f"the Python package {package} cannot be used by {sys.executable}: {error}"
    return Problem(f"{problem}; `{sys.executable} -m pip install {PACKAGES}` installs what is needed")


def version_of(package):
    return importlib.metadata.version(package)


def recipe_of(folder):
    """How an export is loaded.

    Raises:
        Problem: if the folder has no finished export.
    """
    try:
        return json.loads((folder / RECIPE).read_text())
    except (OSError, ValueError) as error:
        raise Problem(f"{folder} has no finished export: {error}; delete the folder and start again") from error


def prepare(request):
    """Writes the export of a model, unless it is there."""
    api = runtime()
    folder, export = pathlib.Path(request["folder"]), pathlib.Path(request["export"])
    # Tracing warns of each branch. Nothing is looked for in the network.
    warnings.simplefilter("ignore")
    os.environ["HF_HUB_OFFLINE"] = "1"
    if not any(folder.glob("*.safetensors")):
        if not request["files"]:
            raise Problem(f"{folder} has no weights in safetensors")
        write_weights(folder, request["files"], request["gguf"], request["seed"])
    source = files_of(folder)
    if (export / RECIPE).is_file() and recipe_of(export)["source"] == source:
        return
    config = configuration(folder)
    recipe = {"weights": request["weights"], "tower": request["tower"], "source": source, **described(folder, config)}
    plain = plain_export(folder, export.with_name("plain"), source, bool(recipe["side"]))
    part = emptied(export.with_name(export.name + ".part"))
    for path in sorted(plain.glob("openvino_*model.xml")):
        if path.name in PARTS:
            precision = recipe["tower"] if "vision" in path.name else recipe["weights"]
            model = compressed(api.Core().read_model(path), precision, config.get_text_config(), "embeddings" in path.name)
            api.save_model(model, part / path.name, compress_to_fp16=False)
    recipe["by"] = ", ".join(f"{package} {version_of(package)}" for package in ("optimum-intel", "nncf"))
    (part / RECIPE).write_text(json.dumps(recipe))
    shutil.rmtree(export, ignore_errors=True)
    part.rename(export)


def files_of(folder):
    """Names, sizes and times of a model's files: those of an export must be the same."""
    files = [*folder.glob("*.safetensors"), folder / "config.json"]
    return [[path.name, path.stat().st_size, path.stat().st_mtime_ns] for path in sorted(files)]


def emptied(folder):
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    return folder


def configuration(folder):
    """The configuration of a folder, as transformers reads it.

    Raises:
        Problem: if it cannot be read, or is of a later version that says the rotary embedding otherwise.
    """
    try:
        from transformers import AutoConfig
    except (ImportError, OSError) as error:
        raise missing("transformers", error) from error
    version, path = version_of("transformers"), folder / "config.json"
    try:
        config = AutoConfig.from_pretrained(folder, local_files_only=True)
        written = json.loads(path.read_text())
    except (OSError, ValueError, KeyError) as error:
        raise Problem(f"transformers {version} cannot read {path}: {error}") from error
    rotary = written.get("text_config", written).get("rope_parameters")
    as_before = {"rope_type": "default", "rope_theta": getattr(config.get_text_config(), "rope_theta", None)}
    if rotary and version.startswith("4.") and as_before | rotary != as_before:
        problem = f"transformers {version} does not read rope_parameters of {path}"
        raise Problem(f"{problem}; say rope_theta and rope_scaling as that version does")
    return config


def described(folder, config):
    """What openvino.py must know of a model.

    Raises:
        Problem: if the model reads pictures in a way that openvino.py does not know.
    """
    context = getattr(config.get_text_config(), "max_position_embeddings", None) or 1 << 20
    vision = getattr(config, "vision_config", None)
    if vision is None:
        return {"decoder": "openvino_model.xml", "context": context, "side": 0}
    if config.model_type not in TOWERS:
        known = ", ".join(TOWERS)
        raise Problem(f"{folder}: pictures of {config.model_type} are not compared with OpenVINO, only those of {known}")
    from transformers import AutoImageProcessor

    processor = AutoImageProcessor.from_pretrained(folder, local_files_only=True)
    return {
        "decoder": "openvino_language_model.xml",
        "context": context,
        "side": getattr(vision, "image_size", "any"),
        "axes": 1,
        "merged": 0,
        "patches": 0,
        "mean": list(processor.image_mean),
        "std": list(processor.image_std),
        **TOWERS[config.model_type](vision),
    }


def write_weights(folder, files, gguf, seed):
    """Writes a folder in Hugging Face's layout: small files, weights, and the configuration as transformers writes it.

    Raises:
        Problem: if transformers cannot make the model.
    """
    try:
        import torch
        import transformers
    except (ImportError, OSError) as error:
        raise missing("transformers", error) from error
    transformers.utils.logging.disable_progress_bar()
    part = emptied(folder.with_name(folder.name + ".part"))
    for name, text in files.items():
        (part / name).write_text(text, encoding="utf-8")
    try:
        if gguf:
            path = pathlib.Path(gguf)
            model = transformers.AutoModelForCausalLM.from_pretrained(path.parent, gguf_file=path.name, dtype=torch.float32)
        else:
            config = configuration(part)
            is_seeing = getattr(config, "vision_config", None) is not None
            kind = transformers.AutoModelForImageTextToText if is_seeing else transformers.AutoModelForCausalLM
            torch.manual_seed(seed)
            model = kind.from_config(config, dtype=torch.bfloat16)
        model.save_pretrained(part)
    except (ImportError, OSError, ValueError, KeyError) as error:
        version = version_of("transformers")
        raise Problem(f"transformers {version} cannot write the weights of {gguf or folder}: {error}") from error
    try:
        part.rename(folder)
    except OSError as error:
        raise Problem(f"{folder} is there and has no safetensors: {error}; delete it") from error


class DrawnWeights(logging.Handler):
    """Notes when transformers draws weights that it does not find in the files."""

    said = ""

    def emit(self, record):
        if "newly initialized" in record.getMessage():
            self.said = record.getMessage()


def plain_export(folder, plain, source, is_seeing):
    """The folder of a model's export in f32, which is kept for further precisions.

    Raises:
        Problem: if optimum-intel does not export the model.
    """
    done = plain / RECIPE
    if done.is_file() and recipe_of(plain)["source"] == source:
        return plain
    try:
        from optimum.intel import OVModelForCausalLM, OVModelForVisualCausalLM
    except (ImportError, OSError) as error:
        raise missing("optimum-intel", error) from error
    kind = OVModelForVisualCausalLM if is_seeing else OVModelForCausalLM
    drawn = DrawnWeights()
    logging.getLogger("transformers.modeling_utils").addHandler(drawn)
    try:
        model = kind.from_pretrained(folder, export=True, load_in_8bit=False, compile=False, local_files_only=True)
        model.save_pretrained(emptied(plain))
    except Exception as error:  # It raises what the layers below it raise.
        versions = " and ".join(f"{package} {version_of(package)}" for package in ("optimum-intel", "transformers"))
        reason = f"{versions} refuse to export {folder}: {type(error).__name__}: {error}"
        raise Problem(f"{reason}; install the versions of docs/latency.md, or leave this model out") from error
    if drawn.said:
        raise Problem(f"transformers {version_of('transformers')} reads {folder} otherwise than it was written: {drawn.said}")
    done.write_text(json.dumps({"source": source}))
    return plain


def compressed(model, precision, text, is_table):
    """A model with its weights in a precision. Tables have 8 bits where matrices have 4, as in optimum-intel."""
    if precision in ("f32", "bf16"):
        return model
    try:
        import nncf
    except (ImportError, OSError) as error:
        raise missing("nncf", error) from error
    nncf.set_log_level(logging.ERROR)
    if precision == "int8" or is_table:
        return nncf.compress_weights(model)
    # precision is "int4".
    widths = (text.hidden_size, text.intermediate_size)
    group = next((group for group in GROUPS if all(width % group == 0 for width in widths)), -1)
    return nncf.compress_weights(model, mode=nncf.CompressWeightsMode.INT4_SYM, group_size=group, ratio=1.0)
