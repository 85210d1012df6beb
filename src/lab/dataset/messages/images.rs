//! Where the pictures of a dataset of messages are.

use crate::dataset::shard::ShardError;
use image::{ImageFormat, RgbImage};
use planagent_files::write_within;
use std::fs;
use std::io::Cursor;
use std::path::Path;

/// The place of a picture in a prompt, as LLaMA-Factory and ms-swift read it.
pub(super) const PLACE: &str = "<image>";
/// Folder of the pictures.
const FOLDER: &str = "images";

/// The path of a picture in the dataset's folder, with slashes on any system.
pub(super) fn path(split: &str, shard: usize, number: usize) -> String {
    format!("{FOLDER}/{split}/{shard:05}/{number:05}.png")
}

/// Creates the folder of a shard's pictures.
pub(super) fn create_folder(folder: &Path, split: &str, shard: usize) -> Result<(), ShardError> {
    let path = folder.join(format!("{FOLDER}/{split}/{shard:05}"));
    fs::create_dir_all(&path).map_err(|source| ShardError::Write { path, source })
}

/// Writes a picture.
pub(super) fn write(folder: &Path, path: &str, image: &RgbImage) -> Result<(), ShardError> {
    let path = folder.join(path);
    let mut bytes = Cursor::new(Vec::new());
    image
        .write_to(&mut bytes, ImageFormat::Png)
        .map_err(|source| ShardError::Image {
            path: path.clone(),
            source,
        })?;
    write_within(&path, bytes.get_ref()).map_err(|source| ShardError::Write { path, source })
}
