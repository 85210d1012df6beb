//! Parity with Hugging Face transformers (`tests/fixtures/tiny_llava_onevision`).

use super::config::OnevisionConfig;
use super::preprocess::OnevisionProcessor;
use super::{FAMILY, LlavaOnevision};
use crate::checkpoint::ConfigObject;
use crate::family::{ImageSettings, Tiles, VisionLanguageModel};
use crate::local::test_faults::{Fault, Parts};
use crate::local::test_prompts::{ONE_TILE, Prompts, SecondImage, is_unsplit, json_of};
use crate::local::test_reference::{difference, whole};
use candle_core::Tensor;
use serde_json::json;
use std::path::Path;

const FIXTURE: &str = "tiny_llava_onevision";

/// Opens a model from parts.
fn assembled(parts: &Parts) -> LlavaOnevision {
    let config = OnevisionConfig::from_json(&parts.path, &parts.config).unwrap();
    let keys = json_of(parts.path.parent().unwrap(), "preprocessor_config.json");
    let object = ConfigObject::root(Path::new("preprocessor_config.json"), &keys).unwrap();
    let side = config.llava.vision.image_size as u32;
    let processor = OnevisionProcessor::read(&object, &config.grids, side).unwrap();
    LlavaOnevision::take(&mut parts.weights(&FAMILY), config, processor).unwrap()
}

#[test]
fn features_logits_and_greedy_tokens_of_both_layouts_are_those_of_transformers() {
    let prompts = Prompts::from_fixture(FIXTURE);
    for folder in [".", "hub_style"] {
        prompts.check(&prompts.open(folder, ImageSettings::default()), |run| {
            !is_unsplit(run)
        });
    }
}

/// As transformers shows each of several images.
#[test]
fn one_view_is_that_of_an_image_among_several() {
    let prompts = Prompts::from_fixture(FIXTURE);
    prompts.check(&prompts.open(".", ONE_TILE), is_unsplit);
}

#[test]
fn pixels_of_tiles_and_of_one_view_are_those_of_transformers() {
    let prompts = Prompts::from_fixture(FIXTURE);
    for (name, index) in [
        ("", 0),
        ("second_", 1),
        ("unsplit_", 0),
        ("unsplit_second_", 1),
    ] {
        let mut model = assembled(&Parts::from_folder(&prompts.folder));
        if is_unsplit(name) {
            model.set_images(ONE_TILE).unwrap();
        }
        let found = model.preprocess(&prompts.image(index)).unwrap();
        let expected = prompts.reference.tensor(&format!("{name}pixel_values"));
        let found = difference(&Tensor::stack(&found.pixels, 0).unwrap(), expected);
        assert!(found < 1e-5, "{name}: the pixels differ by {found}");
    }
}

/// Token counts of the published shape, by the processor's own rule.
#[test]
fn published_images_become_as_many_tokens() {
    let config = OnevisionConfig::from_json(Path::new("config.json"), &json!({})).unwrap();
    let packer = |parts: &Parts| assembled(parts).packer;
    let prompts = Prompts::from_fixture(FIXTURE);
    let packer = packer(&Parts::wrong(&prompts.folder, |parts| {
        parts.config["vision_aspect_ratio"] = json!("anyres_max_9");
    }));
    for ([width, height], tokens) in [
        ([336, 336], 1485),
        ([384, 384], 1485),
        ([448, 448], 3699),
        ([512, 512], 3699),
        ([640, 480], 2929),
        ([1920, 1080], 7269),
        ([100, 50], 1093),
    ] {
        let tiling = config
            .grids
            .tiling(crate::llava_next::Resolution { height, width });
        let found = packer.tokens(&config.grids, &tiling);
        assert_eq!(found, tokens, "{width} x {height}");
        assert!(found <= packer.max_tokens(&config.grids));
    }
    assert_eq!(super::connector::view_tokens(&config.grids), 730);
}

#[test]
fn tiles_are_one_or_as_the_processor_makes_them() {
    let prompts = Prompts::from_fixture(FIXTURE);
    let mut model = assembled(&Parts::from_folder(&prompts.folder));
    let settings = ImageSettings {
        size: None,
        tiles: Some(4),
    };
    let error = model.set_images(settings).unwrap_err().to_string();
    assert!(error.contains("image.tiles = 4"), "{error}");
}

/// Errors in configuration and weights on the way from pixels to features.
const IMAGE_FAULTS: [Fault; 4] = [
    ("the layer before the last one", |parts| {
        parts.config["vision_feature_layer"] = json!(-2);
    }),
    ("the map as large as it is", |parts| {
        parts.config["vision_aspect_ratio"] = json!("anyres_max_9");
    }),
    ("zeros in the place of the newline", |parts| {
        parts.change("image_newline", |newline| newline.zeros_like().unwrap());
    }),
    ("quick_gelu in the tower", |parts| {
        parts.config["vision_config"]["hidden_act"] = json!("quick_gelu");
    }),
];

#[test]
fn errors_that_are_easily_made_lead_far_away() {
    let prompts = Prompts::from_fixture(FIXTURE);
    let run = SecondImage::from_prompts(&prompts);
    let right = assembled(&Parts::from_folder(&prompts.folder));
    let tiles = right.preprocess(&prompts.image(1)).unwrap();
    let encoded = |model: &LlavaOnevision, tiles: &Tiles| model.encode(tiles).unwrap();
    let features = encoded(&right, &tiles);
    run.logits(&right, &features).assert_none("nothing wrong");
    for (what, fault) in IMAGE_FAULTS {
        let model = assembled(&Parts::wrong(&prompts.folder, fault));
        let wrong = encoded(&model, &tiles);
        if wrong.layouts == features.layouts {
            run.logits(&right, &wrong).assert_far(what);
        } else {
            println!("  {what:48} other tokens");
        }
    }
    // What is not the tower's last state: with the norm behind it, and the map in other forms.
    let mut swapped = tiles.clone();
    swapped.pixels.swap(1, 2);
    run.logits(&right, &encoded(&right, &swapped))
        .assert_far("two tiles swapped");
    let tokens = features.rows.dims()[0];
    let view = right.config.grids.tile_tokens();
    let [first, map] = [
        features.rows.narrow(0, 0, view).unwrap(),
        features.rows.narrow(0, view, tokens - view).unwrap(),
    ];
    let last = whole(Tensor::cat(&[&map, &first], 0).unwrap());
    run.logits(&right, &last).assert_far("the whole view last");
}
