//! GGUF files: their container, the metadata of llama.cpp's `llama` decoders and tokenizers, and
//! which files belong together.
//!
//! A file that this program wrote has the small files of the model in its metadata and is opened by
//! these. For a file of llama.cpp, the model's family makes the small files from the metadata
//! ([`GgufLayout`]), so that it reads the same JSON whatever the weights lie in.

pub(crate) mod byte_level;
pub(crate) mod decoder;
pub(crate) mod gemma;
pub(crate) mod gemma3n;
pub(crate) mod gemma4;
mod header;
pub(crate) mod lfm2;
pub(crate) mod llama;
mod metadata;
pub(crate) mod names;
mod pair;
mod parts;
pub(crate) mod qwen35;
mod text_files;
pub(crate) mod tokenizer;
pub(crate) mod unread_keys;
mod vision_marks;

#[cfg(test)]
pub(crate) mod tokenizer_tests;

pub use header::Header;
pub(crate) use header::{DEFAULT_ALIGNMENT, number_of};
pub(crate) use pair::{
    Changed, PairLayout, VisionFiles, Written, as_stored, tower_metadata, tower_with_activation,
};
pub(crate) use parts::{named_parts, open_model};
pub(crate) use text_files::TextFiles;

use super::MllmError;
use super::checkpoint::{ModelFiles, RowOrder, TensorPlace, WeightFile};
use serde_json::Value;
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Key of a small file of the model, before its name.
pub(crate) const FILE: &str = "planagent.file.";
/// The architecture of files that hold a whole model under its canonical names.
pub(crate) const WHOLE_MODEL: &str = "planagent";
/// Key of such a file whose value heads lie as llama.cpp has them
/// ([`GgufLayout::heads_are_tiled`]).
pub(crate) const TILED_HEADS: &str = "planagent.tiled_heads";
/// The architecture of a vision tower ("mmproj").
pub(crate) const TOWER: &str = "clip";
/// The tokenizer, which a user may put beside a GGUF file to replace the one in its metadata.
pub(crate) const TOKENIZER: &str = "tokenizer.json";
/// The chat template, which a user may put beside it too.
pub(crate) const TEMPLATE: &str = "chat_template.jinja";

/// Metadata keys with their values. Floats are of 32 bits in a file.
pub(crate) type Entries = Vec<(String, Value)>;

/// How llama.cpp's files hold a model family: a decoder, and a vision tower beside it where the
/// family has one.
pub trait GgufLayout: Sync {
    /// Whether a decoder and a tower, or a decoder alone, belong to the family.
    fn opens(&self, decoder: &Header, tower: Option<&Header>) -> bool;

    /// The small files of the model, by name, made from the metadata. A note says what the files
    /// leave open.
    fn small_files(
        &self,
        decoder: &Header,
        tower: Option<&Header>,
        notes: &mut Vec<String>,
    ) -> Result<BTreeMap<String, String>, MllmError>;

    /// The canonical name of a tensor of a file; none if the family has no such tensor.
    fn canonical_name(&self, file: &Header, name: &str) -> Result<Option<String>, MllmError>;

    /// llama.cpp's name of a canonical tensor; none if the format has no such tensor.
    fn gguf_name(&self, canonical: &str) -> Option<String>;

    /// Whether llama.cpp stores the weights of the decoder's norms with 1 added.
    fn norms_have_one(&self) -> bool {
        false
    }

    /// Whether llama.cpp stores the value heads of a key apart, in layers with a delta rule.
    fn heads_are_tiled(&self) -> bool {
        false
    }

    /// Whether a tower's file has as many layers (`v.blk.N.`) as its metadata say.
    fn tower_says_its_layers(&self) -> bool {
        true
    }

    /// The metadata for a model with these files, or the part that the format has no key for.
    fn metadata(&self, files: &ModelFiles) -> Result<Result<Description, &'static str>, MllmError>;
}

/// What files of llama.cpp say of a model; or the part that the format has no key for.
pub(crate) type Described = Result<Description, &'static str>;

/// What files of llama.cpp say of a model.
pub struct Description {
    /// The decoder's `general.architecture`.
    pub architecture: &'static str,
    /// Its other metadata.
    pub decoder: Entries,
    /// The vision tower, for a model that has one.
    pub tower: Option<TowerDescription>,
}

/// What a file of llama.cpp says of a vision tower, and how it holds the tensors.
pub struct TowerDescription {
    pub metadata: Entries,
    /// Whether the projections to queries, keys and values are one tensor or three, whatever a
    /// checkpoint has; none where they are written as it has them.
    pub fused: Option<bool>,
    /// The tower's layer by which a merger of an early layer is counted, at its own number.
    pub deep_layers: Vec<usize>,
}

impl TowerDescription {
    /// A tower whose file has the tensors as its checkpoint.
    pub(crate) fn plain(metadata: Entries) -> Self {
        Self {
            metadata,
            fused: None,
            deep_layers: Vec::new(),
        }
    }

    /// A tower whose file has projections to queries, keys and values apart.
    pub(crate) fn apart(metadata: Entries) -> Self {
        Self {
            fused: Some(false),
            ..Self::plain(metadata)
        }
    }
}

pub(crate) fn open_header(path: &Path) -> Result<(Header, WeightFile), MllmError> {
    let file = WeightFile::open(path)?;
    let header = Header::read(path, &mut file.reader()?, file.len())?;
    Ok((header, file))
}

/// The files of a model: the whole of it, or decoder and vision tower.
pub(crate) fn files(model: &Path, mmproj: Option<&Path>) -> Result<Vec<PathBuf>, MllmError> {
    let (header, _) = open_model(model)?;
    let mut files = parts::part_paths(model)?;
    if header.architecture()? != WHOLE_MODEL {
        files.extend(tower_for(&header, mmproj)?);
    }
    Ok(files)
}

/// The files of a decoder alone.
pub(crate) fn decoder_files(model: &Path) -> Result<Vec<PathBuf>, MllmError> {
    parts::part_paths(model)
}

/// The vision tower of a decoder: the named one, else the one that lies beside it. None for a
/// decoder without one.
///
/// # Errors
/// When there is none, and the decoder shows itself as part of a vision model: it must not become a
/// language model in silence.
pub(crate) fn tower_for(
    decoder: &Header,
    mmproj: Option<&Path>,
) -> Result<Option<PathBuf>, MllmError> {
    if let Some(named) = mmproj {
        return Ok(Some(named.to_path_buf()));
    }
    let beside = tower_beside(&decoder.path)?;
    match vision_marks::find(decoder)? {
        Some(mark) if beside.is_none() => Err(no_tower(decoder, &mark)),
        _ => Ok(beside),
    }
}

/// Whether these are files of a decoder of one of these architectures, and of a tower with this kind
/// of projector.
pub(crate) fn is_pair(
    decoder: &Header,
    tower: Option<&Header>,
    architectures: &[&str],
    projector: &str,
) -> bool {
    let found = tower.and_then(|tower| tower.projector().ok().flatten());
    let is_decoder = decoder
        .architecture()
        .is_ok_and(|decoder| architectures.contains(&decoder));
    is_decoder && found == Some(projector)
}

/// The error of a decoder that needs a tower and has none.
pub(crate) fn no_tower(decoder: &Header, mark: &str) -> MllmError {
    MllmError::MissingFile {
        folder: folder_of(&decoder.path).to_path_buf(),
        file: format!(
            "vision tower (a GGUF file of architecture clip, 'mmproj') for {}, which is part of a vision model by {mark}; put it \
             beside the decoder, or name it under mmproj in the model's description; `vision = false` there opens the decoder \
             alone, as a language model that sees nothing",
            file_name(&decoder.path)
        ),
    }
}

/// The folder of a file; that of the process for a name alone.
fn folder_of(file: &Path) -> &Path {
    file.parent()
        .filter(|folder| !folder.as_os_str().is_empty())
        .unwrap_or(Path::new("."))
}

/// The name of a file; empty for a path that ends in none.
fn file_name(path: &Path) -> Cow<'_, str> {
    path.file_name().unwrap_or_default().to_string_lossy()
}

/// The decoder (or whole model) among a folder's GGUF files; none if it has no such file.
pub(crate) fn find(folder: &Path) -> Result<Option<PathBuf>, MllmError> {
    let (models, unreadable) = files_of(folder, |architecture| architecture != TOWER)?;
    match models.as_slice() {
        [] if unreadable.is_empty() => match files_of(folder, |_| true)?.0.first() {
            Some(tower) if !folder.join("config.json").is_file() => Err(MllmError::MissingFile {
                folder: folder.to_path_buf(),
                file: format!(
                    "decoder, only a vision tower ({}); put the GGUF file of the language model beside it",
                    file_name(tower)
                ),
            }),
            _ => Ok(None),
        },
        [] => all_of(folder, unreadable).map_or(Ok(None), Err),
        [model] => Ok(Some(model.clone())),
        several => Err(several_files(folder, "models", several, "name one of them")),
    }
}

/// Where a vision tower is looked for first, and written to.
pub(crate) fn tower_path(model: &Path) -> PathBuf {
    model.with_file_name(format!("mmproj-{}", file_name(model)))
}

/// The vision tower in the folder of a decoder: the one that is named after it, else the only one.
/// None if there is none.
///
/// # Errors
/// When there are several, or the only file that is named as one cannot be read.
pub(crate) fn tower_beside(model: &Path) -> Result<Option<PathBuf>, MllmError> {
    let named = tower_path(model);
    if named.is_file() {
        return Ok(Some(named));
    }
    let folder = folder_of(model);
    let (towers, unreadable) = files_of(folder, |architecture| architecture == TOWER)?;
    let is_named_so = |path: &Path| {
        let name = file_name(path);
        name.to_ascii_lowercase().contains("mmproj")
    };
    match towers.as_slice() {
        [] => {
            let mut broken = unreadable.into_iter();
            let tower = broken.find(|(path, _)| is_named_so(path));
            tower.map_or(Ok(None), |(_, error)| Err(error))
        }
        [tower] => Ok(Some(tower.clone())),
        several => {
            if let Some(best) = best_of_one(several) {
                return Ok(Some(best.to_path_buf()));
            }
            let hint = format!(
                "rename one to {}, or name it under mmproj in the model's description",
                named.display()
            );
            Err(several_files(folder, "vision towers", several, &hint))
        }
    }
}

/// Weight formats of towers, the wanted one first, as llama.cpp prefers them.
pub(crate) const TOWER_FORMATS: [&str; 4] = ["f16", "bf16", "f32", "q8_0"];

/// Of towers that differ in their weight format alone, as repositories of quantizers have them, the
/// one in the best of the usual formats.
fn best_of_one(towers: &[PathBuf]) -> Option<&Path> {
    /// A name without its format, and the place of the format in the order of preference.
    fn split(name: &str) -> Option<(String, usize)> {
        let parts: Vec<&str> = name.split(['-', '.']).collect();
        let mut numbered = parts.iter().enumerate();
        let (at, part) = numbered.find(|(_, part)| TOWER_FORMATS.contains(*part))?;
        let place = TOWER_FORMATS.iter().position(|format| format == part)?;
        let rest = parts.iter().enumerate().filter(|(other, _)| *other != at);
        let rest: Vec<&str> = rest.map(|(_, part)| *part).collect();
        Some((rest.join("-"), place))
    }
    let named = |tower: &PathBuf| split(&file_name(tower).to_ascii_lowercase());
    let split: Option<Vec<(String, usize)>> = towers.iter().map(named).collect();
    let split = split?;
    let (first, _) = split.first()?;
    if split.iter().any(|(rest, _)| rest != first) {
        return None;
    }
    let best = split
        .iter()
        .zip(towers)
        .min_by_key(|((_, place), _)| *place);
    best.map(|(_, tower)| tower.as_path())
}

fn several_files(folder: &Path, what: &str, files: &[PathBuf], hint: &str) -> MllmError {
    let names: Vec<_> = files
        .iter()
        .filter_map(|file| file.file_name())
        .map(|name| name.to_string_lossy())
        .collect();
    MllmError::MissingFile {
        folder: folder.to_path_buf(),
        file: format!(
            "single GGUF file to open: there are several {what} ({}); {hint}",
            names.join(", ")
        ),
    }
}

/// A file that is no model, and what is wrong with it.
type Unreadable = (PathBuf, MllmError);

/// The GGUF files of a folder whose architecture is wanted, sorted, and those that are no model:
/// importance matrices, parts of split models, broken downloads. They do not hide a model beside
/// them.
fn files_of(
    folder: &Path,
    wanted: impl Fn(&str) -> bool,
) -> Result<(Vec<PathBuf>, Vec<Unreadable>), MllmError> {
    let failed = |source| MllmError::Read {
        path: folder.to_path_buf(),
        source,
    };
    let (mut found, mut unreadable) = (Vec::new(), Vec::new());
    let paths = std::fs::read_dir(folder)
        .map_err(failed)?
        .map(|entry| Ok(folder.join(entry?.file_name())));
    let mut paths = paths.collect::<Result<Vec<_>, _>>().map_err(failed)?;
    paths.retain(|path| is_gguf(path));
    paths.sort();
    for path in paths {
        match is_first_of(&path, &wanted) {
            Ok(true) => found.push(path),
            Ok(false) => {}
            Err(error) => unreadable.push((path, error)),
        }
    }
    Ok((found, unreadable))
}

/// Whether a file is a model of a wanted architecture, or the first part of one. Later parts belong
/// to the first.
fn is_first_of(path: &Path, wanted: impl Fn(&str) -> bool) -> Result<bool, MllmError> {
    let (header, _) = open_header(path)?;
    match header.part()?.filter(|part| part.number > 0) {
        None => Ok(wanted(header.architecture()?)),
        Some(part) => parts::lacks_first(&header, part).map_or(Ok(false), Err),
    }
}

/// Whether a file is one by its name. The file that macOS writes beside each on other disks
/// (`._NAME`) is none.
fn is_gguf(path: &Path) -> bool {
    let hidden = path
        .file_name()
        .is_some_and(|name| name.to_string_lossy().starts_with("._"));
    !hidden
        && path
            .extension()
            .is_some_and(|ending| ending.eq_ignore_ascii_case("gguf"))
        && path.is_file()
}

/// One error that tells several.
fn all_of(folder: &Path, unreadable: Vec<Unreadable>) -> Option<MllmError> {
    match unreadable.len() {
        0 | 1 => unreadable.into_iter().map(|(_, error)| error).next(),
        _ => {
            let told: Vec<String> = unreadable
                .iter()
                .map(|(_, error)| error.to_string())
                .collect();
            Some(MllmError::MissingFile {
                folder: folder.to_path_buf(),
                file: format!("GGUF file that is a model: {}", told.join("; ")),
            })
        }
    }
}

/// The small files that the metadata holds, by name.
pub(crate) fn packed_files(header: &Header) -> Result<BTreeMap<String, String>, MllmError> {
    header
        .metadata
        .keys()
        .filter_map(|key| key.strip_prefix(FILE))
        .map(|name| {
            let text = header
                .text(&format!("{FILE}{name}"))?
                .expect("the name is from a key of the metadata");
            Ok((name.to_string(), text.to_string()))
        })
        .collect()
}

/// How a file has the rows of a tensor: llama.cpp writes those of a `llama`'s queries and keys in
/// pairs.
pub(crate) fn row_order(
    header: &Header,
    name: &str,
    place: &TensorPlace,
) -> Result<RowOrder, MllmError> {
    const HEADS: &str = "llama.attention.head_count";
    const KEY_HEADS: &str = "llama.attention.head_count_kv";
    if header.architecture()? != llama::ARCHITECTURE {
        return Ok(RowOrder::Plain);
    }
    let key = match llama::projection(name) {
        Some("attn_k") if header.metadata.contains_key(KEY_HEADS) => KEY_HEADS,
        Some("attn_q" | "attn_k") => HEADS,
        _ => return Ok(RowOrder::Plain),
    };
    let heads = header.required_count(key)?;
    let rows = place
        .shape
        .first()
        .copied()
        .expect("the header refuses tensors without dimensions");
    if rows.is_multiple_of(2 * heads) {
        return Ok(RowOrder::Paired { heads });
    }
    Err(header.error(
        key,
        format!("the {rows} rows of {name} are no {heads} heads of whole pairs"),
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_towers_that_differ_in_their_format_one_is_taken() {
        let best = |names: &[&str]| {
            let towers: Vec<PathBuf> = names.iter().map(PathBuf::from).collect();
            best_of_one(&towers).map(|best| best.to_string_lossy().into_owned())
        };
        for (names, expected) in [
            (
                &["mmproj-BF16.gguf", "mmproj-F16.gguf", "mmproj-F32.gguf"][..],
                Some("mmproj-F16.gguf"),
            ),
            (
                &["mmproj-a-Q8_0.gguf", "mmproj-a-BF16.gguf"],
                Some("mmproj-a-BF16.gguf"),
            ),
            (
                &["a.mmproj-f32.gguf", "a.mmproj-q8_0.gguf"],
                Some("a.mmproj-f32.gguf"),
            ),
            (&["mmproj-a-F16.gguf", "mmproj-b-F16.gguf"], None),
            (&["mmproj-a.gguf", "mmproj-a-F16.gguf"], None),
            (&["one.gguf", "two.gguf"], None),
        ] {
            assert_eq!(best(names).as_deref(), expected, "{names:?}");
        }
    }
}
