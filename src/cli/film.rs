//! Output files of `render`.

use anyhow::bail;
use std::path::{Path, PathBuf};

/// A path for films or pictures, with their format.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum FilmFile {
    Gif(PathBuf),
    Mp4(PathBuf),
    Png(PathBuf),
}

/// Extensions of pictures and films. A path with another one is a folder.
const ENDINGS: [&str; 7] = ["gif", "mp4", "png", "jpg", "jpeg", "webm", "avi"];

impl FilmFile {
    /// The file or folder.
    pub(super) fn path(&self) -> &Path {
        match self {
            Self::Gif(path) | Self::Mp4(path) | Self::Png(path) => path,
        }
    }

    fn ending(&self) -> &'static str {
        match self {
            Self::Gif(_) => "gif",
            Self::Mp4(_) => "mp4",
            Self::Png(_) => "png",
        }
    }

    fn with_path(&self, path: PathBuf) -> Self {
        match self {
            Self::Gif(_) => Self::Gif(path),
            Self::Mp4(_) => Self::Mp4(path),
            Self::Png(_) => Self::Png(path),
        }
    }

    /// Whether it is one file; else a folder. Fails if its extension is that of another format.
    pub(super) fn is_file(&self) -> anyhow::Result<bool> {
        let path = self.path();
        let ending = path
            .extension()
            .map(|ending| ending.to_string_lossy().to_ascii_lowercase())
            .unwrap_or_default();
        if ending == self.ending() {
            return Ok(!path.is_dir());
        }
        if ENDINGS.contains(&ending.as_str()) && !path.is_dir() {
            let own = self.ending();
            bail!(
                "--{own} {}: the name must end in .{own}, or be that of a folder",
                path.display()
            );
        }
        Ok(false)
    }

    /// The file of a simulation in the folder.
    pub(super) fn inside(&self, simulation: &str) -> Self {
        self.with_path(self.path().join(format!("{simulation}.{}", self.ending())))
    }

    /// The file behind links. Checks, before a film is drawn, that it can be written.
    pub(super) fn behind_links(&self) -> anyhow::Result<Self> {
        Ok(self.with_path(super::picture::target_of(self.path())?))
    }
}
