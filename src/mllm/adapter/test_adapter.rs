//! What tests of adapters share: a base without a family, and files of one's own making.

use super::{Adapter, AdapterSpec, BaseModel};
use crate::MllmError;
use crate::checkpoint::{
    MergedAdapter, ModelFiles, RowOrder, TensorPlace, TensorSource, WeightFormatPlan, Weights,
};
use crate::gguf::names::{DECODER_LAYERS, EMBEDDING, FINAL_NORM, Names, OUTPUT};
use crate::gguf::{Described, GgufLayout, Header};
use candle_core::quantized::GgmlDType;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use safetensors::{Dtype, serialize_to_file, tensor::TensorView};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::Path;
use tempfile::TempDir;

/// A family whose canonical names are those of its files.
#[allow(clippy::unnecessary_wraps, reason = "the shape of a family's function")]
pub(super) fn identity(name: &str) -> Option<String> {
    Some(name.to_owned())
}

/// A base with these names, which llama.cpp does not know.
pub(super) fn merged(canonical: &dyn Fn(&str) -> Option<String>) -> BaseModel<'_> {
    BaseModel {
        family: "test",
        canonical_name: canonical,
        gguf: Err("tests"),
        architecture: None,
        heads: [4, 2],
    }
}

pub(super) fn names_of_llama() -> Names {
    Names {
        single: &[EMBEDDING, FINAL_NORM, OUTPUT],
        layers: &[DECODER_LAYERS],
    }
}

/// A text-only llama in llama.cpp's files.
pub(super) struct LlamaLayout;

impl GgufLayout for LlamaLayout {
    fn opens(&self, _: &Header, _: Option<&Header>) -> bool {
        false
    }

    fn small_files(
        &self,
        _: &Header,
        _: Option<&Header>,
        _: &mut Vec<String>,
    ) -> Result<BTreeMap<String, String>, MllmError> {
        Ok(BTreeMap::new())
    }

    fn canonical_name(&self, _: &Header, name: &str) -> Result<Option<String>, MllmError> {
        Ok(names_of_llama().to_canonical(name))
    }

    fn gguf_name(&self, canonical: &str) -> Option<String> {
        names_of_llama().in_gguf(canonical)
    }

    fn metadata(&self, _: &ModelFiles) -> Result<Described, MllmError> {
        Ok(Err("tests"))
    }
}

/// Numbers as a file of one tensor.
pub(super) fn in_memory(numbers: &[f32]) -> impl TensorSource + 'static {
    Memory(
        numbers
            .iter()
            .flat_map(|number| number.to_le_bytes())
            .collect(),
    )
}

#[derive(Debug)]
struct Memory(Vec<u8>);

impl TensorSource for Memory {
    fn path(&self) -> &Path {
        Path::new("memory")
    }

    fn bytes(&self, _: &TensorPlace) -> Result<Vec<u8>, MllmError> {
        Ok(self.0.clone())
    }

    fn hash(&self, _: &mut blake3::Hasher) -> Result<(), MllmError> {
        Ok(())
    }
}

/// A tensor of a file of one's own making: name, shape, numbers.
pub(super) type Made = (String, Vec<usize>, Vec<f32>);

/// Numbers between -0.5 and 0.5, the same for the same seed.
pub(super) fn noise(seed: u64, count: usize) -> Vec<f32> {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    (0..count).map(|_| random.random_range(-0.5..0.5)).collect()
}

/// A tensor of noise.
pub(super) fn made(name: &str, shape: &[usize]) -> Made {
    let seed = name.bytes().fold(7, |seed: u64, byte| {
        seed.wrapping_mul(31).wrapping_add(u64::from(byte))
    });
    let numbers = noise(seed, shape.iter().product());
    (name.to_owned(), shape.to_vec(), numbers)
}

/// The two matrices of a module.
pub(super) fn pair(module: &str, [outputs, inputs]: [usize; 2], rank: usize) -> [Made; 2] {
    [
        made(
            &format!("base_model.model.{module}.lora_A.weight"),
            &[rank, inputs],
        ),
        made(
            &format!("base_model.model.{module}.lora_B.weight"),
            &[outputs, rank],
        ),
    ]
}

/// The two matrices of an embedding.
pub(super) fn embedding_pair(module: &str, [tokens, hidden]: [usize; 2], rank: usize) -> [Made; 2] {
    [
        made(
            &format!("base_model.model.{module}.lora_embedding_A"),
            &[rank, tokens],
        ),
        made(
            &format!("base_model.model.{module}.lora_embedding_B"),
            &[hidden, rank],
        ),
    ]
}

/// Writes `adapter_model.safetensors` or another file of tensors.
pub(super) fn write_tensors(path: &Path, tensors: &[Made]) {
    let bytes: Vec<Vec<u8>> = tensors
        .iter()
        .map(|(.., numbers)| {
            numbers
                .iter()
                .flat_map(|number| number.to_le_bytes())
                .collect()
        })
        .collect();
    let views = tensors.iter().zip(&bytes).map(|((name, shape, _), bytes)| {
        let view = TensorView::new(Dtype::F32, shape.clone(), bytes).unwrap();
        (name.clone(), view)
    });
    serialize_to_file(views, None, path).unwrap();
}

/// A folder of PEFT with these settings beside the usual ones.
pub(super) fn peft(settings: &Value, tensors: &[Made]) -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    let mut config = json!({
        "peft_type": "LORA", "base_model_name_or_path": "org/base", "r": 4, "lora_alpha": 6, "bias": "none",
        "target_modules": ["q_proj", "k_proj"], "lora_dropout": 0.1, "task_type": "CAUSAL_LM",
    });
    for (key, value) in settings.as_object().unwrap() {
        config[key] = value.clone();
    }
    std::fs::write(
        folder.path().join("adapter_config.json"),
        config.to_string(),
    )
    .unwrap();
    write_tensors(&folder.path().join("adapter_model.safetensors"), tensors);
    folder
}

/// The weights of a folder with these tensors, by their own names.
pub(super) fn weights(tensors: &[Made]) -> Weights {
    let mut weights = Weights::empty(Path::new("base"), WeightFormatPlan::default());
    for (name, shape, numbers) in tensors {
        let place = TensorPlace {
            format: GgmlDType::F32.into(),
            shape: shape.clone(),
            begin: 0,
            bytes: (numbers.len() * 4) as u64,
        };
        let file = weights.add_file(in_memory(numbers));
        weights
            .add(name.clone(), file, name.clone(), place, RowOrder::Plain)
            .unwrap();
    }
    weights
}

/// Merges a folder into weights by their own names.
pub(super) fn merge(folder: &Path, weights: &mut Weights) -> Result<MergedAdapter, MllmError> {
    Adapter::open(&AdapterSpec::new(folder))?.merge_into(weights, &merged(&identity))
}

/// The numbers of a tensor.
pub(super) fn numbers(weights: &mut Weights, name: &str, shape: &[usize]) -> Vec<f32> {
    let tensor = weights.take(name, shape).unwrap();
    tensor.flatten_all().unwrap().to_vec1().unwrap()
}
