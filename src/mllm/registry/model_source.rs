//! Where a description finds the files of a model, or its server.

use super::hub::{HubName, addressed, plain, without_owner};
use crate::EndpointSettings;
use serde::{Deserialize, Serialize};
use std::fmt;
use std::path::{Path, PathBuf};

/// Where the files of a model are, or the server that computes it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged, deny_unknown_fields)]
pub enum ModelSource {
    /// A folder; a relative path starts at the description.
    Folder {
        folder: PathBuf,
    },
    /// A GGUF file; a relative path starts at the description.
    File {
        /// The decoder, or the whole model.
        file: PathBuf,
        /// The vision tower; none for the one beside the decoder.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        mmproj: Option<PathBuf>,
    },
    /// A repository of the Hugging Face hub.
    Hub {
        /// `organization/name`.
        hub: String,
        /// Branch, tag or commit.
        #[serde(default = "default_revision")]
        revision: String,
        /// The GGUF file of the repository; none for a repository of safetensors.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        file: Option<String>,
        /// The weight format of the GGUF file, where its name is not given, as llama.cpp writes it
        /// behind a colon (`Q4_K_M`).
        #[serde(default, skip_serializing_if = "Option::is_none")]
        quant: Option<String>,
        /// The vision tower for the GGUF file; none for the one of the repository that fits best.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        mmproj: Option<String>,
    },
    /// Files in the program.
    Embedded {
        embedded: String,
    },
    Endpoint(EndpointSettings),
}

impl ModelSource {
    /// A repository of the hub, or a part of it.
    pub(super) fn of_hub(name: HubName) -> Self {
        Self::Hub {
            hub: name.id,
            revision: name.revision.unwrap_or_else(default_revision),
            file: name.file,
            quant: name.quant,
            mmproj: None,
        }
    }

    /// Reads `hub` as the command line does: an address, or an id with a revision or a file.
    pub(super) fn take_hub_name(&mut self) -> Result<(), String> {
        let Self::Hub {
            hub,
            revision,
            file,
            quant,
            ..
        } = self
        else {
            return Ok(());
        };
        let named = match addressed(hub) {
            Some(named) => named.or_else(|problem| without_owner(hub).ok_or(problem))?,
            None => plain(hub)
                .or_else(|| without_owner(hub))
                .ok_or_else(|| format!("'{hub}' is no hub id; write ORG/NAME"))?,
        };
        *hub = named.id;
        if let Some(named) = named.revision {
            *revision = named;
        }
        *file = file.take().or(named.file);
        *quant = quant.take().or(named.quant);
        if let (Some(file), Some(quant)) = (file, quant) {
            return Err(format!("file {file} and quant {quant} exclude each other"));
        }
        Ok(())
    }

    /// Joins relative paths to a folder.
    pub(super) fn start_at(&mut self, folder: &Path) {
        let paths = match self {
            Self::Folder { folder } => [Some(folder), None],
            Self::File { file, mmproj } => [Some(file), mmproj.as_mut()],
            Self::Hub { .. } | Self::Embedded { .. } | Self::Endpoint(_) => [None, None],
        };
        for path in paths.into_iter().flatten() {
            *path = folder.join(&*path);
        }
    }
}

/// For messages and lists: a path, the hub id with revision and file, or the server.
impl fmt::Display for ModelSource {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Folder { folder } => write!(out, "{}", folder.display()),
            Self::File { file, .. } => write!(out, "{}", file.display()),
            Self::Embedded { .. } => out.write_str("built in"),
            Self::Endpoint(settings) => out.write_str(&settings.in_words()),
            Self::Hub {
                hub,
                revision,
                file,
                quant,
                ..
            } => {
                write!(out, "{hub}")?;
                if let Some(file) = file {
                    write!(out, "/{file}")?;
                } else if let Some(quant) = quant {
                    write!(out, ":{quant}")?;
                }
                if *revision == default_revision() {
                    Ok(())
                } else {
                    write!(out, " ({revision})")
                }
            }
        }
    }
}

/// The default revision of a hub repository.
pub(super) fn default_revision() -> String {
    "main".into()
}
