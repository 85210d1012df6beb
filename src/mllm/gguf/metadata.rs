//! Typed access to the metadata of a GGUF file, whose errors name file and key.

use super::header::Header;
use crate::MllmError;
use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};
use std::sync::PoisonError;

/// Largest count in metadata, as in configurations.
const MAX_COUNT: u64 = 1 << 22;
/// The epsilon of a tower's norms.
const TOWER_EPSILON: &str = "clip.vision.attention.layer_norm_epsilon";
/// The configuration of images, which a user may put beside a GGUF file.
const PROCESSOR: &str = "preprocessor_config.json";

impl Header {
    pub(crate) fn error(&self, key: &str, problem: impl Into<String>) -> MllmError {
        MllmError::Config {
            path: self.path.clone(),
            key: key.into(),
            problem: problem.into(),
        }
    }

    /// Number of weights of its tensors.
    pub(crate) fn parameters(&self) -> u64 {
        let elements = |sides: &[usize]| {
            sides
                .iter()
                .fold(1_u64, |product, side| product.saturating_mul(*side as u64))
        };
        self.tensors
            .values()
            .map(|place| elements(&place.shape))
            .fold(0, u64::saturating_add)
    }

    pub(super) fn missing(&self, key: &str) -> MllmError {
        self.error(key, "is missing from the metadata")
    }

    /// A key's value, converted by `read`; none if it is absent.
    pub(super) fn typed<'a, T>(
        &'a self,
        key: &str,
        expected: &str,
        read: impl FnOnce(&'a Value) -> Option<T>,
    ) -> Result<Option<T>, MllmError> {
        let Some(value) = self.asked(key) else {
            return Ok(None);
        };
        read(value).map(Some).ok_or_else(|| {
            let found = shown(value);
            self.error(key, format!("expected {expected}, found {found}"))
        })
    }

    /// A key's value; that it was asked for is remembered.
    fn asked(&self, key: &str) -> Option<&Value> {
        let value = self.metadata.get(key)?;
        self.asked
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .insert(key.to_owned());
        Some(value)
    }

    /// The keys that nobody asked for, with their values.
    pub(super) fn unread(&self) -> Vec<(&str, &Value)> {
        let asked = self.asked.lock().unwrap_or_else(PoisonError::into_inner);
        let unread = self
            .metadata
            .iter()
            .filter(|(key, _)| !asked.contains(*key));
        unread.map(|(key, value)| (key.as_str(), value)).collect()
    }

    /// A whole number; 0 means that there is none.
    pub(crate) fn whole(&self, key: &str) -> Result<Option<u64>, MllmError> {
        let found = self.typed(key, "a whole number", Value::as_u64)?;
        Ok(found.filter(|number| *number > 0))
    }

    pub(crate) fn count(&self, key: &str) -> Result<Option<usize>, MllmError> {
        let count = |value: &Value| match value {
            // llama.cpp may write one number for each layer.
            Value::Array(list) => {
                let first = list.first()?;
                list.iter()
                    .all(|number| number == first)
                    .then(|| first.as_u64())?
            }
            value => value.as_u64(),
        };
        let expected = format!("a whole number from 1 to {MAX_COUNT}, the same for all layers");
        self.typed(key, &expected, |value| {
            count(value)
                .filter(|count| (1..=MAX_COUNT).contains(count))
                .map(|count| count as usize)
        })
    }

    /// A count whose 0 means that there is none.
    pub(crate) fn count_or_none(&self, key: &str) -> Result<Option<usize>, MllmError> {
        if self.asked(key).and_then(Value::as_u64) == Some(0) {
            Ok(None)
        } else {
            self.count(key)
        }
    }

    /// A number whose 0 means that there is none.
    pub(crate) fn number_or_none(&self, key: &str) -> Result<Option<f64>, MllmError> {
        if self.asked(key).and_then(Value::as_f64) == Some(0.0) {
            Ok(None)
        } else {
            self.number(key)
        }
    }

    pub(crate) fn required_count(&self, key: &str) -> Result<usize, MllmError> {
        self.count(key)?.ok_or_else(|| self.missing(key))
    }

    /// A number without which llama.cpp does not open a file either.
    pub(crate) fn required_number(&self, key: &str) -> Result<f64, MllmError> {
        self.number(key)?.ok_or_else(|| self.missing(key))
    }

    /// A note about a key that is left out, and what llama.cpp takes then.
    pub(crate) fn taken(&self, key: &str, default: impl std::fmt::Display) -> String {
        format!(
            "{}: the key {key} is missing; {default} is taken, as llama.cpp does",
            self.path.display()
        )
    }

    pub(crate) fn number(&self, key: &str) -> Result<Option<f64>, MllmError> {
        self.typed(key, "a positive number", |value| {
            value.as_f64().filter(|number| *number > 0.0)
        })
    }

    pub(crate) fn flag(&self, key: &str) -> Result<Option<bool>, MllmError> {
        self.typed(key, "true or false", Value::as_bool)
    }

    pub(crate) fn text(&self, key: &str) -> Result<Option<&str>, MllmError> {
        self.typed(key, "a text", Value::as_str)
    }

    pub(crate) fn list<T: DeserializeOwned>(
        &self,
        key: &str,
        expected: &str,
    ) -> Result<Option<Vec<T>>, MllmError> {
        self.typed(key, expected, |value| Vec::deserialize(value).ok())
    }

    /// The kind of a tower's projector; none if the file does not say.
    pub(crate) fn projector(&self) -> Result<Option<&str>, MllmError> {
        Ok(self
            .text("clip.vision.projector_type")?
            .or(self.text("clip.projector_type")?))
    }

    /// Mean and deviation of a tower's pixels, as an image processor's configuration has them.
    ///
    /// # Errors
    /// When the file has none, and no configuration beside it has them.
    pub(crate) fn pixel_scale(&self) -> Result<Value, MllmError> {
        let mut scale = json!({});
        let is_beside = self.path.with_file_name(PROCESSOR).is_file();
        for name in ["image_mean", "image_std"] {
            let key = format!("clip.vision.{name}");
            match self.list::<f64>(&key, "a list of numbers")? {
                Some(values) => scale[name] = json!(values),
                None if is_beside => {}
                None => {
                    let problem = format!(
                        "is missing from the metadata; put the model's {PROCESSOR} beside the file"
                    );
                    return Err(self.error(&key, problem));
                }
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
            "layer_norm_eps": self.required_number(TOWER_EPSILON)?,
        }))
    }

    /// Checks that the norms of a tower have the epsilon that its family takes for granted.
    pub(crate) fn check_epsilon(&self, expected: f64) -> Result<(), MllmError> {
        let found = self.required_number(TOWER_EPSILON)?;
        // A file has 32 bits of it.
        if (found / expected - 1.0).abs() < 1e-6 {
            return Ok(());
        }
        let problem = format!("{found:e} is not supported for this model; {expected:e} is");
        Err(self.error(TOWER_EPSILON, problem))
    }

    /// Checks that a tower has the activation that its family takes for granted. A file that does
    /// not say it is noted: llama.cpp would take CLIP's.
    pub(crate) fn check_activation(
        &self,
        expected: &str,
        notes: &mut Vec<String>,
    ) -> Result<(), MllmError> {
        const GELU: &str = "clip.use_gelu";
        const SILU: &str = "clip.use_silu";
        let found = match (self.flag(GELU)?, self.flag(SILU)?) {
            (None, None) if expected == "quick_gelu" => return Ok(()),
            (None, None) => {
                notes.push(format!(
                    "{}: the keys {GELU} and {SILU} are missing; the activation of the family is taken, {expected}",
                    self.path.display()
                ));
                return Ok(());
            }
            (_, Some(true)) => "silu",
            (Some(true), _) => "gelu",
            _ => "quick_gelu",
        };
        if found == expected {
            return Ok(());
        }
        let problem = format!("the activation is {found}; {expected} is supported for this model");
        Err(self.error(if found == "silu" { SILU } else { GELU }, problem))
    }

    /// The value of `general.architecture`. Parts of a split model after the first have none, nor
    /// has what is no model.
    pub(crate) fn architecture(&self) -> Result<&str, MllmError> {
        const KEY: &str = "general.architecture";
        if let Some(architecture) = self.text(KEY)? {
            return Ok(architecture);
        }
        if let Some(part) = self.part()? {
            let problem = format!(
                "is missing from the metadata; this is part {} of {}, and the first part has it",
                part.number + 1,
                part.count
            );
            return Err(self.error(KEY, problem));
        }
        match self.text("general.type")? {
            Some(kind) if kind != "model" => Err(self.error(
                "general.type",
                format!("'{kind}' is no model; name the file of the model"),
            )),
            _ => Err(self.missing(KEY)),
        }
    }
}

/// The beginning of a value, for a message.
pub(super) fn shown(value: &Value) -> String {
    /// Longest part of a value in a message, characters.
    const SHOWN: usize = 60;
    value.to_string().chars().take(SHOWN).collect()
}
