//! LLaVA and LLaVA-NeXT in llama.cpp's GGUF files.

mod names;
mod template;
mod tower;

use std::collections::BTreeMap;

use serde_json::json;

use super::config::{IMAGE_TOKEN_BEYOND, LlavaConfig};
use crate::mllm::MllmError;
use crate::mllm::checkpoint::{ModelFiles, read_json};
use crate::mllm::gguf::{Entries, GgufLayout, Header, TEMPLATE, TOKENIZER, llama, tokenizer};
use crate::mllm::vision::{PixelScale, read_processor};

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
    fn opens(&self, _decoder: &Header, tower: &Header) -> bool {
        tower::is_next(tower) == self.next
    }

    fn small_files(
        &self,
        decoder: &Header,
        tower: &Header,
        notes: &mut Vec<String>,
    ) -> Result<BTreeMap<String, String>, MllmError> {
        let text = llama::text_config(decoder)?;
        let vocabulary = text["vocab_size"].as_u64().unwrap_or_default() as usize;
        let (mut config, note) = tower::config(tower, self.model_type)?;
        notes.extend(note);
        config["tie_word_embeddings"] = text["tie_word_embeddings"].clone();
        config["text_config"] = text;
        let mut files = BTreeMap::new();
        let mut put = |name: &str, value: &serde_json::Value| files.insert(name.to_string(), value.to_string());
        let beside = decoder.path.with_file_name(TOKENIZER);
        let mut tokenizer = if beside.is_file() {
            read_json(&beside)?
        } else {
            let read = tokenizer::read(decoder, vocabulary)?;
            put("tokenizer_config.json", &read.config);
            if let Some(eos) = read.eos {
                put("generation_config.json", &json!({"eos_token_id": eos}));
            }
            read.tokenizer
        };
        let image = tokenizer::image_token(&mut tokenizer)
            .map_err(|problem| MllmError::Tokenizer { path: beside, problem: problem.into() })?;
        if image == vocabulary as u64 {
            config[IMAGE_TOKEN_BEYOND] = json!(true);
        } else {
            config["image_token_index"] = json!(image);
        }
        put(TOKENIZER, &tokenizer);
        put("config.json", &config);
        put("preprocessor_config.json", &tower::preprocessor(tower, self.image_processor)?);
        if !decoder.path.with_file_name(TEMPLATE).is_file() {
            let template = template::of(decoder, notes)?;
            files.insert(TEMPLATE.to_string(), template.to_string());
        }
        Ok(files)
    }

    fn canonical_name(&self, file: &Header, name: &str) -> Result<Option<String>, MllmError> {
        let hidden = tower::hidden(file)?;
        Ok(names::to_canonical(name).map(|canonical| unswapped(file, canonical, hidden)))
    }

    fn gguf_name(&self, canonical: &str) -> Option<String> {
        names::from_canonical(canonical)
    }

    fn metadata(&self, files: &ModelFiles) -> Result<Result<[Entries; 2], &'static str>, MllmError> {
        let (config, pinpoints) = (self.config)(files)?;
        let scale = read_processor(files, |_, object| PixelScale::read(object))?;
        let Some(scale) = scale.mean_and_deviation() else { return Ok(Err("pixels that are not normalized")) };
        let decoder = llama::metadata(&config.text);
        let tower = tower::metadata(&config, pinpoints, scale);
        Ok(decoder.and_then(|decoder| Ok([decoder, tower?])))
    }
}

/// Undoes a swap of llama.cpp's older converter, which calls the first layer of the tower's feed-forward part `ffn_down` and
/// the second `ffn_up`. The first layer is the one whose input is the hidden states.
fn unswapped(header: &Header, canonical: String, hidden: Option<usize>) -> String {
    let Some(layer) = canonical.strip_prefix("vision_tower.encoder.layers.").and_then(|rest| rest.split('.').next())
    else {
        return canonical;
    };
    let down = header.tensors.get(&format!("v.blk.{layer}.ffn_down.weight"));
    let swapped = down.is_some_and(|place| place.shape.get(1).copied() == hidden);
    match canonical.split_once(".mlp.fc") {
        Some((before, "1.weight")) if swapped => format!("{before}.mlp.fc2.weight"),
        Some((before, "2.weight")) if swapped => format!("{before}.mlp.fc1.weight"),
        Some((before, "1.bias")) if swapped => format!("{before}.mlp.fc2.bias"),
        Some((before, "2.bias")) if swapped => format!("{before}.mlp.fc1.bias"),
        _ => canonical,
    }
}
