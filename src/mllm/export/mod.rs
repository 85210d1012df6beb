//! Export of a model as GGUF.
//!
//! A family that llama.cpp knows becomes files that llama.cpp opens too: the decoder, and the vision
//! tower with the projector where it has one. Any other model becomes one file under the canonical names of
//! its tensors. The metadata holds the small files of the model, so that opening the export gives a
//! bit-identical model.

pub(crate) mod tokenizer_metadata;
mod writer;

#[cfg(test)]
mod header_tests;
#[cfg(test)]
mod left_out_tests;
#[cfg(test)]
mod odd_files_tests;
#[cfg(test)]
mod rope_scaling_tests;
#[cfg(test)]
pub(crate) mod round_trip_tests;
#[cfg(test)]
mod stored_format_tests;

use super::MllmError;
use super::checkpoint::{
    LoadReport, ModelFiles, Weights, is_kernel, is_matrix, may_add_one, paired,
};
use super::gguf::names::ROTARY;
use super::gguf::{Entries, FILE, TILED_HEADS, TOWER, WHOLE_MODEL, llama, tower_path};
use super::local::Loading;
use super::source::{Checkpoint, ModelPlace};
use super::text::special_tokens;
use planagent_kernels::attention::frequency_factors;
use planagent_kernels::matrix::WeightFormat;
use serde_json::json;
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
        for (tensor, canonical) in part.layout.tensors.iter().zip(&part.canonical) {
            let data = data(&mut checkpoint.weights, canonical, tensor, part.norm_offset)?;
            let data = match part
                .heads
                .as_ref()
                .and_then(|heads| heads.for_tensor(&tensor.name))
            {
                Some(heads) => paired(&data, tensor.shape.first().copied().unwrap_or(1), heads),
                None => data,
            };
            Layout::write_data(&mut out, &data).map_err(failed)?;
            written += tensor.bytes();
            progress(written, total);
        }
        out.flush().map_err(failed)?;
    }
    Ok(checkpoint.weights.report().clone())
}

/// One file with the canonical names of its tensors.
struct Part {
    kind: GgufPart,
    layout: Layout,
    canonical: Vec<String>,
    /// Whether rows of queries and keys are written in pairs.
    heads: Option<Heads>,
    /// What is added to the weights of norms.
    norm_offset: f32,
}

/// Heads of queries and of keys.
#[derive(Clone, Copy)]
struct Heads {
    queries: usize,
    keys: usize,
}

impl Heads {
    /// The heads of a tensor, by llama.cpp's name, if it makes queries or keys.
    fn for_tensor(self, name: &str) -> Option<usize> {
        match llama::projection(name)? {
            "attn_q" => Some(self.queries),
            "attn_k" => Some(self.keys),
            _ => None,
        }
    }
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
        Ok(layout) => layout.metadata(files)?.map(|metadata| (layout, metadata)),
        Err(lacking) => Err(lacking),
    };
    let (layout, (architecture, decoder, tower)) = match described {
        Ok(described) => described,
        Err(lacking) => {
            checkpoint.weights.note(format!(
                "llama.cpp's format has no place for {lacking}: the file is for this program alone"
            ));
            let mut file = Layout {
                metadata: [general(WHOLE_MODEL), packed].concat(),
                tensors: Vec::new(),
            };
            if checkpoint.weights.heads_are_tiled() {
                file.metadata.push((TILED_HEADS.to_owned(), json!(true)));
            }
            let canonical = plan_tensors(&checkpoint.weights, &mut file, |name| {
                Some(name.to_string())
            });
            // A file for this program holds norms as a folder does.
            let has_one = checkpoint.weights.norms_have_one();
            return Ok(vec![Part {
                kind: GgufPart::Model,
                layout: file,
                canonical,
                heads: None,
                norm_offset: if has_one { -1.0 } else { 0.0 },
            }]);
        }
    };
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
    metadata.extend(packed);
    let mut model = Layout {
        metadata,
        tensors: Vec::new(),
    };
    let is_tower = |name: &str| {
        name.starts_with("v.") || name.starts_with("mm.") || name.starts_with("model.")
    };
    let wanted = |tower: bool| {
        move |name: &str| {
            layout
                .gguf_name(name)
                .filter(|name| is_tower(name) == tower)
        }
    };
    let canonical = plan_tensors(&checkpoint.weights, &mut model, wanted(false));
    let heads = (architecture == llama::ARCHITECTURE).then_some(Heads {
        queries: text.heads,
        keys: text.kv_heads,
    });
    let model = Part {
        kind: GgufPart::Model,
        layout: model,
        canonical,
        heads,
        norm_offset: if layout.norms_have_one() && !checkpoint.weights.norms_have_one() {
            1.0
        } else {
            0.0
        },
    };
    let mut parts = vec![model];
    if let Some(tower) = tower {
        let mut layout = Layout {
            metadata: [general(TOWER), tower].concat(),
            tensors: Vec::new(),
        };
        let canonical = plan_tensors(&checkpoint.weights, &mut layout, wanted(true));
        parts.push(Part {
            kind: GgufPart::Tower,
            layout,
            canonical,
            heads: None,
            norm_offset: 0.0,
        });
    }
    Ok(parts)
}

/// Adds the tensors that `rename` gives a name; returns their canonical names.
fn plan_tensors(
    weights: &Weights,
    layout: &mut Layout,
    rename: impl Fn(&str) -> Option<String>,
) -> Vec<String> {
    let mut canonical = Vec::new();
    for (name, shape) in weights.shapes() {
        if let Some(renamed) = rename(name) {
            let format = weights
                .weight_format_of(name)
                .unwrap_or(WeightFormat::F32)
                .stored();
            let mut shape = shape.to_vec();
            if is_kernel(name) && name != renamed {
                shape.retain(|side| *side != 1);
            }
            if shape.is_empty() {
                // The format has no numbers without a side.
                shape.push(1);
            }
            layout.tensors.push(PlannedTensor {
                name: renamed,
                format,
                shape,
            });
            canonical.push(name.to_string());
        }
    }
    canonical
}

/// The bytes of a tensor in the file.
fn data(
    weights: &mut Weights,
    canonical: &str,
    tensor: &PlannedTensor,
    norm_offset: f32,
) -> Result<Vec<u8>, MllmError> {
    let mut bytes = Vec::with_capacity(tensor.bytes() as usize);
    match tensor.shape.as_slice() {
        &[outputs, inputs] if is_matrix(canonical, &tensor.shape) => {
            let matrix = weights.take_matrix(canonical, [outputs, inputs])?;
            // Writing to memory cannot fail.
            let _ = matrix.write_blocks(&mut bytes);
        }
        shape => {
            let mut values: Vec<f32> = weights
                .take_of_any_rank(canonical, shape)?
                .flatten_all()?
                .to_vec1()?;
            if norm_offset != 0.0 && may_add_one(canonical) {
                for value in &mut values {
                    *value += norm_offset;
                }
            }
            bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
        }
    }
    Ok(bytes)
}

fn packed_files(files: &ModelFiles, tokenizer: &ModelFiles) -> Result<Entries, MllmError> {
    let mut packed = Vec::new();
    for name in FILES {
        let source = if name.starts_with("tokenizer") {
            tokenizer
        } else {
            files
        };
        if let Some(text) = source.text(name)? {
            packed.push((format!("{FILE}{name}"), json!(text)));
        }
    }
    Ok(packed)
}
