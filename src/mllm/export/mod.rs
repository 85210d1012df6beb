//! Export of a model as GGUF.
//!
//! A family that llama.cpp knows becomes files that llama.cpp opens too: the decoder, and the vision
//! tower with the projector where it has one. Any other model becomes one file under the canonical names of
//! its tensors. The metadata holds the small files of the model, so that opening the export gives a
//! bit-identical model.

mod plan;
pub(crate) mod tokenizer_metadata;
mod writer;

#[cfg(test)]
mod header_tests;
#[cfg(test)]
mod left_out_tests;
#[cfg(test)]
mod odd_files_tests;
#[cfg(test)]
mod pair_tests;
#[cfg(test)]
mod rope_scaling_tests;
#[cfg(test)]
pub(crate) mod round_trip_tests;
#[cfg(test)]
mod stored_format_tests;

use super::MllmError;
use super::checkpoint::{LoadReport, ModelFiles};
use super::gguf::names::ROTARY;
use super::gguf::{Description, Entries, FILE, TILED_HEADS, TOWER, WHOLE_MODEL, llama, tower_path};
use super::local::Loading;
use super::source::{Checkpoint, ModelPlace};
use super::text::{special_tokens, template_source};
use plan::{Heads, Part, Share, tower_names};
use planagent_kernels::attention::frequency_factors;
use serde_json::json;
use std::collections::BTreeMap;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use writer::{Layout, PlannedTensor};

const FILES: [&str; 8] = [
    "config.json",
    "generation_config.json",
    "preprocessor_config.json",
    "processor_config.json",
    "tokenizer.json",
    "tokenizer_config.json",
    "chat_template.jinja",
    "chat_template.json",
];

/// A file of an exported model.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GgufPart {
    /// The decoder, or the whole model.
    Model,
    /// The vision tower with the projector. It belongs beside the decoder under the name of
    /// [`GgufPart::path`].
    Tower,
}

impl GgufPart {
    /// The path of this part for a model at `model`.
    pub fn path(self, model: &Path) -> PathBuf {
        match self {
            Self::Model => model.to_path_buf(),
            Self::Tower => tower_path(model),
        }
    }
}

/// Creates the file of a part.
pub type CreateFile<'a> = dyn FnMut(GgufPart) -> io::Result<Box<dyn Write>> + 'a;

/// Writes a model as GGUF under the name `name`, its weights in the format that `loading` asks for.
/// The small files `added` (name, text) are packed with the model's own. `progress` gets the bytes
/// that are written so far, and all bytes.
pub fn export_model(
    name: &str,
    place: &ModelPlace,
    loading: &Loading,
    added: &[(String, String)],
    create: &mut CreateFile<'_>,
    progress: &mut dyn FnMut(u64, u64),
) -> Result<LoadReport, MllmError> {
    let mut checkpoint = loading.open(place)?;
    checkpoint.weights.set_whole_blocks();
    loading.check_family(&checkpoint)?;
    let tokenizer = loading.tokenizer(&checkpoint.files, checkpoint.family)?;
    let parts = parts(&mut checkpoint, &tokenizer, name, added)?;
    let total = parts
        .iter()
        .flat_map(|part| &part.layout.tensors)
        .map(PlannedTensor::bytes)
        .sum();
    let mut written = 0;
    for part in &parts {
        let failed = |source| MllmError::Write {
            what: format!("{:?}", part.kind).to_lowercase(),
            source,
        };
        let mut out = create(part.kind).map_err(failed)?;
        part.layout.write_header(&mut out).map_err(failed)?;
        // A tensor at a time, so that a model is exported in less memory than it has weights.
        part.write_data(&mut checkpoint.weights, &mut |tensor, data| {
            Layout::write_data(&mut out, data).map_err(failed)?;
            written += tensor.bytes();
            progress(written, total);
            Ok(())
        })?;
        out.flush().map_err(failed)?;
    }
    Ok(checkpoint.weights.report().clone())
}

/// The small files of a model by name: configurations, tokenizer and chat template, also those that
/// are made from the metadata of a GGUF file or of a shape.
///
/// # Errors
/// When the model cannot be opened.
pub fn small_files(
    place: &ModelPlace,
    loading: &Loading,
) -> Result<BTreeMap<String, String>, MllmError> {
    let checkpoint = loading.open(place)?;
    let tokenizer = loading.tokenizer(&checkpoint.files, checkpoint.family)?;
    Ok(texts(&checkpoint.files, &tokenizer)?.into_iter().collect())
}

fn parts(
    checkpoint: &mut Checkpoint,
    tokenizer: &ModelFiles,
    name: &str,
    added: &[(String, String)],
) -> Result<Vec<Part>, MllmError> {
    let files = &checkpoint.files;
    let mut packed = packed_files(files, tokenizer)?;
    packed.extend(
        added
            .iter()
            .map(|(name, text)| (format!("{FILE}{name}"), json!(text))),
    );
    let family = checkpoint.family.family();
    let general = |architecture: &str| {
        vec![
            ("general.architecture".to_string(), json!(architecture)),
            ("general.name".to_string(), json!(name)),
            // GGML_QNT_VERSION: the layout of quantized blocks.
            ("general.quantization_version".to_string(), json!(2)),
        ]
    };
    let text = (family.decoder_config)(files)?;
    let described = match family.gguf {
        Ok(layout) => layout
            .metadata(files)?
            .map(|description| (layout, description)),
        Err(lacking) => Err(lacking),
    };
    let (layout, description) = match described {
        Ok(described) => described,
        Err(lacking) => {
            checkpoint.weights.note(format!(
                "no pair for llama.cpp is written ({lacking}): the file is for this program alone"
            ));
            let mut metadata = [general(WHOLE_MODEL), packed].concat();
            if checkpoint.weights.heads_are_tiled() {
                metadata.push((TILED_HEADS.to_owned(), json!(true)));
            }
            let mut part = Part::new(GgufPart::Model, metadata);
            part.plan(&checkpoint.weights, |name, _| {
                vec![(name.to_owned(), Share::Whole)]
            });
            // A file for this program holds norms as a folder does.
            if checkpoint.weights.norms_have_one() {
                part.norm_offset = -1.0;
            }
            return Ok(vec![part]);
        }
    };
    let Description {
        architecture,
        decoder,
        tower,
    } = description;
    let factors = frequency_factors(&text.rope, text.rotated);
    if let Some(factors) = factors.filter(|_| !checkpoint.weights.contains(ROTARY.1)) {
        checkpoint.weights.add_numbers(ROTARY.1, &factors)?;
    }
    let mut metadata = [general(architecture), decoder].concat();
    let json = tokenizer.required_json("tokenizer.json")?;
    match tokenizer_metadata::metadata(&json, &special_tokens(tokenizer)?, text.vocabulary) {
        Some(tokens) => metadata.extend(tokens),
        None => checkpoint
            .weights
            .note("llama.cpp has no tokenizer of this kind: it will not open the decoder".into()),
    }
    if let Some(template) = template_source(files)? {
        metadata.push(("tokenizer.chat_template".to_owned(), json!(template)));
    }
    metadata.extend(packed);
    let is_tower = |name: &str| {
        name.starts_with("v.") || name.starts_with("mm.") || name.starts_with("model.")
    };
    // What llama.cpp adds to norms, if the checkpoint has them without it.
    let norm_offset = if layout.norms_have_one() && !checkpoint.weights.norms_have_one() {
        1.0
    } else {
        0.0
    };
    let mut model = Part::new(GgufPart::Model, metadata);
    model.norm_offset = norm_offset;
    model.heads = (architecture == llama::ARCHITECTURE).then_some(Heads {
        queries: text.heads,
        keys: text.kv_heads,
    });
    model.plan(&checkpoint.weights, |name, _| {
        let name = layout.gguf_name(name).filter(|name| !is_tower(name));
        name.map(|name| (name, Share::Whole)).into_iter().collect()
    });
    let mut parts = vec![model];
    if let Some(tower) = tower {
        let metadata = [general(TOWER), tower.metadata.clone()].concat();
        let mut part = Part::new(GgufPart::Tower, metadata);
        part.norm_offset = norm_offset;
        part.plan(&checkpoint.weights, |name, shape| {
            let mut names = tower_names(layout, &tower, name, shape);
            names.retain(|(name, _)| is_tower(name));
            names
        });
        parts.push(part);
    }
    Ok(parts)
}

fn packed_files(files: &ModelFiles, tokenizer: &ModelFiles) -> Result<Entries, MllmError> {
    let entry = |(name, text)| (format!("{FILE}{name}"), json!(text));
    Ok(texts(files, tokenizer)?.into_iter().map(entry).collect())
}

fn texts(files: &ModelFiles, tokenizer: &ModelFiles) -> Result<Vec<(String, String)>, MllmError> {
    let mut texts = Vec::new();
    for name in FILES {
        let source = if name.starts_with("tokenizer") {
            tokenizer
        } else {
            files
        };
        if let Some(text) = source.text(name)? {
            texts.push((name.to_owned(), text));
        }
    }
    Ok(texts)
}
