//! Parity with numbers that are not part of the project: tiny language models as folders and as
//! llama.cpp's files, and two real models. CONTRIBUTING.md says where the data and the weights are
//! from, and `.ci/run long` runs these tests.

use super::test_prompts::Prompts;
use super::test_reference::{
    Reference, assert_greedy, assert_logits, data, difference, feature_difference, fixture, greedy,
    logits_in_pieces,
};
use super::{Loading, LocalModel, Sequence};
use crate::checkpoint::read_json;
use crate::families::Families;
use crate::family::ImageSettings;
use crate::lfm2_vl::reference_tests::check_lfm2_vl;
use crate::source::{Checkpoint, ModelPlace};
use candle_core::Tensor;
use serde_json::Value;
use std::collections::HashMap;
use std::path::PathBuf;

/// The check of a model.
type Check = fn(&str);

/// Models of larger shapes than those of `tests/fixtures`, and the check of each.
const TINY: [(&str, Check); 11] = [
    ("text/llama", check_text),
    ("text/qwen2", check_text),
    ("text/qwen3", check_text),
    ("text/gemma3_text", check_text),
    ("text/lfm2", check_text),
    ("qwen2_vl", check_folder_and_gguf),
    ("qwen3_5", check_folder_and_gguf),
    ("llava_onevision", check_folder),
    ("gemma3", check_gemma3),
    ("gemma4", check_gemma4),
    ("lfm2_vl", |_| check_lfm2_vl()),
];

#[test]
#[ignore = "needs mllm_reference in $PLANAGENT_DATA"]
fn tiny_models_are_those_of_transformers_as_folders_and_gguf() {
    let failed = TINY
        .iter()
        .filter(|(name, check)| std::panic::catch_unwind(|| check(name)).is_err());
    let failed: Vec<&str> = failed.map(|(name, _)| *name).collect();
    assert!(
        failed.is_empty(),
        "other numbers than the reference: {failed:?}"
    );
}

fn check_text(name: &str) {
    let folder = data().join("mllm_reference").join(name);
    let reference = Reference::open(&folder.join("reference.safetensors"));
    let prompts = read_json(&folder.join("prompts.json")).unwrap();
    for place in [folder.clone(), folder.join("gguf")] {
        let local = LocalModel::open("tiny", &place).unwrap();
        let model = &*local.model;
        assert_eq!(name, format!("text/{}", model.info().architecture));
        for run in ["", "chat_", "long_"] {
            let ids = reference.ids(&format!("{run}input_ids"), 0);
            let text = prompts["runs"][run]["text"].as_str().unwrap();
            let read = local.tokenizer.encode_text(text).unwrap();
            assert_eq!(read, ids, "{name}, '{run}'");
            let expected = reference.tensor(&format!("{run}logits"));
            let worst = assert_logits(model, &ids, None, expected);
            let tokens = reference.ids(&format!("{run}generated"), 0);
            assert_greedy(model, &ids, None, &tokens);
            println!("{} '{run}': logits {worst:.1e}", place.display());
        }
    }
}

fn check_folder(name: &str) {
    let prompts = Prompts::from_data(name);
    prompts.check(&prompts.open(".", ImageSettings::default()), |_| true);
}

fn check_folder_and_gguf(name: &str) {
    check_folder(name);
    let prompts = Prompts::from_data(name);
    let folder = prompts.gguf_with("preprocessor_config.json");
    prompts.check(&Prompts::open_at(folder.path()), |_| true);
}

/// llama.cpp's converter rounds Gemma's projection to f16.
fn check_gemma3(name: &str) {
    check_folder(name);
    let prompts = Prompts::from_data(name);
    let gguf = prompts.open_gguf(ImageSettings::default());
    prompts.check(&gguf, |run| run == "text_");
    let features = gguf.model.encode_image(&prompts.image(1)).unwrap();
    let expected = prompts.reference.tensor("second_features");
    let found = feature_difference(&features.rows, expected);
    println!("{}: features {found:.1e}", prompts.folder.display());
    assert!(found < 1e-3, "the features differ by {found}");
}

/// Attention without a scale: torch's logits in f32 are up to 1.6e-4 from its own in f64.
fn check_gemma4(name: &str) {
    let prompts = Prompts::from_data(name);
    let folder = prompts.gguf_with("preprocessor_config.json");
    for folder in [prompts.folder.as_path(), folder.path()] {
        prompts.check_within(2e-4, &Prompts::open_at(folder), |_| true);
    }
}

/// A real model, and how far its numbers may be from the reference's.
struct Real {
    /// Its name in the reference, and its file.
    name: &'static str,
    file: &'static str,
    /// Of logits in exact arithmetic.
    tolerance: f64,
    /// Greedy tokens of three prompts that are decided by more than that.
    greedy: [usize; 3],
}

const MODELS: [Real; 2] = [
    Real {
        name: "SmolLM2-135M-Instruct Q4_1",
        file: "SmolLM2-135M-Instruct.Q4_1.gguf",
        tolerance: 1e-4,
        greedy: [32; 3],
    },
    Real {
        name: "Gemma 3 270M (base) Q4_K_M",
        file: "gemma-3-270m-q4_k_m.gguf",
        tolerance: 1e-3,
        greedy: [32; 3],
    },
];

/// A chat template for a file that has none.
const PLAIN: &str = "{% for m in messages %}{{ m.content }}{% endfor %}";

/// The file of a model in a folder of its own with a chat template beside it where it has none;
/// none if it is not in `$PLANAGENT_WEIGHTS`.
fn file_of(real: &Real) -> Option<(tempfile::TempDir, ModelPlace)> {
    let weights = std::env::var_os("PLANAGENT_WEIGHTS").map(PathBuf::from)?;
    let file = weights.join(real.file);
    if !file.is_file() {
        println!("SKIPPED: there is no {}", file.display());
        return None;
    }
    let folder = tempfile::tempdir().unwrap();
    let model = folder.path().join(real.file);
    std::fs::hard_link(&file, &model)
        .or_else(|_| std::fs::copy(&file, &model).map(drop))
        .unwrap();
    if real.file.starts_with("gemma") {
        std::fs::write(folder.path().join("chat_template.jinja"), PLAIN).unwrap();
    }
    let mmproj = None;
    Some((folder, ModelPlace::Gguf { model, mmproj }))
}

fn load(place: &ModelPlace) -> LocalModel {
    LocalModel::load("real", place, &Loading::default()).unwrap()
}

/// The files' weights, written out in f32 as a folder: all arithmetic is exact then.
fn written_out(place: &ModelPlace) -> tempfile::TempDir {
    let mut checkpoint = Checkpoint::open(place, None, &Families::default()).unwrap();
    let shapes: Vec<(String, Vec<usize>)> = checkpoint
        .weights
        .shapes()
        .map(|(name, shape)| (name.to_owned(), shape.to_vec()))
        .collect();
    let offset = checkpoint.weights.norms_have_one();
    let mut tensors = HashMap::new();
    for (name, shape) in shapes {
        let mut tensor = checkpoint.weights.take(&name, &shape).unwrap();
        if offset && name.ends_with("norm.weight") {
            tensor = (tensor - 1.0).unwrap();
        }
        tensors.insert(name, tensor);
    }
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    candle_core::safetensors::save(&tensors, path("model.safetensors")).unwrap();
    for name in [
        "config.json",
        "generation_config.json",
        "tokenizer.json",
        "tokenizer_config.json",
        "chat_template.jinja",
    ] {
        if let Some(text) = checkpoint.files.text(name).unwrap() {
            std::fs::write(path(name), text).unwrap();
        }
    }
    folder
}

fn list(value: &Value) -> Vec<u32> {
    serde_json::from_value(value.clone()).unwrap()
}

#[test]
#[ignore = "needs the files of $PLANAGENT_WEIGHTS"]
fn tokens_of_real_models_are_those_of_llama_cpp() {
    let reference = read_json(&fixture("token_ids/text_model_ids.json")).unwrap();
    let texts: Vec<String> = serde_json::from_value(reference["texts"].clone()).unwrap();
    assert_eq!(texts.len(), 100);
    for real in &MODELS {
        let Some((_folder, place)) = file_of(real) else {
            continue;
        };
        let local = load(&place);
        let mut wrong = Vec::new();
        for (index, text) in texts.iter().enumerate() {
            let expected = list(&reference["ids"][real.file][index]);
            let mut found = local.tokenizer.encode_text(text).unwrap();
            // What a chat begins with: nothing, or the beginning of a sequence.
            let begun = local.tokenizer.encode_chat("").unwrap();
            found.splice(0..0, begun);
            if found != expected {
                wrong.push(format!("{text:?}: {found:?} instead of {expected:?}"));
            }
        }
        assert!(wrong.is_empty(), "{}: {wrong:#?}", real.name);
    }
}

/// Perplexity of the tokens after the first, by logits in f64.
fn perplexity(logits: &[Vec<f32>], ids: &[u32]) -> f64 {
    let losses = logits.iter().zip(&ids[1..]).map(|(row, id)| {
        let largest = row.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        let sum: f64 = row
            .iter()
            .map(|logit| f64::from(logit - largest).exp())
            .sum();
        sum.ln() - f64::from(row[*id as usize] - largest)
    });
    (losses.sum::<f64>() / (ids.len() - 1) as f64).exp()
}

fn likeliest(logits: &[Vec<f32>]) -> Vec<u32> {
    logits
        .iter()
        .map(|row| crate::sampling::most_likely(row).unwrap())
        .collect()
}

fn logits_of(local: &LocalModel, ids: &[u32]) -> Tensor {
    logits_in_pieces(&*local.model, ids, None, &[])
}

#[test]
#[ignore = "needs the files of $PLANAGENT_WEIGHTS and real_weights in $PLANAGENT_DATA"]
fn numbers_of_real_models_are_exact_in_f32_and_near_in_their_own_formats() {
    let path = data().join("real_weights/reference.json");
    let reference = read_json(&path).unwrap();
    for real in &MODELS {
        let Some((_folder, place)) = file_of(real) else {
            continue;
        };
        let expected = &reference["models"][real.name];
        let ids = list(&expected["all_ids"]);
        let folder = written_out(&place);
        let exact = load(&ModelPlace::Folder(folder.path().to_path_buf()));
        let text = reference["text"].as_str().unwrap();
        assert_eq!(exact.tokenizer.encode_chat(text).unwrap(), ids);
        let logits = logits_of(&exact, &ids);
        assert_exact(real, &expected["exact"], &logits, &ids);
        for (run, count) in expected["greedy"]
            .as_array()
            .unwrap()
            .iter()
            .zip(real.greedy)
        {
            let mut sequence = Sequence::new(&*exact.model);
            let prompt = list(&run["prompt_ids"]);
            let found = greedy(&*exact.model, &mut sequence, &prompt, None, count);
            assert_eq!(found, list(&run["exact"]["tokens"])[..count], "{run}");
        }
        drop(exact);
        let own = logits_of(&load(&place), &ids);
        assert_near(real, expected, &logits, &own, &ids);
    }
}

/// Twenty prompts of several kinds, 64 tokens each. transformers read the GGUF files itself.
#[test]
#[ignore = "needs the files of $PLANAGENT_WEIGHTS"]
fn greedy_tokens_of_real_models_are_those_of_transformers() {
    let reference = read_json(&fixture("real_weights/greedy.json")).unwrap();
    for real in &MODELS {
        let Some((_folder, place)) = file_of(real) else {
            continue;
        };
        let runs = reference[real.file].as_array().unwrap();
        assert_eq!(runs.len(), 20);
        let folder = written_out(&place);
        let exact = load(&ModelPlace::Folder(folder.path().to_path_buf()));
        for run in runs {
            let prompt = exact.tokenizer.encode_chat(run["prompt"].as_str().unwrap());
            assert_eq!(prompt.as_ref().unwrap(), &list(&run["prompt_ids"]), "{run}");
            let expected = list(&run["tokens"]);
            assert_eq!(expected.len(), 64);
            let mut sequence = Sequence::new(&*exact.model);
            let prompt = prompt.unwrap();
            let found = greedy(&*exact.model, &mut sequence, &prompt, None, expected.len());
            assert_eq!(found, expected, "{}: {run}", real.name);
        }
        println!(
            "{}: greedy tokens of 20 prompts are transformers'",
            real.name
        );
    }
}

/// Checks logits in exact arithmetic.
fn assert_exact(real: &Real, expected: &Value, logits: &Tensor, ids: &[u32]) {
    let rows: Vec<Vec<f32>> = logits.to_vec2().unwrap();
    let found = perplexity(&rows, ids);
    let wanted = expected["perplexity"].as_f64().unwrap();
    println!("{}: perplexity {found:.4}, exact {wanted}", real.name);
    assert!((found / wanted - 1.0).abs() < 1e-4, "{found}");
    assert_eq!(
        likeliest(&rows),
        list(&expected["argmax_at_each_position"]),
        "{}",
        real.name
    );
    let last = rows.last().unwrap();
    let first_ids = expected["logits_of_ids_0_to_7_at_last_position"]
        .as_array()
        .unwrap()
        .iter()
        .enumerate()
        .map(|(id, logit)| (id, logit.as_f64().unwrap()));
    let pair = |pair: &Value| {
        (
            pair[0].as_u64().unwrap() as usize,
            pair[1].as_f64().unwrap(),
        )
    };
    let best = expected["top10_at_last_position"].as_array().unwrap();
    let mut worst = 0.0_f64;
    for (id, logit) in first_ids.chain(best.iter().map(pair)) {
        worst = worst.max((f64::from(last[id]) - logit).abs());
    }
    println!("{}: logits differ by {worst:.1e} at most", real.name);
    // The reference has four digits behind the point.
    assert!(worst < real.tolerance + 5e-5, "{}: {worst}", real.name);
}

/// Checks logits of the file as it is against the exact ones.
fn assert_near(real: &Real, expected: &Value, exact: &Tensor, own: &Tensor, ids: &[u32]) {
    let apart = f64::from(difference(own, exact));
    let theirs = expected["llama_cpp"]["largest_logit_difference_to_exact"]
        .as_f64()
        .unwrap();
    let rows: Vec<Vec<f32>> = own.to_vec2().unwrap();
    let (found, wanted) = (
        perplexity(&rows, ids),
        expected["exact"]["perplexity"].as_f64().unwrap(),
    );
    let exact = likeliest(&exact.to_vec2().unwrap());
    let same = likeliest(&rows)
        .iter()
        .zip(&exact)
        .filter(|(a, b)| a == b)
        .count();
    println!(
        "{}: as it is: logits differ by {apart:.3} (llama.cpp {theirs}), perplexity {found:.4}, {same} of {} alike",
        real.name,
        exact.len()
    );
    assert!(apart <= 1.2 * theirs, "{}: {apart}", real.name);
    assert!(
        (found / wanted - 1.0).abs() < 5e-3,
        "{}: {found}",
        real.name
    );
    assert!(
        same as f64 >= 0.97 * exact.len() as f64,
        "{}: {same}",
        real.name
    );
}

/// A window hides what lies before it: a long text of a real Gemma tells a window of 512 from one
/// that is one wider or narrower.
#[test]
#[ignore = "needs the files of $PLANAGENT_WEIGHTS"]
fn a_long_text_needs_the_window() {
    let real = &MODELS[1];
    let Some((_folder, place)) = file_of(real) else {
        return;
    };
    let local = load(&place);
    let text =
        "The road bends to the left behind the old mill, and a cart waits there. ".repeat(40);
    let ids = local.tokenizer.encode_chat(&text).unwrap();
    assert!(ids.len() > 600, "{}", ids.len());
    let rows: Vec<Vec<f32>> = logits_of(&local, &ids).to_vec2().unwrap();
    let found = perplexity(&rows, &ids);
    // Without a window, it is more than ten times as much on such a text.
    assert!(found < 3.0, "{found}");
}
