//! `SmolVLM` in llama.cpp's GGUF files.

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
        ("v.post_ln.weight", "vision_tower.post_layernorm.weight"),
        ("v.post_ln.bias", "vision_tower.post_layernorm.bias"),
        ("mm.model.fc.weight", "multi_modal_projector.proj.weight"),
    ],
    layers: &[DECODER_LAYERS, VISION_LAYERS],
};

/// Key of the longest side before an image is cut, pixels.
const LONGEST: &str = "clip.vision.preproc_image_size";
/// Tiles along the longest side in all published models.
const TILES: usize = 4;

/// The files of a `SmolVLM`.
pub(super) static LAYOUT: ReadOnlyLayout = ReadOnlyLayout {
    decoders: &["llama"],
    projector: "idefics3",
    model_type: "smolvlm",
    placeholder: "<image>",
    names: NAMES,
    renamed: as_stored,
    vision,
    changed: Changed::Nothing,
    lacking: "whether images are cut into tiles",
};

fn vision(tower: &Header, notes: &mut Vec<String>) -> Result<VisionFiles, MllmError> {
    tower.check_activation("gelu", notes)?;
    let mut vision = tower.vision_config()?;
    vision["hidden_act"] = json!("gelu_pytorch_tanh");
    let tile = tower.required_count("clip.vision.image_size")?;
    let longest = if let Some(longest) = tower.count(LONGEST)? {
        longest
    } else {
        notes.push(format!(
            "the vision tower's file has no {LONGEST}; images are cut into {TILES} tiles a side"
        ));
        TILES * tile
    };
    let mut processor = tower.pixel_scale()?;
    processor["image_processor_type"] = json!("SmolVLMImageProcessor");
    processor["size"] = json!({"longest_edge": longest});
    processor["max_image_size"] = json!({"longest_edge": tile});
    let scale = tower.required_count("clip.vision.projector.scale_factor")?;
    Ok(VisionFiles {
        config: json!({"scale_factor": scale, "vision_config": vision}),
        processor,
    })
}
