//! LLaVA and LLaVA-NeXT in llama.cpp's GGUF files.

mod template;
mod tower;

use super::config::{IMAGE_TOKEN_BEYOND, LlavaConfig};
use crate::MllmError;
use crate::checkpoint::ModelFiles;
use crate::gguf::names::{
    DECODER_LAYERS, EMBEDDING, FINAL_NORM, Names, OUTPUT, ROTARY, VISION_LAYERS, unswapped,
};
use crate::gguf::{
    Described, Description, GgufLayout, Header, TEMPLATE, TOKENIZER, TowerDescription, llama,
    no_tower, tokenizer,
};
use crate::vision::{PixelScale, read_processor};
use serde_json::json;
use std::collections::BTreeMap;

/// The names of a LLaVA's tensors, and the newline of a LLaVA-NeXT.
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
            "v.position_embd.weight",
            "vision_tower.embeddings.position_embedding.weight",
        ),
        ("v.pre_ln.weight", "vision_tower.pre_layrnorm.weight"),
        ("v.pre_ln.bias", "vision_tower.pre_layrnorm.bias"),
        ("mm.0.weight", "multi_modal_projector.linear_1.weight"),
        ("mm.0.bias", "multi_modal_projector.linear_1.bias"),
        ("mm.2.weight", "multi_modal_projector.linear_2.weight"),
        ("mm.2.bias", "multi_modal_projector.linear_2.bias"),
        ("model.image_newline", "image_newline"),
    ],
    layers: &[DECODER_LAYERS, VISION_LAYERS],
};

/// The configuration, and of a LLaVA-NeXT the resolutions (height, width) of its grids.
type Configured = (LlavaConfig, Option<Vec<[u32; 2]>>);

/// The files of a LLaVA or a LLaVA-NeXT.
pub(crate) struct LlavaGguf {
    /// Whether the tower has the newline of LLaVA-NeXT.
    pub next: bool,
    /// The `model_type` of the configuration.
    pub model_type: &'static str,
    /// The `image_processor_type` of the preprocessor.
    pub image_processor: &'static str,
    pub config: fn(&ModelFiles) -> Result<Configured, MllmError>,
}

impl GgufLayout for LlavaGguf {
    fn opens(&self, _decoder: &Header, tower: Option<&Header>) -> bool {
        tower.is_some_and(|tower| tower::is_llava(tower) && tower::is_next(tower) == self.next)
    }

    fn small_files(
        &self,
        decoder: &Header,
        tower: Option<&Header>,
        notes: &mut Vec<String>,
    ) -> Result<BTreeMap<String, String>, MllmError> {
        let tower = tower.ok_or_else(|| no_tower(decoder, "its configuration"))?;
        let text = llama::text_config(decoder, notes)?;
        let vocabulary = text["vocab_size"]
            .as_u64()
            .expect("the configuration of a decoder says its vocabulary")
            as usize;
        let (mut config, note) = tower::config(tower, self.model_type)?;
        notes.extend(note);
        notes.extend(tower::left_out(tower));
        config["tie_word_embeddings"] = text["tie_word_embeddings"].clone();
        config["text_config"] = text;
        let mut files = BTreeMap::new();
        let mut tokenizer = tokenizer::files(decoder, vocabulary, &mut files)?;
        let image =
            tokenizer::image_token(&mut tokenizer).map_err(|problem| MllmError::Tokenizer {
                path: tokenizer::place(decoder),
                problem: problem.into(),
            })?;
        let mut put = |name: &str, value: &serde_json::Value| {
            files.insert(name.to_string(), value.to_string())
        };
        // llama.cpp drops the token of the image, which then has no row in the embedding.
        if image == vocabulary as u64 {
            config[IMAGE_TOKEN_BEYOND] = json!(true);
        } else {
            config["image_token_index"] = json!(image);
        }
        put(TOKENIZER, &tokenizer);
        put("config.json", &config);
        put(
            "preprocessor_config.json",
            &tower::preprocessor(tower, self.image_processor)?,
        );
        if !decoder.path.with_file_name(TEMPLATE).is_file() {
            let template = template::read(decoder, notes)?;
            files.insert(TEMPLATE.to_string(), template.to_string());
        }
        Ok(files)
    }

    fn canonical_name(&self, file: &Header, name: &str) -> Result<Option<String>, MllmError> {
        let hidden = tower::hidden(file)?;
        Ok(NAMES
            .to_canonical(name)
            .map(|canonical| unswapped(file, canonical, hidden)))
    }

    fn gguf_name(&self, canonical: &str) -> Option<String> {
        NAMES.in_gguf(canonical)
    }

    fn metadata(&self, files: &ModelFiles) -> Result<Described, MllmError> {
        let (config, pinpoints) = (self.config)(files)?;
        let scale = read_processor(files, |_, object| PixelScale::read(object))?;
        if config.text.head_norms {
            return Ok(Err("norms of queries and keys in a llama decoder"));
        }
        let decoder = match llama::metadata(llama::ARCHITECTURE, &config.text) {
            Ok(decoder) => decoder,
            Err(lacking) => return Ok(Err(lacking)),
        };
        let tower = tower::metadata(&config, pinpoints, &scale);
        Ok(tower.map(|tower| Description {
            architecture: llama::ARCHITECTURE,
            decoder,
            tower: Some(TowerDescription::plain(tower)),
        }))
    }
}
