//! Picture files of commands.

use anyhow::Context;
use image::{ImageFormat, RgbImage};
use std::path::{Path, PathBuf};

/// A file for a picture; its extension names the format.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct PictureFile {
    path: PathBuf,
    format: ImageFormat,
}

/// An extension of no supported format.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("the name of a picture must end in .png, .jpg or .jpeg")]
pub(super) struct UnknownEnding;

impl TryFrom<PathBuf> for PictureFile {
    type Error = UnknownEnding;

    fn try_from(path: PathBuf) -> Result<Self, Self::Error> {
        let ending = path.extension().map(|ending| ending.to_string_lossy().to_ascii_lowercase());
        let format = match ending.as_deref() {
            Some("png") => ImageFormat::Png,
            Some("jpg" | "jpeg") => ImageFormat::Jpeg,
            _ => return Err(UnknownEnding),
        };
        Ok(Self { path, format })
    }
}

impl PictureFile {
    /// Writes the picture.
    pub(super) fn save(&self, picture: &RgbImage) -> anyhow::Result<()> {
        picture
            .save_with_format(&self.path, self.format)
            .with_context(|| format!("cannot write {}", self.path.display()))
    }

    /// Path of the file.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }
}
