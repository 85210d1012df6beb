//! Qwen3-VL in llama.cpp's GGUF files.

use super::config::Qwen3VlConfig;
use super::patches::PatchProcessor;
use crate::MllmError;
use crate::checkpoint::{LlamaConfig, ModelFiles, VisionConfig};
use crate::gguf::names::{
    DECODER_LAYERS, EMBEDDING, FINAL_NORM, Names, OUTPUT, Pair, VISION_LAYERS,
};
use crate::gguf::{
    Changed, Described, Description, Header, PairLayout, TowerDescription, VisionFiles, Written,
    decoder, tower_with_activation,
};
use planagent_kernels::Activation;
use serde_json::{Value, json};

/// The tensors outside of layers that Qwen's vision-language models share.
pub(crate) const QWEN_NAMES: [Pair; 13] = [
    EMBEDDING,
    FINAL_NORM,
    OUTPUT,
    (
        "v.patch_embd.weight",
        "vision_tower.embeddings.patch_embedding.weight",
    ),
    (
        "v.patch_embd.weight.1",
        "vision_tower.embeddings.patch_embedding.second.weight",
    ),
    (
        "v.patch_embd.bias",
        "vision_tower.embeddings.patch_embedding.bias",
    ),
    (
        "v.position_embd.weight",
        "vision_tower.embeddings.position_embedding.weight",
    ),
    ("v.post_ln.weight", "multi_modal_projector.norm.weight"),
    ("v.post_ln.bias", "multi_modal_projector.norm.bias"),
    ("mm.0.weight", "multi_modal_projector.linear_fc1.weight"),
    ("mm.0.bias", "multi_modal_projector.linear_fc1.bias"),
    ("mm.2.weight", "multi_modal_projector.linear_fc2.weight"),
    ("mm.2.bias", "multi_modal_projector.linear_fc2.bias"),
];

const DEEP: &str = "v.deepstack.";
/// Key of the layers that have these.
const DEEP_LAYERS: &str = "clip.vision.is_deepstack_layers";
const NAMES: Names = Names {
    single: &QWEN_NAMES,
    layers: &[
        DECODER_LAYERS,
        VISION_LAYERS,
        (
            DEEP,
            "multi_modal_projector.deepstack.",
            &[
                ("norm", "norm"),
                ("fc1", "linear_fc1"),
                ("fc2", "linear_fc2"),
            ],
        ),
    ],
};

/// Key of the side of the blocks of patches that become a token, and llama.cpp's default.
const MERGE_KEY: &str = "clip.vision.spatial_merge_size";
const MERGE: usize = 2;
/// Frames that a patch of llama.cpp's files holds.
const FRAMES: usize = 2;
/// Keys of the least and most pixels of an image.
const LIMITS: [&str; 2] = [
    "clip.vision.image_min_pixels",
    "clip.vision.image_max_pixels",
];
/// Architecture of the decoder, and kind of the projector.
const DECODER: &str = "qwen3vl";
const PROJECTOR: &str = "qwen3vl_merger";
/// The placeholder of an image.
pub(crate) const IMAGE: &str = "<|image_pad|>";
/// Least and most pixels of the published processor.
const PIXELS: [u64; 2] = [65_536, 16_777_216];

/// The layers of the tower whose outputs go to the decoder.
fn deep_layers(tower: &Header) -> Result<Vec<usize>, MllmError> {
    let flags: Option<Vec<bool>> = tower.list(DEEP_LAYERS, "a list of true and false")?;
    if flags.is_none() && tower.tensors.keys().any(|name| name.starts_with(DEEP)) {
        let problem = "is missing from the metadata, and the file has mergers of such layers";
        return Err(tower.error(DEEP_LAYERS, problem));
    }
    let flags = flags.unwrap_or_default();
    Ok(flags
        .iter()
        .enumerate()
        .filter(|(_, deep)| **deep)
        .map(|(layer, _)| layer)
        .collect())
}

/// The image processor of a tower, and a note where its file has no limits of an image's pixels.
pub(crate) fn limits(
    tower: &Header,
    pixels: [u64; 2],
    merge: usize,
    notes: &mut Vec<String>,
) -> Result<Value, MllmError> {
    let [least_key, most_key] = LIMITS;
    let named = [tower.whole(least_key)?, tower.whole(most_key)?];
    let [(least, own_least), (most, own_most)] = [(pixels[0], named[0]), (pixels[1], named[1])];
    let [least, most] = [own_least.unwrap_or(least), own_most.unwrap_or(most)];
    if named.contains(&None) {
        notes.push(format!(
            "the vision tower's file has no limits of an image's pixels; {least} to {most} are taken, those of the published \
             processor (a preprocessor_config.json beside the file replaces them)"
        ));
    }
    let mut processor = tower.pixel_scale()?;
    processor["image_processor_type"] = json!("Qwen2VLImageProcessor");
    processor["size"] = PatchProcessor::limits([least, most]);
    processor["patch_size"] = json!(tower.required_count("clip.vision.patch_size")?);
    processor["merge_size"] = json!(merge);
    Ok(processor)
}

/// The files of a Qwen3-VL.
pub(super) static LAYOUT: PairLayout = PairLayout {
    decoders: &[DECODER],
    projector: PROJECTOR,
    model_type: "qwen3_vl",
    placeholder: IMAGE,
    names: NAMES,
    renamed,
    vision,
    changed: Changed::Nothing,
    written: Written::With(metadata),
};

/// The small files of a tower.
pub(crate) fn vision(tower: &Header, notes: &mut Vec<String>) -> Result<VisionFiles, MllmError> {
    tower.check_activation("gelu", notes)?;
    let sizes = tower.vision_config()?;
    let patch = tower.required_count("clip.vision.patch_size")?;
    let side = tower.required_count("clip.vision.image_size")? / patch.max(1);
    let merge = tower.count(MERGE_KEY)?;
    if merge.is_none() {
        notes.push(tower.taken(MERGE_KEY, MERGE));
    }
    let merge = merge.unwrap_or(MERGE);
    let config = json!({
        "vision_config": {
            "depth": sizes["num_hidden_layers"],
            "hidden_size": sizes["hidden_size"],
            "intermediate_size": sizes["intermediate_size"],
            "num_heads": sizes["num_attention_heads"],
            "patch_size": patch,
            "layer_norm_eps": sizes["layer_norm_eps"],
            "hidden_act": "gelu_pytorch_tanh",
            "spatial_merge_size": merge,
            "num_position_embeddings": side * side,
            "deepstack_visual_indexes": deep_layers(tower)?,
        },
    });
    Ok(VisionFiles {
        config,
        processor: limits(tower, PIXELS, merge, notes)?,
    })
}

/// llama.cpp counts the mergers of early layers by the tower's layers, transformers from 0.
fn renamed(file: &Header, name: &str) -> Result<Option<String>, MllmError> {
    let counted = name
        .strip_prefix(DEEP)
        .and_then(|rest| rest.split_once('.'));
    let Some((layer, part)) =
        counted.and_then(|(layer, part)| Some((layer.parse::<usize>().ok()?, part)))
    else {
        return Ok(Some(name.to_string()));
    };
    let index = deep_layers(file)?.iter().position(|deep| *deep == layer);
    Ok(index.map(|index| format!("{DEEP}{index}.{part}")))
}

/// Epsilon of the norms of Qwen2-VL's and Qwen2.5-VL's towers, which transformers' classes have no
/// key for.
pub(crate) const QWEN2_EPSILON: f64 = 1e-6;
/// Side of an image that files of these two name and no code uses, pixels, as in llama.cpp's.
const QWEN2_IMAGE_SIZE: usize = 560;

/// A model of Qwen whose tower takes an image of any size.
#[derive(Clone, Copy)]
pub(crate) struct PatchTower<'a> {
    /// The tower; its image size is the one that the file names.
    pub vision: &'a VisionConfig,
    pub text: &'a LlamaConfig,
    /// Side of the blocks of patches that become one token.
    pub merge: usize,
    /// Frames that a patch holds.
    pub frames: usize,
    pub processor: &'a PatchProcessor,
}

impl PatchTower<'_> {
    /// The metadata of a model with a decoder of this architecture, and a tower with this kind of
    /// projector and activation.
    pub(crate) fn describe(
        &self,
        architecture: &'static str,
        projector: &str,
        act: Activation,
    ) -> Described {
        let (found, decoder) = decoder::describe(self.text)?;
        if found != architecture {
            return Err("this decoder with this tower");
        }
        if self.frames != FRAMES {
            return Err("patches of another number of frames than two");
        }
        let scale = self.processor.scale().mean_and_deviation();
        let mut tower =
            tower_with_activation(act, projector, self.vision, self.text.hidden, scale)?;
        tower.push((MERGE_KEY.to_owned(), json!(self.merge)));
        for (key, pixels) in LIMITS.into_iter().zip(self.processor.pixels()) {
            tower.push((key.to_owned(), json!(pixels)));
        }
        Ok(Description {
            architecture,
            decoder,
            tower: Some(TowerDescription::apart(tower)),
        })
    }

    /// As [`Self::describe`], of a Qwen2-VL or Qwen2.5-VL, whose towers learn no positions.
    pub(crate) fn describe_qwen2(
        &self,
        architecture: &'static str,
        projector: &str,
        act: Activation,
    ) -> Described {
        if (self.vision.layer_norm_eps / QWEN2_EPSILON - 1.0).abs() > 1e-6 {
            return Err("another epsilon of the tower's norms");
        }
        let vision = VisionConfig {
            image_size: QWEN2_IMAGE_SIZE,
            ..self.vision.clone()
        };
        let named = PatchTower {
            vision: &vision,
            ..*self
        };
        named.describe(architecture, projector, act)
    }
}

/// The metadata of a model with these files.
fn metadata(files: &ModelFiles) -> Result<Described, MllmError> {
    let config = Qwen3VlConfig::open(files)?;
    let patch = config.vision.patch_size;
    let processor = PatchProcessor::open(files, patch as u32, config.merge as u32)?;
    let vision = VisionConfig {
        // The learned positions, by which the file counts them.
        image_size: config.positions * patch,
        ..config.vision.clone()
    };
    let model = PatchTower {
        vision: &vision,
        text: &config.text,
        merge: config.merge,
        frames: config.frames,
        processor: &processor,
    };
    let described = model.describe(DECODER, PROJECTOR, Activation::GeluTanh);
    Ok(described.map(|described| with_deep_layers(described, &config)))
}

/// Adds the layers whose outputs go to the decoder. This tower's projections are one tensor.
fn with_deep_layers(mut described: Description, config: &Qwen3VlConfig) -> Description {
    let count = format!("{DECODER}.n_deepstack_layers");
    described.decoder.push((count, json!(config.deep.len())));
    if let Some(tower) = &mut described.tower {
        let flags = (0..config.vision.layers).map(|layer| config.deep.contains(&layer));
        let flags = flags.collect::<Vec<_>>();
        tower.metadata.push((DEEP_LAYERS.to_owned(), json!(flags)));
        tower.fused = Some(true);
        tower.deep_layers.clone_from(&config.deep);
    }
    described
}
