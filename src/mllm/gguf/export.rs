//! Writing a model as GGUF.
//!
//! A LLaVA becomes two files that llama.cpp opens too: the decoder, and the vision tower with the projector. Any other model
//! becomes one, under the canonical names of its tensors. In both cases the small files of the model lie in the metadata,
//! so that opening it again gives the same model to the bit.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use super::clip::{self, Tower};
use super::value::Value;
use super::writer::{Layout, PlannedTensor};
use super::{FILE, WHOLE_MODEL, llama, names, tokenizer_metadata};
use crate::mllm::MllmError;
use crate::mllm::checkpoint::{Checkpoint, LoadReport, ModelFiles, Weights, is_matrix, paired};
use crate::mllm::llava::LlavaConfig;
use crate::mllm::llava_next::LlavaNextConfig;
use crate::mllm::local::Architecture;
use crate::mllm::matrix::WeightFormat;
use crate::mllm::text::special_tokens;
use crate::mllm::vision::{PixelScale, read_processor};

/// The small files that a model may have.
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

/// The files that a model is written to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum GgufPart {
    /// The decoder, or the whole model.
    Model,
    /// The vision tower with the projector; it belongs beside the decoder, under the name that [`GgufPart::path`] gives.
    Tower,
}

impl GgufPart {
    /// The path of this part where the model's is `model`.
    pub fn path(self, model: &Path) -> PathBuf {
        match self {
            Self::Model => model.to_path_buf(),
            Self::Tower => tower_path(model),
        }
    }
}

/// Where the vision tower of a model is looked for first.
pub(super) fn tower_path(model: &Path) -> PathBuf {
    model.with_file_name(format!("mmproj-{}", model.file_name().unwrap_or_default().to_string_lossy()))
}

/// Opens a file to be written.
pub type CreateFile<'a> = dyn FnMut(GgufPart) -> io::Result<Box<dyn Write>> + 'a;

/// Writes a model whose weights are held as its checkpoint was opened. `tokenizer` are the files of its tokenizer. `progress`
/// is told the bytes that are written and their sum.
///
/// # Errors
/// When the model is broken, or a file cannot be written.
pub(crate) fn export(
    mut checkpoint: Checkpoint,
    tokenizer: &ModelFiles,
    name: &str,
    create: &mut CreateFile<'_>,
    progress: &mut dyn FnMut(u64, u64),
) -> Result<LoadReport, MllmError> {
    let parts = parts(&mut checkpoint, tokenizer, name)?;
    let total = parts.iter().flat_map(|part| &part.layout.tensors).map(PlannedTensor::bytes).sum();
    let mut written = 0;
    for part in &parts {
        let failed = |source| MllmError::Write { what: format!("{:?}", part.kind).to_lowercase(), source };
        let mut out = create(part.kind).map_err(failed)?;
        part.layout.write_header(&mut out).map_err(failed)?;
        for (tensor, canonical) in part.layout.tensors.iter().zip(&part.canonical) {
            let data = data(&mut checkpoint.weights, canonical, tensor)?;
            let data = match part.heads.as_ref().and_then(|heads| heads.of(canonical)) {
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
}

/// Heads of queries and of keys.
#[derive(Clone, Copy)]
struct Heads {
    queries: usize,
    keys: usize,
}

impl Heads {
    /// The heads of a tensor, if it makes queries or keys of a decoder.
    fn of(&self, canonical: &str) -> Option<usize> {
        let part = canonical.strip_prefix("language_model.layers.")?.split('.').nth(2)?;
        match part {
            "q_proj" => Some(self.queries),
            "k_proj" => Some(self.keys),
            _ => None,
        }
    }
}

fn parts(checkpoint: &mut Checkpoint, tokenizer: &ModelFiles, name: &str) -> Result<Vec<Part>, MllmError> {
    let files = &checkpoint.files;
    let packed = packed_files(files, tokenizer)?;
    let family = Architecture::of(files)?;
    let general = |architecture: &str| {
        vec![
            ("general.architecture".to_string(), Value::Text(architecture.into())),
            ("general.name".to_string(), Value::Text(name.into())),
            // Of the blocks of quantised tensors (GGML_QNT_VERSION).
            ("general.quantization_version".to_string(), Value::Unsigned(2)),
        ]
    };
    let text = family.decoder(files)?;
    let described = match family {
        Architecture::Llava => llava_metadata(files, &LlavaConfig::open(files)?, None),
        Architecture::LlavaNext => {
            let config = LlavaNextConfig::open(files)?;
            let pinpoints = config.grids.resolutions().iter().map(|size| [size.height, size.width]).collect();
            llava_metadata(files, &config.llava, Some(pinpoints))
        }
        Architecture::CogVlm => Ok(Err("visual experts")),
    };
    let (decoder, tower) = match described? {
        Ok(described) => described,
        Err(what) => {
            checkpoint
                .weights
                .note(format!("llama.cpp's format has no place for {what}: the file is for this program alone"));
            let mut layout = Layout { metadata: [general(WHOLE_MODEL), packed].concat(), tensors: Vec::new() };
            let canonical = plan_tensors(&checkpoint.weights, &mut layout, |name| Some(name.to_string()));
            return Ok(vec![Part { kind: GgufPart::Model, layout, canonical, heads: None }]);
        }
    };
    let mut metadata = [general(llama::ARCHITECTURE), decoder].concat();
    let json = tokenizer.required_json("tokenizer.json")?;
    match tokenizer_metadata::metadata(&json, &special_tokens(tokenizer)?, text.vocabulary) {
        Some(tokens) => metadata.extend(tokens),
        None => checkpoint.weights.note("llama.cpp has no tokenizer of this kind: it will not open the decoder".into()),
    }
    metadata.extend(packed);
    let mut model = Layout { metadata, tensors: Vec::new() };
    let is_tower = |name: &str| name.starts_with("v.") || name.starts_with("mm.") || name.starts_with("model.");
    let wanted = |tower: bool| move |name: &str| names::from_canonical(name).filter(|name| is_tower(name) == tower);
    let canonical = plan_tensors(&checkpoint.weights, &mut model, wanted(false));
    let heads = Some(Heads { queries: text.heads, keys: text.kv_heads });
    let model = Part { kind: GgufPart::Model, layout: model, canonical, heads };
    let mut layout = Layout { metadata: [general(clip::ARCHITECTURE), tower].concat(), tensors: Vec::new() };
    let canonical = plan_tensors(&checkpoint.weights, &mut layout, wanted(true));
    Ok(vec![model, Part { kind: GgufPart::Tower, layout, canonical, heads: None }])
}

/// Metadata of a decoder and of a tower, or what llama.cpp has no key for.
type Described = Result<(Vec<(String, Value)>, Vec<(String, Value)>), &'static str>;

fn llava_metadata(
    files: &ModelFiles,
    config: &LlavaConfig,
    pinpoints: Option<Vec<[u32; 2]>>,
) -> Result<Described, MllmError> {
    let scale = read_processor(files, |_, section| PixelScale::from_section(section))?;
    let Some(scale) = scale.mean_and_deviation() else { return Ok(Err("pixels that are not normalised")) };
    let tower = Tower {
        vision: &config.vision,
        features: &config.feature_layers,
        pinpoints,
        scale,
        projection: config.text.hidden,
    };
    let owned =
        |metadata: Vec<(&str, Value)>| metadata.into_iter().map(|(key, value)| (key.to_string(), value)).collect();
    Ok(llama::metadata(&config.text).and_then(|decoder| Ok((owned(decoder), owned(clip::metadata(&tower)?)))))
}

/// Adds the tensors that `rename` gives a name; gives their canonical ones.
fn plan_tensors(weights: &Weights, layout: &mut Layout, rename: impl Fn(&str) -> Option<String>) -> Vec<String> {
    let mut canonical = Vec::new();
    for (name, shape) in weights.shapes() {
        if let Some(renamed) = rename(name) {
            let format = weights.weight_format_of(name).unwrap_or(WeightFormat::F32).ggml();
            layout.tensors.push(PlannedTensor { name: renamed, format, shape: shape.to_vec() });
            canonical.push(name.to_string());
        }
    }
    canonical
}

/// The data of a tensor as it is written.
fn data(weights: &mut Weights, canonical: &str, tensor: &PlannedTensor) -> Result<Vec<u8>, MllmError> {
    let mut bytes = Vec::with_capacity(tensor.bytes() as usize);
    match tensor.shape.as_slice() {
        &[outputs, inputs] if is_matrix(canonical, &tensor.shape) => {
            let matrix = weights.take_matrix(canonical, [outputs, inputs])?;
            // Writing to memory cannot fail.
            let _ = matrix.write_blocks(&mut bytes);
        }
        shape => {
            let values: Vec<f32> = weights.take(canonical, shape)?.flatten_all()?.to_vec1()?;
            bytes.extend(values.iter().flat_map(|value| value.to_le_bytes()));
        }
    }
    Ok(bytes)
}

fn packed_files(files: &ModelFiles, tokenizer: &ModelFiles) -> Result<Vec<(String, Value)>, MllmError> {
    let mut packed = Vec::new();
    for name in FILES {
        let source = if name.starts_with("tokenizer") { tokenizer } else { files };
        if let Some(text) = source.text(name)? {
            packed.push((format!("{FILE}{name}"), Value::Text(text)));
        }
    }
    Ok(packed)
}
