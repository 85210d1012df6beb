//! Models by name: a description in `models/`, a folder, a repository of the hub, or a server.

mod description;
mod hub;

use std::path::{Path, PathBuf};

pub use description::{GenerationSettings, ModelSource, ModelSpec, PromptSet, RoundTokens};
pub use hub::{HubAccess, HubFiles};

use super::{Architecture, Endpoint, LocalModel, Mllm, MllmError};

/// Finds and opens models.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ModelRegistry {
    /// The folder of descriptions.
    models: PathBuf,
    hub: HubAccess,
}

impl ModelRegistry {
    /// A registry of the descriptions `models/*.toml`.
    pub fn new(models: impl Into<PathBuf>, hub: HubAccess) -> Self {
        Self { models: models.into(), hub }
    }

    /// The names of the described models, sorted.
    ///
    /// # Errors
    /// When the folder of descriptions exists but cannot be read.
    pub fn names(&self) -> Result<Vec<String>, MllmError> {
        let failed = |source| MllmError::Read { path: self.models.clone(), source };
        if !self.models.is_dir() {
            return Ok(Vec::new());
        }
        let mut names = Vec::new();
        for entry in std::fs::read_dir(&self.models).map_err(failed)? {
            let path = entry.map_err(failed)?.path();
            if path.extension().is_some_and(|extension| extension == "toml") {
                names.extend(path.file_stem().map(|stem| stem.to_string_lossy().into_owned()));
            }
        }
        names.sort();
        Ok(names)
    }

    /// Finds a model: a name described in the folder of descriptions, the path of a description, the path of a model
    /// folder, or a hub id, tried in this order. Folders and hub models without a description are taken for general
    /// models, asked with the paper's prompts.
    ///
    /// # Errors
    /// When nothing goes by this name, or its description is broken.
    pub fn find(&self, name: &str) -> Result<ModelSpec, MllmError> {
        let described = self.models.join(format!("{name}.toml"));
        if !name.is_empty() && !name.contains(['/', '\\']) && described.is_file() {
            return ModelSpec::open(&described);
        }
        let path = Path::new(name);
        if path.extension().is_some_and(|extension| extension == "toml") && path.is_file() {
            return ModelSpec::open(path);
        }
        let source = if !name.is_empty() && path.is_dir() {
            ModelSource::Folder { folder: path.to_path_buf() }
        } else if hub::split_id(name).is_some() {
            ModelSource::Hub { hub: name.to_string(), revision: description::default_revision() }
        } else {
            return Err(MllmError::UnknownModel {
                name: name.to_string(),
                models: self.models.clone(),
                known: self.names()?.join(", "),
            });
        };
        Ok(ModelSpec {
            name: path.file_name().map_or_else(|| name.to_string(), |last| last.to_string_lossy().into_owned()),
            architecture: None,
            source,
            tokenizer: None,
            prompt_set: PromptSet::Paper,
            generation: GenerationSettings::default(),
        })
    }

    /// The folder with a model's files; a hub model is downloaded if need be and allowed.
    ///
    /// # Errors
    /// When a hub model cannot be had, or a server computes the model.
    pub fn folder(&self, spec: &ModelSpec) -> Result<PathBuf, MllmError> {
        let files = if spec.tokenizer.is_some() { HubFiles::ModelWithoutTokenizer } else { HubFiles::Model };
        self.fetch(&spec.name, &spec.source, files)
    }

    /// Opens a model of whatever architecture its configuration names, or prepares to ask the server that computes it.
    ///
    /// # Errors
    /// When its files cannot be had or are broken, or are of another architecture than its description says; when a
    /// server's key is missing, or the server lies beyond the network that must not be used.
    pub fn open(&self, spec: &ModelSpec) -> Result<Box<dyn Mllm>, MllmError> {
        if let ModelSource::Endpoint(settings) = &spec.source {
            if self.hub.offline && !settings.is_local() {
                return Err(MllmError::Offline { endpoint: settings.endpoint.clone() });
            }
            return Ok(Box::new(Endpoint::open(&spec.name, settings)?));
        }
        let folder = self.folder(spec)?;
        if let Some(expected) = spec.architecture {
            let found = Architecture::detect(&folder)?;
            if found != expected {
                return Err(MllmError::Config {
                    path: folder.join("config.json"),
                    key: "model_type".into(),
                    problem: format!(
                        "this is a {} model, the description of {:?} says {}",
                        found.name(),
                        spec.name,
                        expected.name()
                    ),
                });
            }
        }
        let tokenizer = match &spec.tokenizer {
            None => folder.clone(),
            Some(source) => self.fetch(&spec.name, source, HubFiles::Tokenizer)?,
        };
        Ok(Box::new(LocalModel::open_with_tokenizer(&spec.name, &folder, &tokenizer)?))
    }

    fn fetch(&self, name: &str, source: &ModelSource, files: HubFiles) -> Result<PathBuf, MllmError> {
        match source {
            ModelSource::Endpoint(settings) => {
                Err(MllmError::NoFiles { name: name.to_string(), endpoint: settings.endpoint.clone() })
            }
            ModelSource::Folder { folder } => Ok(folder.clone()),
            ModelSource::Hub { hub, revision } => self.hub.fetch(hub, revision, files),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn registry() -> (tempfile::TempDir, ModelRegistry) {
        let models = tempfile::tempdir().unwrap();
        let described =
            "name = 'Nano'\narchitecture = 'llava'\nsource = { folder = 'weights' }\nprompt_set = 'compact'\n";
        std::fs::write(models.path().join("nano.toml"), described).unwrap();
        std::fs::write(models.path().join("broken.toml"), "name = 3").unwrap();
        let registry = ModelRegistry::new(models.path(), HubAccess { offline: true, ..HubAccess::default() });
        (models, registry)
    }

    #[test]
    fn names_folders_and_ids_are_found() {
        let (models, registry) = registry();
        assert_eq!(registry.names().unwrap(), ["broken", "nano"]);
        let nano = registry.find("nano").unwrap();
        assert_eq!((nano.name.as_str(), nano.prompt_set), ("Nano", PromptSet::Compact));
        assert_eq!(registry.folder(&nano).unwrap(), models.path().join("weights"));
        let by_path = models.path().join("nano.toml");
        assert_eq!(registry.find(by_path.to_str().unwrap()).unwrap(), nano);
        let folder = registry.find(models.path().to_str().unwrap()).unwrap();
        assert_eq!(folder.source, ModelSource::Folder { folder: models.path().to_path_buf() });
        let hub = registry.find("llava-hf/llava-1.5-7b-hf").unwrap();
        assert_eq!(hub.name, "llava-1.5-7b-hf");
        assert!(matches!(hub.source, ModelSource::Hub { .. }));
    }

    #[test]
    fn every_description_that_ships_is_read() {
        let models = Path::new(env!("CARGO_MANIFEST_DIR")).join("models");
        let registry = ModelRegistry::new(&models, HubAccess { offline: true, ..HubAccess::default() });
        let names = registry.names().unwrap();
        let servers = names.iter().filter(|name| match registry.find(name).unwrap().source {
            ModelSource::Endpoint(settings) => settings.url().is_ok(),
            ModelSource::Folder { .. } | ModelSource::Hub { .. } => false,
        });
        assert_eq!(servers.collect::<Vec<_>>(), ["local-server", "openai"]);
        let openai = registry.find("openai").unwrap();
        assert!(matches!(registry.open(&openai), Err(MllmError::Offline { .. })), "the network is off");
        assert!(matches!(registry.folder(&openai), Err(MllmError::NoFiles { .. })));
        let local = registry.open(&registry.find("local-server").unwrap()).unwrap();
        assert_eq!(local.describe().server.unwrap().model, "default");
    }

    #[test]
    fn unknown_and_broken_models_are_errors() {
        let (_models, registry) = registry();
        match registry.find("nanoo") {
            Err(MllmError::UnknownModel { known, .. }) => assert_eq!(known, "broken, nano"),
            other => panic!("{other:?}"),
        }
        for name in ["", "../nano", "a b"] {
            assert!(matches!(registry.find(name), Err(MllmError::UnknownModel { .. })), "{name}");
        }
        assert!(matches!(registry.find("broken"), Err(MllmError::Description { .. })));
        let nano = registry.find("nano").unwrap();
        assert!(matches!(registry.open(&nano), Err(MllmError::MissingFile { .. })));
    }
}
