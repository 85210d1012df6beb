//! The key of a server: read from the environment, shown nowhere.

use std::fmt;

use reqwest::header::HeaderValue;

use crate::mllm::MllmError;

/// What a key is shown as.
const HIDDEN: &str = "[key]";

/// A key. It has no `Display`, its `Debug` hides it, and [`Self::hide`] takes it out of what a server says.
#[derive(Clone)]
pub(super) struct ApiKey {
    text: String,
    header: HeaderValue,
}

impl ApiKey {
    /// The key that an environment variable holds.
    ///
    /// # Errors
    /// When it is not set, empty, or holds what no header can carry. The error does not hold the key.
    pub(super) fn from_environment(variable: &str) -> Result<Self, MllmError> {
        Self::parse(std::env::var_os(variable).and_then(|value| value.into_string().ok()))
            .map_err(|problem| MllmError::Key { variable: variable.to_string(), problem })
    }

    fn parse(value: Option<String>) -> Result<Self, &'static str> {
        let text = value.ok_or("is not set")?.trim().to_string();
        if text.is_empty() {
            return Err("is empty");
        }
        let mut header = HeaderValue::from_str(&format!("Bearer {text}"))
            .map_err(|_| "holds characters that cannot be sent in a header")?;
        header.set_sensitive(true);
        Ok(Self { text, header })
    }

    /// The value of the header `Authorization`.
    pub(super) fn header(&self) -> HeaderValue {
        self.header.clone()
    }

    /// A text without the key.
    pub(super) fn hide(&self, text: &str) -> String {
        text.replace(&self.text, HIDDEN)
    }
}

impl fmt::Debug for ApiKey {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str(HIDDEN)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_key_is_shown_nowhere() {
        let key = ApiKey::parse(Some(" sk-secret-123\n".into())).unwrap();
        assert_eq!(key.header(), "Bearer sk-secret-123");
        assert_eq!(key.hide("Incorrect API key: sk-secret-123."), "Incorrect API key: [key].");
        for shown in [format!("{key:?}"), format!("{:?}", Some(&key)), format!("{:?}", key.header())] {
            assert!(!shown.contains("secret"), "{shown}");
        }
    }

    #[test]
    fn a_missing_or_unusable_key_is_an_error_without_it() {
        assert!(ApiKey::parse(None).is_err() && ApiKey::parse(Some(" ".into())).is_err());
        let problem = ApiKey::parse(Some("sk-\u{1}secret".into())).unwrap_err();
        assert!(!problem.contains("secret"), "{problem}");
        let error = ApiKey::from_environment("PLANAGENT_NO_SUCH_KEY").unwrap_err().to_string();
        assert!(error.contains("$PLANAGENT_NO_SUCH_KEY, which is not set"), "{error}");
    }
}
