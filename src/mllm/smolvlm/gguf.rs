//! `SmolVLM` in llama.cpp's GGUF files.

use std::collections::BTreeMap;

use serde_json::{Value, json};

use crate::mllm::MllmError;
use crate::mllm::checkpoint::ModelFiles;
use crate::mllm::gguf::names::{DECODER_LAYERS, EMBEDDING, FINAL_NORM, Names, OUTPUT, VISION_LAYERS, unswapped};
use crate::mllm::gguf::{Entries, GgufLayout, Header, TextFiles};

/// The files of a `SmolVLM`.
pub(super) struct SmolVlmGguf;

const NAMES: Names = Names {
    single: &[
        EMBEDDING,
        FINAL_NORM,
        OUTPUT,
        ("v.patch_embd.weight", "vision_tower.embeddings.patch_embedding.weight"),
        ("v.patch_embd.bias", "vision_tower.embeddings.patch_embedding.bias"),
        ("v.position_embd.weight", "vision_tower.embeddings.position_embedding.weight"),
        ("v.post_ln.weight", "vision_tower.post_layernorm.weight"),
        ("v.post_ln.bias", "vision_tower.post_layernorm.bias"),
        ("mm.model.fc.weight", "multi_modal_projector.proj.weight"),
    ],
    layers: &[DECODER_LAYERS, VISION_LAYERS],
};

/// The placeholder of an image.
const IMAGE: &str = "<image>";
/// Key of the longest side before an image is cut, pixels.
const LONGEST: &str = "clip.vision.preproc_image_size";
/// Tiles along the longest side in all published models.
const TILES: usize = 4;

impl GgufLayout for SmolVlmGguf {
    fn opens(&self, decoder: &Header, tower: &Header) -> bool {
        matches!(decoder.architecture(), Ok("llama")) && matches!(tower.projector(), Ok(Some("idefics3")))
    }

    fn small_files(
        &self,
        decoder: &Header,
        tower: &Header,
        notes: &mut Vec<String>,
    ) -> Result<BTreeMap<String, String>, MllmError> {
        let mut files = TextFiles::read(decoder)?;
        let image_token = files.added_id(decoder, IMAGE)?;
        let mut vision = tower.vision_config()?;
        vision["hidden_act"] = json!("gelu_pytorch_tanh");
        let tile = tower.required_count("clip.vision.image_size")?;
        let longest = if let Some(longest) = tower.count(LONGEST)? {
            longest
        } else {
            notes.push(format!("the vision tower's file has no {LONGEST}; images are cut into {TILES} tiles a side"));
            TILES * tile
        };
        let mut processor = tower.pixel_scale()?;
        processor["image_processor_type"] = json!("SmolVLMImageProcessor");
        processor["size"] = json!({"longest_edge": longest});
        processor["max_image_size"] = json!({"longest_edge": tile});
        let config: Value = json!({
            "model_type": "smolvlm",
            "image_token_id": image_token,
            "scale_factor": tower.required_count("clip.vision.projector.scale_factor")?,
            "text_config": files.text_config.clone(),
            "vision_config": vision,
        });
        files.put("config.json", &config);
        files.put("preprocessor_config.json", &processor);
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
        Ok(Err("whether images are cut into tiles"))
    }
}
