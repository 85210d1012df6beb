//! The API key of a server. It comes from the environment and never appears in output.

mod forms;

use crate::MllmError;
use forms::Forms;
use reqwest::header::HeaderValue;
use std::ffi::OsString;
use std::fmt;

/// Replacement of the key in texts.
const HIDDEN: &str = "[key]";

/// A key. It has no `Display`, its `Debug` hides it, and [`Self::hide`] removes it from the
/// server's texts.
#[derive(Clone)]
pub(super) struct ApiKey {
    forms: Forms,
    header: HeaderValue,
}

impl ApiKey {
    /// Reads the key from an environment variable.
    ///
    /// # Errors
    /// When the variable is not set or empty, or a header cannot carry its value. The error does
    /// not contain the key.
    pub(super) fn from_environment(variable: &str) -> Result<Self, MllmError> {
        Self::parse(std::env::var_os(variable)).map_err(|problem| MllmError::Key {
            variable: variable.to_string(),
            problem,
        })
    }

    fn parse(value: Option<OsString>) -> Result<Self, &'static str> {
        let value = value.ok_or("is not set")?;
        let text = value.to_str().ok_or("is not UTF-8")?.trim().to_string();
        if text.is_empty() {
            return Err("is empty");
        }
        let mut header = HeaderValue::from_str(&format!("Bearer {text}"))
            .map_err(|_| "has characters that a header cannot carry")?;
        header.set_sensitive(true);
        Ok(Self {
            forms: Forms::from_key(&text),
            header,
        })
    }

    /// The value of the `Authorization` header.
    pub(super) fn header(&self) -> HeaderValue {
        self.header.clone()
    }

    /// The text without the key: as it is, escaped, in base64 or hexadecimal digits, and without
    /// its longer parts. It must be called before a text is cut, because a short rest of the key
    /// would stay.
    pub(super) fn hide(&self, text: &str) -> String {
        self.forms.replaced(text, HIDDEN)
    }

    /// Whether a text has the key in it.
    pub(super) fn is_in(&self, text: &str) -> bool {
        self.hide(text) != text
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
        assert_eq!(
            key.hide("Incorrect API key: sk-secret-123."),
            "Incorrect API key: [key]."
        );
        for shown in [
            format!("{key:?}"),
            format!("{:?}", Some(&key)),
            format!("{:?}", key.header()),
        ] {
            assert!(!shown.contains("secret"), "{shown}");
        }
    }

    #[test]
    fn a_missing_or_unusable_key_is_an_error_without_it() {
        #[cfg(unix)]
        {
            use std::os::unix::ffi::OsStringExt;
            let bytes = OsString::from_vec(b"sk-\xffsecret".to_vec());
            assert_eq!(ApiKey::parse(Some(bytes)).unwrap_err(), "is not UTF-8");
        }
        assert!(ApiKey::parse(None).is_err() && ApiKey::parse(Some(" ".into())).is_err());
        let problem = ApiKey::parse(Some("sk-\u{1}secret".into())).unwrap_err();
        assert!(!problem.contains("secret"), "{problem}");
        let error = ApiKey::from_environment("PLANAGENT_NO_SUCH_KEY")
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("PLANAGENT_NO_SUCH_KEY is not set"),
            "{error}"
        );
    }
}
