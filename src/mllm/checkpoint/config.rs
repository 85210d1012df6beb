//! Configurations in JSON, read by serde. Every error names the file and the key.

use crate::MllmError;
use serde::de::{DeserializeOwned, Error};
use serde::{Deserialize, Deserializer};
use serde_json::{Map, Value};
use std::fmt::Display;
use std::path::Path;

/// Largest width, layer count or context of a configuration. No model that fits into a machine
/// exceeds it.
pub(super) const MAX_COUNT: u64 = 1 << 22;
/// Longest context, positions: beyond it a configuration is taken for broken.
pub(super) const MAX_CONTEXT: usize = 1 << 20;
/// Widest head. Published ones have up to 512 channels.
pub(super) const MAX_HEAD: usize = 1 << 12;
/// Most heads and most layers. Published decoders have up to 128 of each.
pub(super) const MAX_LAYERS: usize = 1 << 12;

/// Keys where null and absence differ: a null window is no window, and null heads of keys are as
/// many as those of queries; an absent key takes the default of its class.
const NULLABLE: [&str; 2] = ["sliding_window", "num_key_value_heads"];

/// An object of a configuration file. Null entries count as absent.
#[derive(Debug, Clone)]
pub(crate) struct ConfigObject<'a> {
    path: &'a Path,
    /// The keys that lead to the object, each with a dot behind it.
    prefix: String,
    entries: Map<String, Value>,
}

impl<'a> ConfigObject<'a> {
    /// The object that a file holds.
    pub(crate) fn root(path: &'a Path, value: &Value) -> Result<Self, MllmError> {
        let empty = Self {
            path,
            prefix: String::new(),
            entries: Map::new(),
        };
        match value {
            Value::Object(object) => Ok(empty.with_entries(object)),
            other => Err(empty.error("(whole file)", not_an_object(other))),
        }
    }

    fn with_entries(mut self, object: &Map<String, Value>) -> Self {
        let present =
            |(key, value): &(&String, &Value)| !value.is_null() || NULLABLE.contains(&key.as_str());
        self.entries = object
            .iter()
            .filter(present)
            .map(|(key, value)| (key.clone(), value.clone()))
            .collect();
        self
    }

    pub(crate) fn child(&self, key: &str) -> Result<Option<Self>, MllmError> {
        let entry = self.entries.get(key);
        entry.map(|value| self.nested(key, value)).transpose()
    }

    /// The object that a value is which stands below this object at `key`, keys with dots between.
    pub(crate) fn nested(&self, key: &str, value: &Value) -> Result<Self, MllmError> {
        match value {
            Value::Object(object) => Ok(self.empty_child(key).with_entries(object)),
            other => Err(self.error(key, not_an_object(other))),
        }
    }

    /// Refuses every key that is none of these.
    pub(crate) fn only_keys(&self, known: &[&str]) -> Result<(), MllmError> {
        let mut keys = self.entries.keys();
        match keys.find(|key| !known.contains(&key.as_str())) {
            None => Ok(()),
            Some(key) => {
                let problem = format!("is not supported; {} are", known.join(", "));
                Err(self.error(key, problem))
            }
        }
    }

    /// A nested object, empty if absent.
    pub(crate) fn child_or_empty(&self, key: &str) -> Result<Self, MllmError> {
        Ok(self.child(key)?.unwrap_or_else(|| self.empty_child(key)))
    }

    fn empty_child(&self, key: &str) -> Self {
        Self {
            path: self.path,
            prefix: format!("{}{key}.", self.prefix),
            entries: Map::new(),
        }
    }

    /// Takes `defaults`, an object, for absent keys.
    pub(crate) fn with_defaults(mut self, defaults: Value) -> Self {
        if let Value::Object(defaults) = defaults {
            for (key, value) in defaults {
                self.entries.entry(key).or_insert(value);
            }
        }
        self
    }

    pub(crate) fn contains(&self, key: &str) -> bool {
        self.entries.contains_key(key)
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.entries.is_empty()
    }

    /// Whether a key is there without a value. Only those of [`NULLABLE`] can be.
    pub(crate) fn is_null(&self, key: &str) -> bool {
        self.entries.get(key).is_some_and(Value::is_null)
    }

    pub(crate) fn remove(&mut self, key: &str) {
        self.entries.remove(key);
    }

    pub(crate) fn value<T: DeserializeOwned>(&self, key: &str) -> Result<Option<T>, MllmError> {
        self.entries
            .get(key)
            .map(|value| T::deserialize(value).map_err(|error| self.error(key, error)))
            .transpose()
    }

    /// A list, empty if absent.
    pub(crate) fn list<T: DeserializeOwned>(&self, key: &str) -> Result<Vec<T>, MllmError> {
        Ok(self.value(key)?.unwrap_or_default())
    }

    /// Reads a token id, or the first of a list; none if absent.
    pub(crate) fn first_id(&self, key: &str) -> Result<Option<u32>, MllmError> {
        Ok(self
            .value::<OneOrMany<u32>>(key)?
            .and_then(|ids| ids.as_slice().first().copied()))
    }

    /// Reads a finite number above zero; none if absent.
    pub(crate) fn positive(&self, key: &str) -> Result<Option<f64>, MllmError> {
        self.entries
            .get(key)
            .map(|value| positive(value).map_err(|error| self.error(key, error)))
            .transpose()
    }

    /// Reads the object as a flat struct with defaults; keys that the struct does not have are
    /// ignored.
    pub(crate) fn read<T: DeserializeOwned>(&self) -> Result<T, MllmError> {
        serde_path_to_error::deserialize(&self.entries)
            .map_err(|error| self.error(&error.path().to_string(), error.inner()))
    }

    pub(crate) fn error(&self, key: &str, problem: impl Display) -> MllmError {
        MllmError::Config {
            path: self.path.to_path_buf(),
            key: format!("{}{key}", self.prefix),
            problem: problem.to_string(),
        }
    }
}

fn not_an_object(value: &Value) -> String {
    let shown: String = value.to_string().chars().take(60).collect();
    format!("expected an object, found {shown}")
}

#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(
    untagged,
    expecting = "expected a whole number or a list of whole numbers"
)]
pub(crate) enum OneOrMany<T> {
    One(T),
    Many(Vec<T>),
}

impl<T> OneOrMany<T> {
    pub(crate) fn as_slice(&self) -> &[T] {
        match self {
            Self::One(value) => std::slice::from_ref(value),
            Self::Many(values) => values,
        }
    }
}

/// A whole number from 1 to [`MAX_COUNT`].
pub(crate) fn count<'de, D: Deserializer<'de>>(deserializer: D) -> Result<usize, D::Error> {
    checked_count(u64::deserialize(deserializer)?)
}

/// A count, or null for none.
pub(crate) fn optional_count<'de, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<Option<usize>, D::Error> {
    Option::<u64>::deserialize(deserializer)?
        .map(checked_count)
        .transpose()
}

fn checked_count<E: Error>(count: u64) -> Result<usize, E> {
    if (1..=MAX_COUNT).contains(&count) {
        return Ok(count as usize);
    }
    Err(E::custom(format!(
        "expected a whole number from 1 to {MAX_COUNT}, found {count}"
    )))
}

/// Widest row of a matrix: all heads, the feed-forward part, or merged patches. The decoder of 405
/// billion weights has 53,248.
pub(crate) const MAX_WIDTH: usize = 1 << 20;

/// Checks a width that is the product of two numbers, of which `key` is at fault if it is too
/// large.
pub(crate) fn check_width(
    object: &ConfigObject<'_>,
    key: &str,
    number: usize,
    factor: usize,
) -> Result<(), MllmError> {
    if number
        .checked_mul(factor)
        .is_some_and(|width| width <= MAX_WIDTH)
    {
        return Ok(());
    }
    Err(object.error(
        key,
        format!("{number} times {factor} is wider than the {MAX_WIDTH} numbers that are supported"),
    ))
}

/// Checks that numbers, each under its key, are from 1 to a limit.
pub(crate) fn check_ranges(
    object: &ConfigObject<'_>,
    numbers: &[(&str, usize, usize)],
) -> Result<(), MllmError> {
    match numbers
        .iter()
        .find(|(_, number, most)| !(1..=*most).contains(number))
    {
        None => Ok(()),
        Some((key, number, most)) => Err(object.error(
            key,
            format!("expected a whole number from 1 to {most}, found {number}"),
        )),
    }
}

/// A finite number above zero.
pub(crate) fn positive<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    let number = f64::deserialize(deserializer)?;
    if number.is_finite() && number > 0.0 {
        return Ok(number);
    }
    Err(D::Error::custom(format!(
        "expected a positive number, found {number}"
    )))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[derive(Debug, PartialEq, Deserialize)]
    #[serde(default)]
    struct Example {
        #[serde(deserialize_with = "count")]
        width: usize,
        #[serde(deserialize_with = "positive")]
        eps: f64,
        #[serde(deserialize_with = "optional_count")]
        sliding_window: Option<usize>,
    }

    impl Default for Example {
        fn default() -> Self {
            Self {
                width: 4,
                eps: 1.0,
                sliding_window: Some(9),
            }
        }
    }

    fn read(value: &Value) -> Result<Example, MllmError> {
        let root = ConfigObject::root(Path::new("config.json"), &json!({"part": value}))?;
        root.child_or_empty("part")?
            .with_defaults(json!({"eps": 2.0}))
            .read()
    }

    #[test]
    fn absent_and_null_keys_take_defaults() {
        assert_eq!(
            read(&json!({"other": 1})).unwrap(),
            Example {
                eps: 2.0,
                ..Example::default()
            }
        );
        assert_eq!(
            read(&json!({"width": null, "eps": 3})).unwrap(),
            Example {
                eps: 3.0,
                ..Example::default()
            }
        );
        assert_eq!(
            read(&json!({"sliding_window": null}))
                .unwrap()
                .sliding_window,
            None
        );
    }

    #[test]
    fn errors_name_file_and_key() {
        for (value, key) in [
            (json!({"width": 0}), "part.width"),
            (json!({"width": -1}), "part.width"),
            (json!({"width": 1_u64 << 40}), "part.width"),
            (json!({"width": 1.5}), "part.width"),
            (json!({"eps": "small"}), "part.eps"),
            (json!({"eps": 0}), "part.eps"),
            (json!({"sliding_window": 0}), "part.sliding_window"),
            (json!([]), "part"),
        ] {
            match read(&value) {
                Err(MllmError::Config {
                    path, key: found, ..
                }) => {
                    assert_eq!((path.to_str(), found.as_str()), (Some("config.json"), key));
                }
                other => panic!("{value}: {other:?}"),
            }
        }
        assert!(ConfigObject::root(Path::new("config.json"), &json!([])).is_err());
    }
}
