//! Our numbers against those of Hugging Face transformers.
//!
//! `tests/fixtures/llava_reference` holds weights, inputs and outputs of a small LLaVA (its script stands beside it),
//! `tests/fixtures/tiny_llava` a complete folder with tokenizer, preprocessor and chat template.

use std::path::{Path, PathBuf};

use candle_core::{Device, Tensor};

use super::Llava;
use super::model::{LlavaModel, Sequence};
use crate::mllm::decoder::Logits;
use crate::mllm::{Turn, checkpoint::read_json};

/// Largest difference that the reference tests accept.
const TOLERANCE: f32 = 1e-4;

fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures").join(name)
}

/// The tensors of a reference file.
struct Reference(std::collections::HashMap<String, Tensor>);

impl Reference {
    fn open(path: &Path) -> Self {
        Self(candle_core::safetensors::load(path, &Device::Cpu).unwrap())
    }

    fn tensor(&self, name: &str) -> &Tensor {
        &self.0[name]
    }

    fn ids(&self, name: &str) -> Vec<u32> {
        let ids = self.tensor(name).flatten_all().unwrap().to_vec1::<i64>().unwrap();
        ids.into_iter().map(|id| u32::try_from(id).unwrap()).collect()
    }
}

fn difference(found: &Tensor, expected: &Tensor) -> f32 {
    let found = found.flatten_all().unwrap();
    let expected = expected.flatten_all().unwrap();
    assert_eq!(found.dims(), expected.dims());
    let difference = (found - expected).unwrap().abs().unwrap().max(0).unwrap();
    difference.to_scalar().unwrap()
}

/// The logits of all positions when the ids are appended in pieces.
fn logits_in_pieces(model: &LlavaModel, ids: &[u32], features: &Tensor, pieces: &[usize]) -> Tensor {
    let mut sequence = model.new_sequence();
    let mut rows = Vec::new();
    let mut rest = ids;
    for piece in pieces.iter().copied().chain([ids.len()]) {
        let (now, later) = rest.split_at(piece.min(rest.len()));
        rows.extend(model.append(&mut sequence, now, Some(features), Logits::All).unwrap());
        rest = later;
    }
    assert_eq!(sequence.ids(), ids);
    Tensor::cat(&rows, 0).unwrap()
}

fn greedy(model: &LlavaModel, sequence: &mut Sequence, ids: &[u32], features: &Tensor, count: usize) -> Vec<u32> {
    let mut tokens: Vec<u32> = Vec::new();
    let mut next = ids.to_vec();
    while tokens.len() < count {
        let logits = model.append(sequence, &next, Some(features), Logits::Last).unwrap().unwrap();
        let token = logits.argmax(1).unwrap().to_vec1::<u32>().unwrap()[0];
        tokens.push(token);
        next = vec![token];
    }
    tokens
}

fn assert_logits(model: &LlavaModel, ids: &[u32], features: &Tensor, expected: &Tensor) {
    let one_by_one = vec![1; ids.len()];
    for pieces in [&[][..], &[1], &[4, 3, 9], &one_by_one] {
        let found = difference(&logits_in_pieces(model, ids, features, pieces), expected);
        assert!(found < TOLERANCE, "in pieces of {pieces:?} the logits differ by {found}");
    }
}

#[test]
fn features_logits_and_greedy_tokens_are_those_of_transformers() {
    let folder = fixture("llava_reference");
    let reference = Reference::open(&folder.join("io.safetensors"));
    let model = LlavaModel::open(&folder).unwrap();
    let pixels = reference.tensor("pixel_values").squeeze(0).unwrap();
    let features = model.encode_image(&pixels).unwrap();
    assert!(difference(&features, reference.tensor("packed")) < TOLERANCE);

    let ids = reference.ids("input_ids");
    assert_logits(&model, &ids, &features, reference.tensor("logits"));

    let generated = reference.ids("gen");
    let expected = &generated[ids.len()..];
    let mut sequence = model.new_sequence();
    assert_eq!(greedy(&model, &mut sequence, &ids, &features, expected.len()), expected);

    // Going back and taking another way leaves no trace.
    sequence.truncate(7);
    assert_eq!(greedy(&model, &mut sequence, &ids[7..], &features, expected.len()), expected);
    let mut copy = model.new_sequence();
    sequence.truncate(20);
    copy.restore(&sequence.to_prefix().unwrap()).unwrap();
    assert_eq!(greedy(&model, &mut copy, &ids[20..], &features, expected.len()), expected);
}

#[test]
fn a_complete_folder_gives_the_pixels_ids_logits_and_tokens_of_transformers() {
    let folder = fixture("tiny_llava");
    let reference = Reference::open(&folder.join("reference.safetensors"));
    let texts = read_json(&folder.join("prompts.json")).unwrap();
    let text = |value: &serde_json::Value| value.as_str().unwrap().to_string();
    let system = text(&texts["system"]);
    let prompts = [text(&texts["prompts"][0]), text(&texts["prompts"][1])];
    let llava = Llava::open("tiny", &folder).unwrap();
    let side = llava.model.config().vision.image_size;

    let image = image::open(folder.join("image.png")).unwrap().into_rgb8();
    let pixels = llava.processor.process(&image, side).unwrap();
    let pixel_difference = difference(&pixels, reference.tensor("pixel_values"));
    assert!(pixel_difference < 1e-5, "{pixel_difference}");
    let features = llava.model.encode_image(&pixels).unwrap();
    assert!(difference(&features, reference.tensor("features")) < TOLERANCE);

    let first = Turn { prompt: prompts[0].clone(), answer: text(&texts["first_answer"]) };
    for (name, turns, prompt) in [("", vec![], &prompts[0]), ("chat_", vec![first], &prompts[1])] {
        let ids = llava.prompt_ids(&system, true, &turns, prompt).unwrap();
        assert_eq!(ids, reference.ids(&format!("{name}input_ids")));
        assert_logits(&llava.model, &ids, &features, reference.tensor(&format!("{name}logits")));
        let expected = reference.ids(&format!("{name}generated"));
        let mut sequence = llava.model.new_sequence();
        assert_eq!(greedy(&llava.model, &mut sequence, &ids, &features, expected.len()), expected);
    }
}

#[test]
fn the_model_that_ships_gives_the_pixels_and_logits_of_transformers() {
    let reference = Reference::open(&fixture("nano_reference").join("reference.safetensors"));
    let llava = Llava::open("nano", &Path::new(env!("CARGO_MANIFEST_DIR")).join("models/nano")).unwrap();
    let image = image::open(fixture("nano_reference").join("image.png")).unwrap().into_rgb8();
    let pixels = llava.processor.process(&image, llava.model.config().vision.image_size).unwrap();
    let corner = pixels.narrow(1, 0, 4).unwrap().narrow(2, 0, 4).unwrap();
    assert!(difference(&corner, reference.tensor("pixel_corner")) < 1e-5);
    let features = llava.model.encode_image(&pixels).unwrap();
    let ids = reference.ids("input_ids");
    let expected = reference.tensor("logits");
    let all = logits_in_pieces(&llava.model, &ids, &features, &[]);
    let kept = all.narrow(0, ids.len() - expected.dims()[0], expected.dims()[0]).unwrap();
    let found = difference(&kept, expected);
    assert!(found < TOLERANCE, "the logits differ by {found}");
}
