//! Parity with a torch implementation of the model
//! (`tests/fixtures/tiny_cogvlm/make_tiny_cogvlm.py`).

use super::config::CogVlmConfig;
use super::language::positions;
use super::preprocess::pixel_values;
use super::{CogVlm, FAMILY};
use crate::family::ImageFeatures;
use crate::local::test_faults::{Deviation, Fault, Parts, one_further};
use crate::local::test_reference::{
    FEATURE_TOLERANCE, Reference, Run, assert_chat, difference, feature_difference, fixture,
    synthetic, whole,
};
use crate::vision::{Filter, resize};
use candle_core::{DType, Device, Tensor};
use serde_json::json;
use std::path::PathBuf;

/// Opens a model from parts.
fn assembled(parts: &Parts) -> CogVlm {
    let config = CogVlmConfig::from_json(&parts.path, &parts.config).unwrap();
    CogVlm::take(&mut parts.weights(&FAMILY), config).unwrap()
}

/// The reference: its folder, the run, and the model without a fault.
fn reference() -> (PathBuf, Run, CogVlm) {
    let folder = fixture("tiny_cogvlm");
    let model = assembled(&Parts::from_folder(&folder));
    let run = Run::open(
        &folder.join("reference.safetensors"),
        model.info.image_token,
    );
    (folder, run, model)
}

fn features(model: &CogVlm, run: &Run) -> ImageFeatures {
    whole(
        model
            .adapter
            .forward(&model.tower.forward(&run.pixels[0]).unwrap())
            .unwrap(),
    )
}

#[test]
fn a_complete_folder_gives_the_pixels_ids_logits_and_tokens_of_the_reference() {
    let folder = fixture("tiny_cogvlm");
    let reference = Reference::open(&folder.join("reference.safetensors"));
    let image = image::open(folder.join("image.png")).unwrap().into_rgb8();
    let pixels = pixel_values(&image, 56).unwrap();
    let found = difference(&pixels, reference.tensor("pixel_values"));
    assert!(found < 1e-5, "the pixels differ by {found}");
    let model = assembled(&Parts::from_folder(&folder));
    let found = feature_difference(
        &model.tower.forward(&pixels).unwrap(),
        reference.tensor("tower"),
    );
    assert!(
        found < FEATURE_TOLERANCE,
        "the tower's output differs by {found}"
    );
    assert_chat(&folder, &["", "chat_", "text_"]);
}

#[test]
fn features_logits_and_greedy_tokens_are_those_of_the_reference() {
    let (_, run, model) = reference();
    run.assert_same(&model, &features(&model, &run));
}

#[test]
fn positions_are_those_of_the_reference() {
    let path = fixture("tiny_cogvlm").join("reference.safetensors");
    let reference = Reference::open(&path);
    let image = 1..1 + Run::open(&path, 0).features.dims()[0];
    for name in ["", "chat_"] {
        let expected = reference.ids(&format!("{name}position_ids"), 0);
        let count = reference.tensor(&format!("{name}input_ids")).elem_count();
        assert_eq!(positions(0..count, &image), expected, "{name}");
    }
}

/// Errors on the way from pixels to features.
const IMAGE_FAULTS: [Fault; 6] = [
    // LLaVA takes the layer before the last.
    ("the tower's last layer but one", |parts| {
        let layers = &mut parts.config["vision_config"]["num_hidden_layers"];
        *layers = json!(layers.as_u64().unwrap() - 1);
    }),
    ("the tower's norms swapped", |parts| {
        let name = |norm: &str| format!("model.vision.transformer.layers.1.{norm}.weight");
        parts.swap(&name("input_layernorm"), &name("post_attention_layernorm"));
    }),
    ("the tower's attention output transposed", |parts| {
        parts.change("layers.0.attention.dense.weight", |tensor| {
            tensor.t().unwrap()
        });
    }),
    ("quick_gelu in the place of gelu", |parts| {
        parts.config["vision_config"]["hidden_act"] = json!("quick_gelu");
    }),
    ("the adapter's gate and value swapped", |parts| {
        let name = |layer: &str| format!("model.vision.linear_proj.{layer}.weight");
        parts.swap(&name("gate_proj"), &name("dense_h_to_4h"));
    }),
    ("the image's beginning and end swapped", |parts| {
        parts.swap("model.vision.boi", "model.vision.eoi");
    }),
];

/// Errors in the decoder's weights.
const DECODER_FAULTS: [Fault; 1] = [("the experts of a layer swapped", |parts| {
    for matrix in ["gate_proj", "up_proj", "down_proj"] {
        let name = |expert: &str| format!("model.layers.1.mlp.{expert}_mlp.{matrix}.weight");
        parts.swap(&name("vision"), &name("language"));
    }
})];

#[test]
fn errors_that_are_easily_made_lead_far_away() {
    let (folder, run, right) = reference();
    Deviation::print_heading(&folder);
    Deviation::from_run(&run, &right, &features(&right, &run)).assert_none("nothing wrong");
    for (what, fault) in IMAGE_FAULTS {
        let model = assembled(&Parts::wrong(&folder, fault));
        Deviation::from_run(&run, &model, &features(&model, &run)).assert_far(what);
    }
    for (what, fault) in DECODER_FAULTS {
        let model = assembled(&Parts::wrong(&folder, fault));
        Deviation::from_run(&run, &model, &features(&model, &run)).assert_logits_far(what);
    }
    let image = run.image(right.info.image_token);
    let own = positions(0..run.ids.len(), &image);
    let placed =
        |positions, vision| Deviation::of_placed(&run, &right, &right.decoder, positions, vision);
    let vision = image.start..image.end - 1;
    let shifted = |part| placed(one_further(&own, &part), vision.clone());
    placed(own.clone(), vision.clone()).assert_none("the right positions");
    // Only differences of positions count.
    shifted(0..own.len()).assert_none("every position one further");
    shifted(image.end..own.len()).assert_logits_far("the text behind the image one further");
    shifted(image.start + 1..image.end - 1).assert_logits_far("the patches one further");
    let one_each = (0..own.len() as u32).collect();
    placed(one_each, vision.clone()).assert_logits_far("a position for each patch");
    placed(own.clone(), image).assert_logits_far("the image's end through the vision expert");
    placed(own, 0..0).assert_logits_far("no vision expert");
}

#[test]
fn images_of_any_shape_are_stretched_as_pillow_does() {
    let mut expected = candle_core::safetensors::load(
        fixture("tiny_cogvlm").join("square.safetensors"),
        &Device::Cpu,
    )
    .unwrap();
    let raw = |height, width, side| {
        let square = resize(&synthetic(height, width), side, side, Filter::Bicubic);
        let side = side as usize;
        Tensor::from_vec(square.into_raw(), (side, side, 3), &Device::Cpu)
            .unwrap()
            .permute((2, 0, 1))
            .unwrap()
    };
    let sums = |axis: usize| {
        raw(413, 597, 490)
            .to_dtype(DType::I64)
            .unwrap()
            .sum(axis)
            .unwrap()
    };
    for (name, axis) in [("rows", 2), ("columns", 1)] {
        let expected = expected.remove(&format!("{name} of 413x597")).unwrap();
        assert_eq!(
            sums(axis).to_vec2::<i64>().unwrap(),
            expected.to_vec2::<i64>().unwrap(),
            "{name}"
        );
    }
    assert!(expected.len() >= 6);
    for (name, expected) in expected {
        let (height, width) = name.split_once('x').unwrap();
        let found = raw(height.parse().unwrap(), width.parse().unwrap(), 56);
        assert_eq!(
            found.to_vec3::<u8>().unwrap(),
            expected.to_vec3::<u8>().unwrap(),
            "{name}"
        );
    }
}
