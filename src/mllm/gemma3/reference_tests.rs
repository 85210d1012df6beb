//! Parity with Hugging Face transformers and llama.cpp's files (`tests/fixtures/tiny_gemma3`).

use super::config::Gemma3Config;
use super::model::Gemma3;
use super::{FAMILY, processor};
use crate::checkpoint::ModelFiles;
use crate::decoder::Logits;
use crate::family::{ImageSettings, VisionLanguageModel};
use crate::local::Sequence;
use crate::local::test_faults::{Fault, Parts};
use crate::local::test_prompts::{Prompts, SecondImage};
use crate::local::test_reference::{difference, whole};
use candle_core::Tensor;
use serde_json::json;
use std::ops::Range;

const FIXTURE: &str = "tiny_gemma3";

/// Which positions of a prompt see one another, from those that should.
type Seen = fn(Range<usize>) -> Range<usize>;

/// Opens a model from parts.
fn assembled(parts: &Parts) -> Gemma3 {
    let config = Gemma3Config::from_json(&parts.path, &parts.config).unwrap();
    let files = ModelFiles::folder(parts.path.parent().unwrap()).unwrap();
    let processor = processor(&files).unwrap();
    Gemma3::take(&mut parts.weights(&FAMILY), &config, processor).unwrap()
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
    for (name, index) in [("", 0), ("second_", 1)] {
        let found = model.preprocess(&prompts.image(index)).unwrap();
        let expected = prompts.reference.tensor(&format!("{name}pixel_values"));
        let found = difference(&found.pixels[0], expected);
        assert!(found < 1e-5, "{name}: the pixels differ by {found}");
    }
}

/// However the tokens are appended and cut back, those behind an image see all of it.
#[test]
fn an_image_that_was_computed_in_parts_is_computed_once_more() {
    let prompts = Prompts::from_fixture(FIXTURE);
    let model = assembled(&Parts::from_folder(&prompts.folder));
    let ids = prompts.reference.ids("second_input_ids", 0);
    let features = model.encode_image(&prompts.image(1)).unwrap();
    let bits = |logits: Tensor| -> Vec<u32> {
        let row: Vec<f32> = logits.flatten_all().unwrap().to_vec1().unwrap();
        row.iter().map(|value| value.to_bits()).collect()
    };
    let append = |sequence: &mut Sequence, ids: &[u32]| {
        let logits = sequence.append(&model, ids, Some(&features), Logits::Last);
        bits(logits.unwrap().unwrap())
    };
    let image_token = model.info().image_token;
    let first = ids.iter().position(|id| *id == image_token).unwrap();
    let behind = ids.iter().rposition(|id| *id == image_token).unwrap() + 1;
    let mut fresh = Sequence::new(&model);
    append(&mut fresh, &ids[..first]);
    append(&mut fresh, &ids[first..behind]);
    let expected = append(&mut fresh, &ids[behind..]);
    let mut parted = Sequence::new(&model);
    append(&mut parted, &ids[..first]);
    append(&mut parted, &ids[first..first + 2]);
    append(&mut parted, &ids[first + 2..behind]);
    assert_eq!(append(&mut parted, &ids[behind..]), expected);
    assert!(parted.cut(first + 4).is_empty());
    append(&mut parted, &ids[first + 4..behind]);
    assert_eq!(append(&mut parted, &ids[behind..]), expected);
    assert_eq!(parted.ids(), ids);
}

/// Errors on the way from pixels to features.
const IMAGE_FAULTS: [Fault; 3] = [
    ("the norm of the projector without the 1", |parts| {
        parts.change("mm_soft_emb_norm.weight", |weight| (weight - 1.0).unwrap());
    }),
    ("silu in the tower", |parts| {
        parts.config["vision_config"]["hidden_act"] = json!("silu");
    }),
    ("the norm behind the tower without its bias", |parts| {
        parts.change("post_layernorm.bias", |bias| bias.zeros_like().unwrap());
    }),
];

/// Errors in the decoder's configuration.
const DECODER_FAULTS: [Fault; 6] = [
    ("no windows", |parts| {
        parts.config["text_config"]["sliding_window"] = json!(1024);
    }),
    ("a window that is one narrower", |parts| {
        parts.config["text_config"]["sliding_window"] = json!(6);
    }),
    ("a window that is one wider", |parts| {
        parts.config["text_config"]["sliding_window"] = json!(8);
    }),
    ("the global base in local layers", |parts| {
        let rope = &mut parts.config["text_config"]["rope_parameters"];
        rope["sliding_attention"]["rope_theta"] = json!(1e6);
    }),
    ("positions that are not scaled", |parts| {
        parts.config["text_config"]["rope_parameters"]["full_attention"] =
            json!({"rope_type": "default", "rope_theta": 1e6});
    }),
    ("the first layer is global", |parts| {
        let kinds = parts.config["text_config"]["layer_types"].as_array_mut();
        kinds.unwrap().rotate_left(5);
    }),
];

#[test]
fn errors_that_are_easily_made_lead_far_away() {
    let prompts = Prompts::from_fixture(FIXTURE);
    let run = SecondImage::from_prompts(&prompts);
    let (right, features) = run.check_faults(&prompts, assembled, [&IMAGE_FAULTS, &DECODER_FAULTS]);
    let seen: [(&str, Seen); 2] = [
        ("a causal mask within the image", |_| 0..0),
        ("begin and end among the image's tokens", |image| {
            image.start - 1..image.end + 1
        }),
    ];
    for (what, change) in seen {
        run.seeing(&right, &features, change)
            .assert_logits_far(what);
    }
    let scale = (32f64).sqrt();
    for (what, factor) in [
        ("features times the root of the width", scale),
        ("features divided by the root of the width", 1.0 / scale),
    ] {
        run.logits(&right, &whole((&features.rows * factor).unwrap()))
            .assert_far(what);
    }
    // 36 patches, of which blocks of 2 by 2 become a token.
    let pixels = &right.preprocess(&prompts.image(1)).unwrap().pixels[0];
    let encoder = &right.encoder;
    let grid = encoder
        .tower
        .forward(pixels)
        .unwrap()
        .reshape(vec![3, 2, 3, 2, 16])
        .unwrap();
    let projected = |pooled: Tensor| {
        let pooled = pooled.reshape((9, 16)).unwrap();
        whole(encoder.project(&pooled).unwrap())
    };
    let one = grid.narrow(1, 0, 1).unwrap().narrow(3, 0, 1).unwrap();
    run.logits(&right, &projected(one.contiguous().unwrap()))
        .assert_far("one patch in the place of the average");
    let most = grid.max(3).unwrap().max(1).unwrap();
    run.logits(&right, &projected(most))
        .assert_far("the maximum in the place of the average");
    let columns = grid.mean(3).unwrap().mean(1).unwrap();
    let columns = columns.transpose(0, 1).unwrap().contiguous().unwrap();
    run.logits(&right, &projected(columns))
        .assert_far("tokens in columns");
}
