//! Keys that change what a model computes and that no code reads.

use super::config::ConfigObject;
use crate::MllmError;
use serde_json::Value;

/// The value with which a key changes nothing.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Neutral {
    Flag(bool),
    Number(f64),
    /// One of these texts; without texts, no value at all.
    Text(&'static [&'static str]),
    /// A list whose texts are all this one.
    Each(&'static str),
}

impl Neutral {
    fn is(self, value: &Value) -> bool {
        match self {
            Self::Flag(flag) => value.as_bool() == Some(flag),
            Self::Number(number) => value.as_f64() == Some(number),
            Self::Text(texts) => value.as_str().is_some_and(|text| texts.contains(&text)),
            Self::Each(text) => value
                .as_array()
                .is_some_and(|all| all.iter().all(|one| one.as_str() == Some(text))),
        }
    }

    fn shown(self) -> String {
        match self {
            Self::Flag(flag) => flag.to_string(),
            Self::Number(number) => number.to_string(),
            Self::Text([]) => "null".to_owned(),
            Self::Text(texts) => texts.join(" or "),
            Self::Each(text) => format!("a list of {text}"),
        }
    }
}

impl ConfigObject<'_> {
    /// Refuses keys with another than their neutral value. Absent keys must have it as the default
    /// of their class.
    pub(crate) fn only_neutral(&self, keys: &[(&str, Neutral)]) -> Result<(), MllmError> {
        /// Longest part of a value in a message, characters.
        const SHOWN: usize = 60;
        for (key, neutral) in keys {
            let Some(value) = self.value::<Value>(key)?.filter(|value| !value.is_null()) else {
                continue;
            };
            if !neutral.is(&value) {
                let found: String = value.to_string().chars().take(SHOWN).collect();
                let problem = format!("{found} is not supported; {} is", neutral.shown());
                return Err(self.error(key, problem));
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use serde_json::json;

    #[test]
    fn another_than_the_neutral_value_is_named() {
        let keys = [
            ("flag", Neutral::Flag(true)),
            ("number", Neutral::Number(1.0)),
            ("text", Neutral::Text(&["a", "b"])),
            ("list", Neutral::Each("full")),
        ];
        let check = |value: &Value| {
            ConfigObject::root(Path::new("config.json"), value)?.only_neutral(&keys)
        };
        let neutral =
            json!({"flag": true, "number": 1, "text": "b", "list": ["full", "full"], "other": 7});
        check(&neutral).unwrap();
        check(&json!({"flag": null})).unwrap();
        for (key, value) in [
            ("flag", json!(false)),
            ("flag", json!("yes")),
            ("number", json!(0.5)),
            ("text", json!("c")),
            ("list", json!(["full", "part"])),
            ("list", json!("full")),
        ] {
            let mut changed = neutral.clone();
            changed[key] = value;
            let error = check(&changed).unwrap_err().to_string();
            assert!(
                error.starts_with(&format!("config.json: {key}: "))
                    && error.contains("is not supported"),
                "{error}"
            );
        }
    }
}
