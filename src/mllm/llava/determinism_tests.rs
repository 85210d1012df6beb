//! The same weights and prompt give the same logits, to the bit, at any thread count.

use std::fmt::Write as _;
use std::path::Path;
use std::process::Command;

use candle_core::{Device, Tensor};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

use super::model::LlavaModel;
use crate::mllm::decoder::Logits;

/// Tells the test that it is the child that computes, and where its weights are.
const FOLDER: &str = "PLANAGENT_TEST_FOLDER";
const TEST: &str = "mllm::llava::determinism_tests::logits_are_the_same_bits_at_any_thread_count";

/// Writes a checkpoint of the shipped model's size (vision 4 x 192, decoder 6 x 256) with random weights: large enough
/// for the matrix products to be split over threads.
fn write_checkpoint(folder: &Path) {
    let config = serde_json::json!({
        "image_token_index": 3,
        "vision_config": {"hidden_size": 192, "intermediate_size": 768, "num_hidden_layers": 4,
            "num_attention_heads": 6, "image_size": 128, "patch_size": 16},
        "text_config": {"hidden_size": 256, "intermediate_size": 688, "num_hidden_layers": 6,
            "num_attention_heads": 8, "num_key_value_heads": 4, "vocab_size": 512, "max_position_embeddings": 512},
    });
    std::fs::write(folder.join("config.json"), config.to_string()).unwrap();
    let mut shapes: Vec<(String, Vec<usize>)> = vec![
        ("vision_tower.embeddings.class_embedding".into(), vec![192]),
        ("vision_tower.embeddings.patch_embedding.weight".into(), vec![192, 3, 16, 16]),
        ("vision_tower.embeddings.position_embedding.weight".into(), vec![65, 192]),
        ("multi_modal_projector.linear_1.weight".into(), vec![256, 192]),
        ("multi_modal_projector.linear_1.bias".into(), vec![256]),
        ("multi_modal_projector.linear_2.weight".into(), vec![256, 256]),
        ("multi_modal_projector.linear_2.bias".into(), vec![256]),
        ("language_model.embed_tokens.weight".into(), vec![512, 256]),
        ("language_model.norm.weight".into(), vec![256]),
        ("lm_head.weight".into(), vec![512, 256]),
    ];
    let mut norm = |name: String| {
        shapes.push((format!("{name}.weight"), vec![192]));
        shapes.push((format!("{name}.bias"), vec![192]));
    };
    norm("vision_tower.pre_layrnorm".into());
    for layer in 0..4 {
        let layer = format!("vision_tower.encoder.layers.{layer}");
        norm(format!("{layer}.layer_norm1"));
        norm(format!("{layer}.layer_norm2"));
    }
    for layer in 0..4 {
        let layer = format!("vision_tower.encoder.layers.{layer}");
        let attention = ["q_proj", "k_proj", "v_proj", "out_proj"].map(|part| (format!("self_attn.{part}"), 192, 192));
        let mlp = [("mlp.fc1".to_string(), 768, 192), ("mlp.fc2".to_string(), 192, 768)];
        for (part, outputs, inputs) in attention.into_iter().chain(mlp) {
            shapes.push((format!("{layer}.{part}.weight"), vec![outputs, inputs]));
            shapes.push((format!("{layer}.{part}.bias"), vec![outputs]));
        }
    }
    for layer in 0..6 {
        let layer = format!("language_model.layers.{layer}");
        for (part, outputs, inputs) in [
            ("self_attn.q_proj", 256, 256),
            ("self_attn.k_proj", 128, 256),
            ("self_attn.v_proj", 128, 256),
            ("self_attn.o_proj", 256, 256),
            ("mlp.gate_proj", 688, 256),
            ("mlp.up_proj", 688, 256),
            ("mlp.down_proj", 256, 688),
        ] {
            shapes.push((format!("{layer}.{part}.weight"), vec![outputs, inputs]));
        }
        shapes.push((format!("{layer}.input_layernorm.weight"), vec![256]));
        shapes.push((format!("{layer}.post_attention_layernorm.weight"), vec![256]));
    }
    let mut random = Pcg64Mcg::seed_from_u64(7);
    let tensors: std::collections::HashMap<String, Tensor> = shapes
        .into_iter()
        .map(|(name, shape)| {
            let count = shape.iter().product();
            let values: Vec<f32> = (0..count).map(|_| random.random_range(-0.1..0.1)).collect();
            (name, Tensor::from_vec(values, shape, &Device::Cpu).unwrap())
        })
        .collect();
    candle_core::safetensors::save(&tensors, folder.join("model.safetensors")).unwrap();
}

/// The bits of the logits of a prefill, of ten single steps and of a rewound piece.
fn logits_hash(folder: &Path) -> String {
    let model = LlavaModel::open(folder).unwrap();
    let pixels: Vec<f32> = (0..3 * 128 * 128).map(|index| (index as f32 * 0.37).sin()).collect();
    let pixels = Tensor::from_vec(pixels, (3, 128, 128), &Device::Cpu).unwrap();
    let features = model.encode_image(&pixels).unwrap();
    let ids: Vec<u32> = (10..40).chain(std::iter::repeat_n(3, 64)).chain(100..190).collect();
    let mut sequence = model.new_sequence();
    let mut hasher = blake3::Hasher::new();
    let mut add = |logits: Option<Tensor>| -> u32 {
        let row: Vec<f32> = logits.unwrap().flatten_all().unwrap().to_vec1().unwrap();
        for value in &row {
            hasher.update(&value.to_bits().to_le_bytes());
        }
        (row[0].to_bits() % 500).max(4)
    };
    let mut token = add(model.append(&mut sequence, &ids, Some(&features), Logits::All).unwrap());
    for _ in 0..10 {
        token = add(model.append(&mut sequence, &[token], Some(&features), Logits::Last).unwrap());
    }
    sequence.truncate(150);
    add(model.append(&mut sequence, &[5, 6, 7, 8, 9], Some(&features), Logits::All).unwrap());
    hasher.finalize().to_hex().to_string()
}

#[test]
fn logits_are_the_same_bits_at_any_thread_count() {
    if let Ok(folder) = std::env::var(FOLDER) {
        let folder = Path::new(&folder);
        std::fs::write(folder.join(out_file(&threads())), logits_hash(folder)).unwrap();
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    write_checkpoint(folder.path());
    let mut hashes = Vec::new();
    for threads in ["1", "2", "3"] {
        let output = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", TEST])
            .env(FOLDER, folder.path())
            .env("RAYON_NUM_THREADS", threads)
            .output()
            .unwrap();
        let mut log = String::new();
        write!(log, "{}", String::from_utf8_lossy(&output.stdout)).unwrap();
        assert!(output.status.success(), "{log}");
        hashes.push(std::fs::read_to_string(folder.path().join(out_file(threads))).expect(&log));
    }
    assert_eq!(hashes[0], hashes[1], "1 and 2 threads");
    assert_eq!(hashes[0], hashes[2], "1 and 3 threads");
}

fn threads() -> String {
    std::env::var("RAYON_NUM_THREADS").unwrap()
}

fn out_file(threads: &str) -> String {
    format!("logits-{threads}")
}
