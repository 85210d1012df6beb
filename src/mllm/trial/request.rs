//! What a trial opens, and the digest of its content.

use crate::checkpoint::{MAX_SMALL_FILES, safetensors_folder, small_file_limit};
use crate::gguf::{decoder_files, files as gguf_files, find as find_gguf, open_header};
use crate::{Loading, MllmError, ModelPlace};
use planagent_files::serde_path;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Incremented when a trial tries something else.
const VERSION: u32 = 1;
/// Endings of the small files of a model.
const SMALL_FILES: [&str; 2] = ["json", "jinja"];

/// The files of a model that are tried, as the child process reads them.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TrialRequest {
    #[serde(default, with = "serde_path")]
    folder: Option<PathBuf>,
    #[serde(default, with = "serde_path")]
    gguf: Option<PathBuf>,
    #[serde(default, with = "serde_path")]
    mmproj: Option<PathBuf>,
    /// A GGUF decoder that is opened without its tower.
    #[serde(default, with = "serde_path")]
    decoder: Option<PathBuf>,
    /// Folder of the tokenizer, for models whose files have none.
    #[serde(default, with = "serde_path")]
    tokenizer: Option<PathBuf>,
    /// Texts that the tokenizer reads besides its own.
    pub(super) samples: Vec<String>,
}

impl TrialRequest {
    /// The files of a model; none for one that the program holds, or whose files do not exist.
    pub(super) fn for_model(place: &ModelPlace, loading: &Loading) -> Option<Self> {
        let tokenizer = loading.tokenizer.clone();
        let request = match place.clone() {
            ModelPlace::Folder(folder) => Self {
                folder: Some(folder),
                tokenizer,
                ..Self::default()
            },
            ModelPlace::Gguf { model, mmproj } => Self {
                gguf: Some(model),
                mmproj,
                tokenizer,
                ..Self::default()
            },
            ModelPlace::Decoder(decoder) => Self {
                decoder: Some(decoder),
                tokenizer,
                ..Self::default()
            },
            ModelPlace::Embedded(_) | ModelPlace::Random { .. } => return None,
        };
        place.path().exists().then_some(request)
    }

    pub(super) fn with_samples(self, samples: &[String]) -> Self {
        Self {
            samples: samples.to_vec(),
            ..self
        }
    }

    /// Where the files are, and how they are loaded.
    pub(super) fn place(&self) -> Option<(ModelPlace, Loading)> {
        let folder = self.folder.clone().map(ModelPlace::Folder);
        let gguf = || {
            Some(ModelPlace::Gguf {
                model: self.gguf.clone()?,
                mmproj: self.mmproj.clone(),
            })
        };
        let decoder = || self.decoder.clone().map(ModelPlace::Decoder);
        let loading = Loading {
            tokenizer: self.tokenizer.clone(),
            ..Loading::default()
        };
        Some((folder.or_else(gguf).or_else(decoder)?, loading))
    }

    /// BLAKE3 of the small files with their names, of the metadata of GGUF files, and of what a
    /// trial does.
    pub(super) fn digest(&self) -> Result<String, MllmError> {
        let mut hasher = blake3::Hasher::new();
        add(
            &mut hasher,
            &(VERSION, env!("CARGO_PKG_VERSION"), &self.samples),
        );
        for folder in [&self.folder, &self.tokenizer].into_iter().flatten() {
            add(&mut hasher, &"folder");
            add_files(&mut hasher, &small_files(folder)?)?;
        }
        let gguf = match (self.gguf.as_ref().or(self.decoder.as_ref()), &self.folder) {
            (Some(model), _) => Some(model.clone()),
            (None, Some(folder)) if !safetensors_folder::has_safetensors(folder) => {
                find_gguf(folder)?
            }
            _ => None,
        };
        if let Some(model) = gguf {
            // Files beside a GGUF file take precedence over its metadata.
            let beside = model
                .parent()
                .filter(|_| self.folder.is_none())
                .map(Path::to_path_buf);
            add_files(
                &mut hasher,
                &beside
                    .map(|folder| small_files(&folder))
                    .transpose()?
                    .unwrap_or_default(),
            )?;
            let files = if self.decoder.is_some() {
                decoder_files(&model)?
            } else {
                gguf_files(&model, self.mmproj.as_deref())?
            };
            for file in files {
                let (header, _) = open_header(&file)?;
                let tensors: Vec<_> = header
                    .tensors
                    .iter()
                    .map(|(name, place)| (name, &place.shape))
                    .collect();
                add(&mut hasher, &(&header.metadata, tensors));
            }
        }
        Ok(hasher.finalize().to_hex().to_string())
    }
}

/// Adds a value to a digest, with its length.
fn add(hasher: &mut blake3::Hasher, value: &impl Serialize) {
    let text = serde_json::to_vec(value).expect("names, numbers and lists can be written as JSON");
    hasher.update(&(text.len() as u64).to_le_bytes());
    hasher.update(&text);
}

/// Adds files with their names to a digest.
fn add_files(hasher: &mut blake3::Hasher, files: &[PathBuf]) -> Result<(), MllmError> {
    for file in files {
        let mut content = blake3::Hasher::new();
        hash_file(file, &mut content)?;
        let name = file
            .file_name()
            .expect("an entry of a folder has a name")
            .to_string_lossy();
        add(hasher, &(name, content.finalize().to_hex().as_str()));
    }
    Ok(())
}

/// The small files of a model's folder, sorted.
///
/// # Errors
/// When the folder cannot be read, has too many of them, or one is too large.
pub(crate) fn small_files(folder: &Path) -> Result<Vec<PathBuf>, MllmError> {
    let folder = if folder.as_os_str().is_empty() {
        Path::new(".")
    } else {
        folder
    };
    let failed = |source| MllmError::Read {
        path: folder.to_path_buf(),
        source,
    };
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        let is_small = path
            .extension()
            .is_some_and(|ending| SMALL_FILES.iter().any(|small| ending == *small));
        if is_small && path.is_file() {
            files.push(path);
        }
        if files.len() > MAX_SMALL_FILES {
            let problem = format!("it has more than {MAX_SMALL_FILES} small files (.json, .jinja)");
            return Err(failed(std::io::Error::other(problem)));
        }
    }
    files.sort();
    Ok(files)
}

/// Adds a small file to a digest.
pub(crate) fn hash_file(path: &Path, hasher: &mut blake3::Hasher) -> Result<(), MllmError> {
    let failed = |source| MllmError::Read {
        path: path.to_path_buf(),
        source,
    };
    hasher.update(&planagent_files::read(path, small_file_limit(path)).map_err(failed)?);
    Ok(())
}
