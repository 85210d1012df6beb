//! The same weights and prompt give bit-identical logits at any thread count.

use std::fmt::Write as _;
use std::path::Path;
use std::process::Command;

use candle_core::Tensor;
use image::RgbImage;
use serde_json::json;

use super::Sequence;
use crate::mllm::cogvlm::CogVlm;
use crate::mllm::decoder::Logits;
use crate::mllm::family::VisionLanguageModel;
use crate::mllm::llava::Llava;
use crate::mllm::llava_next::LlavaNext;

/// Set in the child process of the test: the folder for its result.
const FOLDER: &str = "PLANAGENT_TEST_FOLDER";
const TEST: &str = "mllm::local::determinism_tests::logits_are_the_same_bits_at_any_thread_count";

/// Models of nano's size (vision 4 x 192, decoder 6 x 256) with random weights, large enough to split matrix products over
/// threads.
fn models() -> Vec<(Box<dyn VisionLanguageModel>, RgbImage)> {
    let vision = |heads: &str| {
        json!({"hidden_size": 192, "intermediate_size": 768, "num_hidden_layers": 4, heads: 6, "image_size": 128,
            "patch_size": 16})
    };
    let text = json!({"hidden_size": 256, "intermediate_size": 688, "num_hidden_layers": 6, "num_attention_heads": 8,
        "num_key_value_heads": 4, "vocab_size": 512, "max_position_embeddings": 512});
    let llava = json!({"image_token_index": 3, "vision_config": vision("num_attention_heads"), "text_config": text,
        "image_grid_pinpoints": [[128, 256], [256, 128]]});
    let mut cogvlm = text.clone();
    cogvlm["num_key_value_heads"] = json!(8);
    cogvlm["vision_config"] = vision("num_heads");
    let picture =
        |width, height| RgbImage::from_fn(width, height, |x, y| image::Rgb([x as u8, y as u8, (x * y) as u8]));
    vec![
        (Box::new(Llava::random(&llava)), picture(128, 128)),
        (Box::new(LlavaNext::random(&llava)), picture(200, 90)),
        (Box::new(CogVlm::random(&cogvlm)), picture(140, 100)),
    ]
}

/// A hash of the logits of a prefill, ten single steps and a rewound piece, for every family.
fn logits_hash() -> String {
    let mut hasher = blake3::Hasher::new();
    for (model, image) in models() {
        let model = &*model;
        let features = model.encode_image(&image).unwrap();
        let patches = features.layout.tokens;
        let ids: Vec<u32> =
            (10..40).chain(std::iter::repeat_n(model.info().image_token, patches)).chain(100..190).collect();
        let mut sequence = Sequence::new(model);
        let mut add = |logits: Option<Tensor>| -> u32 {
            let row: Vec<f32> = logits.unwrap().flatten_all().unwrap().to_vec1().unwrap();
            assert!(row.iter().all(|value| value.is_finite()));
            for value in &row {
                hasher.update(&value.to_bits().to_le_bytes());
            }
            (row[0].to_bits() % 500).max(4)
        };
        let mut token = add(sequence.append(model, &ids, Some(&features), Logits::All).unwrap());
        for _ in 0..10 {
            token = add(sequence.append(model, &[token], Some(&features), Logits::Last).unwrap());
        }
        sequence.truncate(patches + 86);
        add(sequence.append(model, &[5, 6, 7, 8, 9], Some(&features), Logits::All).unwrap());
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
        let features = model.encode_image(&image).unwrap();
        let patches = features.layout.tokens;
        let ids: Vec<u32> =
            (10..40).chain(std::iter::repeat_n(model.info().image_token, patches)).chain(100..150).collect();
        let logits = |chunk: usize| -> Vec<f32> {
            let mut sequence = Sequence::new(model);
            let mut logits = None;
            for part in ids.chunks(chunk) {
                logits = sequence.append(model, part, Some(&features), Logits::Last).unwrap();
            }
            logits.unwrap().flatten_all().unwrap().to_vec1().unwrap()
        };
        let (whole, chunks) = (logits(ids.len()), logits(33));
        let apart = whole.iter().zip(&chunks).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(apart < 1e-4, "{}: {apart}", model.info().architecture);
    }
}
