//! Our numbers against a statement of the model in torch (`tests/fixtures/tiny_cogvlm/make_tiny_cogvlm.py`).

use std::path::Path;

use candle_core::{DType, Device, Tensor};

use super::CogVlm;
use super::config::CogVlmConfig;
use super::language::positions;
use super::preprocess::pixel_values;
use crate::mllm::checkpoint::{Weights, read_json};
use crate::mllm::decoder::{DecoderInput, Logits};
use crate::mllm::local::test_reference::{
    FEATURE_TOLERANCE, LOGIT_TOLERANCE, Reference, assert_chat, assert_greedy, assert_logits, difference,
    feature_difference, fixture, logits_deviation, open_checkpoint, shared_reference, synthetic,
};
use crate::mllm::local::{Sequence, VisionLanguageModel};
use crate::mllm::vision::{Filter, resize};

/// Opens a folder with a change to its weights.
fn open(folder: &Path, change: impl FnOnce(&mut Weights)) -> CogVlm {
    let path = folder.join("config.json");
    let mut weights = open_checkpoint(folder).weights;
    change(&mut weights);
    let config = CogVlmConfig::from_json(&path, &read_json(&path).unwrap()).unwrap();
    CogVlm::take(&mut weights, config).unwrap()
}

#[test]
fn a_complete_folder_gives_the_pixels_ids_logits_and_tokens_of_the_reference() {
    let folder = fixture("tiny_cogvlm");
    let reference = Reference::open(&folder.join("reference.safetensors"));
    let image = image::open(folder.join("image.png")).unwrap().into_rgb8();
    let pixels = pixel_values(&image, 56).unwrap();
    let found = difference(&pixels, reference.tensor("pixel_values"));
    assert!(found < 1e-5, "the pixels differ by {found}");
    let model = CogVlm::open(&mut open_checkpoint(&folder)).unwrap();
    let found = feature_difference(&model.tower.forward(&pixels).unwrap(), reference.tensor("tower"));
    assert!(found < FEATURE_TOLERANCE, "the tower's output differs by {found}");
    assert_chat(&folder, &["", "chat_", "text_"]);
}

#[test]
fn features_logits_and_greedy_tokens_of_the_larger_reference() {
    let Some(folder) = shared_reference("cogvlm") else {
        return;
    };
    let reference = Reference::open(&folder.join("io.safetensors"));
    let model = open(&folder, |_| {});
    let pixels = reference.tensor("pixel_values").squeeze(0).unwrap();
    let features = model.encode_pixels(&pixels).unwrap();
    let found = feature_difference(&features, reference.tensor("image_embeds"));
    assert!(found < FEATURE_TOLERANCE, "the features differ by {found}");
    let mut ids = reference.ids("input_ids", 0);
    let image = reference.ids("token_type_ids", 0);
    for (id, kind) in ids.iter_mut().zip(&image) {
        if *kind == 1 {
            *id = model.facts.image_token;
        }
    }
    let expected = reference.ids("position_ids", 0);
    assert_eq!(positions(0..ids.len(), &(1..1 + features.dims()[0])), expected);
    assert_logits(&model, &ids, &features, reference.tensor("logits"));
    assert_greedy(&model, &ids, &features, &reference.ids("gen", 0));
}

#[test]
fn a_missing_layer_or_a_swapped_adapter_is_noticed() {
    let folder = fixture("tiny_cogvlm");
    let reference = Reference::open(&folder.join("reference.safetensors"));
    let mut changed = vec![
        open(&folder, |weights| {
            weights.swap("vision.linear_proj.gate_proj.weight", "vision.linear_proj.dense_h_to_4h.weight");
        }),
        open(&folder, |weights| weights.swap("vision.boi", "vision.eoi")),
        open(&folder, |weights| {
            let name = |norm: &str| format!("vision.transformer.layers.1.{norm}.weight");
            weights.swap(&name("input_layernorm"), &name("post_attention_layernorm"));
        }),
    ];
    // The layer before the last, which is the one that LLaVA takes.
    let mut shallow = open(&folder, |_| {});
    shallow.tower.drop_last_layer();
    changed.push(shallow);
    for model in changed {
        let features = model.encode_pixels(reference.tensor("pixel_values")).unwrap();
        let found = feature_difference(&features, reference.tensor("features"));
        assert!(found > 100.0 * FEATURE_TOLERANCE, "the features differ only by {found}");
        let ids = reference.ids("input_ids", model.facts.image_token);
        let found = logits_deviation(&model, &ids, &features, reference.tensor("logits"));
        assert!(found > 100.0 * LOGIT_TOLERANCE, "the logits differ only by {found}");
    }
}

#[test]
fn swapped_experts_are_noticed() {
    let folder = fixture("tiny_cogvlm");
    let reference = Reference::open(&folder.join("reference.safetensors"));
    let model = open(&folder, |weights| {
        for matrix in ["gate_proj", "up_proj", "down_proj"] {
            let name = |expert: &str| format!("layers.1.mlp.{expert}_mlp.{matrix}.weight");
            weights.swap(&name("vision"), &name("language"));
        }
    });
    let ids = reference.ids("input_ids", model.facts.image_token);
    let found = logits_deviation(&model, &ids, reference.tensor("features"), reference.tensor("logits"));
    assert!(found > 100.0 * LOGIT_TOLERANCE, "{found}");
}

#[test]
fn shifted_positions_and_a_misrouted_end_are_noticed() {
    let folder = fixture("tiny_cogvlm");
    let reference = Reference::open(&folder.join("reference.safetensors"));
    let model = open(&folder, |_| {});
    let features = reference.tensor("features");
    let ids = reference.ids("input_ids", model.facts.image_token);
    let rows = Sequence::new(&model).placed_rows(&model, &ids, Some(features)).unwrap().rows;
    let end = 1 + features.dims()[0];
    let deviation = |positions: Vec<u32>, vision| {
        let input = DecoderInput { rows: rows.clone(), positions, vision };
        let logits = model.decoder.forward(&input, &mut model.new_cache(), Logits::All).unwrap().unwrap();
        difference(&logits, reference.tensor("logits"))
    };
    let right = positions(0..ids.len(), &(1..end));
    assert!(deviation(right.clone(), 1..end - 1) < LOGIT_TOLERANCE);
    let one_each: Vec<u32> = (0..ids.len() as u32).collect();
    let text_shifted = right.iter().enumerate().map(|(index, place)| place + u32::from(index >= end)).collect();
    let patches_shifted =
        right.iter().enumerate().map(|(index, place)| place + u32::from((2..end - 1).contains(&index))).collect();
    for (what, positions, vision) in [
        ("a position for each patch", one_each, 1..end - 1),
        ("text one further", text_shifted, 1..end - 1),
        ("patches one further", patches_shifted, 1..end - 1),
        ("the image's end through the vision expert", right.clone(), 1..end),
        ("no vision expert", right, 0..0),
    ] {
        let found = deviation(positions, vision);
        assert!(found > 100.0 * LOGIT_TOLERANCE, "{what}: {found}");
    }
}

#[test]
fn images_of_any_shape_are_stretched_as_pillow_does() {
    let mut expected =
        candle_core::safetensors::load(fixture("tiny_cogvlm").join("square.safetensors"), &Device::Cpu).unwrap();
    let raw = |height, width, side| {
        let square = resize(&synthetic(height, width), side, side, Filter::Bicubic);
        let side = side as usize;
        Tensor::from_vec(square.into_raw(), (side, side, 3), &Device::Cpu).unwrap().permute((2, 0, 1)).unwrap()
    };
    let sums = |axis: usize| raw(413, 597, 490).to_dtype(DType::I64).unwrap().sum(axis).unwrap();
    for (name, axis) in [("rows", 2), ("columns", 1)] {
        let expected = expected.remove(&format!("{name} of 413x597")).unwrap();
        assert_eq!(sums(axis).to_vec2::<i64>().unwrap(), expected.to_vec2::<i64>().unwrap(), "{name}");
    }
    assert!(expected.len() >= 6);
    for (name, expected) in expected {
        let (height, width) = name.split_once('x').unwrap();
        let found = raw(height.parse().unwrap(), width.parse().unwrap(), 56);
        assert_eq!(found.to_vec3::<u8>().unwrap(), expected.to_vec3::<u8>().unwrap(), "{name}");
    }
}
