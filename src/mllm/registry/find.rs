//! What the name of a model stands for.

use super::hub::HubName;
use super::{ModelRegistry, ModelSource, ModelSpec, address, built_in, hub};
use crate::{EmbeddedModel, MllmError};
use std::path::{Path, PathBuf};

/// Whether a word can be nothing but a path.
fn is_path(path: &Path) -> bool {
    let is_description = || {
        path.extension()
            .is_some_and(|extension| extension == "toml")
    };
    path.has_root()
        || path.starts_with(".")
        || path.starts_with("..")
        || hub::is_gguf(path)
        || is_description()
}

/// A model of the hub without a description. Its name in results is the last part of its word.
fn of_hub(named: HubName) -> ModelSpec {
    let word = named.word();
    let last = match (&named.file, named.id.split_once('/')) {
        (None, Some((owner, _))) => word[owner.len() + 1..].replace('/', "-"),
        _ => word.rsplit('/').next().unwrap_or(&word).to_owned(),
    };
    ModelSpec::plain(last, ModelSource::of_hub(named))
}

impl ModelRegistry {
    /// The names of the described models, in the folder and in the program, sorted.
    pub fn names(&self) -> Result<Vec<String>, MllmError> {
        let failed = |source| MllmError::Read {
            path: self.models.clone(),
            source,
        };
        let embedded = EmbeddedModel::all().iter().map(|model| model.name);
        let mut names: Vec<String> = embedded
            .chain(built_in::names())
            .map(str::to_owned)
            .collect();
        if self.models.is_dir() {
            for entry in std::fs::read_dir(&self.models).map_err(failed)? {
                let path = entry.map_err(failed)?.path();
                if path
                    .extension()
                    .is_some_and(|extension| extension == "toml")
                {
                    names.extend(
                        path.file_stem()
                            .map(|stem| stem.to_string_lossy().into_owned()),
                    );
                }
            }
        }
        names.sort();
        names.dedup();
        Ok(names)
    }

    pub(super) fn unknown(&self, name: &str) -> MllmError {
        let known = self.names().unwrap_or_default().join(", ");
        MllmError::UnknownModel {
            name: name.to_string(),
            models: self.models.clone(),
            known,
        }
    }

    /// Whether a name stands for more than files of a model on this machine: a server, a
    /// repository of the hub, or a description by its path. A run that was made elsewhere may not
    /// choose these.
    pub fn leads_elsewhere(&self, name: &str) -> bool {
        let is_elsewhere = |source: &ModelSource| {
            matches!(source, ModelSource::Endpoint(_) | ModelSource::Hub { .. })
        };
        if self.description(name).is_none()
            && Path::new(name).extension().is_some_and(|e| e == "toml")
        {
            return true;
        }
        // What cannot be found is said when it is opened.
        self.find(name).is_ok_and(|spec| {
            let sources = [
                Some(&spec.source),
                spec.tokenizer.as_ref(),
                spec.draft_model.as_ref(),
            ];
            sources.into_iter().flatten().any(is_elsewhere)
        })
    }

    /// Finds a model. `name` is, in this order:
    /// 1. the name of a description in the folder, then of one in the program,
    /// 2. the path of a description, a model folder or a GGUF file,
    /// 3. the address of a page of the hub (`https://huggingface.co/org/name`, `hf.co/org/name`),
    /// 4. the address of a server (`http://127.0.0.1:8080/v1`), perhaps with `#` and its name of
    ///    the model,
    /// 5. a hub id, perhaps with a revision (`org/name@v1`), and with a GGUF file
    ///    (`org/name/file.gguf`) or its weight format (`org/name:Q4_K_M`).
    ///
    /// [`Self::asking`] says how it is asked.
    pub fn find(&self, name: &str) -> Result<ModelSpec, MllmError> {
        if let Some(described) = self.description(name) {
            return ModelSpec::open(&described);
        }
        if let Some(model) = EmbeddedModel::find(name) {
            let source = ModelSource::Embedded {
                embedded: name.to_owned(),
            };
            return Ok(ModelSpec {
                source,
                ..ModelSpec::parse(Path::new(name), model.description)?
            });
        }
        if let Some(text) = built_in::find(name) {
            return ModelSpec::parse(Path::new(name), text);
        }
        let path = Path::new(name);
        if path
            .extension()
            .is_some_and(|extension| extension == "toml")
            && path.is_file()
        {
            return ModelSpec::open(path);
        }
        if let Some(named) = hub::addressed(name) {
            let named = named.map_err(|problem| MllmError::HubName {
                word: name.to_owned(),
                problem,
            })?;
            return Ok(of_hub(named));
        }
        if let Some(server) = address::server(name) {
            return server;
        }
        let source = if !name.is_empty() && path.is_dir() {
            // A repository's folder in the hub's cache stands for its snapshot.
            ModelSource::Folder {
                folder: hub::snapshot_in(path).unwrap_or_else(|| path.to_path_buf()),
            }
        } else if hub::is_gguf(path) && path.is_file() {
            ModelSource::File {
                file: path.to_path_buf(),
                mmproj: None,
            }
        } else if let Some(named) = hub::plain(name) {
            return Ok(of_hub(named));
        } else if is_path(path) {
            return Err(MllmError::AbsentModel {
                path: path.to_path_buf(),
            });
        } else {
            return Err(self.unknown(name));
        };
        let last = path.file_name().map_or_else(
            || name.to_string(),
            |last| last.to_string_lossy().into_owned(),
        );
        Ok(ModelSpec::plain(last, source))
    }

    /// The description of a name, if `models/` has one.
    pub fn description(&self, name: &str) -> Option<PathBuf> {
        let described = self.models.join(format!("{name}.toml"));
        (!name.is_empty() && !name.contains(['/', '\\']) && described.is_file())
            .then_some(described)
    }
}
