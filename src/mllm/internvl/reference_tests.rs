//! Parity with Hugging Face transformers and llama.cpp's files (`tests/fixtures/tiny_internvl3`).

use super::config::InternVlConfig;
use super::tiles::TileProcessor;
use super::{FAMILY, InternVl, take};
use crate::family::{ImageFeatures, ImageLayout, ImageSettings, VisionLanguageModel};
use crate::local::test_faults::{Deviation, Fault, Parts};
use crate::local::test_prompts::{ONE_TILE, Prompts, is_unsplit, json_of};
use crate::local::test_reference::{Run, difference};
use crate::tiled::TileEncoder;
use crate::tiled::Tiler;
use candle_core::Tensor;
use serde_json::json;

/// Opens a model from parts.
fn assembled(parts: &Parts) -> InternVl {
    let config = InternVlConfig::from_json(&parts.path, &parts.config, || Ok(None)).unwrap();
    take(
        &mut parts.weights(&FAMILY),
        &config,
        TileProcessor::new(16, 1, 12),
    )
    .unwrap()
}

#[test]
fn features_logits_and_greedy_tokens_of_both_layouts_are_those_of_transformers() {
    let prompts = Prompts::from_fixture("tiny_internvl3");
    for folder in [".", "original"] {
        prompts.check(&prompts.open(folder, ImageSettings::default()), |name| {
            !is_unsplit(name)
        });
        prompts.check(&prompts.open(folder, ONE_TILE), is_unsplit);
    }
}

#[test]
fn llama_cpps_files_give_the_same() {
    let prompts = Prompts::from_fixture("tiny_internvl3");
    prompts.check(&prompts.open_gguf(ImageSettings::default()), |name| {
        !is_unsplit(name)
    });
    prompts.check(&prompts.open_gguf(ONE_TILE), is_unsplit);
}

#[test]
fn views_have_the_pixels_of_transformers() {
    let prompts = Prompts::from_fixture("tiny_internvl3");
    for (name, index, most) in [("", 0, 12), ("second_", 1, 12), ("unsplit_", 0, 1)] {
        let views = TileProcessor::new(16, 1, most)
            .views(&prompts.image(index))
            .unwrap();
        let found = difference(
            &Tensor::stack(&views, 0).unwrap(),
            prompts.reference.tensor(&format!("{name}pixel_values")),
        );
        assert!(found < 1e-6, "{name}: the pixels differ by {found}");
    }
}

#[test]
fn grids_of_tiles_are_those_of_transformers() {
    let prompts = Prompts::from_fixture("tiny_internvl3");
    let tiles = json_of(&prompts.folder, "tiles.json");
    let cases = tiles["cases"].as_array().unwrap();
    assert!(cases.len() > 20);
    for case in cases {
        let number = |key: &str| case[key].as_u64().unwrap() as u32;
        let found =
            TileProcessor::new(number("tile"), 1, 12).grid(number("width"), number("height"));
        assert_eq!(
            (found.columns, found.rows),
            (number("columns"), number("rows")),
            "{case}"
        );
        assert_eq!(found.views(), number("tiles") as usize, "{case}");
    }
}

/// Errors in configuration and weights on the way from pixels to features.
const IMAGE_FAULTS: [Fault; 5] = [
    ("quick_gelu in the place of gelu", |parts| {
        parts.config["vision_config"]["hidden_act"] = json!("quick_gelu");
    }),
    ("no scales of the layers", |parts| {
        for scale in ["lambda_1", "lambda_2"] {
            parts.change(scale, |tensor| tensor.ones_like().unwrap());
        }
    }),
    ("the last layer but one", |parts| {
        parts.config["vision_config"]["num_hidden_layers"] = json!(3);
    }),
    ("no bias of the patches", |parts| {
        parts.change("projection.bias", |tensor| tensor.zeros_like().unwrap());
    }),
    ("the class token's position for no token", |parts| {
        parts.change("cls_token", |tensor| tensor.zeros_like().unwrap());
    }),
];

/// Errors in the decoder's weights and configuration.
const DECODER_FAULTS: [Fault; 2] = [
    ("another base of the rotary embedding", |parts| {
        parts.config["text_config"]["rope_parameters"]["rope_theta"] = json!(10_000);
    }),
    ("queries without their bias", |parts| {
        parts.change("self_attn.q_proj.bias", |tensor| {
            tensor.zeros_like().unwrap()
        });
    }),
];

/// Wrong orders of the axes (block row, row within, block column, column within, channel).
const WRONG_ORDERS: [(&str, [usize; 5]); 3] = [
    ("columns before rows in a token", [0, 2, 3, 1, 4]),
    ("channels first in a token", [0, 2, 4, 1, 3]),
    ("the tokens of a tile in columns", [2, 0, 1, 3, 4]),
];

/// Features of the first image.
fn features(rows: Tensor) -> ImageFeatures {
    ImageFeatures {
        rows,
        deep: Vec::new(),
        layouts: vec![ImageLayout {
            tokens: 28,
            rows: 2,
            columns: 3,
        }],
    }
}

fn encoded(model: &InternVl, views: &[Tensor]) -> ImageFeatures {
    features(model.encoder.encode_views(views).unwrap())
}

/// The features of a model whose connector takes the axes in another order.
fn shuffled(model: &InternVl, views: &[Tensor], order: [usize; 5]) -> ImageFeatures {
    let rows = views.iter().map(|pixels| {
        let patches = model
            .encoder
            .patches(pixels)
            .unwrap()
            .reshape(vec![2, 2, 2, 2, 32])
            .unwrap();
        let merged = patches
            .permute(order.to_vec())
            .unwrap()
            .reshape((4, 128))
            .unwrap();
        model.encoder.project(&merged).unwrap()
    });
    features(Tensor::cat(&rows.collect::<Vec<_>>(), 0).unwrap())
}

#[test]
fn errors_that_are_easily_made_lead_far_away() {
    let Prompts { folder, .. } = Prompts::from_fixture("tiny_internvl3");
    let run = Run::open(&folder.join("reference.safetensors"), 0);
    Deviation::print_heading(&folder);
    let right = assembled(&Parts::from_folder(&folder));
    Deviation::from_run(&run, &right, &encoded(&right, &run.pixels)).assert_none("nothing wrong");
    for (what, fault) in IMAGE_FAULTS {
        let model = assembled(&Parts::wrong(&folder, fault));
        Deviation::from_run(&run, &model, &encoded(&model, &run.pixels)).assert_far(what);
    }
    for (what, order) in WRONG_ORDERS {
        Deviation::from_run(&run, &right, &shuffled(&right, &run.pixels, order)).assert_far(what);
    }
    let mut first = run.pixels.clone();
    first.rotate_right(1);
    Deviation::from_run(&run, &right, &encoded(&right, &first)).assert_far("the whole view first");
    let clip: Vec<Tensor> = run
        .pixels
        .iter()
        .map(|pixels| (pixels * 0.85).unwrap())
        .collect();
    Deviation::from_run(&run, &right, &encoded(&right, &clip))
        .assert_far("pixels by CLIP's deviation");
    for (what, fault) in DECODER_FAULTS {
        let model = assembled(&Parts::wrong(&folder, fault));
        Deviation::from_run(&run, &model, &encoded(&model, &run.pixels)).assert_logits_far(what);
    }
    assert_eq!(
        right.image_layout(40, 24).unwrap(),
        encoded(&right, &run.pixels).layouts[0]
    );
}
