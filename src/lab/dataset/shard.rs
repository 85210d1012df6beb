//! Shards on disk: a JSONL file of labeled states and a PNG with their images, one below the other.
//!
//! Beside its conversation, a state has `occupancy`: three grids of 16 x 16 cells, for now, 1 s and
//! 2 s later. All of them cover the area of the present picture. Each is 64 hexadecimal digits, row
//! by row and four digits a row. Row 0 is the top of the picture, and the highest bit of a row is
//! its left column. A bit is set where the box of a vehicle, bicycle, pedestrian or static object
//! touches the cell. Where the search accepts several codes, `tried` has each with its chance, its
//! value and the answers of the last two rounds that lead to it. Two consecutive states with the
//! same `twin` have the same prompts, other pictures and other best codes.

use super::label::LabeledState;
use image::{ImageError, RgbImage};
use serde::Serialize;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

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

/// Name of the file with the settings of a dataset.
const META: &str = "meta.json";

/// Whether a folder holds a dataset with the same `meta.json`; not if it is new or empty.
///
/// # Errors
/// When it holds other files, or a dataset with other settings.
pub(super) fn is_begun(folder: &Path, meta: &impl Serialize) -> Result<bool, ShardError> {
    let other = || ShardError::OtherSettings(folder.to_owned());
    match fs::read_to_string(folder.join(META)) {
        Ok(present) if present == text(meta)? => Ok(true),
        Ok(_) => Err(other()),
        Err(_) if fs::read_dir(folder).is_ok_and(|mut entries| entries.next().is_some()) => {
            Err(other())
        }
        Err(_) => Ok(false),
    }
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
    fs::write(&path, text(meta)?).map_err(|source| ShardError::Write { path, source })
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
    fs::read_to_string(paths(folder, split, shard).0)
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
            && !name.contains(".unfinished")
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
    paths.sort();
    let texts = paths.iter().map(|path| {
        fs::read_to_string(path).map_err(|source| ShardError::Read {
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
    let unfinished = png.with_extension("unfinished.png");
    stack
        .save(&unfinished)
        .map_err(|source| ShardError::Image {
            path: unfinished.clone(),
            source,
        })?;
    rename(&unfinished, &png)?;
    let unfinished = jsonl.with_extension("unfinished.jsonl");
    fs::write(&unfinished, lines).map_err(|source| ShardError::Write {
        path: unfinished.clone(),
        source,
    })?;
    rename(&unfinished, &jsonl)?;
    Ok(count)
}

fn rename(from: &Path, to: &Path) -> Result<(), ShardError> {
    fs::rename(from, to).map_err(|source| ShardError::Write {
        path: to.to_owned(),
        source,
    })
}
