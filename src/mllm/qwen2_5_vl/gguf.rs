//! Qwen2.5-VL in llama.cpp's GGUF files.

use super::config::Qwen25VlConfig;
use crate::MllmError;
use crate::checkpoint::ModelFiles;
use crate::gguf::names::{DECODER_LAYERS, Names};
use crate::gguf::{Changed, Described, Header, PairLayout, VisionFiles, Written, as_stored};
use crate::qwen3_vl::{IMAGE, PatchProcessor, PatchTower, QWEN_NAMES, QWEN2_EPSILON, limits};
use planagent_kernels::Activation;
use serde_json::json;

const NAMES: Names = Names {
    single: &QWEN_NAMES,
    layers: &[
        DECODER_LAYERS,
        (
            "v.blk.",
            "vision_tower.encoder.layers.",
            &[
                ("ln1", "layer_norm1"),
                ("ln2", "layer_norm2"),
                ("attn_q", "self_attn.q_proj"),
                ("attn_k", "self_attn.k_proj"),
                ("attn_v", "self_attn.v_proj"),
                ("attn_out", "self_attn.out_proj"),
                ("ffn_gate", "mlp.gate_proj"),
                ("ffn_up", "mlp.up_proj"),
                ("ffn_down", "mlp.down_proj"),
            ],
        ),
    ],
};

/// Architecture of the decoder, and kind of the projector.
const DECODER: &str = "qwen2vl";
const PROJECTOR: &str = "qwen2.5vl_merger";
/// Least and most pixels of the published processor.
const PIXELS: [u64; 2] = [3136, 12_845_056];
/// Side of the blocks of patches that become a token, and of a window in pixels; the files do not
/// say them.
const MERGE: usize = 2;
const WINDOW: usize = 112;
/// Key of the distance of layers that attend to the whole image.
const WHOLE_EVERY: &str = "clip.vision.n_wa_pattern";

/// The files of a Qwen2.5-VL.
pub(super) static LAYOUT: PairLayout = PairLayout {
    decoders: &[DECODER],
    projector: PROJECTOR,
    model_type: "qwen2_5_vl",
    placeholder: IMAGE,
    names: NAMES,
    renamed: as_stored,
    vision,
    changed: Changed::Nothing,
    written: Written::With(metadata),
};

fn vision(tower: &Header, notes: &mut Vec<String>) -> Result<VisionFiles, MllmError> {
    tower.check_activation("silu", notes)?;
    tower.check_epsilon(QWEN2_EPSILON)?;
    let sizes = tower.vision_config()?;
    let layers = tower.required_count("clip.vision.block_count")?;
    let every = tower.required_count(WHOLE_EVERY)?;
    let merge = tower
        .count_or_none("clip.vision.spatial_merge_size")?
        .unwrap_or(MERGE);
    let config = json!({
        "vision_config": {
            "depth": layers,
            "hidden_size": sizes["hidden_size"],
            "intermediate_size": sizes["intermediate_size"],
            "num_heads": sizes["num_attention_heads"],
            "patch_size": sizes["patch_size"],
            "hidden_act": "silu",
            "spatial_merge_size": merge,
            "window_size": tower.count_or_none("clip.vision.window_size")?.unwrap_or(WINDOW),
            "fullatt_block_indexes": (0..layers).filter(|layer| (layer + 1).is_multiple_of(every)).collect::<Vec<_>>(),
        },
    });
    Ok(VisionFiles {
        config,
        processor: limits(tower, PIXELS, merge, notes)?,
    })
}

/// The metadata of a model with these files.
fn metadata(files: &ModelFiles) -> Result<Described, MllmError> {
    let config = Qwen25VlConfig::open(files)?;
    let patch = config.vision.patch_size as u32;
    let processor = PatchProcessor::open(files, patch, config.merge as u32)?;
    Ok(described(&config, &processor))
}

fn described(config: &Qwen25VlConfig, processor: &PatchProcessor) -> Described {
    let model = PatchTower {
        vision: &config.vision,
        text: &config.text,
        merge: config.merge,
        frames: config.frames,
        processor,
    };
    let every =
        whole_every(config).ok_or("layers that attend to the whole image at uneven distances")?;
    if config.window != WINDOW / config.vision.patch_size / config.merge * config.merge {
        return Err("windows of another size than 112 pixels");
    }
    let mut described = model.describe_qwen2(DECODER, PROJECTOR, Activation::Silu)?;
    if let Some(tower) = &mut described.tower {
        tower.metadata.push((WHOLE_EVERY.to_owned(), json!(every)));
    }
    Ok(described)
}

/// The distance of layers that attend to the whole image, the first of which ends a period.
fn whole_every(config: &Qwen25VlConfig) -> Option<usize> {
    let every = config.whole.first()? + 1;
    let is_whole = |layer: &usize| (layer + 1).is_multiple_of(every);
    (0..config.vision.layers)
        .filter(is_whole)
        .eq(config.whole.iter().copied())
        .then_some(every)
}
