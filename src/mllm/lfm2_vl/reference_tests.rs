//! Parity with Hugging Face transformers (`tests/fixtures/make_lfm2_vl.py`) and llama.cpp's files.

use super::FAMILY;
use super::config::Lfm2VlConfig;
use super::model::Lfm2Vl;
use super::processor::ViewProcessor;
use crate::checkpoint::{ConfigObject, read_json};
use crate::decoder::Logits;
use crate::family::{ImageFeatures, ImageSettings, Tiles, VisionLanguageModel};
use crate::local::Sequence;
use crate::local::test_faults::{Deviation, Fault, Parts};
use crate::local::test_prompts::{Prompts, json_of};
use crate::local::test_reference::{
    FEATURE_TOLERANCE, Reference, assert_greedy, assert_logits, data, difference,
    feature_difference,
};
use crate::source::ModelPlace;
use candle_core::{Device, Tensor};
use serde_json::json;
use std::collections::HashMap;
use std::path::Path;

const FIXTURE: &str = "tiny_lfm2_vl";

#[test]
fn features_logits_and_greedy_tokens_are_those_of_transformers() {
    let prompts = Prompts::from_fixture(FIXTURE);
    prompts.check(&prompts.open(".", ImageSettings::default()), |_| true);
}

/// The views of a run, (3, height, width) each, from rows of patches (y, x, channel); `padded` for
/// views that have the same number of rows, where those behind the patches mean nothing.
fn views(reference: &Reference, name: &str, patch: usize, padded: bool) -> Vec<Tensor> {
    let shapes = reference.tensor(&format!("{name}spatial_shapes"));
    let shapes: Vec<Vec<i64>> = shapes.to_vec2().unwrap();
    let rows = reference.tensor(&format!("{name}pixel_values"));
    let mut first = 0;
    let view = |(index, shape): (usize, &Vec<i64>)| {
        let [height, width] = [0, 1].map(|side| usize::try_from(shape[side]).unwrap());
        let patches = if padded {
            rows.get(index).unwrap().narrow(0, 0, height * width)
        } else {
            rows.narrow(0, first, height * width)
        };
        first += height * width;
        patches
            .unwrap()
            .reshape(vec![height, width, patch, patch, 3])
            .unwrap()
            .permute(vec![4, 0, 2, 1, 3])
            .unwrap()
            .reshape((3, height * patch, width * patch))
            .unwrap()
    };
    shapes.iter().enumerate().map(view).collect()
}

#[test]
fn views_have_the_pixels_of_pillow() {
    let prompts = Prompts::from_fixture(FIXTURE);
    let local = prompts.open(".", ImageSettings::default());
    for (name, index, count) in [("", 0, 1), ("second_", 1, 7)] {
        let expected = views(&prompts.reference, name, 4, false);
        let tiles = local.model().preprocess(&prompts.image(index)).unwrap();
        assert_eq!((tiles.pixels.len(), expected.len()), (count, count));
        for (found, expected) in tiles.pixels.iter().zip(&expected) {
            assert_eq!(found.dims(), expected.dims());
            assert!(difference(found, expected) < 1e-6);
        }
    }
}

#[test]
fn pictures_of_many_sizes_become_the_views_of_transformers() {
    let folder = Prompts::from_fixture(FIXTURE).folder;
    let cases = json_of(&folder, "tiles.json");
    for case in cases["cases"].as_array().unwrap() {
        let number = |key: &str| u32::try_from(case[key].as_u64().unwrap()).unwrap();
        let small =
            json!({"tile_size": 32, "min_image_tokens": 4, "max_image_tokens": 16, "max_tiles": 6});
        let (keys, patch) = if number("tile") == 32 {
            (small, 4)
        } else {
            (json!({}), 16)
        };
        let object = ConfigObject::root(Path::new("preprocessor_config.json"), &keys).unwrap();
        let processor = ViewProcessor::read(&object, [patch, 2]).unwrap();
        let (width, height) = (number("width"), number("height"));
        let plan = processor.plan(width, height).unwrap();
        let layout = processor.layout(width, height).unwrap();
        let found = json!({"whole": plan.whole, "rows": layout.rows, "columns": layout.columns, "tokens": layout.tokens});
        let expected = json!({"whole": case["whole"], "rows": case["rows"].as_u64().unwrap().max(1),
            "columns": case["columns"].as_u64().unwrap().max(1), "tokens": case["tokens"]});
        assert_eq!(found, expected, "{case}");
    }
}

/// A copy of the fixture whose tensors have the names of published files.
#[test]
fn published_names_and_keys_open_the_same_model() {
    let prompts = Prompts::from_fixture(FIXTURE);
    let copy = prompts.in_layout(".");
    let path = copy.path().join("config.json");
    let mut config = read_json(&path).unwrap();
    config["model_type"] = json!("lfm2-vl");
    config["image_token_index"] = config["image_token_id"].take();
    config["tie_embedding"] = config["tie_word_embeddings"].take();
    config["text_config"]["block_ff_dim"] = config["text_config"]["intermediate_size"].take();
    config["text_config"]["full_attn_idxs"] = json!([1, 3]);
    config["text_config"]["layer_types"].take();
    std::fs::write(&path, config.to_string()).unwrap();
    let weights = copy.path().join("model.safetensors");
    let tensors = candle_core::safetensors::load(&weights, &Device::Cpu).unwrap();
    let mut renamed: HashMap<String, Tensor> = tensors
        .into_iter()
        .map(|(name, tensor)| {
            let inner = "vision_tower.vision_model.";
            (name.replace("vision_tower.", inner), tensor)
        })
        .collect();
    let probe = Tensor::zeros((1, 1, 24), candle_core::DType::F32, &Device::Cpu).unwrap();
    renamed.insert("model.vision_tower.vision_model.head.probe".into(), probe);
    candle_core::safetensors::save(&renamed, &weights).unwrap();
    let local = Prompts::open_at(copy.path());
    prompts.check(&local, |name| name == "second_");
}

#[test]
fn one_view_in_the_place_of_tiles_is_a_setting() {
    let prompts = Prompts::from_fixture(FIXTURE);
    let layout = |tiles| {
        let image = ImageSettings { size: None, tiles };
        let local = prompts.open(".", image);
        local.model().image_layout(90, 61).unwrap()
    };
    let [own, one, four] = [None, Some(1), Some(4)].map(layout);
    assert_eq!((own.rows * own.columns, one.rows * one.columns), (6, 1));
    assert!(four.rows * four.columns <= 4 && four.rows * four.columns > 1);
    assert!(one.tokens <= 16, "{one:?}");
}

/// Opens a model from parts.
fn assembled(folder: &Path, parts: &Parts) -> Lfm2Vl {
    let config = Lfm2VlConfig::from_json(&parts.path, &parts.config).unwrap();
    let path = folder.join("preprocessor_config.json");
    let keys = read_json(&path).unwrap();
    let object = ConfigObject::root(&path, &keys).unwrap();
    let processor = ViewProcessor::read(&object, [4, 2]).unwrap();
    Lfm2Vl::take(&mut parts.weights(&FAMILY), &config, processor).unwrap()
}

/// The columns of a matrix over blocks of 2 by 2 patches of 24 channels, in another order.
fn blocks(order: [usize; 4]) -> impl Fn(&Tensor) -> Tensor {
    move |tensor| {
        let outputs = tensor.dims()[0];
        tensor
            .reshape((outputs, 2, 2, 24))
            .unwrap()
            .permute((order[0], order[1], order[2], order[3]))
            .unwrap()
            .contiguous()
            .unwrap()
            .reshape((outputs, 96))
            .unwrap()
    }
}

const IMAGE_FAULTS: [Fault; 7] = [
    ("a patch as channel, row, column", |parts| {
        parts.change("patch_embedding.weight", |kernel| {
            kernel
                .reshape((24, 4, 4, 3))
                .unwrap()
                .permute((0, 3, 1, 2))
                .unwrap()
                .contiguous()
                .unwrap()
                .reshape((24, 48))
                .unwrap()
        });
    }),
    ("columns of a block before its rows", |parts| {
        parts.change("linear_1.weight", blocks([0, 2, 1, 3]));
    }),
    ("channels of a block first", |parts| {
        parts.change("linear_1.weight", blocks([0, 3, 1, 2]));
    }),
    ("positions transposed", |parts| {
        parts.change("position_embedding.weight", |learned| {
            let grid = learned.reshape((7, 7, 24)).unwrap();
            let turned = grid.transpose(0, 1).unwrap().contiguous().unwrap();
            turned.reshape((49, 24)).unwrap()
        });
    }),
    ("no weights of the norm behind the tower", |parts| {
        parts.change("post_layernorm.weight", |weight| {
            weight.ones_like().unwrap()
        });
        parts.change("post_layernorm.bias", |bias| bias.zeros_like().unwrap());
    }),
    ("another activation of the projector", |parts| {
        parts.config["projector_hidden_act"] = json!("relu");
    }),
    ("another activation of the tower", |parts| {
        parts.config["vision_config"]["hidden_act"] = json!("quick_gelu");
    }),
];

#[test]
fn errors_that_are_easily_made_lead_far_away() {
    let prompts = Prompts::from_fixture(FIXTURE);
    let reference = &prompts.reference;
    Deviation::print_heading(&prompts.folder);
    let ids = reference.ids("second_input_ids", 0);
    let tiles = Tiles {
        pixels: views(reference, "second_", 4, false),
        width: 90,
        height: 61,
    };
    let deviation = |model: &Lfm2Vl, features: &ImageFeatures| {
        let mut sequence = Sequence::new(model);
        let logits = sequence.append(model, &ids, Some(features), Logits::All);
        let (logits, expected) = (logits.unwrap().unwrap(), reference.tensor("second_logits"));
        let kept = expected.dims()[0];
        let last = logits.narrow(0, ids.len() - kept, kept).unwrap();
        Deviation {
            features: feature_difference(&features.rows, reference.tensor("second_features")),
            logits: difference(&last, expected),
        }
    };
    let right = assembled(&prompts.folder, &Parts::from_folder(&prompts.folder));
    let features = right.encode(&tiles).unwrap();
    deviation(&right, &features).assert_none("nothing");
    for (what, fault) in IMAGE_FAULTS {
        let model = assembled(&prompts.folder, &Parts::wrong(&prompts.folder, fault));
        deviation(&model, &model.encode(&tiles).unwrap()).assert_far(what);
    }
    // Three columns and two rows of tiles with 16 tokens each, then the thumbnail.
    let thumbnail = features.rows.dims()[0] - 6 * 16;
    let part = |index: usize| features.rows.narrow(0, index * 16, 16).unwrap();
    let last = features.rows.narrow(0, 6 * 16, thumbnail).unwrap();
    let ordered = |order: &[usize], thumbnail_first: bool| {
        let mut rows: Vec<Tensor> = order.iter().map(|index| part(*index)).collect();
        rows.insert(if thumbnail_first { 0 } else { 6 }, last.clone());
        ImageFeatures {
            rows: Tensor::cat(&rows, 0).unwrap(),
            ..features.clone()
        }
    };
    deviation(&right, &ordered(&[0, 1, 2, 3, 4, 5], true)).assert_far("the thumbnail first");
    deviation(&right, &ordered(&[0, 3, 1, 4, 2, 5], false)).assert_far("tiles in columns");
}

/// Checks the reference of the data folder as folder and GGUF. It has a norm before the projector, a picture that is
/// enlarged, and one in six tiles. Its pixels are those of torchvision.
pub(crate) fn check_lfm2_vl() {
    let folder = data().join("mllm_reference/lfm2_vl");
    let reference = Reference::open(&folder.join("reference.safetensors"));
    let gguf = tempfile::tempdir().unwrap();
    for name in [
        "gguf/model.gguf",
        "gguf/mmproj-model.gguf",
        "preprocessor_config.json",
    ] {
        let from = folder.join(name);
        std::fs::copy(&from, gguf.path().join(from.file_name().unwrap())).unwrap();
    }
    for place in [folder.as_path(), gguf.path()] {
        let place = ModelPlace::Folder(place.to_path_buf());
        let local = Prompts::load(&place, ImageSettings::default());
        let model = local.model();
        let mut worst = [0_f32; 3];
        for (run, index) in [
            ("", Some(0)),
            ("second_", Some(1)),
            ("chat_", Some(0)),
            ("text_", None),
            ("nosystem_", Some(1)),
        ] {
            let features = index.map(|index: usize| {
                let name = ["", "second_"][index];
                let path = folder.join(format!("image_{index}.png"));
                let image = image::open(path).unwrap().into_rgb8();
                let pixels = views(&reference, name, 16, true);
                let own = model.preprocess(&image).unwrap();
                for (found, expected) in own.pixels.iter().zip(&pixels) {
                    assert_eq!(found.dims(), expected.dims());
                    worst[0] = worst[0].max(difference(found, expected));
                }
                let tiles = Tiles { pixels, ..own };
                let features = model.encode(&tiles).unwrap();
                let expected = reference.tensor(&format!("{name}features"));
                let apart = feature_difference(&features.rows, expected);
                worst[1] = worst[1].max(apart);
                features
            });
            let ids = reference.ids(&format!("{run}input_ids"), 0);
            let expected = reference.tensor(&format!("{run}logits"));
            let apart = assert_logits(model, &ids, features.as_ref(), expected);
            worst[2] = worst[2].max(apart);
            let tokens = reference.ids(&format!("{run}generated"), 0);
            assert_greedy(model, &ids, features.as_ref(), &tokens);
        }
        println!(
            "{}: pixels, features, logits {worst:?}",
            place.path().display()
        );
        // A level of 255 is 2/255 after normalization.
        assert!(worst[0] < 1.01 / 127.5, "{worst:?}");
        assert!(worst[1] < FEATURE_TOLERANCE, "{worst:?}");
    }
}
