//! Parity with Hugging Face transformers and llama.cpp's files (`tests/fixtures/tiny_smolvlm`).

use super::config::SmolVlmConfig;
use super::tiles::TileProcessor;
use super::{FAMILY, SmolVlm, take};
use crate::checkpoint::ConfigObject;
use crate::family::{ImageFeatures, ImageLayout, ImageSettings, VisionLanguageModel};
use crate::local::test_faults::{Deviation, Fault, Parts};
use crate::local::test_prompts::{ONE_TILE, Prompts, is_unsplit, json_of};
use crate::local::test_reference::{Run, difference};
use crate::tiled::TileEncoder;
use crate::tiled::{Grid, Tiler};
use candle_core::Tensor;
use serde_json::json;

/// A processor for these sizes, pixels.
fn processor(longest: u64, tile: u32) -> TileProcessor {
    let keys = json!({"size": {"longest_edge": longest}, "max_image_size": {"longest_edge": tile}});
    let path = "preprocessor_config.json".as_ref();
    TileProcessor::read(&ConfigObject::root(path, &keys).unwrap(), tile).unwrap()
}

/// Opens a model from parts.
fn assembled(parts: &Parts) -> SmolVlm {
    let config = SmolVlmConfig::from_json(&parts.path, &parts.config).unwrap();
    take(&mut parts.weights(&FAMILY), &config, processor(48, 16)).unwrap()
}

#[test]
fn features_logits_and_greedy_tokens_are_those_of_transformers() {
    let prompts = Prompts::from_fixture("tiny_smolvlm");
    for folder in [".", "hub_style"] {
        prompts.check(&prompts.open(folder, ImageSettings::default()), |name| {
            !is_unsplit(name)
        });
        prompts.check(&prompts.open(folder, ONE_TILE), is_unsplit);
    }
}

#[test]
fn llama_cpps_files_give_the_same() {
    let prompts = Prompts::from_fixture("tiny_smolvlm");
    prompts.check(&prompts.open_gguf(ImageSettings::default()), |name| {
        !is_unsplit(name)
    });
    prompts.check(&prompts.open_gguf(ONE_TILE), is_unsplit);
}

#[test]
fn views_have_the_pixels_of_transformers() {
    let prompts = Prompts::from_fixture("tiny_smolvlm");
    let mut one = processor(48, 16);
    one.set_tiles(1).unwrap();
    let split = processor(48, 16);
    let cases = [
        ("", 0, &split),
        ("second_", 1, &split),
        ("unsplit_", 0, &one),
        ("unsplit_second_", 1, &one),
    ];
    for (name, index, processor) in cases {
        let views = Tensor::stack(&processor.views(&prompts.image(index)).unwrap(), 0).unwrap();
        let found = difference(
            &views,
            prompts.reference.tensor(&format!("{name}pixel_values")),
        );
        assert!(found < 1e-6, "{name}: the pixels differ by {found}");
    }
}

#[test]
fn grids_of_tiles_are_those_of_transformers() {
    let prompts = Prompts::from_fixture("tiny_smolvlm");
    let tiles = json_of(&prompts.folder, "tiles.json");
    let cases = tiles["cases"].as_array().unwrap();
    assert!(cases.len() > 40);
    for case in cases {
        let number = |key: &str| case[key].as_u64().unwrap() as u32;
        let pair = |key: &str| {
            [0, 1]
                .map(|index| case[key][index].as_u64().unwrap() as u32)
                .into()
        };
        let found = processor(number("longest_edge").into(), number("tile"))
            .tiling(number("width"), number("height"));
        assert_eq!(
            (found.first, found.second),
            (pair("first_resize"), pair("second_resize")),
            "{case}"
        );
        // transformers counts no rows where an image is not cut.
        let Grid { rows, columns, .. } = found.grid;
        assert_eq!(
            (rows, columns),
            (number("rows").max(1), number("columns").max(1)),
            "{case}"
        );
    }
}

/// Errors in configuration and weights on the way from pixels to features.
const IMAGE_FAULTS: [Fault; 4] = [
    ("quick_gelu in the place of gelu", |parts| {
        parts.config["vision_config"]["hidden_act"] = json!("quick_gelu");
    }),
    ("the tower without its last norm", |parts| {
        parts.change("post_layernorm.weight", |tensor| {
            tensor.ones_like().unwrap()
        });
        parts.change("post_layernorm.bias", |tensor| tensor.zeros_like().unwrap());
    }),
    ("no bias of the patches", |parts| {
        parts.change("patch_embedding.bias", |tensor| {
            tensor.zeros_like().unwrap()
        });
    }),
    ("the last layer but one", |parts| {
        parts.config["vision_config"]["num_hidden_layers"] = json!(2);
    }),
];

/// Wrong orders of the axes (block row, row within, block column, column within, channel).
const WRONG_ORDERS: [(&str, [usize; 5]); 3] = [
    ("columns before rows in a token", [0, 2, 3, 1, 4]),
    ("channels first in a token", [0, 2, 4, 1, 3]),
    ("the tokens of a tile in columns", [2, 0, 1, 3, 4]),
];

/// The features of a model whose connector takes the axes in another order.
fn shuffled(model: &SmolVlm, run: &Run, order: [usize; 5]) -> ImageFeatures {
    let rows = run.pixels.iter().map(|pixels| {
        let patches = model
            .encoder
            .tower
            .forward(pixels)
            .unwrap()
            .reshape(vec![2, 4, 2, 4, 32])
            .unwrap();
        model
            .encoder
            .projection
            .forward(
                &patches
                    .permute(order.to_vec())
                    .unwrap()
                    .reshape((4, 512))
                    .unwrap(),
            )
            .unwrap()
    });
    features(Tensor::cat(&rows.collect::<Vec<_>>(), 0).unwrap())
}

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

#[test]
fn errors_that_are_easily_made_lead_far_away() {
    let Prompts { folder, .. } = Prompts::from_fixture("tiny_smolvlm");
    let run = Run::open(&folder.join("reference.safetensors"), 0);
    Deviation::print_heading(&folder);
    let right = assembled(&Parts::from_folder(&folder));
    let encoded =
        |model: &SmolVlm, views: &[Tensor]| features(model.encoder.encode_views(views).unwrap());
    Deviation::from_run(&run, &right, &encoded(&right, &run.pixels)).assert_none("nothing wrong");
    for (what, fault) in IMAGE_FAULTS {
        let model = assembled(&Parts::wrong(&folder, fault));
        Deviation::from_run(&run, &model, &encoded(&model, &run.pixels)).assert_far(what);
    }
    for (what, order) in WRONG_ORDERS {
        Deviation::from_run(&run, &right, &shuffled(&right, &run, order)).assert_far(what);
    }
    let mut first = run.pixels.clone();
    first.rotate_right(1);
    Deviation::from_run(&run, &right, &encoded(&right, &first)).assert_far("the whole view first");
    let picture = image::open(folder.join("image_0.png")).unwrap().into_rgb8();
    let bicubic = json!({"size": {"longest_edge": 48}, "max_image_size": {"longest_edge": 16}, "resample": 3});
    let root = ConfigObject::root("".as_ref(), &bicubic).unwrap();
    let views = TileProcessor::read(&root, 16)
        .unwrap()
        .views(&picture)
        .unwrap();
    Deviation::from_run(&run, &right, &encoded(&right, &views))
        .assert_far("bicubic in the place of Lanczos");
    for (what, fault) in [
        (
            "another base of the rotary embedding",
            (|parts| {
                parts.config["text_config"]["rope_parameters"]["rope_theta"] = json!(10_000);
            }) as fn(&mut Parts),
        ),
        ("norms with another epsilon", |parts| {
            parts.config["text_config"]["rms_norm_eps"] = json!(1e-1);
        }),
    ] {
        let model = assembled(&Parts::wrong(&folder, fault));
        Deviation::from_run(&run, &model, &encoded(&model, &run.pixels)).assert_logits_far(what);
    }
    assert_eq!(
        right.image_layout(40, 24).unwrap(),
        features(run.features.clone()).layouts[0]
    );
}
