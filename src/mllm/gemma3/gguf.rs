//! Gemma 3 with vision in llama.cpp's GGUF files.

use super::config::Gemma3Config;
use super::processor;
use crate::MllmError;
use crate::checkpoint::ModelFiles;
use crate::gguf::names::{EMBEDDING, FINAL_NORM, GEMMA_LAYERS, Names, OUTPUT, VISION_LAYERS};
use crate::gguf::{
    Described, Description, GgufLayout, Header, TextFiles, TowerDescription, decoder, gemma,
    is_pair, no_tower, tower_with_activation,
};
use crate::vision::PixelScale;
use planagent_kernels::Activation;
use serde_json::json;
use std::collections::BTreeMap;

const NAMES: Names = Names {
    single: &[
        EMBEDDING,
        FINAL_NORM,
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
            "v.position_embd.weight",
            "vision_tower.embeddings.position_embedding.weight",
        ),
        ("v.post_ln.weight", "vision_tower.post_layernorm.weight"),
        ("v.post_ln.bias", "vision_tower.post_layernorm.bias"),
        (
            "mm.soft_emb_norm.weight",
            "multi_modal_projector.mm_soft_emb_norm.weight",
        ),
        (
            "mm.input_projection.weight",
            "multi_modal_projector.mm_input_projection_weight",
        ),
    ],
    layers: &[GEMMA_LAYERS, VISION_LAYERS],
};

/// The kind of the projector.
const PROJECTOR: &str = "gemma3";
/// The token of an image. A file whose tokenizer ends before it gets it behind all others.
const SOFT: &str = "<image_soft_token>";
/// Key of the side of the blocks of patches that become a token.
const SCALE: &str = "clip.vision.projector.scale_factor";
/// Their side where a file does not say it.
const POOL: usize = 4;

/// The files of a Gemma 3 with vision.
pub(super) struct Gemma3Gguf;

impl GgufLayout for Gemma3Gguf {
    fn opens(&self, decoder: &Header, tower: Option<&Header>) -> bool {
        is_pair(decoder, tower, &[gemma::ARCHITECTURE], PROJECTOR)
    }

    fn small_files(
        &self,
        decoder: &Header,
        tower: Option<&Header>,
        notes: &mut Vec<String>,
    ) -> Result<BTreeMap<String, String>, MllmError> {
        let tower = tower.ok_or_else(|| no_tower(decoder, "its configuration"))?;
        tower.check_activation("gelu", notes)?;
        let mut files = TextFiles::read(decoder, notes)?;
        let mut vision = tower.vision_config()?;
        // llama.cpp writes one word for both forms of this activation; transformers' class has the
        // one by tanh.
        vision["hidden_act"] = json!("gelu_pytorch_tanh");
        let pool = tower.count_or_none(SCALE)?;
        if pool.is_none() {
            notes.push(tower.taken(SCALE, POOL));
        }
        let pool = pool.unwrap_or(POOL);
        let patch = tower.required_count("clip.vision.patch_size")?.max(1);
        let size = tower.required_count("clip.vision.image_size")?;
        let side = size / patch / pool.max(1);
        let config = json!({
            "model_type": "gemma3",
            "image_token_id": files.id_of(decoder, SOFT)?,
            "mm_tokens_per_image": side * side,
            "text_config": files.text_config.clone(),
            "vision_config": vision,
        });
        let mut processor = tower.pixel_scale()?;
        processor["image_processor_type"] = json!("Gemma3ImageProcessor");
        processor["size"] = json!({"height": size, "width": size});
        files.put("config.json", &config);
        files.put("preprocessor_config.json", &processor);
        Ok(files.into_files())
    }

    fn canonical_name(&self, file: &Header, name: &str) -> Result<Option<String>, MllmError> {
        NAMES.unswapped(file, name)
    }

    fn gguf_name(&self, canonical: &str) -> Option<String> {
        NAMES.in_gguf(canonical)
    }

    fn norms_have_one(&self) -> bool {
        true
    }

    fn metadata(&self, files: &ModelFiles) -> Result<Described, MllmError> {
        let config = Gemma3Config::open(files)?;
        Ok(described(&config, processor(files)?.scale()))
    }
}

fn described(config: &Gemma3Config, scale: &PixelScale) -> Described {
    let (architecture, decoder) = decoder::describe(&config.text)?;
    let mut tower = tower_with_activation(
        Activation::GeluTanh,
        PROJECTOR,
        &config.vision,
        config.text.hidden,
        scale.mean_and_deviation(),
    )?;
    tower.push((SCALE.to_owned(), json!(config.pool)));
    Ok(Description {
        architecture,
        decoder,
        tower: Some(TowerDescription::plain(tower)),
    })
}
