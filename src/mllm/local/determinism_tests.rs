//! The same weights and prompt give bit-identical logits at any thread count.

use super::Sequence;
use crate::checkpoint::{ModelFiles, Weights};
use crate::decoder::Logits;
use crate::families::{Architecture, Families};
use crate::family::{ImageFeatures, VisionLanguageModel};
use candle_core::Tensor;
use image::RgbImage;
use serde_json::{Value, json};
use std::fmt::Write as _;
use std::path::Path;
use std::process::Command;

/// Set in the child process of the test: the folder for its result.
const FOLDER: &str = "PLANAGENT_TEST_FOLDER";
const TEST: &str = "local::determinism_tests::logits_are_the_same_bits_at_any_thread_count";

/// A model with random weights in the shape of a configuration.
pub(super) fn random(
    architecture: &str,
    config: &Value,
    processor: &Value,
) -> Box<dyn VisionLanguageModel> {
    let texts = [
        ("config.json", config),
        ("preprocessor_config.json", processor),
    ];
    let texts = texts.map(|(name, value)| (name.to_string(), value.to_string()));
    let files = ModelFiles::packed(Path::new(architecture), texts.into());
    let family = Architecture::named(architecture).unwrap().family();
    (family.open)(&files, &mut Weights::random(7)).unwrap()
}

/// An object with further keys.
fn with(mut value: Value, keys: Value) -> Value {
    if let (Some(value), Value::Object(keys)) = (value.as_object_mut(), keys) {
        value.extend(keys);
    }
    value
}

/// A picture of this size.
fn picture(width: u32, height: u32) -> RgbImage {
    RgbImage::from_fn(width, height, |x, y| {
        image::Rgb([x as u8, y as u8, (x * y) as u8])
    })
}

/// A Gemma 4 around this decoder.
fn pooled(text: &Value, varied: &Value) -> Value {
    json!({"image_token_id": 3, "text_config": with(text.clone(), varied.clone()),
        "vision_config": {"hidden_size": 128, "intermediate_size": 192, "num_hidden_layers": 3, "num_attention_heads": 4,
            "num_key_value_heads": 2, "head_dim": 32, "patch_size": 8, "position_embedding_size": 120,
            "use_clipped_linears": true, "standardize": true}})
}

/// A Gemma 3n around this decoder.
fn fused(text: &Value, streamed: &Value) -> Value {
    json!({"image_token_id": 3, "text_config": with(text.clone(), streamed.clone()),
        "vision_soft_tokens_per_image": 16, "audio_config": {"vocab_offset": 509, "vocab_size": 3}, "vision_config": {
            "vocab_offset": 506, "vocab_size": 3, "model_args": {"stem_size": 32, "msfa_output_resolution": 4, "block_args": [
                [{"block_type": "er", "out_chs": 48, "stride": 2, "exp_ratio": 4}],
                [{"block_type": "uir", "out_chs": 64, "stride": 2, "dw_kernel_size_start": 3, "dw_kernel_size_mid": 5}],
                [{"block_type": "uir", "out_chs": 96, "stride": 2, "exp_ratio": 4},
                    {"block_type": "mqa", "out_chs": 96, "stride": 1, "num_heads": 4, "key_dim": 32, "value_dim": 32,
                        "kv_stride": 2}],
                [{"block_type": "uir", "out_chs": 128, "stride": 2, "exp_ratio": 4}]]}}})
}

/// Models of nano's size (vision 4 x 192, decoder 6 x 256) with random weights, large enough to
/// split matrix products over threads: every family that is built in.
fn models() -> Vec<(Box<dyn VisionLanguageModel>, RgbImage)> {
    let tower = |heads: &str, image_size: u32| {
        json!({"hidden_size": 192, "intermediate_size": 768, "num_hidden_layers": 4, heads: 6, "image_size": image_size,
            "patch_size": 16})
    };
    let text = json!({"hidden_size": 256, "intermediate_size": 688, "num_hidden_layers": 6, "num_attention_heads": 8,
        "num_key_value_heads": 4, "vocab_size": 512, "max_position_embeddings": 512});
    let grids = json!([[128, 256], [256, 128]]);
    let llava = json!({"image_token_index": 3, "vision_config": tower("num_attention_heads", 128), "text_config": text,
        "image_grid_pinpoints": grids});
    let square = json!({"size": 128, "crop_size": 128, "image_grid_pinpoints": grids});
    let cogvlm = with(
        text.clone(),
        json!({"num_key_value_heads": 8, "vision_config": tower("num_heads", 128)}),
    );
    let tiles = |keys: Value| {
        with(
            keys,
            json!({"image_token_id": 3, "text_config": text, "vision_config": tower("num_attention_heads", 64)}),
        )
    };
    let longest = json!({"size": {"longest_edge": 128}, "max_image_size": {"longest_edge": 64}});
    let axes = |lengths: [u32; 3], vision: Value| {
        let rope = json!({"rope_type": "default", "mrope_section": lengths});
        // The epsilon and activation of these towers are their own.
        let mut sizes = tower("num_heads", 128);
        sizes.as_object_mut().unwrap().remove("num_hidden_layers");
        json!({"image_token_id": 3, "text_config": with(text.clone(), json!({"head_dim": 32, "rope_parameters": rope})),
            "vision_config": with(with(sizes, json!({"depth": 4})), vision)})
    };
    let deep = json!({"num_position_embeddings": 64, "deepstack_visual_indexes": [0, 2]});
    let windows = json!({"window_size": 64, "fullatt_block_indexes": [1, 3]});
    let onevision = json!({"image_token_index": 3, "vision_config": tower("num_attention_heads", 128),
        "text_config": text, "image_grid_pinpoints": grids, "vision_aspect_ratio": "anyres_max_1"});
    let local = json!({"head_dim": 32, "sliding_window": 24, "sliding_window_pattern": 2});
    let gemma = json!({"image_token_index": 3, "mm_tokens_per_image": 16,
        "vision_config": tower("num_attention_heads", 128), "text_config": with(text.clone(), local)});
    let varied = json!({"head_dim": 32, "global_head_dim": 64, "num_kv_shared_layers": 2, "use_double_wide_mlp": true,
        "sliding_window": 24, "hidden_size_per_layer_input": 32, "use_bidirectional_attention": "vision",
        "vocab_size_per_layer_input": text["vocab_size"], "final_logit_softcapping": 5.0,
        "layer_types": (0..text["num_hidden_layers"].as_u64().unwrap())
            .map(|layer| if layer % 2 == 1 { "full_attention" } else { "sliding_attention" })
            .collect::<Vec<_>>()});
    let pooled = pooled(&text, &varied);
    let streamed = json!({"model_type": "gemma3n_text", "head_dim": 32, "num_kv_shared_layers": 2, "sliding_window": 24,
        "hidden_size_per_layer_input": 32, "laurel_rank": 32, "layer_types": varied["layer_types"],
        "activation_sparsity_pattern": vec![0.7; text["num_hidden_layers"].as_u64().unwrap() as usize]});
    let fused = fused(&text, &streamed);
    let whole = json!({"embed_dim": 192, "hidden_size": 256});
    let pixels = json!({"size": {"shortest_edge": 1024, "longest_edge": 65_536}});
    let convolve = json!({"model_type": "lfm2", "block_auto_adjust_ff_dim": false,
        "layer_types": ["conv", "conv", "full_attention", "conv", "full_attention", "conv"]});
    let mut convolving = tiles(json!({"projector_hidden_size": 128}));
    convolving["text_config"] = with(text.clone(), convolve.clone());
    convolving["vision_config"]["num_patches"] = json!(16);
    let views =
        json!({"tile_size": 64, "min_image_tokens": 4, "max_image_tokens": 8, "max_tiles": 4});
    let mut biased = tiles(json!({}));
    biased["vision_config"]["attention_bias"] = json!(true);
    let mut ruled = axes([4, 2, 2], json!({"num_position_embeddings": 64}));
    let rule = json!({"full_attention_interval": 3, "linear_num_key_heads": 2, "linear_num_value_heads": 4,
        "linear_key_head_dim": 32, "linear_value_head_dim": 48, "partial_rotary_factor": 0.5});
    ruled["text_config"] = with(ruled["text_config"].take(), rule.clone());
    let models = vec![
        (random("llava", &llava, &square), picture(128, 128)),
        (random("llava-next", &llava, &square), picture(200, 90)),
        (random("cogvlm", &cogvlm, &json!({})), picture(140, 100)),
        (
            random("smolvlm", &tiles(json!({})), &longest),
            picture(120, 90),
        ),
        (
            random("internvl", &biased, &json!({"max_patches": 4, "size": 64})),
            picture(100, 200),
        ),
        (
            random("qwen3-vl", &axes([6, 5, 5], deep), &pixels),
            picture(160, 100),
        ),
        (
            random("qwen2.5-vl", &axes([4, 6, 6], windows), &pixels),
            picture(130, 170),
        ),
        (
            random("qwen2-vl", &axes([4, 6, 6], whole), &pixels),
            picture(170, 130),
        ),
        (
            random("llava-onevision", &onevision, &square),
            picture(200, 90),
        ),
        (
            random(
                "gemma3",
                &gemma,
                &json!({"size": {"height": 128, "width": 128}}),
            ),
            picture(90, 70),
        ),
        (
            random(
                "gemma3n",
                &fused,
                &json!({"size": {"height": 128, "width": 128}}),
            ),
            picture(90, 70),
        ),
        (
            random(
                "gemma4",
                &pooled,
                &json!({"max_soft_tokens": 20, "patch_size": 8}),
            ),
            picture(100, 150),
        ),
        (random("lfm2-vl", &convolving, &views), picture(130, 170)),
        (random("qwen3.5", &ruled, &pixels), picture(160, 100)),
    ];
    // Models that read text alone.
    let local = json!({"model_type": "gemma3_text", "head_dim": 32, "sliding_window": 24, "sliding_window_pattern": 2});
    let texts = [
        ("llama", json!({"model_type": "llama"})),
        ("qwen2", json!({"model_type": "qwen2"})),
        ("qwen3", json!({"model_type": "qwen3", "head_dim": 32})),
        ("gemma3_text", local),
        ("gemma3n_text", streamed.clone()),
        (
            "gemma4_text",
            with(varied, json!({"model_type": "gemma4_text"})),
        ),
        ("lfm2", convolve),
        (
            "qwen3_5_text",
            with(
                rule,
                json!({"model_type": "qwen3_5_text", "head_dim": 32, "rope_parameters": {"mrope_section": [4, 2, 2]}}),
            ),
        ),
    ];
    let texts = texts.map(|(name, keys)| {
        let model = random(name, &with(text.clone(), keys), &json!({}));
        (model, picture(1, 1))
    });
    let models: Vec<_> = models.into_iter().chain(texts).collect();
    let known: Vec<&str> = Families::default().iter().map(Architecture::name).collect();
    assert_eq!(
        models
            .iter()
            .map(|(model, _)| model.info().architecture)
            .collect::<Vec<_>>(),
        known
    );
    models
}

/// The features of an image; none in a model that reads text alone.
fn features_of(model: &dyn VisionLanguageModel, image: &RgbImage) -> Option<ImageFeatures> {
    model.info().image_size?;
    Some(model.encode_image(image).unwrap())
}

/// A hash of the logits of a prefill, ten single steps and a rewound piece, for every family.
fn logits_hash() -> String {
    let mut hasher = blake3::Hasher::new();
    for (model, image) in models() {
        let model = &*model;
        let features = features_of(model, &image);
        let patches = features.as_ref().map_or(0, ImageFeatures::tokens);
        let ids: Vec<u32> = (10..40)
            .chain(std::iter::repeat_n(model.info().image_token, patches))
            .chain(100..190)
            .collect();
        let mut sequence = Sequence::new(model);
        let mut add = |logits: Option<Tensor>| -> u32 {
            let row: Vec<f32> = logits.unwrap().flatten_all().unwrap().to_vec1().unwrap();
            assert!(row.iter().all(|value| value.is_finite()));
            for value in &row {
                hasher.update(&value.to_bits().to_le_bytes());
            }
            (row[0].to_bits() % 500).max(4)
        };
        let mut token = add(sequence
            .append(model, &ids, features.as_ref(), Logits::All)
            .unwrap());
        for _ in 0..10 {
            token = add(sequence
                .append(model, &[token], features.as_ref(), Logits::Last)
                .unwrap());
        }
        let again = sequence.cut(patches + 86);
        let piece = [again.as_slice(), &[5, 6, 7, 8, 9]].concat();
        add(sequence
            .append(model, &piece, features.as_ref(), Logits::Tail(5))
            .unwrap());
    }
    hasher.finalize().to_hex().to_string()
}

#[test]
fn logits_are_the_same_bits_at_any_thread_count() {
    if let Ok(folder) = std::env::var(FOLDER) {
        let folder = Path::new(&folder);
        std::fs::write(folder.join(out_file(&threads())), logits_hash()).unwrap();
        return;
    }
    let folder = tempfile::tempdir().unwrap();
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

#[test]
fn a_prompt_in_chunks_gives_the_logits_of_the_whole_also_where_a_chunk_ends_inside_the_image() {
    for (model, image) in models() {
        let model = &*model;
        let features = features_of(model, &image);
        let patches = features.as_ref().map_or(0, ImageFeatures::tokens);
        let ids: Vec<u32> = (10..40)
            .chain(std::iter::repeat_n(model.info().image_token, patches))
            .chain(100..150)
            .collect();
        let logits = |chunk: usize| -> Vec<f32> {
            let mut sequence = Sequence::new(model);
            let mut logits = None;
            for part in ids.chunks(chunk) {
                logits = sequence
                    .append(model, part, features.as_ref(), Logits::Last)
                    .unwrap();
            }
            logits.unwrap().flatten_all().unwrap().to_vec1().unwrap()
        };
        let (whole, chunks) = (logits(ids.len()), logits(33));
        let apart = whole
            .iter()
            .zip(&chunks)
            .map(|(a, b)| (a - b).abs())
            .fold(0.0, f32::max);
        assert!(apart < 1e-4, "{}: {apart}", model.info().architecture);
    }
}
