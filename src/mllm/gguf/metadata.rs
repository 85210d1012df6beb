//! Typed access to the metadata of a GGUF file, whose errors name file and key.

use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};

use super::header::Header;
use crate::MllmError;

/// Largest count in metadata, as in configurations.
const MAX_COUNT: u64 = 1 << 22;

impl Header {
    pub(crate) fn error(&self, key: &str, problem: impl Into<String>) -> MllmError {
        MllmError::Config { path: self.path.clone(), key: key.into(), problem: problem.into() }
    }

    fn missing(&self, key: &str) -> MllmError {
        self.error(key, "is missing from the metadata")
    }

    /// A key's value, converted by `read`; none if it is absent.
    fn typed<'a, T>(
        &'a self,
        key: &str,
        expected: &str,
        read: impl FnOnce(&'a Value) -> Option<T>,
    ) -> Result<Option<T>, MllmError> {
        /// Longest part of a value in a message, characters.
        const SHOWN: usize = 60;
        let Some(value) = self.metadata.get(key) else { return Ok(None) };
        read(value).map(Some).ok_or_else(|| {
            let found: String = value.to_string().chars().take(SHOWN).collect();
            self.error(key, format!("expected {expected}, found {found}"))
        })
    }

    pub(crate) fn count(&self, key: &str) -> Result<Option<usize>, MllmError> {
        let count = |value: &Value| match value {
            // llama.cpp may write one number for each layer.
            Value::Array(list) => {
                let first = list.first()?;
                list.iter().all(|number| number == first).then(|| first.as_u64())?
            }
            value => value.as_u64(),
        };
        let expected = format!("a whole number from 1 to {MAX_COUNT}, the same for all layers");
        self.typed(key, &expected, |value| {
            count(value).filter(|count| (1..=MAX_COUNT).contains(count)).map(|count| count as usize)
        })
    }

    pub(crate) fn required_count(&self, key: &str) -> Result<usize, MllmError> {
        self.count(key)?.ok_or_else(|| self.missing(key))
    }

    pub(crate) fn number(&self, key: &str) -> Result<Option<f64>, MllmError> {
        self.typed(key, "a number", Value::as_f64)
    }

    pub(crate) fn flag(&self, key: &str) -> Result<Option<bool>, MllmError> {
        self.typed(key, "true or false", Value::as_bool)
    }

    pub(crate) fn text(&self, key: &str) -> Result<Option<&str>, MllmError> {
        self.typed(key, "a text", Value::as_str)
    }

    pub(crate) fn list<T: DeserializeOwned>(&self, key: &str, expected: &str) -> Result<Option<Vec<T>>, MllmError> {
        self.typed(key, expected, |value| Vec::deserialize(value).ok())
    }

    /// The kind of a tower's projector; none if the file does not say.
    pub(crate) fn projector(&self) -> Result<Option<&str>, MllmError> {
        Ok(self.text("clip.vision.projector_type")?.or(self.text("clip.projector_type")?))
    }

    /// Mean and deviation of a tower's pixels, as an image processor's configuration has them.
    pub(crate) fn pixel_scale(&self) -> Result<Value, MllmError> {
        let mut scale = json!({});
        for key in ["image_mean", "image_std"] {
            if let Some(values) = self.list::<f64>(&format!("clip.vision.{key}"), "a list of numbers")? {
                scale[key] = json!(values);
            }
        }
        Ok(scale)
    }

    /// The sizes of a tower, as a `vision_config` has them.
    pub(crate) fn vision_config(&self) -> Result<Value, MllmError> {
        Ok(json!({
            "hidden_size": self.required_count("clip.vision.embedding_length")?,
            "intermediate_size": self.required_count("clip.vision.feed_forward_length")?,
            "num_hidden_layers": self.required_count("clip.vision.block_count")?,
            "num_attention_heads": self.required_count("clip.vision.attention.head_count")?,
            "image_size": self.required_count("clip.vision.image_size")?,
            "patch_size": self.required_count("clip.vision.patch_size")?,
            "layer_norm_eps": self.number("clip.vision.attention.layer_norm_epsilon")?,
        }))
    }

    /// The value of `general.architecture`.
    pub(crate) fn architecture(&self) -> Result<&str, MllmError> {
        const KEY: &str = "general.architecture";
        self.text(KEY)?.ok_or_else(|| self.missing(KEY))
    }
}
