//! A checkpoint with an adapter.

use super::{Checkpoint, unread};
use crate::MllmError;
use crate::adapter::{Adapter, AdapterSpec, BaseModel};
use crate::checkpoint::ModelFiles;
use crate::gguf::llama;
use serde_json::Value;

/// Parts of configurations that describe a decoder.
const DECODERS: [&str; 2] = ["text_config", "llm_config"];

impl Checkpoint {
    /// Merges an adapter into the weights, if there is one.
    pub(crate) fn adapted(mut self, adapter: Option<&AdapterSpec>) -> Result<Self, MllmError> {
        let Some(adapter) = adapter else {
            if self.files.is_folder() {
                unread::check_without_adapter(self.files.place())?;
            }
            return Ok(self);
        };
        let adapter = Adapter::open(adapter)?;
        let decoder = self.decoder_config()?;
        let family = self.family.family();
        let base = BaseModel {
            family: family.name,
            canonical_name: &family.canonical_name,
            gguf: family.gguf,
            architecture: architecture(&self.files)?,
            heads: [decoder.heads, decoder.kv_heads],
        };
        adapter.merge_into(&mut self.weights, &base)?;
        Ok(self)
    }
}

/// llama.cpp's name of the decoder of a model.
fn architecture(files: &ModelFiles) -> Result<Option<&'static str>, MllmError> {
    let config = files.required_json("config.json")?;
    let kind = |part: &Value| {
        part.get("model_type")?
            .as_str()
            .and_then(llama::architecture_of)
    };
    let parts = DECODERS.iter().filter_map(|key| config.get(key));
    Ok(parts.chain([&config]).find_map(kind))
}
