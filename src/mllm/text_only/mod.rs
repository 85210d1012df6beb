//! Models that read text alone: a decoder with its tokenizer and chat template, and no vision tower.

mod gemma3n;
mod gguf;
pub(crate) mod lfm2;
mod model;

#[cfg(test)]
mod gemma3n_tests;
#[cfg(test)]
mod gemma_tests;
#[cfg(test)]
mod lfm2_tests;

use super::MllmError;
use super::checkpoint::{ConfigObject, DecoderType, LlamaConfig, ModelFiles, Weights};
use super::decoder::{LlamaLayer, StreamLayer};
use super::family::{About, Family, OpenedModel};
pub(crate) use gemma3n::canonical_name as gemma3n_name;
use gguf::TextGguf;
use model::TextModel;

/// Llama and its relatives with the same tensors: `SmolLM2`, Mistral.
pub(crate) const LLAMA: Family = Family {
    name: "llama",
    config_names: &["llama", "LlamaForCausalLM", "mistral", "MistralForCausalLM"],
    canonical_name,
    gguf: Ok(&TextGguf::of_llama(&["llama"])),
    missing_tokenizer: TOKENIZER,
    decoder_config: |files| config(files, DecoderType::Llama),
    open: |files, weights| {
        let config = config(files, DecoderType::Llama)?;
        take(weights, "llama", &config)
    },
    about: About {
        models: "Llama, Mistral, SmolLM2",
        gguf: &[("llama", None)],
        tested: "transformers, llama.cpp: src/mllm/local/outside_tests.rs",
        example: "HuggingFaceTB/SmolLM2-135M-Instruct",
    },
};

/// Qwen 2 and 2.5, and the decoders of Qwen2-VL and Qwen2.5-VL without their towers.
pub(crate) const QWEN2: Family = Family {
    name: "qwen2",
    config_names: &[
        "qwen2",
        "Qwen2ForCausalLM",
        "qwen2_5_vl_text",
        "qwen2_vl_text",
    ],
    canonical_name,
    gguf: Ok(&TextGguf::of_llama(&["qwen2", "qwen2vl"])),
    missing_tokenizer: TOKENIZER,
    decoder_config: |files| config(files, DecoderType::Qwen2),
    open: |files, weights| {
        let config = config(files, DecoderType::Qwen2)?;
        take(weights, "qwen2", &config)
    },
    about: About {
        models: "Qwen2 and Qwen2.5",
        gguf: &[("qwen2", None)],
        tested: "transformers, llama.cpp: src/mllm/local/outside_tests.rs",
        example: "Qwen/Qwen2.5-0.5B-Instruct",
    },
};

/// Qwen 3, and the decoder of Qwen3-VL without its tower.
pub(crate) const QWEN3: Family = Family {
    name: "qwen3",
    config_names: &["qwen3", "Qwen3ForCausalLM", "qwen3_vl_text"],
    canonical_name,
    gguf: Ok(&TextGguf::of_llama(&["qwen3", "qwen3vl"])),
    missing_tokenizer: TOKENIZER,
    decoder_config: |files| config(files, DecoderType::Qwen3),
    open: |files, weights| {
        let config = config(files, DecoderType::Qwen3)?;
        take(weights, "qwen3", &config)
    },
    about: About {
        models: "Qwen3 with a dense decoder",
        gguf: &[("qwen3", None)],
        tested: "transformers, llama.cpp: src/mllm/local/outside_tests.rs",
        example: "Qwen/Qwen3-0.6B",
    },
};

/// Gemma 3 without a vision tower.
pub(crate) const GEMMA3: Family = Family {
    name: "gemma3_text",
    config_names: &["gemma3_text", "Gemma3ForCausalLM"],
    canonical_name,
    gguf: Ok(&TextGguf::OF_GEMMA),
    missing_tokenizer: TOKENIZER,
    decoder_config: |files| config(files, DecoderType::Gemma3),
    open: |files, weights| {
        let config = config(files, DecoderType::Gemma3)?;
        take(weights, "gemma3_text", &config)
    },
    about: About {
        models: "Gemma 3 without its tower",
        gguf: &[("gemma3", None)],
        tested: "transformers, llama.cpp: tests/fixtures/tiny_gemma3_text",
        example: "google/gemma-3-270m-it",
    },
};

/// Gemma 3n without its towers.
pub(crate) const GEMMA3N: Family = Family {
    name: "gemma3n_text",
    config_names: &["gemma3n_text", "Gemma3nForCausalLM"],
    canonical_name: gemma3n_name,
    gguf: Ok(&TextGguf::OF_GEMMA3N),
    missing_tokenizer: TOKENIZER,
    decoder_config: |files| config(files, DecoderType::Gemma3n),
    open: |files, weights| {
        let config = config(files, DecoderType::Gemma3n)?;
        take_streams(weights, "gemma3n_text", &config)
    },
    about: About {
        models: "Gemma 3n without its towers",
        gguf: &[("gemma3n", None)],
        tested: "transformers, llama.cpp's converter: tests/fixtures/tiny_gemma3n",
        example: "./my-gemma-3n",
    },
};

/// Gemma 4 without a vision tower.
pub(crate) const GEMMA4: Family = Family {
    name: "gemma4_text",
    config_names: &["gemma4_text", "Gemma4ForCausalLM"],
    canonical_name: |stored| canonical_name(stored).map(gemma4_name),
    gguf: Ok(&TextGguf::OF_GEMMA4),
    missing_tokenizer: TOKENIZER,
    decoder_config: |files| config(files, DecoderType::Gemma4),
    open: |files, weights| {
        let config = config(files, DecoderType::Gemma4)?;
        take(weights, "gemma4_text", &config)
    },
    about: About {
        models: "Gemma 4 without its tower",
        gguf: &[("gemma4", None)],
        tested: "transformers, llama.cpp: tests/fixtures/tiny_gemma4",
        example: "./my-gemma-4",
    },
};

/// LFM2: short convolutions, and attention in some layers.
pub(crate) const LFM2: Family = Family {
    name: "lfm2",
    config_names: &["lfm2", "Lfm2ForCausalLM"],
    canonical_name: |stored| canonical_name(stored).map(|name| lfm2::canonical_name(&name)),
    gguf: Ok(&TextGguf::OF_LFM2),
    missing_tokenizer: TOKENIZER,
    decoder_config: |files| config(files, DecoderType::Lfm2),
    open: |files, weights| {
        let config = config(files, DecoderType::Lfm2)?;
        take(weights, "lfm2", &config)
    },
    about: About {
        models: "LFM2 and LFM2.5 with a dense decoder",
        gguf: &[("lfm2", None)],
        tested: "transformers, llama.cpp: tests/fixtures/tiny_lfm2",
        example: "LiquidAI/LFM2-350M",
    },
};

/// Qwen 3.5, and the decoder of its vision models without their towers.
pub(crate) const QWEN35: Family = Family {
    name: "qwen3_5_text",
    config_names: &["qwen3_5_text", "Qwen3_5ForCausalLM"],
    canonical_name: |stored| qwen35_name(&canonical_name(stored)?),
    gguf: Ok(&TextGguf::OF_QWEN35),
    missing_tokenizer: TOKENIZER,
    decoder_config: |files| config(files, DecoderType::Qwen35),
    open: |files, weights| {
        let config = config(files, DecoderType::Qwen35)?;
        take(weights, "qwen3_5_text", &config)
    },
    about: About {
        models: "Qwen3.5 without its tower",
        gguf: &[("qwen35", None)],
        tested: "transformers, llama.cpp: tests/fixtures/tiny_qwen3_5",
        example: "./my-qwen3.5",
    },
};

const TOKENIZER: &str = "tokenizer.json";

/// Takes the weights of a language model of the family `name`.
pub(crate) fn take(weights: &mut Weights, name: &'static str, config: &LlamaConfig) -> OpenedModel {
    Ok(Box::new(TextModel::<LlamaLayer>::take(
        weights, name, config,
    )?))
}

/// As [`take`], of a model with several streams of hidden states.
pub(crate) fn take_streams(
    weights: &mut Weights,
    name: &'static str,
    config: &LlamaConfig,
) -> OpenedModel {
    Ok(Box::new(TextModel::<StreamLayer>::take(
        weights, name, config,
    )?))
}

/// The canonical name of a tensor of a Gemma 4, from that of a Llama: the factor of a layer is no
/// weight in folders, and one in llama.cpp's files.
pub(crate) fn gemma4_name(name: String) -> String {
    if name.ends_with(".layer_scalar") {
        name + ".weight"
    } else {
        name
    }
}

/// The canonical name of a tensor of a Qwen 3.5, from that of a Qwen; none for the blocks that
/// predict further tokens.
pub(crate) fn qwen35_name(name: &str) -> Option<String> {
    let is_predicting = name.starts_with("language_model.mtp.");
    (!is_predicting).then(|| name.replacen(".linear_attn.dt_bias", ".linear_attn.dt.bias", 1))
}

/// The canonical name of a tensor: that of the decoder of a vision model.
fn canonical_name(stored: &str) -> Option<String> {
    // Old files hold the frequencies, which follow from the configuration.
    if stored.ends_with(".rotary_emb.inv_freq") {
        return None;
    }
    let name = stored.strip_prefix("model.").unwrap_or(stored);
    if name.starts_with("lm_head.") || name.starts_with("language_model.") {
        return Some(name.to_string());
    }
    Some(format!("language_model.{name}"))
}

/// The configuration of a decoder, whose keys stand at the root. A file without a `model_type` has
/// the class that its `architectures` name, else `unnamed`.
fn config(files: &ModelFiles, unnamed: DecoderType) -> Result<LlamaConfig, MllmError> {
    let (path, json) = (
        files.path("config.json"),
        files.required_json("config.json")?,
    );
    let root = ConfigObject::root(&path, &json)?;
    let classes: Vec<String> = root.list("architectures")?;
    let named = classes
        .first()
        .and_then(|class| DecoderType::of_architecture(class));
    LlamaConfig::read(root, named.unwrap_or(unnamed))
}

/// What is read of the small files, for tests of their keys.
#[cfg(test)]
pub(crate) fn read_files(files: &ModelFiles) -> Result<String, MllmError> {
    Ok(format!("{:?}", config(files, DecoderType::Llama)?))
}

#[cfg(test)]
mod tests {
    use super::canonical_name;

    #[test]
    fn every_layout_has_one_canonical_name() {
        for (name, canonical) in [
            ("model.norm.weight", Some("language_model.norm.weight")),
            (
                "layers.0.mlp.up_proj.weight",
                Some("language_model.layers.0.mlp.up_proj.weight"),
            ),
            ("lm_head.weight", Some("lm_head.weight")),
            ("model.layers.3.self_attn.rotary_emb.inv_freq", None),
        ] {
            assert_eq!(canonical_name(name).as_deref(), canonical);
        }
    }
}
