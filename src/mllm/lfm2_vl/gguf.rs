//! LFM2-VL in llama.cpp's GGUF files.

use crate::MllmError;
use crate::gguf::names::{EMBEDDING, LFM2_LAYERS, LFM2_NORM, Names, OUTPUT, VISION_LAYERS};
use crate::gguf::{Changed, Header, PairLayout, VisionFiles, Written, as_stored};
use serde_json::json;

const NORM: &str = "mm.input_norm.weight";
const POSITIONS: &str = "v.position_embd.weight";

const NAMES: Names = Names {
    single: &[
        EMBEDDING,
        LFM2_NORM,
        OUTPUT,
        (
            "v.patch_embd.weight",
            "vision_tower.embeddings.patch_embedding.weight",
        ),
        (
            "v.patch_embd.bias",
            "vision_tower.embeddings.patch_embedding.bias",
        ),
        (
            POSITIONS,
            "vision_tower.embeddings.position_embedding.weight",
        ),
        ("v.post_ln.weight", "vision_tower.post_layernorm.weight"),
        ("v.post_ln.bias", "vision_tower.post_layernorm.bias"),
        (NORM, "multi_modal_projector.layer_norm.weight"),
        (
            "mm.input_norm.bias",
            "multi_modal_projector.layer_norm.bias",
        ),
        ("mm.1.weight", "multi_modal_projector.linear_1.weight"),
        ("mm.1.bias", "multi_modal_projector.linear_1.bias"),
        ("mm.2.weight", "multi_modal_projector.linear_2.weight"),
        ("mm.2.bias", "multi_modal_projector.linear_2.bias"),
    ],
    layers: &[LFM2_LAYERS, VISION_LAYERS],
};

/// The files of an LFM2-VL.
pub(super) static LAYOUT: PairLayout = PairLayout {
    decoders: &["lfm2"],
    projector: "lfm2",
    model_type: "lfm2_vl",
    placeholder: "<image>",
    names: NAMES,
    renamed: as_stored,
    vision,
    changed: Changed::Nothing,
    written: Written::Not("how images are cut into tiles"),
};

fn vision(tower: &Header, notes: &mut Vec<String>) -> Result<VisionFiles, MllmError> {
    tower.check_activation("gelu", notes)?;
    let mut vision = tower.vision_config()?;
    vision["hidden_act"] = json!("gelu_pytorch_tanh");
    let shape = |name: &str| tower.tensors.get(name).map(|place| place.shape.as_slice());
    // The size in the file is a stand-in.
    if let Some([positions, _]) = shape(POSITIONS) {
        vision["num_patches"] = json!(positions);
    }
    let downsample = tower.required_count("clip.vision.projector.scale_factor")?;
    let mut config = json!({
        "vision_config": vision,
        "downsample_factor": downsample,
        "projector_use_layernorm": tower.tensors.contains_key(NORM),
        "projector_bias": tower.tensors.contains_key("mm.1.bias"),
    });
    if let Some([width, _]) = shape("mm.1.weight") {
        config["projector_hidden_size"] = json!(width);
    }
    notes.push(
        "the vision tower's file does not say how images are cut: tiles of 512 pixels with a thumbnail and 64 to 256 tokens \
         a view are taken, as llama.cpp does (a preprocessor_config.json beside the file replaces them)"
            .into(),
    );
    let mut processor = tower.pixel_scale()?;
    processor["image_processor_type"] = json!("Lfm2VlImageProcessor");
    processor["encoder_patch_size"] = json!(tower.required_count("clip.vision.patch_size")?);
    processor["downsample_factor"] = json!(downsample);
    Ok(VisionFiles { config, processor })
}
