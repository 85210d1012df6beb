//! PEFT's own merged weights and logits (`tests/fixtures/quantized_reference`).

use super::test_adapter::{identity, merged, names_of_llama, weights};
use super::{Adapter, AdapterSpec, BaseModel};
use crate::checkpoint::{
    ConfigObject, DecoderType, LlamaConfig, Weights, paired, read_json, safetensors_folder,
};
use crate::decoder::{Decoder, DecoderInput, LanguageModel, LlamaLayer, Logits};
use crate::families::Families;
use crate::family::{Tiles, VisionLanguageModel};
use crate::llava::{Llava, LlavaConfig};
use crate::local::test_reference::{
    LOGIT_TOLERANCE, Reference, difference, fixture, logits_in_pieces,
};
use crate::source::{Checkpoint, ModelPlace};
use crate::vision::ClipImageProcessor;
use candle_core::{Device, Tensor};
use std::collections::HashMap;
use std::path::PathBuf;

/// Largest error of a merged weight.
const TOLERANCE: f32 = 1e-5;

/// The cases whose base is a llama, and the base.
const LLAMA: [(&str, &str); 17] = [
    ("lora_plain", "base_llama"),
    ("lora_rslora", "base_llama"),
    ("lora_dora", "base_llama"),
    ("lora_modules_to_save", "base_llama"),
    ("lora_embedding", "base_llama"),
    ("lora_embedding_dora", "base_llama"),
    ("lora_patterns", "base_llama"),
    ("lora_layers", "base_llama"),
    ("lora_regex", "base_llama"),
    ("lora_all_linear", "base_llama"),
    ("lora_lora_bias", "base_llama_bias"),
    ("lora_bias_only", "base_llama_bias"),
    ("lora_trainable_tokens", "base_llama"),
    ("lora_trainable_tokens_tied", "base_llama_tied"),
    ("lora_pissa", "base_llama"),
    ("lora_pissa_converted", "base_llama"),
    ("lora_olora", "base_llama"),
];

/// A folder of the reference.
fn folder(name: &str) -> PathBuf {
    fixture("quantized_reference").join(name)
}

/// The weights that a case expects, by their names in transformers.
fn expected(case: &str) -> HashMap<String, Tensor> {
    let path = folder(case).join("expected.safetensors");
    let tensors = candle_core::safetensors::load(path, &Device::Cpu).unwrap();
    let weights = tensors.into_iter().filter_map(|(name, tensor)| {
        let name = name.strip_prefix("weight.")?.to_owned();
        Some((name, tensor))
    });
    weights.collect()
}

fn base(name: &str, canonical: &dyn Fn(&str) -> Option<String>) -> Weights {
    safetensors_folder::open(&folder(name), None, canonical).unwrap()
}

/// Checks the weights of a case; gives the largest error.
fn check(
    case: &str,
    mut weights: Weights,
    base: &BaseModel<'_>,
    stored: &dyn Fn(&str) -> String,
) -> f32 {
    let spec = AdapterSpec::new(match case {
        "lora_gguf" => folder(case).join("adapter.gguf"),
        _ => folder(case),
    });
    Adapter::open(&spec)
        .unwrap()
        .merge_into(&mut weights, base)
        .unwrap();
    let mut worst = 0.0_f32;
    for (name, tensor) in expected(case) {
        let found = weights.take(&stored(&name), tensor.dims()).unwrap();
        let error = difference(&found, &tensor);
        assert!(error < TOLERANCE, "{case}: {name} differs by {error}");
        worst = worst.max(error);
    }
    worst
}

#[test]
fn merged_weights_are_those_of_peft() {
    for (case, of) in LLAMA {
        let weights = base(of, &identity);
        let worst = check(case, weights, &merged(&identity), &str::to_owned);
        println!("{case}: {worst:e}");
    }
}

/// The logits of a llama with these weights.
fn logits(mut weights: Weights, base: &str, ids: &[u32]) -> Tensor {
    let path = folder(base).join("config.json");
    let json = read_json(&path).unwrap();
    let root = ConfigObject::root(&path, &json).unwrap();
    let config = LlamaConfig::read(root, DecoderType::Llama).unwrap();
    let decoder: Decoder<LlamaLayer> = Decoder::take(&mut weights, &config, "model.").unwrap();
    let input = DecoderInput {
        rows: decoder.embed(ids).unwrap(),
        tokens: ids.iter().copied().map(Some).collect(),
        positions: (0..ids.len() as u32).map(|at| [at; 3]).collect(),
        prompt_end: ids.len(),
        vision: Vec::new(),
        deep: Vec::new(),
    };
    let mut cache = decoder.new_cache(ids.len());
    let logits = decoder.forward(&input, &mut cache, Logits::All).unwrap();
    logits.unwrap()
}

#[test]
fn logits_are_those_of_peft() {
    for (case, of) in LLAMA {
        let mut weights = base(of, &identity);
        let adapter = Adapter::open(&AdapterSpec::new(folder(case))).unwrap();
        adapter
            .merge_into(&mut weights, &merged(&identity))
            .unwrap();
        let reference = Reference::open(&folder(case).join("expected.safetensors"));
        let found = logits(weights, of, &reference.ids("input_ids", 0));
        let error = difference(&found, reference.tensor("logits"));
        assert!(
            error < LOGIT_TOLERANCE,
            "{case}: the logits differ by {error}"
        );
        println!("{case}: logits {error:e}");
    }
}

#[test]
fn weights_of_gpt2_whose_outputs_are_columns_are_those_of_peft() {
    let weights = base("base_gpt2", &identity);
    let worst = check("lora_conv1d", weights, &merged(&identity), &str::to_owned);
    println!("lora_conv1d: {worst:e}");
}

/// The experts of a folder as one tensor of a layer, as transformers has them in memory.
#[test]
fn weights_of_experts_are_those_of_peft() {
    let stored =
        candle_core::safetensors::load(folder("base_mixtral/model.safetensors"), &Device::Cpu)
            .unwrap();
    let mut made = Vec::new();
    let mut add = |name: String, tensor: Tensor| {
        let numbers: Vec<f32> = tensor
            .to_dtype(candle_core::DType::F32)
            .and_then(|tensor| tensor.flatten_all()?.to_vec1())
            .unwrap();
        made.push((name, tensor.dims().to_vec(), numbers));
    };
    for layer in 0..2 {
        let expert = |expert: usize, part: &str| {
            let name =
                format!("model.layers.{layer}.block_sparse_moe.experts.{expert}.{part}.weight");
            stored[&name].clone()
        };
        let gate_up = (0..4).map(|e| Tensor::cat(&[expert(e, "w1"), expert(e, "w3")], 0).unwrap());
        let down = (0..4).map(|e| expert(e, "w2"));
        let stack = |tensors: Vec<Tensor>| Tensor::stack(&tensors, 0).unwrap();
        let module = format!("model.layers.{layer}.mlp.experts");
        add(format!("{module}.gate_up_proj"), stack(gate_up.collect()));
        add(format!("{module}.down_proj"), stack(down.collect()));
        let name = format!("model.layers.{layer}.self_attn.q_proj.weight");
        add(name.clone(), stored[&name].clone());
    }
    let weights = weights(&made);
    let worst = check("lora_moe", weights, &merged(&identity), &str::to_owned);
    println!("lora_moe: {worst:e}");
}

#[test]
fn a_file_of_llama_cpp_gives_the_weights_of_peft() {
    let canonical = |name: &str| names_of_llama().to_canonical(&stored_in_gguf(name)?);
    let base_model = BaseModel {
        gguf: Ok(&super::test_adapter::LlamaLayout),
        architecture: Some("llama"),
        heads: [4, 2],
        ..merged(&canonical)
    };
    let mut weights = base("base_llama", &canonical);
    let spec = AdapterSpec::new(folder("lora_gguf/adapter.gguf"));
    let adapter = Adapter::open(&spec).unwrap();
    adapter.merge_into(&mut weights, &base_model).unwrap();
    for (name, tensor) in expected("lora_gguf") {
        let heads = match name.split('.').nth(2) {
            Some("attn_q") => Some(4),
            Some("attn_k") => Some(2),
            _ => None,
        };
        let name = names_of_llama().to_canonical(&name).unwrap();
        let found = weights.take(&name, tensor.dims()).unwrap();
        let numbers: Vec<f32> = found.flatten_all().unwrap().to_vec1().unwrap();
        let bytes: Vec<u8> = numbers.iter().flat_map(|n| n.to_le_bytes()).collect();
        let bytes = heads.map_or(bytes.clone(), |heads| {
            paired(&bytes, tensor.dims()[0], heads)
        });
        let numbers: Vec<f32> = bytes
            .as_chunks::<4>()
            .0
            .iter()
            .map(|bytes| f32::from_le_bytes(*bytes))
            .collect();
        let found = Tensor::from_vec(numbers, tensor.dims(), &Device::Cpu).unwrap();
        let error = difference(&found, &tensor);
        assert!(error < TOLERANCE, "{name} differs by {error}");
    }
}

/// The name in GGUF of a tensor of a llama in transformers.
fn stored_in_gguf(name: &str) -> Option<String> {
    let name = name.strip_prefix("model.").unwrap_or(name);
    let canonical = match name {
        "lm_head.weight" => name.to_owned(),
        name => format!("language_model.{name}"),
    };
    names_of_llama().in_gguf(&canonical)
}

#[test]
fn a_llava_with_names_of_any_age_gives_the_weights_and_logits_of_peft() {
    for case in ["lora_llava", "lora_llava_old_names"] {
        let open = || {
            let place = ModelPlace::Folder(folder("base_llava"));
            Checkpoint::open(&place, None, &Families::default())
                .unwrap()
                .adapted(Some(&AdapterSpec::new(folder(case))))
                .unwrap()
        };
        let mut checkpoint = open();
        let canonical = checkpoint.family.family().canonical_name;
        for (name, tensor) in expected(case) {
            let found = checkpoint
                .weights
                .take(&canonical(&name).unwrap(), tensor.dims())
                .unwrap();
            let error = difference(&found, &tensor);
            assert!(error < TOLERANCE, "{case}: {name} differs by {error}");
        }
        let mut checkpoint = open();
        let reference = Reference::open(&folder(case).join("expected.safetensors"));
        let config = LlavaConfig::open(&checkpoint.files).unwrap();
        let processor = ClipImageProcessor::square(config.vision.image_size as u32);
        let model = Llava::take(&mut checkpoint.weights, config, processor).unwrap();
        let pixels = vec![reference.tensor("pixel_values").clone()];
        let features = model
            .encode(&Tiles {
                pixels,
                width: 28,
                height: 28,
            })
            .unwrap();
        let ids = reference.ids("input_ids", 15);
        let logits = logits_in_pieces(&model, &ids, Some(&features), &[]);
        let error = difference(&logits, reference.tensor("logits"));
        assert!(
            error < LOGIT_TOLERANCE,
            "{case}: the logits differ by {error}"
        );
        println!("{case}: logits {error:e}");
    }
}
