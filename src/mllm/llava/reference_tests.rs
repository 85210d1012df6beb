//! Parity with Hugging Face transformers.
//!
//! `tests/fixtures/llava_reference` has weights, inputs and outputs of a small LLaVA, with its
//! script. `tests/fixtures/tiny_llava` is a complete folder with tokenizer, preprocessor and chat
//! template.

use super::config::LlavaConfig;
use super::{FAMILY, Llava};
use crate::checkpoint::TowerType;
use crate::families::Families;
use crate::family::{ImageFeatures, VisionLanguageModel};
use crate::local::LocalModel;
use crate::local::test_faults::{
    Deviation, LLAVA_DECODER_FAULTS, LLAVA_IMAGE_FAULTS, Parts, one_further,
};
use crate::local::test_reference::{
    FEATURE_TOLERANCE, LOGIT_TOLERANCE, Reference, Run, assert_chat, assert_greedy, assert_logits,
    difference, feature_difference, fixture, logits_deviation, open_checkpoint, whole,
};
use crate::source::{Checkpoint, ModelPlace};
use crate::vision::ClipImageProcessor;
use candle_core::Tensor;
use planagent_kernels::matrix::WeightFormat;
use serde_json::json;
use std::path::{Path, PathBuf};

/// Opens a model from parts.
fn assembled(parts: &Parts) -> Llava {
    let config = LlavaConfig::from_json(&parts.path, &parts.config).unwrap();
    let processor = ClipImageProcessor::square(config.vision.image_size as u32);
    Llava::take(&mut parts.weights(&FAMILY), config, processor).unwrap()
}

/// The reference with random pixels.
fn reference() -> (PathBuf, Run) {
    let folder = fixture("llava_reference");
    let run = Run::open(&folder.join("io.safetensors"), 0);
    (folder, run)
}

fn open_llava(folder: &Path) -> Llava {
    let mut checkpoint = open_checkpoint(folder);
    Llava::open(&checkpoint.files, &mut checkpoint.weights).unwrap()
}

fn features(model: &Llava, run: &Run) -> ImageFeatures {
    whole(model.core.encoder.encode(&run.pixels[..1]).unwrap())
}

#[test]
fn features_logits_and_greedy_tokens_are_those_of_transformers() {
    let (folder, run) = reference();
    let model = assembled(&Parts::from_folder(&folder));
    run.assert_same(&model, &features(&model, &run));
}

#[test]
fn errors_that_are_easily_made_lead_far_away() {
    let (folder, run) = reference();
    Deviation::print_heading(&folder);
    let right = assembled(&Parts::from_folder(&folder));
    Deviation::from_run(&run, &right, &features(&right, &run)).assert_none("nothing wrong");
    for (what, fault) in LLAVA_IMAGE_FAULTS {
        let model = assembled(&Parts::wrong(&folder, fault));
        Deviation::from_run(&run, &model, &features(&model, &run)).assert_far(what);
    }
    let full = Parts::wrong(&folder, |parts| {
        parts.config["vision_feature_select_strategy"] = json!("full");
    });
    let with_class = features(&assembled(&full), &run)
        .rows
        .narrow(0, 0, run.features.dims()[0])
        .unwrap();
    Deviation::from_run(&run, &right, &whole(with_class))
        .assert_far("the class token kept, the last patch lost");
    for (what, fault) in LLAVA_DECODER_FAULTS {
        let model = assembled(&Parts::wrong(&folder, fault));
        Deviation::from_run(&run, &model, &features(&model, &run)).assert_logits_far(what);
    }
    let image = run.image(right.info().image_token);
    let own: Vec<u32> = (0..run.ids.len() as u32).collect();
    let placed =
        |positions| Deviation::of_placed(&run, &right, &right.core.decoder, positions, 0..0);
    let shifted = |part| placed(one_further(&own, &part));
    // Only differences of positions count.
    shifted(0..own.len()).assert_none("every position one further");
    shifted(image.end..own.len()).assert_logits_far("the text behind the image one further");
    shifted(image.clone()).assert_logits_far("the image one further");
    let shared = (0..own.len())
        .map(|index| (index.min(image.start) + index.saturating_sub(image.end - 1)) as u32);
    placed(shared.collect()).assert_logits_far("one position for the whole image");
}

#[test]
fn a_complete_folder_gives_the_pixels_ids_logits_and_tokens_of_transformers() {
    let folder = fixture("tiny_llava");
    let reference = Reference::open(&folder.join("reference.safetensors"));
    let image = image::open(folder.join("image.png")).unwrap().into_rgb8();
    let pixels = ClipImageProcessor::open(&open_checkpoint(&folder).files)
        .unwrap()
        .process(&image, 32)
        .unwrap();
    let found = difference(&pixels, reference.tensor("pixel_values"));
    assert!(found < 1e-5, "the pixels differ by {found}");
    assert_chat(&folder, &["", "chat_"]);
}

#[test]
fn the_model_that_ships_gives_the_pixels_and_logits_of_transformers() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../models/nano");
    let reference = Reference::open(&fixture("nano_reference").join("reference.safetensors"));
    let model = open_llava(&folder);
    let image = image::open(fixture("nano_reference").join("image.png"))
        .unwrap()
        .into_rgb8();
    let pixels = model
        .processor
        .process(&image, model.core.config.vision.image_size)
        .unwrap();
    let corner = pixels.narrow(1, 0, 4).unwrap().narrow(2, 0, 4).unwrap();
    assert!(difference(&corner, reference.tensor("pixel_corner")) < 1e-5);
    let features = model.encode_image(&image).unwrap();
    let ids = reference.ids("input_ids", 0);
    let found = logits_deviation(&model, &ids, &features, reference.tensor("logits"));
    assert!(found < LOGIT_TOLERANCE, "the logits differ by {found}");
    assert!(LocalModel::open("nano", &folder).is_ok());
}

/// Eight bits of weights and of products' inputs, and attention in sixteen, on trained weights. With
/// `q4_k`, rows of 768 numbers have one scale for 256.
#[test]
fn features_of_a_quantized_tower_are_near_those_in_f32() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../models/nano");
    let image = image::open(fixture("nano_reference").join("image.png"))
        .unwrap()
        .into_rgb8();
    let features = |quantize| {
        let mut checkpoint = Checkpoint::open(
            &ModelPlace::Folder(folder.clone()),
            quantize,
            &Families::default(),
        )
        .unwrap();
        let model = Llava::open(&checkpoint.files, &mut checkpoint.weights).unwrap();
        model.encode_image(&image).unwrap().rows
    };
    let exact = features(None);
    let dot = |a: &Tensor, b: &Tensor| {
        (a * b)
            .unwrap()
            .sum_all()
            .unwrap()
            .to_scalar::<f32>()
            .unwrap()
    };
    for format in [WeightFormat::Q8_0, WeightFormat::Q4K] {
        let rounded = features(Some(format));
        let apart = feature_difference(&rounded, &exact);
        let cosine = dot(&exact, &rounded) / (dot(&exact, &exact) * dot(&rounded, &rounded)).sqrt();
        println!(
            "{format}: features differ by {apart:.1e}, cosine distance {:.1e}",
            1.0 - cosine
        );
        assert!(
            apart > 0.0 && apart < 2e-2,
            "{format}: the features differ by {apart}"
        );
        assert!(1.0 - cosine < 1e-3, "{format}: the cosine is {cosine}");
    }
}

#[test]
fn a_siglip_tower_and_a_qwen2_decoder_compute_what_transformers_computes() {
    let folder = fixture("tiny_llava_siglip");
    let path = folder.join("reference.safetensors");
    let (reference, run) = (Reference::open(&path), Run::open(&path, 0));
    let parts = Parts::from_folder(&folder);
    let model = assembled(&parts);
    assert_eq!(
        (model.core.config.tower, model.info().max_image_tokens),
        (TowerType::Siglip, 16)
    );
    run.assert_same(&model, &features(&model, &run));
    let ids = reference.ids("text_input_ids", 0);
    assert_logits(&model, &ids, None, reference.tensor("text_logits"));
    assert_greedy(&model, &ids, None, &reference.ids("text_generated", 0));

    let mut clip = parts;
    clip.config["vision_config"]["hidden_act"] = json!("gelu");
    let wrong = features(&assembled(&clip), &run);
    assert!(
        feature_difference(&wrong.rows, &run.features) > 2.0 * FEATURE_TOLERANCE,
        "the other form of gelu is not noticed"
    );
}
