//! Qwen2.5-VL in llama.cpp's GGUF files.

use std::collections::BTreeMap;

use serde_json::{Value, json};

use crate::mllm::MllmError;
use crate::mllm::checkpoint::ModelFiles;
use crate::mllm::gguf::names::{DECODER_LAYERS, Names, unswapped};
use crate::mllm::gguf::{Entries, GgufLayout, Header, TextFiles};
use crate::mllm::qwen3_vl::{IMAGE, QWEN_NAMES, limits};

/// The files of a Qwen2.5-VL.
pub(super) struct Qwen25VlGguf;

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

/// Least and most pixels of the published processor.
const PIXELS: [u64; 2] = [3136, 12_845_056];
/// Side of the blocks of patches that become a token, and of a window in pixels; the files do not say them.
const MERGE: usize = 2;
const WINDOW: usize = 112;
/// Key of the distance of layers that attend to the whole image.
const WHOLE_EVERY: &str = "clip.vision.n_wa_pattern";

impl GgufLayout for Qwen25VlGguf {
    fn opens(&self, decoder: &Header, tower: &Header) -> bool {
        matches!(decoder.architecture(), Ok("qwen2vl")) && matches!(tower.projector(), Ok(Some("qwen2.5vl_merger")))
    }

    fn small_files(
        &self,
        decoder: &Header,
        tower: &Header,
        notes: &mut Vec<String>,
    ) -> Result<BTreeMap<String, String>, MllmError> {
        let mut files = TextFiles::read(decoder)?;
        let sizes = tower.vision_config()?;
        let layers = tower.required_count("clip.vision.block_count")?;
        let every = tower.required_count(WHOLE_EVERY)?;
        let config: Value = json!({
            "model_type": "qwen2_5_vl",
            "image_token_id": files.added_id(decoder, IMAGE)?,
            "text_config": files.text_config.clone(),
            "vision_config": {
                "depth": layers,
                "hidden_size": sizes["hidden_size"],
                "intermediate_size": sizes["intermediate_size"],
                "num_heads": sizes["num_attention_heads"],
                "patch_size": sizes["patch_size"],
                "hidden_act": "silu",
                "spatial_merge_size": MERGE,
                "window_size": WINDOW,
                "fullatt_block_indexes": (0..layers).filter(|layer| (layer + 1).is_multiple_of(every)).collect::<Vec<_>>(),
            },
        });
        files.put("config.json", &config);
        files.put("preprocessor_config.json", &limits(tower, PIXELS, MERGE, notes)?);
        Ok(files.into_files())
    }

    fn canonical_name(&self, file: &Header, name: &str) -> Result<Option<String>, MllmError> {
        let hidden = file.count("clip.vision.embedding_length")?;
        Ok(NAMES.to_canonical(name).map(|canonical| unswapped(file, canonical, hidden)))
    }

    fn gguf_name(&self, canonical: &str) -> Option<String> {
        NAMES.in_gguf(canonical)
    }

    fn metadata(&self, _files: &ModelFiles) -> Result<Result<[Entries; 2], &'static str>, MllmError> {
        Ok(Err("the limits of an image's pixels"))
    }
}
