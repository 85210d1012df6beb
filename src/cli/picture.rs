//! Picture files of commands.

use anyhow::{Context, bail};
use clap::builder::{PathBufValueParser, TypedValueParser};
use image::{ImageFormat, RgbImage};
use planagent_files::{WholeFile, target, write_whole};
use std::fs::File;
use std::io::{self, Cursor};
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

/// Takes a path with the extension of a picture format.
pub(super) fn picture_file() -> impl TypedValueParser<Value = PictureFile> {
    PathBufValueParser::new().try_map(PictureFile::try_from)
}

/// Fails if a file cannot be written: said before the work, not after it. A file that exists is not
/// changed.
pub(super) fn check_output(file: &Path) -> anyhow::Result<()> {
    let folder = file
        .parent()
        .filter(|folder| !folder.as_os_str().is_empty());
    if let Some(folder) = folder.filter(|folder| !folder.is_dir()) {
        bail!(
            "cannot write {}: there is no folder {}",
            file.display(),
            folder.display()
        );
    }
    target(file)
        .and_then(|file| open_once(&file))
        .with_context(|| format!("cannot write {}", file.display()))
}

/// Opens a file for writing. In the place of one that is missing, only a temporary file is created
/// and deleted again: another process may write the file meanwhile.
fn open_once(file: &Path) -> io::Result<()> {
    if file.exists() {
        return File::options().append(true).open(file).map(|_| ());
    }
    WholeFile::create(file).map(drop)
}

/// The file to write, behind links; see [`check_output`].
pub(super) fn target_of(file: &Path) -> anyhow::Result<PathBuf> {
    check_output(file)?;
    target(file).with_context(|| format!("cannot write {}", file.display()))
}

/// Writes a picture: all of it, or nothing.
pub(super) fn write_picture(
    picture: &RgbImage,
    format: ImageFormat,
    path: &Path,
) -> anyhow::Result<()> {
    let mut bytes = Cursor::new(Vec::new());
    let encoded = picture.write_to(&mut bytes, format);
    encoded
        .map_err(io::Error::other)
        .and_then(|()| write_whole(path, bytes.get_ref()))
        .with_context(|| format!("cannot write {}", path.display()))
}

impl TryFrom<PathBuf> for PictureFile {
    type Error = UnknownEnding;

    fn try_from(path: PathBuf) -> Result<Self, Self::Error> {
        let ending = path
            .extension()
            .map(|ending| ending.to_string_lossy().to_ascii_lowercase());
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
        check_output(&self.path)?;
        write_picture(picture, self.format, &self.path)
    }

    /// A file beside this one, with a word before the extension: `scene.png` and `scene.model.png`.
    pub(super) fn beside(&self, word: &str) -> Self {
        let mut name = self
            .path
            .file_stem()
            .expect("a path with an ending has a stem")
            .to_owned();
        name.push(format!(".{word}."));
        name.push(
            self.path
                .extension()
                .expect("the ending of a picture names its format"),
        );
        Self {
            path: self.path.with_file_name(name),
            format: self.format,
        }
    }

    /// Path of the file.
    pub(super) fn path(&self) -> &Path {
        &self.path
    }
}
