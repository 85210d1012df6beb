//! The decoders of candle-transformers.

use super::CandleError;
use super::config::{Kind, for_candle};
use candle_core::quantized::gguf_file;
use candle_core::{DType, Device, Tensor};
use candle_nn::VarBuilder;
use candle_transformers::models::{
    gemma3, lfm2, llama, quantized_gemma3, quantized_llama, quantized_qwen2, quantized_qwen3,
    qwen2, qwen3,
};
use serde::de::DeserializeOwned;
use serde_json::Value;
use std::collections::HashMap;
use std::fs::{self, File};
use std::path::{Path, PathBuf};

/// A decoder with its keys and values.
pub(super) enum Decoder {
    Llama(Box<llama::Llama>, Box<llama::Cache>),
    Qwen2(Box<qwen2::ModelForCausalLM>),
    Qwen3(Box<qwen3::ModelForCausalLM>),
    Gemma3(Box<gemma3::Model>),
    /// Its convolutions forget what lies before a pass of several tokens.
    Lfm2(Box<lfm2::Model>, Box<lfm2::Cache>),
    QuantizedLlama(Box<quantized_llama::ModelWeights>),
    QuantizedQwen2(Box<quantized_qwen2::ModelWeights>),
    QuantizedQwen3(Box<quantized_qwen3::ModelWeights>),
    /// With a copy of the model that has seen nothing: this class cannot forget.
    QuantizedGemma3(Box<[quantized_gemma3::ModelWeights; 2]>),
}

/// A decoder with its facts.
pub(super) struct Opened {
    pub decoder: Decoder,
    pub parameters: u64,
    pub vocabulary: usize,
    /// Positions that the class has angles for.
    pub context: usize,
    pub weight_format: String,
    /// The configuration of a folder, to empty the cache of a Llama with.
    pub llama: Option<llama::Config>,
}

/// Positions for which `quantized_llama` has angles.
const LLAMA_POSITIONS: usize = quantized_llama::MAX_SEQ_LEN;

impl Opened {
    /// Opens a folder with safetensors.
    pub(super) fn folder(folder: &Path) -> Result<Self, CandleError> {
        let path = folder.join("config.json");
        let text = fs::read_to_string(&path).map_err(|error| CandleError::read(&path, &error))?;
        let config: Value = serde_json::from_str(&text)
            .map_err(|error| CandleError::Unsupported(format!("{}: {error}", path.display())))?;
        let (kind, config) = for_candle(&path, &config)?;
        let mut tensors = HashMap::new();
        for file in weight_files(folder)? {
            tensors.extend(candle_core::safetensors::load(file, &Device::Cpu)?);
        }
        let parameters = tensors
            .values()
            .map(|tensor| tensor.elem_count() as u64)
            .sum();
        let weights = VarBuilder::from_tensors(tensors, DType::F32, &Device::Cpu);
        // candle's cache of Llama cannot be emptied. Its configuration is kept to make a new one.
        let mut kept = None;
        let decoder = match kind {
            Kind::Llama => {
                let config = read::<llama::LlamaConfig>(&path, &config)?.into_config(false);
                let model = llama::Llama::load(weights, &config)?;
                let cache = llama::Cache::new(true, DType::F32, &config, &Device::Cpu)?;
                kept = Some(config);
                Decoder::Llama(Box::new(model), Box::new(cache))
            }
            Kind::Qwen2 => Decoder::Qwen2(Box::new(qwen2::ModelForCausalLM::new(
                &read(&path, &config)?,
                weights,
            )?)),
            Kind::Qwen3 => Decoder::Qwen3(Box::new(qwen3::ModelForCausalLM::new(
                &read(&path, &config)?,
                weights,
            )?)),
            Kind::Gemma3 => Decoder::Gemma3(Box::new(gemma3::Model::new(
                false,
                &read(&path, &config)?,
                weights,
            )?)),
            Kind::Lfm2 => {
                let config = read::<lfm2::Lfm2Config>(&path, &config)?.into_config(false);
                let cache = lfm2::Cache::new(true, DType::F32, &config, &Device::Cpu)?;
                Decoder::Lfm2(
                    Box::new(lfm2::Model::new(&config, weights)?),
                    Box::new(cache),
                )
            }
        };
        let number = |key: &str| config.get(key).and_then(Value::as_u64).unwrap_or(0) as usize;
        Ok(Self {
            decoder,
            parameters,
            vocabulary: number("vocab_size"),
            context: number("max_position_embeddings"),
            weight_format: "f32".to_owned(),
            llama: kept,
        })
    }

    /// Opens a GGUF file.
    pub(super) fn gguf(path: &Path) -> Result<Self, CandleError> {
        let mut file = File::open(path).map_err(|error| CandleError::read(path, &error))?;
        let content = gguf_file::Content::read(&mut file)?;
        let text = |key: &str| {
            let value = content.metadata.get(key)?;
            value.to_string().ok().cloned()
        };
        let Some(architecture) = text("general.architecture") else {
            let problem = format!("{}: general.architecture is missing", path.display());
            return Err(CandleError::Unsupported(problem));
        };
        let kind = Kind::named(&architecture)?;
        let key = format!("{architecture}.rope.scaling.type");
        if let Some(scaling) = text(&key).filter(|scaling| scaling != "none") {
            let problem = format!(
                "{}: {key}: candle's class does not read '{scaling}'",
                path.display()
            );
            return Err(CandleError::Unsupported(problem));
        }
        let embedding = content.tensor_infos.get("token_embd.weight");
        let vocabulary = embedding.and_then(|info| info.shape.dims().first().copied());
        let mut shares: HashMap<String, u64> = HashMap::new();
        for info in content.tensor_infos.values() {
            let format = format!("{:?}", info.ggml_dtype).to_lowercase();
            *shares.entry(format).or_default() += info.shape.elem_count() as u64;
        }
        let parameters = shares.values().sum();
        let most = shares
            .into_iter()
            .max_by_key(|(name, count)| (*count, name.clone()));
        let context = content
            .metadata
            .get(&format!("{architecture}.context_length"))
            .and_then(|value| value.to_u32().ok())
            .map_or(0, |context| context as usize);
        let cpu = &Device::Cpu;
        let decoder = match kind {
            Kind::Llama => Decoder::QuantizedLlama(Box::new(
                quantized_llama::ModelWeights::from_gguf(content, &mut file, cpu)?,
            )),
            Kind::Qwen2 => Decoder::QuantizedQwen2(Box::new(
                quantized_qwen2::ModelWeights::from_gguf(content, &mut file, cpu)?,
            )),
            Kind::Qwen3 => Decoder::QuantizedQwen3(Box::new(
                quantized_qwen3::ModelWeights::from_gguf(content, &mut file, cpu)?,
            )),
            Kind::Gemma3 => {
                // This class cannot empty its cache, so a copy that was never used stays beside it.
                let model = quantized_gemma3::ModelWeights::from_gguf(content, &mut file, cpu)?;
                Decoder::QuantizedGemma3(Box::new([model.clone(), model]))
            }
            Kind::Lfm2 => {
                let problem =
                    "its class of an LFM2 in GGUF cannot forget a sequence; a folder is compared";
                return Err(CandleError::Unsupported(problem.to_owned()));
            }
        };
        Ok(Self {
            decoder,
            parameters,
            vocabulary: vocabulary.unwrap_or(0),
            context: if kind == Kind::Llama {
                context.min(LLAMA_POSITIONS)
            } else {
                context
            },
            weight_format: most.map_or_else(|| "unknown".to_owned(), |(name, _)| name),
            llama: None,
        })
    }

    /// The logits behind tokens that follow `offset` computed ones.
    pub(super) fn forward(&mut self, ids: &[u32], offset: usize) -> Result<Vec<f32>, CandleError> {
        let input = Tensor::new(ids, &Device::Cpu)?.unsqueeze(0)?;
        let logits = match &mut self.decoder {
            Decoder::Llama(model, cache) => model.forward(&input, offset, cache),
            Decoder::Qwen2(model) => model.forward(&input, offset),
            Decoder::Qwen3(model) => model.forward(&input, offset),
            Decoder::Gemma3(model) => model.forward(&input, offset),
            Decoder::Lfm2(model, cache) => model.forward(&input, offset, cache),
            Decoder::QuantizedLlama(model) => model.forward(&input, offset),
            Decoder::QuantizedQwen2(model) => model.forward(&input, offset),
            Decoder::QuantizedQwen3(model) => model.forward(&input, offset),
            Decoder::QuantizedGemma3(models) => models[0].forward(&input, offset),
        }?;
        Ok(logits.flatten_all()?.to_dtype(DType::F32)?.to_vec1()?)
    }

    /// Drops all keys and values.
    pub(super) fn forget(&mut self) -> Result<(), CandleError> {
        match &mut self.decoder {
            Decoder::Llama(_, cache) => {
                if let Some(config) = &self.llama {
                    **cache = llama::Cache::new(true, DType::F32, config, &Device::Cpu)?;
                }
            }
            Decoder::Qwen2(model) => model.clear_kv_cache(),
            Decoder::Qwen3(model) => model.clear_kv_cache(),
            Decoder::Gemma3(model) => model.clear_kv_cache(),
            Decoder::Lfm2(_, cache) => cache.clear(),
            Decoder::QuantizedLlama(model) => model.clear_kv_cache(),
            Decoder::QuantizedQwen2(model) => model.clear_kv_cache(),
            Decoder::QuantizedQwen3(model) => model.clear_kv_cache(),
            Decoder::QuantizedGemma3(models) => models[0] = models[1].clone(),
        }
        Ok(())
    }
}

/// Reads a configuration of candle.
fn read<T: DeserializeOwned>(path: &Path, config: &Value) -> Result<T, CandleError> {
    T::deserialize(config)
        .map_err(|error| CandleError::Unsupported(format!("{}: {error}", path.display())))
}

/// The safetensors files of a folder, in order.
fn weight_files(folder: &Path) -> Result<Vec<PathBuf>, CandleError> {
    let entries = fs::read_dir(folder).map_err(|error| CandleError::read(folder, &error))?;
    let mut files: Vec<PathBuf> = entries
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter(|path| {
            path.extension()
                .is_some_and(|ending| ending == "safetensors")
        })
        .collect();
    files.sort();
    Ok(files)
}
