//! GGUF files: llama.cpp's decoders with their vision towers ("mmproj"), and what this program writes.
//!
//! A file that this program wrote has the small files of the model in its metadata and is opened by these. Of llama.cpp's
//! files, configuration, tokenizer and preprocessor are made of the metadata, so that the families of models read the same
//! JSON whatever the weights lie in.

mod clip;
mod export;
mod header;
mod llama;
mod metadata;
mod names;
mod template;
mod tokenizer;
mod tokenizer_metadata;
mod value;
mod writer;

#[cfg(test)]
mod header_tests;
#[cfg(test)]
mod round_trip_tests;
#[cfg(test)]
mod tokenizer_tests;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde_json::json;

pub(crate) use export::export;
pub use export::{CreateFile, GgufPart};
use header::Header;

use super::MllmError;
use super::checkpoint::{
    Checkpoint, FileKind, ModelFiles, RowOrder, TensorPlace, WeightFile, WeightFormatPlan, Weights, read_json,
};
use super::llava::IMAGE_TOKEN_BEYOND;
use super::matrix::WeightFormat;

/// Key of a small file of the model, before its name.
const FILE: &str = "planagent.file.";
/// The architecture of files that hold a whole model under its canonical names.
const WHOLE_MODEL: &str = "planagent";
/// The tokenizer, which a user may put beside a GGUF file to replace the one in its metadata.
const TOKENIZER: &str = "tokenizer.json";
/// Other files that may be put beside it.
const BESIDE: [&str; 2] = ["tokenizer_config.json", TEMPLATE];
/// The chat template.
const TEMPLATE: &str = "chat_template.jinja";

/// Opens a model: its decoder, and its vision tower, by default the one that lies beside it.
///
/// # Errors
/// When a file is missing, broken, or not of a supported kind.
pub(crate) fn open(
    model: &Path,
    mmproj: Option<&Path>,
    quantize: Option<WeightFormat>,
) -> Result<Checkpoint, MllmError> {
    let (header, file) = open_header(model)?;
    let architecture = header.architecture()?.to_string();
    if header.count("split.count")?.is_some_and(|parts| parts > 1) {
        return Err(header
            .error("split.count", "a model in several files is not read; join them with llama-gguf-split --merge"));
    }
    let plan = WeightFormatPlan { quantize, kind: FileKind::Gguf, tied: true };
    let mut weights = Weights::empty(model, plan);
    match architecture.as_str() {
        WHOLE_MODEL => {
            let index = weights.add_file(file);
            for (name, place) in &header.tensors {
                weights.add(name.clone(), index, name.clone(), place.clone(), RowOrder::Plain)?;
            }
            Ok(Checkpoint { files: ModelFiles::packed(model, packed_files(&header)?), weights })
        }
        llama::ARCHITECTURE => {
            let beside = mmproj.map_or_else(|| tower_beside(model), |mmproj| Ok(mmproj.to_path_buf()))?;
            let (tower, tower_file) = open_header(&beside)?;
            if tower.architecture()? != clip::ARCHITECTURE {
                return Err(tower.error("general.architecture", "this is no vision tower (clip)"));
            }
            let mut notes = Vec::new();
            let mut texts = packed_files(&header)?;
            if texts.is_empty() {
                texts = made_files(&header, &tower, &mut notes)?;
            }
            let mut files = ModelFiles::packed(model, texts);
            files.prefer(model.parent().unwrap_or(Path::new("")), &BESIDE)?;
            add_tensors(&mut weights, &header, file)?;
            add_tensors(&mut weights, &tower, tower_file)?;
            for note in notes {
                weights.note(note);
            }
            Ok(Checkpoint { files, weights })
        }
        clip::ARCHITECTURE => Err(header.error(
            "general.architecture",
            "this is a vision tower (mmproj); name the file of the decoder, beside which it is found",
        )),
        other => Err(header.error(
            "general.architecture",
            format!("{other:?} is not supported; LLaVA's decoder is {:?}", llama::ARCHITECTURE),
        )),
    }
}

/// The files of a model: the whole of it, or decoder and vision tower.
///
/// # Errors
/// When one is missing or broken.
pub(crate) fn files(model: &Path, mmproj: Option<&Path>) -> Result<Vec<PathBuf>, MllmError> {
    let (header, _) = open_header(model)?;
    let mut files = vec![model.to_path_buf()];
    if header.architecture()? != WHOLE_MODEL {
        files.push(mmproj.map_or_else(|| tower_beside(model), |mmproj| Ok(mmproj.to_path_buf()))?);
    }
    Ok(files)
}

/// The decoder (or whole model) among a folder's GGUF files; none if it has no such file.
///
/// # Errors
/// When there are several, or a file is broken.
pub(crate) fn find(folder: &Path) -> Result<Option<PathBuf>, MllmError> {
    let models = files_of(folder, |architecture| architecture != clip::ARCHITECTURE)?;
    match models.as_slice() {
        [] => Ok(None),
        [model] => Ok(Some(model.clone())),
        several => Err(several_files(folder, "models", several, "name one of them")),
    }
}

fn open_header(path: &Path) -> Result<(Header, WeightFile), MllmError> {
    let file = WeightFile::open(path)?;
    let header = Header::read(path, &mut file.reader()?, file.len())?;
    Ok((header, file))
}

/// The vision tower in the folder of a decoder: the one that is named after it, else the only one.
fn tower_beside(model: &Path) -> Result<PathBuf, MllmError> {
    let named = export::tower_path(model);
    if named.is_file() {
        return Ok(named);
    }
    let folder = model.parent().unwrap_or(Path::new(""));
    let towers = files_of(folder, |architecture| architecture == clip::ARCHITECTURE)?;
    match towers.as_slice() {
        [] => Err(MllmError::MissingFile {
            folder: folder.to_path_buf(),
            file: "vision tower (a GGUF file of architecture clip, \"mmproj\"); put it beside the decoder, or name it under \
                   mmproj in the model's description"
                .into(),
        }),
        [tower] => Ok(tower.clone()),
        several => {
            Err(several_files(folder, "vision towers", several, "name one under mmproj in the model's description"))
        }
    }
}

fn several_files(folder: &Path, what: &str, files: &[PathBuf], hint: &str) -> MllmError {
    let names: Vec<_> = files.iter().filter_map(|file| file.file_name()).map(|name| name.to_string_lossy()).collect();
    MllmError::MissingFile {
        folder: folder.to_path_buf(),
        file: format!("single GGUF file to open: there are several {what} ({}); {hint}", names.join(", ")),
    }
}

/// The GGUF files of a folder whose architecture is wanted, sorted.
fn files_of(folder: &Path, wanted: impl Fn(&str) -> bool) -> Result<Vec<PathBuf>, MllmError> {
    let listed = if folder.as_os_str().is_empty() { Path::new(".") } else { folder };
    let failed = |source| MllmError::Read { path: listed.to_path_buf(), source };
    let mut found = Vec::new();
    for entry in std::fs::read_dir(listed).map_err(failed)? {
        let name = entry.map_err(failed)?.file_name();
        let path = folder.join(&name);
        if path.extension().is_some_and(|extension| extension == "gguf")
            && wanted(open_header(&path)?.0.architecture()?)
        {
            found.push(path);
        }
    }
    found.sort();
    Ok(found)
}

/// The small files that the metadata holds, by name.
fn packed_files(header: &Header) -> Result<BTreeMap<String, String>, MllmError> {
    header
        .metadata
        .keys()
        .filter_map(|key| key.strip_prefix(FILE))
        .map(|name| {
            let text = header.text(&format!("{FILE}{name}"))?.unwrap_or_default();
            Ok((name.to_string(), text.to_string()))
        })
        .collect()
}

/// What stands for the small files of a model of llama.cpp.
fn made_files(header: &Header, tower: &Header, notes: &mut Vec<String>) -> Result<BTreeMap<String, String>, MllmError> {
    let text = llama::text_config(header)?;
    let vocabulary = text["vocab_size"].as_u64().unwrap_or_default() as usize;
    let (mut config, note) = clip::config(tower)?;
    notes.extend(note);
    config["tie_word_embeddings"] = text["tie_word_embeddings"].clone();
    config["text_config"] = text;
    let mut files = BTreeMap::new();
    let mut put = |name: &str, value: &serde_json::Value| files.insert(name.to_string(), value.to_string());
    let beside = header.path.with_file_name(TOKENIZER);
    let mut tokenizer = if beside.is_file() {
        read_json(&beside)?
    } else {
        let read = tokenizer::read(header, vocabulary)?;
        put("tokenizer_config.json", &read.config);
        if let Some(eos) = read.eos {
            put("generation_config.json", &json!({"eos_token_id": eos}));
        }
        read.tokenizer
    };
    let image = tokenizer::image_token(&mut tokenizer)
        .map_err(|problem| MllmError::Tokenizer { path: beside, problem: problem.into() })?;
    if image == vocabulary as u64 {
        config[IMAGE_TOKEN_BEYOND] = json!(true);
    } else {
        config["image_token_index"] = json!(image);
    }
    put(TOKENIZER, &tokenizer);
    put("config.json", &config);
    put("preprocessor_config.json", &clip::preprocessor(tower)?);
    if header.path.with_file_name(TEMPLATE).is_file() {
        return Ok(files);
    }
    let template = if let Some(template) = header.text("tokenizer.chat_template")? {
        template
    } else {
        let file = header.path.file_stem().unwrap_or_default().to_string_lossy();
        let name = header.text("general.name")?.unwrap_or(&file);
        let (template, called) = template::by_name(name);
        notes.push(format!(
            "the file has no chat template; {called}'s form of a chat is taken, by the name {name:?} (a {TEMPLATE} beside the \
             file replaces it)"
        ));
        template
    };
    files.insert(TEMPLATE.to_string(), template.to_string());
    Ok(files)
}

/// Adds the tensors of a file of llama.cpp under their canonical names.
fn add_tensors(weights: &mut Weights, header: &Header, file: WeightFile) -> Result<(), MllmError> {
    let index = weights.add_file(file);
    let hidden = header.count("clip.vision.embedding_length")?;
    for (name, place) in &header.tensors {
        let Some(canonical) = names::to_canonical(name) else {
            weights.note(format!("{}: tensor {name} is not used", header.path.display()));
            continue;
        };
        let rows = row_order(header, name, place)?;
        weights.add(unswapped(header, canonical, hidden), index, name.clone(), place.clone(), rows)?;
    }
    Ok(())
}

/// llama.cpp has the rows of queries and keys in pairs.
fn row_order(header: &Header, name: &str, place: &TensorPlace) -> Result<RowOrder, MllmError> {
    const HEADS: &str = "llama.attention.head_count";
    const KEY_HEADS: &str = "llama.attention.head_count_kv";
    let key = match name.strip_prefix("blk.").and_then(|rest| rest.split('.').nth(1)) {
        Some("attn_k") if header.metadata.contains_key(KEY_HEADS) => KEY_HEADS,
        Some("attn_q" | "attn_k") => HEADS,
        _ => return Ok(RowOrder::Plain),
    };
    let heads = header.required_count(key)?;
    let rows = place.shape.first().copied().unwrap_or_default();
    if rows.is_multiple_of(2 * heads) {
        return Ok(RowOrder::Paired { heads });
    }
    Err(header.error(key, format!("the {rows} rows of {name} are no {heads} heads of whole pairs")))
}

/// llama.cpp's older converter calls the first layer of the tower's feed-forward part `ffn_down` and the second `ffn_up`.
/// The widths tell: the first takes the hidden states.
fn unswapped(header: &Header, canonical: String, hidden: Option<usize>) -> String {
    let Some(layer) = canonical.strip_prefix("vision_tower.encoder.layers.").and_then(|rest| rest.split('.').next())
    else {
        return canonical;
    };
    let down = header.tensors.get(&format!("v.blk.{layer}.ffn_down.weight"));
    let swapped = down.is_some_and(|place| place.shape.get(1).copied() == hidden);
    match canonical.split_once(".mlp.fc") {
        Some((before, "1.weight")) if swapped => format!("{before}.mlp.fc2.weight"),
        Some((before, "2.weight")) if swapped => format!("{before}.mlp.fc1.weight"),
        Some((before, "1.bias")) if swapped => format!("{before}.mlp.fc2.bias"),
        Some((before, "2.bias")) if swapped => format!("{before}.mlp.fc1.bias"),
        _ => canonical,
    }
}
