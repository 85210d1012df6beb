//! Gemma 4 with vision in llama.cpp's GGUF files.

use crate::MllmError;
use crate::gguf::names::{
    EMBEDDING, FINAL_NORM, GEMMA4_LAYERS, GEMMA4_SINGLE, Names, OUTPUT, Pair, ROTARY,
};
use crate::gguf::{Changed, Header, PairLayout, VisionFiles, Written, as_stored};
use serde_json::json;

const POSITIONS: &str = "v.position_embd.weight";
const SHIFT: &str = "v.std_bias";

const NAMES: Names = Names {
    single: &[
        EMBEDDING,
        FINAL_NORM,
        OUTPUT,
        ROTARY,
        GEMMA4_SINGLE[0],
        GEMMA4_SINGLE[1],
        GEMMA4_SINGLE[2],
        (
            "v.patch_embd.weight",
            "vision_tower.embeddings.patch_embedding.weight",
        ),
        (
            POSITIONS,
            "vision_tower.patch_embedder.position_embedding_table",
        ),
        (SHIFT, "vision_tower.std_bias"),
        ("v.std_scale", "vision_tower.std_scale"),
        (
            "mm.input_projection.weight",
            "multi_modal_projector.embedding_projection.weight",
        ),
    ],
    layers: &[
        GEMMA4_LAYERS,
        ("v.blk.", "vision_tower.encoder.layers.", &TOWER_PARTS),
    ],
};

const TOWER_PARTS: [Pair; 13] = [
    ("ln1", "input_layernorm"),
    ("attn_q", "self_attn.q_proj"),
    ("attn_k", "self_attn.k_proj"),
    ("attn_v", "self_attn.v_proj"),
    ("attn_q_norm", "self_attn.q_norm"),
    ("attn_k_norm", "self_attn.k_norm"),
    ("attn_out", "self_attn.o_proj"),
    ("attn_post_norm", "post_attention_layernorm"),
    ("ln2", "pre_feedforward_layernorm"),
    ("ffn_gate", "mlp.gate_proj"),
    ("ffn_up", "mlp.up_proj"),
    ("ffn_down", "mlp.down_proj"),
    ("ffn_post_norm", "post_feedforward_layernorm"),
];

/// The files of a Gemma 4.
pub(super) static LAYOUT: PairLayout = PairLayout {
    decoders: &["gemma4"],
    projector: "gemma4v",
    model_type: "gemma4",
    placeholder: "<|image|>",
    names: NAMES,
    renamed: as_stored,
    vision,
    changed: Changed::Nothing,
    written: Written::Not("how many tokens an image becomes"),
};

fn vision(tower: &Header, notes: &mut Vec<String>) -> Result<VisionFiles, MllmError> {
    let mut vision = tower.vision_config()?;
    vision["rms_norm_eps"] = vision["layer_norm_eps"].take();
    // The size in the file is a stand-in.
    vision["image_size"].take();
    let side = |name: &str, axis: usize| {
        let place = tower.tensors.get(name)?;
        place.shape.get(axis).copied()
    };
    if let Some(width) = side("v.blk.0.attn_q_norm.weight", 0) {
        vision["head_dim"] = json!(width);
        if let Some(keys) = side("v.blk.0.attn_k.weight", 0) {
            vision["num_key_value_heads"] = json!(keys / width.max(1));
        }
    }
    if let Some(positions) = side(POSITIONS, 1) {
        vision["position_embedding_size"] = json!(positions);
    }
    vision["standardize"] = json!(tower.tensors.contains_key(SHIFT));
    vision["use_clipped_linears"] = json!(tower.tensors.contains_key("v.blk.0.attn_q.input_max"));
    notes.push(
        "the vision tower's file does not say how many tokens an image becomes: at most 280, of 3 by 3 patches, are \
         taken, as llama.cpp does (a preprocessor_config.json beside the file replaces them)"
            .into(),
    );
    let mut processor = tower.pixel_scale()?;
    processor["image_processor_type"] = json!("Gemma4ImageProcessor");
    processor["patch_size"] = json!(tower.required_count("clip.vision.patch_size")?);
    processor["do_normalize"] = json!(true);
    let config = json!({"vision_config": vision});
    Ok(VisionFiles { config, processor })
}
