//! Models that llama.cpp's `gguf-split` cut into several files. The first part has the metadata, and
//! each its own tensors.

use super::header::Header;
use super::open_header;
use crate::MllmError;
use crate::checkpoint::WeightFile;
use serde_json::Value;
use std::path::{Path, PathBuf};

const COUNT: &str = "split.count";
const NUMBER: &str = "split.no";
const TENSORS: &str = "split.tensors.count";
/// How the name of a file ends.
const ENDING: &str = ".gguf";
/// Most parts of a model. Published ones have up to about 50.
const MAX_PARTS: u64 = 1 << 10;

/// A part's place among the parts of its model, from 0.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Part {
    pub(super) number: usize,
    pub(super) count: usize,
}

/// Opens a model by its file, or by any of its parts. Gives the header over all parts, and the
/// files in the order of [`Header::part_of`].
pub(crate) fn open_model(path: &Path) -> Result<(Header, Vec<WeightFile>), MllmError> {
    let (header, file) = open_header(path)?;
    let Some(part) = header.part()? else {
        return Ok((header, vec![file]));
    };
    let paths = part.paths(&header)?;
    // Lazily: an absent part is reported before others are read.
    let mut parts = paths.iter().map(|path| {
        if path.is_file() {
            open_header(path)
        } else {
            Err(absent(&header, path, part))
        }
    });
    let Some(first) = parts.next() else {
        return Ok((header, vec![file]));
    };
    let (mut whole, file) = first?;
    check_part(&whole, Part { number: 0, ..part })?;
    let mut files = vec![file];
    for (number, opened) in parts.enumerate() {
        let (header, file) = opened?;
        let number = number + 1;
        check_part(&header, Part { number, ..part })?;
        for (name, place) in header.tensors {
            if whole.tensors.contains_key(&name) {
                return Err(MllmError::TwiceStored {
                    place: header.path,
                    name,
                });
            }
            whole.parts.insert(name.clone(), number);
            whole.tensors.insert(name, place);
        }
        files.push(file);
    }
    let announced = whole.typed(TENSORS, "a whole number", Value::as_u64)?;
    if let Some(announced) = announced.filter(|count| *count != whole.tensors.len() as u64) {
        let found = whole.tensors.len();
        let problem = format!(
            "{announced} tensors are announced, but the {} parts have {found}: one of them is of another model",
            part.count
        );
        return Err(whole.error(TENSORS, problem));
    }
    Ok((whole, files))
}

/// The files of a model: its own, or all of its parts.
pub(super) fn part_paths(path: &Path) -> Result<Vec<PathBuf>, MllmError> {
    let (header, _) = open_header(path)?;
    match header.part()? {
        None => Ok(vec![path.to_path_buf()]),
        Some(part) => part.paths(&header),
    }
}

/// Why a part that is not the first cannot be opened by the first: that is not in the folder.
pub(super) fn lacks_first(header: &Header, part: Part) -> Option<MllmError> {
    match part.paths(header) {
        Err(error) => Some(error),
        Ok(paths) => paths
            .first()
            .filter(|first| !first.is_file())
            .map(|first| absent(header, first, part)),
    }
}

/// The names of all parts of a model, by the name of one; a name that is not of a part stands alone.
pub(crate) fn named_parts(file: &str) -> Vec<String> {
    let parsed = || {
        let (stem, ending) = file.split_at_checked(file.len().checked_sub(ENDING.len())?)?;
        let (head, count) = stem.rsplit_once("-of-")?;
        let (name, number) = head.rsplit_once('-')?;
        let is_number = |text: &str| text.len() >= 5 && text.bytes().all(|b| b.is_ascii_digit());
        if !(is_number(number) && is_number(count)) {
            return None;
        }
        let count: u64 = count.parse().ok()?;
        let part = |number: u64| format!("{name}-{number:05}-of-{count:05}{ending}");
        (1..=MAX_PARTS)
            .contains(&count)
            .then(|| (1..=count).map(part).collect())
    };
    parsed().unwrap_or_else(|| vec![file.to_owned()])
}

impl Header {
    /// The file's place among the parts of its model; none for a model in one file.
    pub(super) fn part(&self) -> Result<Option<Part>, MllmError> {
        let whole = |key: &str| self.typed(key, "a whole number", Value::as_u64);
        let Some(count) = whole(COUNT)?.filter(|count| *count > 1) else {
            return Ok(None);
        };
        if count > MAX_PARTS {
            let problem = format!("{count} parts; at most {MAX_PARTS} are supported");
            return Err(self.error(COUNT, problem));
        }
        let number = whole(NUMBER)?.unwrap_or(0);
        if number >= count {
            let problem = format!("{number} is no part of {count}, which count from 0");
            return Err(self.error(NUMBER, problem));
        }
        Ok(Some(Part {
            number: number as usize,
            count: count as usize,
        }))
    }

    /// The index of the file that has a tensor.
    pub(crate) fn part_of(&self, tensor: &str) -> usize {
        self.parts.get(tensor).copied().unwrap_or(0)
    }
}

impl Part {
    /// The paths of all parts, by the names that `gguf-split` gives them.
    fn paths(self, header: &Header) -> Result<Vec<PathBuf>, MllmError> {
        let Self { number, count } = self;
        let name = header.path.file_name().unwrap_or_default();
        let name = name.to_string_lossy();
        let own = format!("-{:05}-of-{count:05}", number + 1);
        let ending = name.len().saturating_sub(ENDING.len());
        let stem = name
            .split_at_checked(ending)
            .and_then(|(stem, ending)| Some((stem.strip_suffix(&own)?, ending)));
        let Some((stem, ending)) = stem else {
            let problem = format!(
                "this is part {} of {count}, whose name must end in {own}.gguf so that the others are found; give all parts their \
                 names back, or join them with llama-gguf-split --merge",
                number + 1
            );
            return Err(header.error(COUNT, problem));
        };
        let path = |part: usize| {
            let name = format!("{stem}-{part:05}-of-{count:05}{ending}");
            header.path.with_file_name(name)
        };
        Ok((1..=count).map(path).collect())
    }
}

/// Checks that a file is the part that its name says.
fn check_part(header: &Header, expected: Part) -> Result<(), MllmError> {
    let found = header.part()?;
    if found == Some(expected) {
        return Ok(());
    }
    let problem = match found {
        Some(Part { number, count }) => format!("the file is part {} of {count}", number + 1),
        None => "the file is no part of a model".to_owned(),
    };
    let Part { number, count } = expected;
    let problem = format!(
        "{problem}, but its name is that of part {} of {count}",
        number + 1
    );
    Err(header.error(NUMBER, problem))
}

fn absent(header: &Header, path: &Path, part: Part) -> MllmError {
    let missing = path
        .file_name()
        .expect("the path of a part ends in its name")
        .to_string_lossy();
    let problem = format!(
        "this is part {} of {}, and the part {missing} is not beside it; put all parts into one folder",
        part.number + 1,
        part.count
    );
    header.error(COUNT, problem)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_name_of_a_part_names_all_parts() {
        assert_eq!(
            named_parts("q8/m-00002-of-00003.gguf"),
            [
                "q8/m-00001-of-00003.gguf",
                "q8/m-00002-of-00003.gguf",
                "q8/m-00003-of-00003.gguf"
            ]
        );
        for alone in [
            "m.gguf",
            "m-1-of-2.gguf",
            "m-00001-of-99999.gguf",
            "m-00001-of-0000x.gguf",
            "-of-.gguf",
            "gguf",
            "é",
        ] {
            assert_eq!(named_parts(alone), [alone]);
        }
    }
}
