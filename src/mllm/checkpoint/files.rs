//! The small files of a model: configurations, tokenizer, chat template.

use super::own_keys::OwnKeys;
use super::{parse_json, read_text};
use crate::MllmError;
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// The files of a model folder, or their texts in the metadata of a GGUF file.
#[derive(Debug, Clone)]
pub struct ModelFiles {
    place: PathBuf,
    /// Texts of files outside of a folder, by name, each with the path that messages show.
    packed: Option<BTreeMap<String, (PathBuf, String)>>,
    /// The GGUF files that the texts were made from, where they do not hold them.
    made_from: Option<OwnKeys>,
}

impl ModelFiles {
    pub(crate) fn folder(folder: &Path) -> Result<Self, MllmError> {
        if folder.is_dir() {
            return Ok(Self {
                place: folder.to_path_buf(),
                packed: None,
                made_from: None,
            });
        }
        Err(MllmError::MissingFile {
            folder: folder.to_path_buf(),
            file: "such folder, so no config.json".into(),
        })
    }

    /// Texts of files by name; `place` is the file or shape that holds them.
    pub(crate) fn packed(place: &Path, texts: BTreeMap<String, String>) -> Self {
        let packed = texts
            .into_iter()
            .map(|(name, text)| (name.clone(), (place.join(name), text)))
            .collect();
        Self {
            place: place.to_path_buf(),
            packed: Some(packed),
            made_from: None,
        }
    }

    /// The same texts, made from the metadata of GGUF files.
    pub(crate) fn made_from(self, files: OwnKeys) -> Self {
        Self {
            made_from: Some(files),
            ..self
        }
    }

    /// An error about a key of these files by the name that the key has on the disk.
    pub(crate) fn by_own_key(&self, error: MllmError) -> MllmError {
        match &self.made_from {
            Some(files) => files.rename(error),
            None => error,
        }
    }

    /// The file of llama.cpp that has a tensor by llama.cpp's name; none for other files.
    pub(crate) fn file_of_tensor(&self, tensor: &str) -> Option<&Path> {
        self.made_from.as_ref().map(|files| files.file_of(tensor))
    }

    /// Replaces each file of `names` that a folder holds by the folder's.
    pub(crate) fn prefer(&mut self, folder: &Path, names: &[&str]) -> Result<(), MllmError> {
        let Some(packed) = &mut self.packed else {
            return Ok(());
        };
        for name in names {
            let path = folder.join(name);
            if path.is_file() {
                let text = read_text(&path)?;
                packed.insert((*name).to_string(), (path, text));
            }
        }
        Ok(())
    }

    /// Whether they lie in a folder.
    pub(crate) fn is_folder(&self) -> bool {
        self.packed.is_none()
    }

    /// The folder or file.
    pub(crate) fn place(&self) -> &Path {
        &self.place
    }

    /// The path of a file in messages.
    pub(crate) fn path(&self, name: &str) -> PathBuf {
        let packed = self.packed.as_ref().and_then(|packed| packed.get(name));
        packed.map_or_else(|| self.place.join(name), |(path, _)| path.clone())
    }

    pub(crate) fn text(&self, name: &str) -> Result<Option<String>, MllmError> {
        if let Some(packed) = &self.packed {
            return Ok(packed.get(name).map(|(_, text)| text.clone()));
        }
        let path = self.place.join(name);
        if path.is_file() {
            read_text(&path).map(Some)
        } else {
            Ok(None)
        }
    }

    pub(crate) fn json(&self, name: &str) -> Result<Option<Value>, MllmError> {
        self.text(name)?
            .map(|text| parse_json(&self.path(name), &text))
            .transpose()
    }

    pub(crate) fn required_json(&self, name: &str) -> Result<Value, MllmError> {
        self.json(name)?.ok_or_else(|| self.missing(name))
    }

    /// The error for a missing file. `file` may name alternatives.
    pub(crate) fn missing(&self, file: &str) -> MllmError {
        MllmError::MissingFile {
            folder: self.place.clone(),
            file: file.to_string(),
        }
    }
}
