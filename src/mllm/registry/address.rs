//! The address of a server in place of a model's name: no description is needed.

use super::{ModelSource, ModelSpec};
use crate::{EndpointSettings, MllmError};

/// The model at an address; `None` for a word that is no address. Nothing is sent yet.
pub(super) fn server(word: &str) -> Option<Result<ModelSpec, MllmError>> {
    // What stands around an address where it was copied from.
    let copied = |c: char| c.is_whitespace() || "'\"<>`,;".contains(c);
    let word = word.trim_matches(copied);
    if let Some(problem) = other_scheme(word) {
        let address = word.to_owned();
        return Some(Err(MllmError::Address { address, problem }));
    }
    let settings = EndpointSettings::of_address(word)?;
    if let Err(problem) = settings.url() {
        return Some(Err(MllmError::Address {
            address: word.to_owned(),
            problem,
        }));
    }
    // Without a name of the model, results show the server.
    let shown = if settings.model.is_empty() {
        &settings.endpoint
    } else {
        &settings.model
    };
    Some(Ok(ModelSpec::plain(
        shown.clone(),
        ModelSource::Endpoint(settings),
    )))
}

/// What is wrong with the beginning of an address that is not of HTTP: another scheme, or one that
/// is mistyped.
fn other_scheme(word: &str) -> Option<String> {
    let plain = word.to_ascii_lowercase();
    let mistyped = [
        "http:/", "https:/", "http//", "https//", "http:\\", "https:\\",
    ];
    let is_mistyped = || mistyped.iter().any(|begin| plain.starts_with(begin));
    let (scheme, _) = plain.split_once("://").unwrap_or(("", ""));
    let is_other = scheme.len() > 1 && scheme.chars().all(|c| c.is_ascii_alphanumeric());
    match scheme {
        "http" | "https" => None,
        "file" => Some("write the path of a file or folder without file://".to_owned()),
        _ if is_other || is_mistyped() => {
            Some("the address of a server begins with http:// or https://".to_owned())
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use crate::MllmError;
    use crate::registry::{HubAccess, ModelRegistry, NamedBy};

    #[test]
    fn an_address_is_a_model() {
        let nowhere = tempfile::tempdir().unwrap();
        let registry = ModelRegistry::new(
            nowhere.path(),
            HubAccess {
                offline: true,
                ..HubAccess::default()
            },
        );
        let spec = registry.find("http://127.0.0.1:8080/v1").unwrap();
        assert_eq!(
            spec.source.to_string(),
            "the model at http://127.0.0.1:8080/v1"
        );
        let asking = registry.asking(&spec).unwrap();
        assert_eq!(
            (asking.prompt_set.as_str(), asking.named_by),
            ("paper", NamedBy::Default)
        );
        assert_eq!(
            registry.find("localhost:11434#eye:7b").unwrap().name,
            "eye:7b"
        );
        let away = registry.find("http://192.0.2.1/v1").unwrap();
        assert!(matches!(
            registry.open(&away),
            Err(MllmError::Offline { .. })
        ));
        for copied in [
            " http://127.0.0.1:8080/v1 ",
            "<http://127.0.0.1:8080/v1>",
            "http://127.0.0.1:8080/v1,",
        ] {
            let spec = registry.find(copied).unwrap();
            assert_eq!(
                spec.source.to_string(),
                "the model at http://127.0.0.1:8080/v1",
                "{copied}"
            );
        }
        for broken in [
            "http://",
            "https://key@a.example/v1",
            "http://a b/v1",
            "ws://127.0.0.1:8080",
            "http:/127.0.0.1:8080/v1",
            "https//a.example/v1",
        ] {
            assert!(
                matches!(registry.find(broken), Err(MllmError::Address { .. })),
                "{broken}"
            );
        }
    }
}
