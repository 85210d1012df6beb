//! Typed access to the metadata of a GGUF file, whose errors name file and key.

use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

use super::header::Header;
use crate::mllm::MllmError;

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

    /// The value of `general.architecture`.
    pub(crate) fn architecture(&self) -> Result<&str, MllmError> {
        const KEY: &str = "general.architecture";
        self.text(KEY)?.ok_or_else(|| self.missing(KEY))
    }
}
