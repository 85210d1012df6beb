//! Qwen2-VL in llama.cpp's GGUF files. Its decoders have the architecture of Qwen2.5-VL's; the
//! projector tells the families apart.

use super::config::Qwen2VlConfig;
use crate::MllmError;
use crate::checkpoint::ModelFiles;
use crate::gguf::names::{DECODER_LAYERS, Names, VISION_LAYERS};
use crate::gguf::{Changed, Described, Header, PairLayout, VisionFiles, Written, as_stored};
use crate::qwen3_vl::{IMAGE, PatchProcessor, PatchTower, QWEN_NAMES, QWEN2_EPSILON, limits};
use planagent_kernels::Activation;
use serde_json::json;

const NAMES: Names = Names {
    single: &QWEN_NAMES,
    layers: &[DECODER_LAYERS, VISION_LAYERS],
};

/// Architecture of the decoder, and kind of the projector.
const DECODER: &str = "qwen2vl";
const PROJECTOR: &str = "qwen2vl_merger";
/// Least and most pixels of the published processor.
const PIXELS: [u64; 2] = [3136, 12_845_056];
/// Side of the blocks of patches that become a token; the files do not say it.
const MERGE: usize = 2;
/// The first layer of the feed-forward part, in the first layer of the tower.
const UP: &str = "v.blk.0.ffn_up.weight";
/// The last layer of the merger.
const OUT: &str = "mm.2.weight";

/// The files of a Qwen2-VL.
pub(super) static LAYOUT: PairLayout = PairLayout {
    decoders: &[DECODER],
    projector: PROJECTOR,
    model_type: "qwen2_vl",
    placeholder: IMAGE,
    names: NAMES,
    renamed: as_stored,
    vision,
    changed: Changed::Nothing,
    written: Written::With(metadata),
};

fn vision(tower: &Header, notes: &mut Vec<String>) -> Result<VisionFiles, MllmError> {
    tower.check_activation("quick_gelu", notes)?;
    tower.check_epsilon(QWEN2_EPSILON)?;
    let sizes = tower.vision_config()?;
    let hidden = tower.required_count("clip.vision.embedding_length")?;
    let merge = tower
        .count_or_none("clip.vision.spatial_merge_size")?
        .unwrap_or(MERGE);
    let config = json!({
        "vision_config": {
            "depth": sizes["num_hidden_layers"],
            "embed_dim": hidden,
            "mlp_ratio": wide(tower, hidden)? as f64 / hidden.max(1) as f64,
            "hidden_size": shape(tower, OUT)?[0],
            "num_heads": sizes["num_attention_heads"],
            "patch_size": sizes["patch_size"],
            "hidden_act": "quick_gelu",
            "spatial_merge_size": merge,
        },
    });
    Ok(VisionFiles {
        config,
        processor: limits(tower, PIXELS, merge, notes)?,
    })
}

/// Width of the feed-forward layers. The key of this name holds the decoder's width
/// (`conversion/qwenvl.py` in llama.cpp), and older files have the layers' names exchanged.
fn wide(tower: &Header, hidden: usize) -> Result<usize, MllmError> {
    let [outputs, inputs] = shape(tower, UP)?;
    Ok(if inputs == hidden { outputs } else { inputs })
}

/// Outputs and inputs of a matrix.
fn shape(tower: &Header, name: &str) -> Result<[usize; 2], MllmError> {
    let place = tower.tensors.get(name);
    place
        .and_then(|place| place.shape.as_slice().try_into().ok())
        .ok_or_else(|| MllmError::MissingTensor {
            folder: tower.path.clone(),
            name: name.into(),
        })
}

/// The metadata of a model with these files.
fn metadata(files: &ModelFiles) -> Result<Described, MllmError> {
    let config = Qwen2VlConfig::open(files)?;
    let patch = config.vision.patch_size as u32;
    let processor = PatchProcessor::open(files, patch, config.merge as u32)?;
    Ok(described(&config, &processor))
}

fn described(config: &Qwen2VlConfig, processor: &PatchProcessor) -> Described {
    let model = PatchTower {
        vision: &config.vision,
        text: &config.text,
        merge: config.merge,
        frames: config.frames,
        processor,
    };
    model.describe_qwen2(DECODER, PROJECTOR, Activation::QuickGelu)
}
