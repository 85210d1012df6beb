//! Typed access to a JSON object whose errors name file and key.

use std::path::Path;

use serde_json::{Map, Value};

use crate::mllm::MllmError;

/// A JSON object of a configuration file, with the path of keys that leads to it. `null` counts as absent.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Section<'a> {
    path: &'a Path,
    prefix: &'a str,
    object: &'a Map<String, Value>,
}

impl<'a> Section<'a> {
    /// The root object of `path`.
    ///
    /// # Errors
    /// When the file does not hold an object.
    pub(crate) fn root(path: &'a Path, value: &'a Value) -> Result<Self, MllmError> {
        let object = value.as_object().ok_or_else(|| MllmError::Config {
            path: path.to_path_buf(),
            key: "(whole file)".into(),
            problem: format!("expected an object, found {}", kind(value)),
        })?;
        Ok(Self { path, prefix: "", object })
    }

    /// The object as serde reads it.
    pub(crate) fn config(&self) -> super::ConfigObject<'a> {
        super::ConfigObject::nested(self.path, self.prefix, self.object)
    }

    /// A nested object; none if absent. `prefix` is the key with a dot, for messages.
    pub(crate) fn section(&self, key: &str, prefix: &'a str) -> Result<Option<Section<'a>>, MllmError> {
        match self.get(key) {
            None => Ok(None),
            Some(Value::Object(object)) => Ok(Some(Section { path: self.path, prefix, object })),
            Some(other) => Err(self.error(key, format!("expected an object, found {}", kind(other)))),
        }
    }

    /// The value of a key that is present and not null.
    pub(crate) fn get(&self, key: &str) -> Option<&'a Value> {
        self.object.get(key).filter(|value| !value.is_null())
    }

    /// A finite positive number, or the default.
    pub(crate) fn positive(&self, key: &str, default: f64) -> Result<f64, MllmError> {
        match self.get(key) {
            None => Ok(default),
            Some(value) => value
                .as_f64()
                .filter(|number| number.is_finite() && *number > 0.0)
                .ok_or_else(|| self.error(key, format!("expected a positive number, found {value}"))),
        }
    }

    /// A truth value, or the default.
    pub(crate) fn flag(&self, key: &str, default: bool) -> Result<bool, MllmError> {
        match self.get(key) {
            None => Ok(default),
            Some(value) => {
                value.as_bool().ok_or_else(|| self.error(key, format!("expected true or false, found {}", kind(value))))
            }
        }
    }

    /// A text, or none.
    pub(crate) fn text(&self, key: &str) -> Result<Option<&'a str>, MllmError> {
        match self.get(key) {
            None => Ok(None),
            Some(value) => value
                .as_str()
                .map(Some)
                .ok_or_else(|| self.error(key, format!("expected a text, found {}", kind(value)))),
        }
    }

    /// A list of finite numbers of a given length, or the default.
    pub(crate) fn triple(&self, key: &str, default: [f32; 3]) -> Result<[f32; 3], MllmError> {
        let Some(value) = self.get(key) else {
            return Ok(default);
        };
        let numbers: Option<Vec<f32>> = value
            .as_array()
            .and_then(|values| values.iter().map(|number| number.as_f64().map(|number| number as f32)).collect());
        numbers
            .and_then(|numbers| <[f32; 3]>::try_from(numbers).ok())
            .filter(|numbers| numbers.iter().all(|number| number.is_finite()))
            .ok_or_else(|| self.error(key, format!("expected three numbers, found {value}")))
    }

    /// The error of a key.
    pub(crate) fn error(&self, key: &str, problem: String) -> MllmError {
        MllmError::Config { path: self.path.to_path_buf(), key: format!("{}{key}", self.prefix), problem }
    }
}

/// What a JSON value is, in words.
fn kind(value: &Value) -> &'static str {
    match value {
        Value::Null => "null",
        Value::Bool(_) => "a truth value",
        Value::Number(_) => "a number",
        Value::String(_) => "a text",
        Value::Array(_) => "a list",
        Value::Object(_) => "an object",
    }
}
