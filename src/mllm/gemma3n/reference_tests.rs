//! Parity with Hugging Face transformers and timm (`tests/fixtures/tiny_gemma3n_vision`).

use super::config::Gemma3nConfig;
use super::model::Gemma3n;
use super::tower::Map;
use super::{FAMILY, processor};
use crate::checkpoint::{ModelFiles, read_json};
use crate::family::{ImageSettings, VisionLanguageModel};
use crate::local::test_faults::{Fault, Parts};
use crate::local::test_prompts::{Prompts, SecondImage};
use crate::local::test_reference::{difference, whole};
use crate::local::{Loading, LocalModel};
use crate::source::ModelPlace;
use candle_core::{DType, Tensor};
use serde_json::{Value, json};

const FIXTURE: &str = "tiny_gemma3n_vision";
/// The first token of the table of pictures: the mark behind an image.
const MARK: u32 = 304;
/// Tokens along a side, and width of the tower's tokens.
const GRID: usize = 3;
const WIDTH: usize = 64;

/// Opens a model from parts.
fn assembled(parts: &Parts) -> Gemma3n {
    let config = Gemma3nConfig::from_json(&parts.path, &parts.config).unwrap();
    let files = ModelFiles::folder(parts.path.parent().unwrap()).unwrap();
    let mut weights = parts.weights(&FAMILY);
    let seen = config.seen.unwrap();
    Gemma3n::take(
        &mut weights,
        &config.text,
        &seen,
        processor(&files).unwrap(),
    )
    .unwrap()
}

/// What opening a folder says whose `file` is changed.
fn changed(file: &str, change: impl FnOnce(&mut Value)) -> Result<LocalModel, crate::MllmError> {
    let copy = Prompts::from_fixture(FIXTURE).in_layout(".");
    let path = copy.path().join(file);
    let mut value = read_json(&path).unwrap();
    change(&mut value);
    std::fs::write(&path, value.to_string()).unwrap();
    let place = ModelPlace::Folder(copy.path().to_path_buf());
    LocalModel::load("tiny", &place, &Loading::default())
}

#[test]
fn features_logits_and_greedy_tokens_of_both_layouts_are_those_of_transformers() {
    let prompts = Prompts::from_fixture(FIXTURE);
    for folder in [".", "hub_style"] {
        prompts.check(&prompts.open(folder, ImageSettings::default()), |_| true);
    }
}

#[test]
fn llama_cpps_files_give_the_same() {
    let prompts = Prompts::from_fixture(FIXTURE);
    prompts.check(&prompts.open_gguf(ImageSettings::default()), |_| true);
}

#[test]
fn pixels_are_those_of_transformers() {
    let prompts = Prompts::from_fixture(FIXTURE);
    let model = assembled(&Parts::from_folder(&prompts.folder));
    let found = model.preprocess(&prompts.image(1)).unwrap();
    let expected = prompts.reference.tensor("second_pixels");
    let expected = (expected.to_dtype(DType::F32).unwrap() / 255.0).unwrap();
    let found = difference(&found.pixels[0], &expected);
    assert!(found < 1e-6, "the pixels differ by {found}");
}

/// The decoder has other shapes than that of `tiny_gemma3n`.
#[test]
fn a_folder_whose_tower_is_null_opens_as_a_language_model() {
    let prompts = Prompts::from_fixture(FIXTURE);
    let blind = changed("config.json", |config| {
        config["vision_config"] = Value::Null;
    })
    .unwrap();
    assert_eq!(blind.model().info().image_size, None);
    prompts.check(&blind, |name| name == "text_");
}

#[test]
fn tokens_of_pictures_and_sounds_are_embedded_by_tables_of_their_own() {
    let prompts = Prompts::from_fixture(FIXTURE);
    let model = assembled(&Parts::from_folder(&prompts.folder));
    let ids: Vec<u32> = (MARK..MARK + 6).collect();
    let rows = model.decoder().embed(&ids).unwrap();
    let found = difference(&rows, prompts.reference.tensor("table_rows"));
    assert!(found < 1e-5, "the rows differ by {found}");
    // The same bits in any pass, between tokens of the decoder.
    let mixed = [7, 9, MARK, MARK + 1, 11, MARK + 4];
    let together = model.decoder().embed(&mixed).unwrap();
    for (index, id) in mixed.into_iter().enumerate() {
        let alone = model.decoder().embed(&[id]).unwrap();
        let row = together.narrow(0, index, 1).unwrap();
        assert_eq!(difference(&alone, &row).to_bits(), 0, "{id}");
    }
    assert_eq!(model.decoder().embed(&[]).unwrap().dims(), [0, 32]);
}

#[test]
fn pictures_of_other_sizes_are_refused_by_their_key() {
    for (key, value, said) in [
        ("size", json!({"height": 64, "width": 64}), "multiple of"),
        ("size", json!({"height": 96, "width": 48}), "square"),
        ("size", json!({"shortest_edge": 96}), "square"),
        ("image_processor_type", json!("BlipImageProcessor"), "CLIP"),
    ] {
        let opened = changed("preprocessor_config.json", |config| config[key] = value);
        let problem = opened.map(|_| ()).unwrap_err().to_string();
        assert!(problem.contains(key) && problem.contains(said), "{problem}");
    }
}

fn zeros(weight: &Tensor) -> Tensor {
    weight.zeros_like().unwrap()
}

fn ones(weight: &Tensor) -> Tensor {
    weight.ones_like().unwrap()
}

/// Rows with their halves exchanged.
fn halves_exchanged(rows: &Tensor) -> Tensor {
    let half = rows.dims()[1] / 2;
    let [first, second] = [0, half].map(|start| rows.narrow(1, start, half).unwrap());
    Tensor::cat(&[second, first], 1).unwrap()
}

/// Errors on the way from pixels to features.
const IMAGE_FAULTS: [Fault; 13] = [
    ("the first convolution without its bias", |parts| {
        parts.change("conv_stem.conv.bias", zeros);
    }),
    ("the first convolution without its norm", |parts| {
        parts.change("conv_stem.bn.weight", ones);
    }),
    ("blocks without the factors of their channels", |parts| {
        parts.change("layer_scale.gamma", ones);
    }),
    ("factors of channels as they are made", |parts| {
        parts.change("layer_scale.gamma", |scale| (ones(scale) * 1e-5).unwrap());
    }),
    ("norms by 1 + w in blocks", |parts| {
        parts.change("pw_proj.bn.weight", |weight| (weight + 1.0).unwrap());
    }),
    ("keys and values exchanged", |parts| {
        let name =
            |part| format!("model.vision_tower.timm_model.blocks.2.2.attn.{part}.proj.weight");
        parts.swap(&name("key"), &name("value"));
    }),
    ("keys of other pixels", |parts| {
        parts.change("attn.key.down_conv.weight", |kernel| {
            kernel.flip(&[2, 3]).unwrap()
        });
    }),
    ("heads of queries across", |parts| {
        parts.change("blocks.2.2.attn.query.proj.weight", |rows| {
            let rows = rows.reshape((3, 8, 8)).unwrap();
            let across = rows.transpose(0, 1).unwrap().contiguous().unwrap();
            across.reshape((24, 8, 1, 1)).unwrap()
        });
    }),
    ("maps fused in the other order", |parts| {
        parts.change("msfa.ffn.pw_exp.conv.weight", halves_exchanged);
    }),
    ("tokens without their norm", |parts| {
        parts.change("msfa.norm.weight", ones);
    }),
    ("the norm of tokens of the table for the tower's", |parts| {
        let name = |part| format!("model.embed_vision.{part}_embedding_norm.weight");
        parts.swap(&name("hard"), &name("soft"));
    }),
    ("the norm before the projection by 1 + w", |parts| {
        parts.change("embed_vision.soft_embedding_norm.weight", |weight| {
            (weight + 1.0).unwrap()
        });
    }),
    ("pixels from −1 to 1", |parts| {
        // Pixels 2 (x − 0.5): twice the kernel, and half of its sum less.
        let name = "model.vision_tower.timm_model.conv_stem.conv.weight";
        let kernel = parts.tensor(name).to_dtype(DType::F32).unwrap();
        let sums = kernel.flatten_from(1).unwrap().sum(1).unwrap();
        parts.change("conv_stem.conv.weight", |kernel| (kernel * 2.0).unwrap());
        parts.change("conv_stem.conv.bias", |bias| {
            (bias.to_dtype(DType::F32).unwrap() - &sums).unwrap()
        });
    }),
];

fn text(parts: &mut Parts) -> &mut Value {
    &mut parts.config["text_config"]
}

/// Errors in the decoder, and in what it reads of tokens.
const DECODER_FAULTS: [Fault; 8] = [
    (
        "the mark behind the image from the decoder's table",
        |parts| {
            parts.config["vision_config"]["vocab_offset"] = json!(MARK + 1);
        },
    ),
    ("rows of the table without their norm", |parts| {
        parts.change("embed_vision.hard_embedding_norm.weight", ones);
    }),
    (
        "another row for tokens that the table of layers lacks",
        |parts| {
            parts.change("embed_tokens_per_layer.weight", |table| {
                let first = table.narrow(0, 1, 1).unwrap();
                let others = table.narrow(0, 1, table.dims()[0] - 1).unwrap();
                Tensor::cat(&[first, others], 0).unwrap()
            });
        },
    ),
    ("all gates count", |parts| {
        text(parts)["activation_sparsity_pattern"] = json!(vec![0.0; 6]);
    }),
    ("no bound of logits", |parts| {
        text(parts)["final_logit_softcapping"] = json!(1e6);
    }),
    ("a window that is one wider", |parts| {
        text(parts)["sliding_window"] = json!(10);
    }),
    ("the base of global layers in local ones", |parts| {
        text(parts)["rope_parameters"]["sliding_attention"]["rope_theta"] = json!(1e6);
    }),
    ("scores divided by the root of the width", |parts| {
        parts.change("q_norm.weight", |weight| {
            (weight * 24_f64.sqrt().recip()).unwrap()
        });
    }),
];

#[test]
fn errors_that_are_easily_made_lead_far_away() {
    let prompts = Prompts::from_fixture(FIXTURE);
    let run = SecondImage::from_prompts(&prompts);
    let (right, features) = run.check_faults(&prompts, assembled, [&IMAGE_FAULTS, &DECODER_FAULTS]);
    let scale = 32_f64.sqrt();
    let scaled = whole((&features.rows * scale).unwrap());
    run.logits(&right, &scaled)
        .assert_far("features times the root of the width");
    let columns = features.rows.reshape((GRID, GRID, 32)).unwrap();
    let columns = columns.transpose(0, 1).unwrap().contiguous().unwrap();
    run.logits(&right, &whole(columns.reshape((GRID * GRID, 32)).unwrap()))
        .assert_far("tokens in columns");
}

/// With the odd zero of a border before the image: the mirrored network of the mirrored image.
#[test]
fn the_odd_zero_of_a_border_lies_behind_the_image() {
    let prompts = Prompts::from_fixture(FIXTURE);
    let run = SecondImage::from_prompts(&prompts);
    let mirrored = assembled(&Parts::wrong(&prompts.folder, |parts| {
        for end in [
            "conv_exp.weight",
            "conv_stem.conv.weight",
            "dw_start.conv.weight",
        ] {
            parts.change(end, |kernel| kernel.flip(&[2, 3]).unwrap());
        }
        for end in ["dw_mid.conv.weight", "down_conv.weight"] {
            parts.change(end, |kernel| kernel.flip(&[2, 3]).unwrap());
        }
    }));
    let pixels = &mirrored.preprocess(&prompts.image(1)).unwrap().pixels[0];
    let pixels = pixels.flip(&[1, 2]).unwrap();
    let tokens = mirrored.tower.forward(&pixels).unwrap().flip(&[0]).unwrap();
    let features = mirrored
        .decoder
        .embedder
        .seen(&tokens.contiguous().unwrap());
    run.logits(&mirrored, &whole(features.unwrap()))
        .assert_far("the odd zero before the image");
}

/// Errors in the way from two maps to tokens.
#[test]
fn tokens_are_averages_of_the_maps_of_two_stages() {
    let prompts = Prompts::from_fixture(FIXTURE);
    let run = SecondImage::from_prompts(&prompts);
    let right = assembled(&Parts::from_folder(&prompts.folder));
    let pixels = &right.preprocess(&prompts.image(1)).unwrap().pixels[0];
    let [before, last] = right.tower.maps(pixels).unwrap();
    let judged = |fused: &Map| {
        let tokens = right.tower.tokens(fused).unwrap();
        let features = right.decoder.embedder.seen(&tokens).unwrap();
        run.logits(&right, &whole(features))
    };
    let fused = right.tower.fused(&before, &last).unwrap();
    judged(&fused).assert_none("nothing wrong");
    let blocks = fused.rows.reshape(vec![GRID, 2, GRID, 2, WIDTH]).unwrap();
    let repeated = |blocks: Tensor| {
        let wide = blocks.broadcast_as(vec![GRID, 2, GRID, 2, WIDTH]).unwrap();
        let rows = wide.contiguous().unwrap().reshape(((), WIDTH)).unwrap();
        Map {
            rows,
            grid: fused.grid,
        }
    };
    let first = blocks.narrow(1, 0, 1).unwrap().narrow(3, 0, 1).unwrap();
    judged(&repeated(first)).assert_far("one pixel in the place of the average");
    let most = blocks.max_keepdim(3).unwrap().max_keepdim(1).unwrap();
    judged(&repeated(most)).assert_far("the maximum in the place of the average");
    // The map of the last stage repeated as a whole, not pixel by pixel.
    let tiled = last.rows.reshape((GRID, GRID, 8)).unwrap();
    let tiled = Tensor::cat(&[&tiled, &tiled], 1).unwrap();
    let tiled = Tensor::cat(&[&tiled, &tiled], 0).unwrap();
    let tiled = Map {
        rows: tiled.reshape(((), 8)).unwrap(),
        grid: before.grid,
    };
    judged(&right.tower.fused(&before, &tiled).unwrap()).assert_far("a map beside itself");
}
