//! `InternVL` in llama.cpp's GGUF files, which its converter makes from the authors' layout.

use super::config::IMAGE;
use crate::MllmError;
use crate::gguf::names::{
    DECODER_LAYERS, EMBEDDING, FINAL_NORM, Names, OUTPUT, ROTARY, VISION_LAYERS,
};
use crate::gguf::{Changed, Header, ReadOnlyLayout, VisionFiles, as_stored};
use serde_json::json;

const NAMES: Names = Names {
    single: &[
        EMBEDDING,
        FINAL_NORM,
        OUTPUT,
        ROTARY,
        ("v.class_embd", "vision_tower.embeddings.class_embedding"),
        (
            "v.patch_embd.weight",
            "vision_tower.embeddings.patch_embedding.weight",
        ),
        (
            "v.patch_embd.bias",
            "vision_tower.embeddings.patch_embedding.bias",
        ),
        (
            "v.position_embd.weight",
            "vision_tower.embeddings.position_embedding.weight",
        ),
        (
            "mm.model.mlp.0.weight",
            "multi_modal_projector.layer_norm.weight",
        ),
        (
            "mm.model.mlp.0.bias",
            "multi_modal_projector.layer_norm.bias",
        ),
        (
            "mm.model.mlp.1.weight",
            "multi_modal_projector.linear_1.weight",
        ),
        ("mm.model.mlp.1.bias", "multi_modal_projector.linear_1.bias"),
        (
            "mm.model.mlp.3.weight",
            "multi_modal_projector.linear_2.weight",
        ),
        ("mm.model.mlp.3.bias", "multi_modal_projector.linear_2.bias"),
    ],
    layers: &[DECODER_LAYERS, VISION_LAYERS],
};

/// Keys of the least and most tiles, with the published models' numbers.
const TILES: [(&str, &str, usize); 2] = [
    ("clip.vision.preproc_min_tiles", "min_patches", 1),
    ("clip.vision.preproc_max_tiles", "max_patches", 12),
];

/// The files of an `InternVL`.
pub(super) static LAYOUT: ReadOnlyLayout = ReadOnlyLayout {
    decoders: &["qwen2", "qwen3", "llama"],
    projector: "internvl",
    model_type: "internvl",
    placeholder: IMAGE,
    names: NAMES,
    renamed: as_stored,
    vision,
    changed: Changed::Nothing,
    lacking: "the filter that images are resized with",
};

fn vision(tower: &Header, notes: &mut Vec<String>) -> Result<VisionFiles, MllmError> {
    tower.check_activation("gelu", notes)?;
    let mut vision = tower.vision_config()?;
    vision["hidden_act"] = json!("gelu");
    vision["attention_bias"] = json!(true);
    let mut processor = tower.pixel_scale()?;
    processor["image_processor_type"] = json!("GotOcr2ImageProcessor");
    processor["size"] = vision["image_size"].clone();
    for (key, name, published) in TILES {
        let count = tower.count(key)?;
        if count.is_none() {
            notes.push(format!(
                "the vision tower's file has no {key}; it is taken for {published}"
            ));
        }
        processor[name] = json!(count.unwrap_or(published));
    }
    let scale = tower.required_count("clip.vision.projector.scale_factor")?;
    Ok(VisionFiles {
        config: json!({"downsample_ratio": 1.0 / scale as f64, "vision_config": vision}),
        processor,
    })
}
