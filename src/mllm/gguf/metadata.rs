//! Typed access to the metadata of a GGUF file, whose errors name file and key.

use super::header::Header;
use super::value::Value;
use crate::mllm::MllmError;

/// Largest count that metadata may hold, as in configurations.
const MAX_COUNT: u64 = 1 << 22;

impl Header {
    /// The error of a key.
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
        let Some(value) = self.metadata.get(key) else { return Ok(None) };
        match read(value) {
            Some(value) => Ok(Some(value)),
            None => Err(self.error(key, format!("expected {expected}, found {value}"))),
        }
    }

    /// A positive integer.
    pub(crate) fn count(&self, key: &str) -> Result<Option<usize>, MllmError> {
        let count = |value: &Value| match value {
            // llama.cpp may write one number for each layer.
            Value::Integers(list) => {
                let first = list.first().copied()?;
                list.iter().all(|number| *number == first).then(|| u64::try_from(first).ok())?
            }
            value => value.as_u64(),
        };
        let expected = format!("a whole number from 1 to {MAX_COUNT}, the same for all layers");
        self.typed(key, &expected, |value| {
            count(value).filter(|count| (1..=MAX_COUNT).contains(count)).map(|count| count as usize)
        })
    }

    /// A positive integer that must exist.
    pub(crate) fn required_count(&self, key: &str) -> Result<usize, MllmError> {
        self.count(key)?.ok_or_else(|| self.missing(key))
    }

    /// A number. A 32-bit float gives the shortest decimal that rounds to it, which is what its writer had.
    pub(crate) fn number(&self, key: &str) -> Result<Option<f64>, MllmError> {
        let number = |value: &Value| match value {
            Value::Float(number) => number.to_string().parse().ok(),
            value => value.as_f64(),
        };
        self.typed(key, "a number", |value| number(value).filter(|number| number.is_finite()))
    }

    /// A truth value.
    pub(crate) fn flag(&self, key: &str) -> Result<Option<bool>, MllmError> {
        self.typed(key, "true or false", |value| match value {
            Value::Bool(truth) => Some(*truth),
            _ => None,
        })
    }

    /// A text.
    pub(crate) fn text(&self, key: &str) -> Result<Option<&str>, MllmError> {
        self.typed(key, "a text", |value| match value {
            Value::Text(text) => Some(text.as_str()),
            _ => None,
        })
    }

    /// A list of texts that must exist.
    pub(crate) fn required_texts(&self, key: &str) -> Result<&[String], MllmError> {
        let texts = self.typed(key, "a list of texts", |value| match value {
            Value::Texts(list) => Some(list.as_slice()),
            _ => None,
        })?;
        texts.ok_or_else(|| self.missing(key))
    }

    /// A list of numbers.
    pub(crate) fn numbers(&self, key: &str) -> Result<Option<Vec<f64>>, MllmError> {
        self.typed(key, "a list of numbers", |value| match value {
            Value::Floats(list) => list.iter().map(|number| number.to_string().parse().ok()).collect(),
            _ => None,
        })
    }

    /// A list of integers.
    pub(crate) fn integers(&self, key: &str) -> Result<Option<&[i64]>, MllmError> {
        self.typed(key, "a list of integers", |value| match value {
            Value::Integers(list) => Some(list.as_slice()),
            _ => None,
        })
    }

    /// The value of `general.architecture`.
    pub(crate) fn architecture(&self) -> Result<&str, MllmError> {
        const KEY: &str = "general.architecture";
        self.text(KEY)?.ok_or_else(|| self.missing(KEY))
    }
}
