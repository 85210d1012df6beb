//! Our numbers against those of Hugging Face transformers.
//!
//! `tests/fixtures/llava_reference` holds weights, inputs and outputs of a small LLaVA (its script stands beside it),
//! `tests/fixtures/tiny_llava` a complete folder with tokenizer, preprocessor and chat template.

use std::path::Path;

use serde_json::{Value, json};

use super::Llava;
use super::config::LlavaConfig;
use crate::mllm::checkpoint::{Weights, read_json};
use crate::mllm::local::test_reference::{
    FEATURE_TOLERANCE, LOGIT_TOLERANCE, Reference, assert_chat, assert_greedy, assert_logits, difference,
    feature_difference, fixture, logits_deviation, open_checkpoint,
};
use crate::mllm::local::{LocalModel, VisionLanguageModel};
use crate::mllm::vision::ClipImageProcessor;

/// Opens the reference with a change to its configuration and its weights.
fn open(change: impl FnOnce(&mut Value, &mut Weights)) -> (Llava, Reference) {
    let folder = fixture("llava_reference");
    let path = folder.join("config.json");
    let mut config = read_json(&path).unwrap();
    let mut weights = open_checkpoint(&folder).weights;
    change(&mut config, &mut weights);
    let config = LlavaConfig::from_json(&path, &config).unwrap();
    let processor = ClipImageProcessor::square(config.vision.image_size as u32);
    (Llava::take(&mut weights, config, processor).unwrap(), Reference::open(&folder.join("io.safetensors")))
}

/// How far the features and the logits are from the reference.
fn deviations(model: &Llava, reference: &Reference) -> (f32, f32) {
    let features = model.encode_pixels(&reference.tensor("pixel_values").squeeze(0).unwrap()).unwrap();
    let ids = reference.ids("input_ids", 0);
    let logits = logits_deviation(model, &ids, &features, reference.tensor("logits"));
    (feature_difference(&features, reference.tensor("packed")), logits)
}

#[test]
fn features_logits_and_greedy_tokens_are_those_of_transformers() {
    let (model, reference) = open(|_, _| {});
    let (features, _) = deviations(&model, &reference);
    assert!(features < FEATURE_TOLERANCE, "the features differ by {features}");
    let features = model.encode_pixels(&reference.tensor("pixel_values").squeeze(0).unwrap()).unwrap();
    let ids = reference.ids("input_ids", 0);
    assert_logits(&model, &ids, &features, reference.tensor("logits"));
    assert_greedy(&model, &ids, &features, &reference.ids("gen", 0)[ids.len()..]);
}

#[test]
fn a_wrong_layer_or_a_swapped_projector_is_noticed() {
    let layer = |layer: i32| open(move |config, _| config["vision_feature_layer"] = json!(layer));
    let swapped = open(|_, weights| {
        weights.swap("multi_modal_projector.linear_1.weight", "multi_modal_projector.linear_2.weight");
        weights.swap("multi_modal_projector.linear_1.bias", "multi_modal_projector.linear_2.bias");
    });
    for (model, reference) in [layer(-1), layer(-3), swapped] {
        let (features, logits) = deviations(&model, &reference);
        assert!(features > 100.0 * FEATURE_TOLERANCE && logits > 100.0 * LOGIT_TOLERANCE, "{features} {logits}");
    }
}

#[test]
fn image_tokens_at_a_shifted_position_are_noticed() {
    let (model, reference) = open(|_, _| {});
    let features = model.encode_pixels(&reference.tensor("pixel_values").squeeze(0).unwrap()).unwrap();
    let ids = reference.ids("input_ids", 0);
    let mut shifted = ids.clone();
    let first = ids.iter().position(|id| *id == model.facts().image_token).unwrap();
    shifted.swap(first - 1, first + model.facts().most_image_tokens - 1);
    let found = logits_deviation(&model, &shifted, &features, reference.tensor("logits"));
    assert!(found > 100.0 * LOGIT_TOLERANCE, "{found}");
}

#[test]
fn a_complete_folder_gives_the_pixels_ids_logits_and_tokens_of_transformers() {
    let folder = fixture("tiny_llava");
    let reference = Reference::open(&folder.join("reference.safetensors"));
    let image = image::open(folder.join("image.png")).unwrap().into_rgb8();
    let pixels = ClipImageProcessor::open(&open_checkpoint(&folder).files).unwrap().process(&image, 32).unwrap();
    let found = difference(&pixels, reference.tensor("pixel_values"));
    assert!(found < 1e-5, "the pixels differ by {found}");
    assert_chat(&folder, &["", "chat_"]);
}

#[test]
fn the_model_that_ships_gives_the_pixels_and_logits_of_transformers() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("models/nano");
    let reference = Reference::open(&fixture("nano_reference").join("reference.safetensors"));
    let model = Llava::open(&mut open_checkpoint(&folder)).unwrap();
    let image = image::open(fixture("nano_reference").join("image.png")).unwrap().into_rgb8();
    let pixels = model.processor.process(&image, model.facts.image_size).unwrap();
    let corner = pixels.narrow(1, 0, 4).unwrap().narrow(2, 0, 4).unwrap();
    assert!(difference(&corner, reference.tensor("pixel_corner")) < 1e-5);
    let features = model.encode_image(&image).unwrap();
    let ids = reference.ids("input_ids", 0);
    let found = logits_deviation(&model, &ids, &features, reference.tensor("logits"));
    assert!(found < LOGIT_TOLERANCE, "the logits differ by {found}");
    assert!(LocalModel::open("nano", &folder).is_ok());
}
