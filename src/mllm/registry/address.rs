//! The address of a server in place of a model's name: no description is needed.

use super::{ModelSource, ModelSpec};
use crate::{EndpointSettings, MllmError};

/// The model at an address; `None` for a word that is no address. Nothing is sent yet.
pub(super) fn server(word: &str) -> Option<Result<ModelSpec, MllmError>> {
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
        for broken in ["http://", "https://key@a.example/v1", "http://a b/v1"] {
            assert!(
                matches!(registry.find(broken), Err(MllmError::Address { .. })),
                "{broken}"
            );
        }
    }
}
