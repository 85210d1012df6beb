//! Shards on disk: a JSONL file of labeled states and a PNG with their images, one below the other.
//!
//! Beside its conversation, a state has `occupancy`: three grids of 16 x 16 cells, for now, 1 s and
//! 2 s later. All of them cover the area of the present picture. Each is 64 hexadecimal digits, row
//! by row and four digits a row. Row 0 is the top of the picture, and the highest bit of a row is
//! its left column. A bit is set where the box of a vehicle, bicycle, pedestrian or static object
//! touches the cell. Where the search accepts several codes, `tried` has each with its chance, its
//! value and the answers of the last two rounds that lead to it. `refused` has the codes that
//! Reflection refuses, each with its value, nuPlan's score, Reflection's score with its parts, and
//! the reason. Two consecutive states with the same `twin` have the same prompts, other pictures
//! and other best codes.

use super::label::LabeledState;
use image::{ImageError, ImageFormat, RgbImage};
use planagent_files::{MAX_SETTINGS_BYTES, UNFINISHED, read_text, write_within};
use serde::Serialize;
use std::fs;
use std::io::{self, Cursor};
use std::path::{Path, PathBuf};

/// Version of the files of a dataset; a folder of another version is not continued.
pub const FORMAT: u32 = 1;

#[derive(Debug, thiserror::Error)]
pub enum ShardError {
    #[error("cannot write {}: {source}", path.display())]
    Write { path: PathBuf, source: io::Error },
    #[error("cannot write {}: {source}", path.display())]
    Image { path: PathBuf, source: ImageError },
    #[error("cannot read {}: {source}", path.display())]
    Read { path: PathBuf, source: io::Error },
    #[error("not a labeled state: {0}")]
    Json(#[from] serde_json::Error),
    #[error("{} holds other files, or a dataset with other settings; name a new folder", .0.display())]
    OtherSettings(PathBuf),
}

/// `meta.json`.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Meta {
    pub format: u32,
    /// Side of an image, pixels.
    pub image_pixels: u32,
    /// Side of the area that an image shows, meters.
    pub view_m: f64,
    pub prompt_set: String,
    /// Share of modified scenarios.
    pub modified: f64,
    /// Times of the occupancy grids after the state, seconds.
    pub occupancy_s: [f64; 3],
    pub seed: u64,
    pub planagent: String,
}

/// Largest JSONL file of a shard that is read, bytes. One of 500 states has a megabyte.
const MAX_SHARD_BYTES: u64 = 256 << 20;
/// Name of the file with the settings of a dataset.
const META: &str = "meta.json";

/// Whether a folder holds a dataset with the same `meta.json`; not if it is new or empty.
///
/// # Errors
/// When it holds other files, or a dataset with other settings.
pub(super) fn is_begun(folder: &Path, meta: &impl Serialize) -> Result<bool, ShardError> {
    let other = || ShardError::OtherSettings(folder.to_owned());
    let expected = text(meta)?;
    // Earlier versions left a part of the file where the disk was full.
    let is_begin = |present: &str| present != expected && expected.starts_with(present);
    match read_text(&folder.join(META), MAX_SETTINGS_BYTES) {
        Ok(present) if present == expected => Ok(true),
        Ok(present) if is_begin(&present) && !has_others(folder) => Ok(false),
        Ok(_) => Err(other()),
        Err(_) if has_others(folder) => Err(other()),
        Err(_) => Ok(false),
    }
}

/// Whether a folder has other files than those that a dataset begins with.
fn has_others(folder: &Path) -> bool {
    fs::read_dir(folder).is_ok_and(|entries| {
        entries.flatten().any(|entry| {
            let name = entry.file_name();
            let name = name.to_string_lossy();
            name != META && !name.starts_with(UNFINISHED)
        })
    })
}

/// Creates the folder with its `meta.json`, or resumes a dataset with the same `meta.json`.
pub(super) fn open_folder(folder: &Path, meta: &impl Serialize) -> Result<(), ShardError> {
    fs::create_dir_all(folder).map_err(|source| ShardError::Write {
        path: folder.to_owned(),
        source,
    })?;
    if is_begun(folder, meta)? {
        return Ok(());
    }
    let path = folder.join(META);
    write_within(&path, text(meta)?.as_bytes()).map_err(|source| ShardError::Write { path, source })
}

fn text(meta: &impl Serialize) -> Result<String, ShardError> {
    Ok(serde_json::to_string_pretty(meta)? + "\n")
}

/// The JSONL and PNG file of a shard.
pub(super) fn paths(folder: &Path, split: &str, shard: usize) -> (PathBuf, PathBuf) {
    let base = folder.join(format!("{split}-{shard:05}"));
    (base.with_extension("jsonl"), base.with_extension("png"))
}

/// Number of states of a complete shard. The JSONL file is written last, so its presence shows
/// completeness.
pub(super) fn complete(folder: &Path, split: &str, shard: usize) -> Option<usize> {
    read_text(&paths(folder, split, shard).0, MAX_SHARD_BYTES)
        .ok()
        .map(|text| text.lines().count())
}

/// The lines of all complete shards of a split, in the order of their names.
pub(super) fn lines(folder: &Path, split: &str) -> Result<Vec<String>, ShardError> {
    let failed = |source| ShardError::Read {
        path: folder.to_owned(),
        source,
    };
    let is_of_split = |path: &PathBuf| {
        let name = path
            .file_name()
            .expect("an entry of a folder has a name")
            .to_string_lossy();
        name.starts_with(&format!("{split}-"))
            && name.ends_with(".jsonl")
            && !name.ends_with(".unfinished.jsonl")
    };
    let entries = fs::read_dir(folder)
        .map_err(failed)?
        .collect::<Result<Vec<_>, _>>()
        .map_err(failed)?;
    let mut paths: Vec<PathBuf> = entries
        .into_iter()
        .map(|entry| entry.path())
        .filter(is_of_split)
        .collect();
    // Folders list files in any order, and training must see the same lines in the same order.
    paths.sort();
    let texts = paths.iter().map(|path| {
        read_text(path, MAX_SHARD_BYTES).map_err(|source| ShardError::Read {
            path: path.clone(),
            source,
        })
    });
    let texts = texts.collect::<Result<Vec<_>, _>>()?;
    Ok(texts
        .iter()
        .flat_map(|text| text.lines().map(str::to_owned))
        .collect())
}

/// Writes a shard, and gives the number of its states: each file under a temporary name first, the
/// PNG before the JSONL.
pub(super) fn write(
    folder: &Path,
    split: &str,
    shard: usize,
    states: Vec<(LabeledState, RgbImage)>,
    pixels: u32,
) -> Result<usize, ShardError> {
    let count = states.len();
    let (jsonl, png) = paths(folder, split, shard);
    let mut stack = RgbImage::new(pixels, pixels * (states.len() as u32).max(1));
    let mut lines = String::new();
    for (row, (mut state, image)) in states.into_iter().enumerate() {
        image::imageops::replace(&mut stack, &image, 0, i64::from(pixels) * row as i64);
        state.image = row;
        lines.push_str(&serde_json::to_string(&state)?);
        lines.push('\n');
    }
    let mut picture = Cursor::new(Vec::new());
    stack
        .write_to(&mut picture, ImageFormat::Png)
        .map_err(|source| ShardError::Image {
            path: png.clone(),
            source,
        })?;
    write_file(&png, picture.get_ref())?;
    write_file(&jsonl, lines.as_bytes())?;
    Ok(count)
}

pub(super) fn write_file(path: &Path, bytes: &[u8]) -> Result<(), ShardError> {
    write_within(path, bytes).map_err(|source| ShardError::Write {
        path: path.to_owned(),
        source,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_folder_in_which_the_settings_were_cut_off_begins_again() {
        let meta = json!({"format": FORMAT, "seed": 3});
        let whole = text(&meta).unwrap();
        for present in ["", &whole[..7]] {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join(META);
            fs::write(&path, present).unwrap();
            assert!(!is_begun(folder.path(), &meta).unwrap());
            open_folder(folder.path(), &meta).unwrap();
            assert_eq!(fs::read_to_string(&path).unwrap(), whole);
            assert!(is_begun(folder.path(), &meta).unwrap());
        }
        for (present, other) in [("", "train-00000.jsonl"), ("{}", "train-00000.png")] {
            let folder = tempfile::tempdir().unwrap();
            fs::write(folder.path().join(META), present).unwrap();
            fs::write(folder.path().join(other), "").unwrap();
            assert!(is_begun(folder.path(), &meta).is_err());
        }
        let folder = tempfile::tempdir().unwrap();
        fs::write(folder.path().join(META), "{}").unwrap();
        assert!(is_begun(folder.path(), &meta).is_err());
    }

    #[cfg(unix)]
    #[test]
    fn a_device_in_the_place_of_a_file_is_not_read() {
        let meta = json!({"format": FORMAT, "seed": 3});
        let folder = tempfile::tempdir().unwrap();
        for name in [META, "train-00000.jsonl"] {
            std::os::unix::fs::symlink("/dev/zero", folder.path().join(name)).unwrap();
        }
        assert!(is_begun(folder.path(), &meta).is_err());
        assert_eq!(complete(folder.path(), "train", 0), None);
        assert!(lines(folder.path(), "train").is_err());
    }
}
