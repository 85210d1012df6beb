//! Our numbers against those of Hugging Face transformers: pixels of tiles, packed features, logits, greedy tokens.

use std::path::Path;

use candle_core::{DType, Tensor};
use serde_json::{Value, json};

use super::LlavaNext;
use super::config::LlavaNextConfig;
use super::grid::{Resolution, TileGrids};
use super::preprocess::AnyresImageProcessor;
use crate::mllm::checkpoint::{Weights, read_json};
use crate::mllm::local::LocalModel;
use crate::mllm::local::test_reference::{
    FEATURE_TOLERANCE, LOGIT_TOLERANCE, Reference, assert_chat, assert_greedy, assert_logits, difference,
    feature_difference, fixture, logits_deviation, open_checkpoint, shared_reference, synthetic,
};
use crate::mllm::vision::{Filter, PixelScale};

/// Opens a folder with a change to its configuration and its weights.
fn open(folder: &Path, change: impl FnOnce(&mut Value, &mut Weights)) -> LlavaNext {
    let path = folder.join("config.json");
    let mut config = read_json(&path).unwrap();
    let mut weights = open_checkpoint(folder).weights;
    change(&mut config, &mut weights);
    let config = LlavaNextConfig::from_json(&path, &config).unwrap();
    let processor = AnyresImageProcessor { filter: Filter::Bicubic, scale: PixelScale::CLIP };
    LlavaNext::take(&mut weights, config, processor).unwrap()
}

fn tiles(pixels: &Tensor) -> Vec<Tensor> {
    (0..pixels.dims()[0]).map(|tile| pixels.get(tile).unwrap()).collect()
}

#[test]
fn complete_folders_give_the_pixels_ids_logits_and_tokens_of_transformers() {
    for (name, rounds) in [("tiny_llava_next", &["", "chat_"][..]), ("tiny_llava_next_mistral", &[""])] {
        let folder = fixture(name);
        let reference = Reference::open(&folder.join("reference.safetensors"));
        let model = LlavaNext::open(&mut open_checkpoint(&folder)).unwrap();
        let image = image::open(folder.join("image.png")).unwrap().into_rgb8();
        let tiling = model.grids.tiling(Resolution { height: image.height(), width: image.width() });
        let pixels = model.processor.process(&image, &tiling, 32).unwrap();
        let found = difference(&Tensor::stack(&pixels, 0).unwrap(), reference.tensor("pixel_values"));
        assert!(found < 1e-5, "the pixels differ by {found}");
        assert_chat(&folder, rounds);
    }
}

#[test]
fn features_logits_and_greedy_tokens_of_the_larger_reference() {
    let Some(folder) = shared_reference("llava_next") else {
        return;
    };
    let reference = Reference::open(&folder.join("io.safetensors"));
    let model = open(&folder, |_, _| {});
    let tiling = model.grids.tiling(Resolution { height: 90, width: 160 });
    let pixels = tiles(&reference.tensor("pixel_values").squeeze(0).unwrap());
    let features = model.encode_tiles(&pixels, &tiling).unwrap();
    let found = feature_difference(&features, reference.tensor("packed"));
    assert!(found < FEATURE_TOLERANCE, "the features differ by {found}");
    let ids = reference.ids("input_ids", 0);
    assert_logits(&model, &ids, &features, reference.tensor("logits"));
    assert_greedy(&model, &ids, &features, &reference.ids("gen", 0)[ids.len()..]);
}

#[test]
fn a_wrong_layer_or_a_swapped_projector_is_noticed() {
    let folder = fixture("tiny_llava_next");
    let reference = Reference::open(&folder.join("reference.safetensors"));
    let pixels = tiles(reference.tensor("pixel_values"));
    let swapped = open(&folder, |_, weights| {
        weights.swap("multi_modal_projector.linear_1.weight", "multi_modal_projector.linear_2.weight");
        weights.swap("multi_modal_projector.linear_1.bias", "multi_modal_projector.linear_2.bias");
    });
    let no_newline = open(&folder, |_, weights| weights.swap("image_newline", "multi_modal_projector.linear_1.bias"));
    let last_layer = open(&folder, |config, _| config["vision_feature_layer"] = json!(-1));
    for model in [swapped, no_newline, last_layer] {
        let tiling = model.grids.tiling(Resolution { height: 53, width: 75 });
        let features = model.encode_tiles(&pixels, &tiling).unwrap();
        let found = feature_difference(&features, reference.tensor("features"));
        assert!(found > 100.0 * FEATURE_TOLERANCE, "the features differ only by {found}");
        let ids = reference.ids("input_ids", 0);
        let found = logits_deviation(&model, &ids, &features, reference.tensor("logits"));
        assert!(found > 100.0 * LOGIT_TOLERANCE, "the logits differ only by {found}");
    }
}

#[test]
fn tiles_out_of_their_place_and_shifted_positions_are_noticed() {
    let folder = fixture("tiny_llava_next");
    let reference = Reference::open(&folder.join("reference.safetensors"));
    let model = open(&folder, |_, _| {});
    let tiling = model.grids.tiling(Resolution { height: 53, width: 75 });
    let mut pixels = tiles(reference.tensor("pixel_values"));
    let right = model.encode_tiles(&pixels, &tiling).unwrap();
    pixels.swap(1, 2);
    let swapped = model.encode_tiles(&pixels, &tiling).unwrap();
    assert!(feature_difference(&swapped, reference.tensor("features")) > 100.0 * FEATURE_TOLERANCE);
    let mut ids = reference.ids("input_ids", 0);
    let first = ids.iter().position(|id| *id == model.facts.image_token).unwrap();
    ids.swap(first - 1, first + right.dims()[0] - 1);
    let found = logits_deviation(&model, &ids, &right, reference.tensor("logits"));
    assert!(found > 100.0 * LOGIT_TOLERANCE, "{found}");
}

#[test]
fn a_window_that_is_left_out_is_noticed() {
    let folder = fixture("tiny_llava_next_mistral");
    let reference = Reference::open(&folder.join("reference.safetensors"));
    let model = open(&folder, |config, _| config["text_config"]["sliding_window"] = Value::Null);
    let ids = reference.ids("input_ids", 0);
    let found = logits_deviation(&model, &ids, reference.tensor("features"), reference.tensor("logits"));
    assert!(found > 100.0 * LOGIT_TOLERANCE, "{found}");
}

/// The size in a name `HEIGHTxWIDTH`.
fn size(name: &str) -> Option<(u32, u32)> {
    let (height, width) = name.split_once('x')?;
    Some((height.parse().ok()?, width.parse().ok()?))
}

#[test]
fn tiles_of_odd_images_have_the_pixels_of_transformers() {
    let folder = fixture("tiny_llava_next");
    let model = open(&folder, |_, _| {});
    let expected =
        candle_core::safetensors::load(folder.join("anyres.safetensors"), &candle_core::Device::Cpu).unwrap();
    assert!(expected.len() >= 7);
    for (name, expected) in expected {
        let (height, width) = size(&name).unwrap();
        let tiling = model.grids.tiling(Resolution { height, width });
        let pixels = raw_processor().process(&synthetic(height, width), &tiling, 32).unwrap();
        let pixels = Tensor::stack(&pixels, 0).unwrap();
        assert_eq!(pixels.dims(), expected.dims(), "{name}");
        let found = difference(&pixels, &expected.to_dtype(DType::F32).unwrap());
        assert!(found == 0.0, "{name}: the pixels differ by {found}");
    }
}

/// A processor that leaves the 8-bit values as they are.
fn raw_processor() -> AnyresImageProcessor {
    let path = Path::new("preprocessor_config.json");
    let raw = json!({"do_rescale": false, "do_normalize": false});
    let section = crate::mllm::checkpoint::Section::root(path, &raw).unwrap();
    AnyresImageProcessor { filter: Filter::Bicubic, scale: PixelScale::from_section(&section).unwrap() }
}

#[test]
fn the_grids_of_the_real_models_are_those_of_transformers() {
    let anyres = read_json(&fixture("tiny_llava_next").join("anyres.json")).unwrap();
    let resolutions = [(336, 672), (672, 336), (672, 672), (1008, 336), (336, 1008)]
        .map(|(height, width)| Resolution { height, width })
        .to_vec();
    let grids = TileGrids::new(resolutions, 336, 24).unwrap();
    let number = |value: &Value| u32::try_from(value.as_u64().unwrap()).unwrap();
    let sizes = anyres["sizes"].as_array().unwrap();
    assert!(sizes.len() > 100);
    for row in sizes {
        let [height, width, best_height, best_width, tokens] = [0, 1, 2, 3, 4].map(|index| number(&row[index]));
        let tiling = grids.tiling(Resolution { height, width });
        assert_eq!(tiling.target, Resolution { height: best_height, width: best_width }, "{height} x {width}");
        assert_eq!(grids.tokens(&tiling), tokens as usize, "{height} x {width}");
    }

    let sums = &anyres["sums"];
    let (height, width) = (number(&sums["size"][0]), number(&sums["size"][1]));
    let tiling = grids.tiling(Resolution { height, width });
    let tiles = raw_processor().process(&synthetic(height, width), &tiling, 336).unwrap();
    for (key, axis) in [("rows", 2), ("columns", 1)] {
        for (tile, pixels) in tiles.iter().enumerate() {
            let found = pixels.sum(axis).unwrap().to_vec2::<f32>().unwrap();
            let expected: Vec<Vec<f32>> = serde_json::from_value(sums[key][tile].clone()).unwrap();
            assert_eq!(found, expected, "{key} of tile {tile}");
        }
    }
}

#[test]
fn broken_configurations_are_named() {
    let path = fixture("tiny_llava_next").join("config.json");
    let config = read_json(&path).unwrap();
    for (key, value) in [
        ("image_grid_pinpoints", json!([])),
        ("image_grid_pinpoints", json!([[32, 50]])),
        ("image_grid_pinpoints", json!([[32, 64, 96]])),
        ("image_grid_pinpoints", json!([[0, 64]])),
        ("image_grid_pinpoints", json!([[32, 1_u64 << 40]])),
        ("image_grid_pinpoints", json!("all")),
        ("vision_feature_select_strategy", json!("full")),
    ] {
        let mut changed = config.clone();
        changed[key] = value;
        match LlavaNextConfig::from_json(&path, &changed) {
            Err(crate::mllm::MllmError::Config { key: named, .. }) => assert_eq!(named, key),
            other => panic!("{key}: {other:?}"),
        }
    }
    assert!(LocalModel::open("next", path.parent().unwrap()).is_ok());
}
