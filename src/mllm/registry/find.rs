//! What the name of a model stands for.

use super::hub::HubName;
use super::{ModelRegistry, ModelSource, ModelSpec, address, built_in, hub};
use crate::{EmbeddedModel, MllmError};
use planagent_files::KIND_BYTES;
use std::io::Read;
use std::path::{Path, PathBuf};

/// The file that a model folder begins with.
const CONFIG: &str = "config.json";
/// The first bytes of a GGUF file.
const GGUF: &[u8] = b"GGUF";
/// Folders of models in a folder that an error names.
const MAX_INNER: usize = 5;

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

/// The model in a folder. A repository's folder in the hub's cache stands for its snapshot.
fn in_folder(path: &Path) -> Result<ModelSource, MllmError> {
    if let Some(folder) = hub::snapshot_in(path) {
        return Ok(ModelSource::Folder { folder });
    }
    // Weights without a configuration are a model that is not whole.
    let inner = if is_model_folder(path) || has_weights(path) {
        Vec::new()
    } else {
        inner_models(path)
    };
    if inner.is_empty() {
        return Ok(ModelSource::Folder {
            folder: path.to_path_buf(),
        });
    }
    let inner: Vec<String> = inner
        .iter()
        .map(|folder| folder.display().to_string())
        .collect();
    Err(MllmError::OuterFolder {
        path: path.to_path_buf(),
        inner: inner.join(", "),
    })
}

/// Whether a folder has a file that a model begins with.
fn is_model_folder(folder: &Path) -> bool {
    folder.join(CONFIG).is_file() || names_in(folder).iter().any(|path| hub::is_gguf(path))
}

fn has_weights(folder: &Path) -> bool {
    names_in(folder).iter().any(|path| {
        path.extension()
            .is_some_and(|ending| ending == "safetensors")
    })
}

/// The folders of models in a folder that is none, as a clone or an archive leaves them.
fn inner_models(folder: &Path) -> Vec<PathBuf> {
    let mut inner: Vec<PathBuf> = names_in(folder)
        .into_iter()
        .filter(|path| path.is_dir() && is_model_folder(path))
        .collect();
    inner.sort();
    inner.truncate(MAX_INNER);
    inner
}

/// The paths in a folder. One that cannot be listed has none; opening it says why.
fn names_in(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    entries.map(|entry| entry.path()).collect()
}

/// The model that a file belongs to: a GGUF file, by whatever name (Ollama's have none that says
/// so), or the folder of a file as Hugging Face writes it.
fn of_file(path: &Path) -> Result<ModelSource, MllmError> {
    let mut beginning = Vec::new();
    // A file that cannot be read says so when it is opened.
    if let Ok(file) = planagent_files::open(path) {
        let _ = file.take(KIND_BYTES as u64).read_to_end(&mut beginning);
    }
    if hub::is_gguf(path) || beginning.starts_with(GGUF) {
        return Ok(ModelSource::File {
            file: path.to_path_buf(),
            mmproj: None,
        });
    }
    let is_part = path
        .extension()
        .is_some_and(|ending| ending == "json" || ending == "safetensors");
    match path.parent() {
        Some(folder) if is_part && folder.join(CONFIG).is_file() => Ok(ModelSource::Folder {
            folder: if folder.as_os_str().is_empty() {
                PathBuf::from(".")
            } else {
                folder.to_path_buf()
            },
        }),
        _ => Err(MllmError::NoModelFile {
            path: path.to_path_buf(),
            kind: planagent_files::kind_of(&beginning),
        }),
    }
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
    ///    (`org/name/file.gguf`) or its weight format (`org/name:Q4_K_M`); without an organization
    ///    (`gpt2`) where the cache has it.
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
            let named = named.or_else(|problem| {
                let cached = self.hub.cached_without_owner(name);
                cached.ok_or_else(|| MllmError::HubName {
                    word: name.to_owned(),
                    problem,
                })
            })?;
            return Ok(of_hub(named));
        }
        if let Some(server) = address::server(name) {
            return server;
        }
        let source = if !name.is_empty() && path.is_dir() {
            in_folder(path)?
        } else if !name.is_empty() && path.is_file() {
            of_file(path)?
        } else if let Some(named) = hub::plain(name) {
            return Ok(of_hub(named));
        } else if let Some(named) = self.hub.cached_without_owner(name) {
            return Ok(of_hub(named));
        } else if is_path(path) {
            return Err(MllmError::AbsentModel {
                path: path.to_path_buf(),
            });
        } else {
            return Err(self.unknown(name));
        };
        // A file of a folder stands for it.
        let named = match &source {
            ModelSource::Folder { folder } if path.is_file() => folder,
            _ => path,
        };
        let last = named.file_name().map_or_else(
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
