//! The configuration and the tensors of candle's model, under its names.

use crate::MllmError;
use crate::checkpoint::{ConfigObject, ModelFiles, Weights};
use crate::qwen3_vl::{Qwen3VlConfig, canonical_name};
use candle_core::{DType, Device, Tensor};
use candle_transformers::models::qwen3_vl::Config;
use serde_json::json;
use std::collections::HashMap;

/// The configuration in candle's form.
pub(super) fn config(
    files: &ModelFiles,
    Qwen3VlConfig {
        vision,
        positions,
        merge,
        frames,
        deep,
        text,
        image_token,
    }: &Qwen3VlConfig,
    tied: bool,
) -> Result<Config, MllmError> {
    let (path, file) = (
        files.path("config.json"),
        files.required_json("config.json")?,
    );
    let root = ConfigObject::root(&path, &file)?;
    let act: Option<String> = root
        .child("vision_config")?
        .map(|vision| vision.value("hidden_act"))
        .transpose()?
        .flatten();
    let config = json!({
        "text_config": {
            "head_dim": text.head_dim, "vocab_size": text.vocabulary, "hidden_size": text.hidden,
            "intermediate_size": text.intermediate, "num_hidden_layers": text.layers, "num_attention_heads": text.heads,
            "num_key_value_heads": text.kv_heads, "hidden_act": "silu", "max_position_embeddings": text.context,
            "rms_norm_eps": text.rms_norm_eps, "tie_word_embeddings": tied, "rope_theta": text.rope.theta,
            "sliding_window": null,
        },
        "vision_config": {
            "depth": vision.layers, "hidden_size": vision.hidden, "out_hidden_size": text.hidden,
            "hidden_act": act.unwrap_or_else(|| "gelu_pytorch_tanh".into()), "intermediate_size": vision.intermediate,
            "num_heads": vision.heads, "in_chans": 3, "patch_size": vision.patch_size, "spatial_merge_size": merge,
            "temporal_patch_size": frames, "num_position_embeddings": positions * positions,
            "deepstack_visual_indexes": deep,
        },
        // Only images are shown, so the other ids are not looked at.
        "image_token_id": image_token, "video_token_id": 0, "vision_start_token_id": 0, "vision_end_token_id": 0,
    });
    serde_json::from_value(config).map_err(|error| root.error("vision_config", error.to_string()))
}

/// Takes all tensors, in f32.
pub(super) fn take(
    weights: &mut Weights,
    config: &Config,
) -> Result<HashMap<String, Tensor>, MllmError> {
    let mut tensors = HashMap::new();
    for (name, shape) in names(config) {
        tensors.insert(name.clone(), weights.take(&canonical_name(&name), &shape)?);
    }
    if !config.text_config.tie_word_embeddings {
        // Candle asks for a bias of the output layer, which no checkpoint has.
        let bias = Tensor::zeros(config.text_config.vocab_size, DType::F32, &Device::Cpu)?;
        tensors.insert("lm_head.bias".into(), bias);
    }
    Ok(tensors)
}

/// Names and shapes of the tensors of a model.
fn names(config: &Config) -> Vec<(String, Vec<usize>)> {
    let (text, vision) = (&config.text_config, &config.vision_config);
    let width = vision.hidden_size;
    let mut names = Vec::new();
    let mut add = |name: String, shape: &[usize]| names.push((name, shape.to_vec()));
    let patch = [
        width,
        vision.in_chans,
        vision.temporal_patch_size,
        vision.patch_size,
        vision.patch_size,
    ];
    biased(&mut add, "model.visual.patch_embed.proj", &patch);
    add(
        "model.visual.pos_embed.weight".into(),
        &[vision.num_position_embeddings, width],
    );
    for layer in 0..vision.depth {
        let block = format!("model.visual.blocks.{layer}");
        biased(&mut add, &format!("{block}.norm1"), &[width]);
        biased(&mut add, &format!("{block}.norm2"), &[width]);
        biased(&mut add, &format!("{block}.attn.qkv"), &[3 * width, width]);
        biased(&mut add, &format!("{block}.attn.proj"), &[width, width]);
        biased(
            &mut add,
            &format!("{block}.mlp.linear_fc1"),
            &[vision.intermediate_size, width],
        );
        biased(
            &mut add,
            &format!("{block}.mlp.linear_fc2"),
            &[width, vision.intermediate_size],
        );
    }
    let merged = width * vision.spatial_merge_size * vision.spatial_merge_size;
    let deep = (0..vision.deepstack_visual_indexes.len())
        .map(|index| (format!("deepstack_merger_list.{index}"), merged));
    for (merger, normed) in deep.chain([("merger".to_owned(), width)]) {
        let merger = format!("model.visual.{merger}");
        biased(&mut add, &format!("{merger}.norm"), &[normed]);
        biased(&mut add, &format!("{merger}.linear_fc1"), &[merged, merged]);
        biased(
            &mut add,
            &format!("{merger}.linear_fc2"),
            &[vision.out_hidden_size, merged],
        );
    }
    let hidden = text.hidden_size;
    let decoder = "model.language_model";
    let (queries, keys) = (
        text.num_attention_heads * text.head_dim,
        text.num_key_value_heads * text.head_dim,
    );
    add(
        format!("{decoder}.embed_tokens.weight"),
        &[text.vocab_size, hidden],
    );
    add(format!("{decoder}.norm.weight"), &[hidden]);
    for layer in 0..text.num_hidden_layers {
        for (part, shape) in [
            ("self_attn.q_proj", &[queries, hidden][..]),
            ("self_attn.k_proj", &[keys, hidden]),
            ("self_attn.v_proj", &[keys, hidden]),
            ("self_attn.o_proj", &[hidden, queries]),
            ("self_attn.q_norm", &[text.head_dim]),
            ("self_attn.k_norm", &[text.head_dim]),
            ("mlp.gate_proj", &[text.intermediate_size, hidden]),
            ("mlp.up_proj", &[text.intermediate_size, hidden]),
            ("mlp.down_proj", &[hidden, text.intermediate_size]),
            ("input_layernorm", &[hidden]),
            ("post_attention_layernorm", &[hidden]),
        ] {
            add(format!("{decoder}.layers.{layer}.{part}.weight"), shape);
        }
    }
    if !text.tie_word_embeddings {
        add("lm_head.weight".into(), &[text.vocab_size, hidden]);
    }
    names
}

/// A weight of this shape and its bias.
fn biased(add: &mut impl FnMut(String, &[usize]), name: &str, shape: &[usize]) {
    add(format!("{name}.weight"), shape);
    add(
        format!("{name}.bias"),
        shape.get(..1).expect("a weight has one dimension at least"),
    );
}
