//! Parity with Hugging Face transformers and llama.cpp's files (`tests/fixtures/tiny_qwen2_5_vl`).

use super::config::Qwen25VlConfig;
use super::{FAMILY, Qwen25Vl, take};
use crate::checkpoint::ConfigObject;
use crate::family::ImageSettings;
use crate::local::test_faults::{Fault, Parts};
use crate::local::test_prompts::{Prompts, SecondImage, assert_resized, raster_pixels};
use crate::local::test_reference::difference;
use crate::qwen3_vl::{PatchEncoder, PatchProcessor};
use candle_core::Tensor;
use serde_json::json;

/// A processor for images of so many pixels in patches of this side.
fn processor(pixels: [u64; 2], patch: u32) -> PatchProcessor {
    let keys = json!({"size": PatchProcessor::limits(pixels)});
    PatchProcessor::read(&ConfigObject::root("".as_ref(), &keys).unwrap(), patch, 2).unwrap()
}

/// The limits of the reference, pixels.
const TINY: [u64; 2] = [1024, 12_288];
/// The side of its patches, pixels.
const PATCH: u32 = 8;

/// Opens a model from parts.
fn assembled(parts: &Parts) -> Qwen25Vl {
    let config = Qwen25VlConfig::from_json(&parts.path, &parts.config).unwrap();
    take(&mut parts.weights(&FAMILY), &config, processor(TINY, PATCH)).unwrap()
}

#[test]
fn features_logits_and_greedy_tokens_of_both_layouts_are_those_of_transformers() {
    let prompts = Prompts::from_fixture("tiny_qwen2_5_vl");
    for folder in [".", "hub_style"] {
        prompts.check(&prompts.open(folder, ImageSettings::default()), |_| true);
    }
}

#[test]
fn llama_cpps_files_give_the_same() {
    let prompts = Prompts::from_fixture("tiny_qwen2_5_vl");
    let folder = prompts.gguf_with("preprocessor_config.json");
    prompts.check(&Prompts::open_at(folder.path()), |_| true);
}

#[test]
fn pixels_and_sizes_are_those_of_transformers() {
    let prompts = Prompts::from_fixture("tiny_qwen2_5_vl");
    for (name, index) in [("", 0), ("second_", 1)] {
        let found = processor(TINY, PATCH)
            .process(&prompts.image(index))
            .unwrap();
        let found = difference(&found, &raster_pixels(&prompts.reference, name, PATCH));
        assert!(found < 1e-6, "{name}: the pixels differ by {found}");
    }
    assert_resized(&prompts.folder, "tiny", |width, height| {
        processor(TINY, PATCH).resized(width, height)
    });
    assert_resized(&prompts.folder, "real", |width, height| {
        processor([3136, 1_003_520], 14).resized(width, height)
    });
}

/// Errors in configuration and weights on the way from pixels to features. The second image has
/// several windows.
const IMAGE_FAULTS: [Fault; 4] = [
    ("no windows", |parts| {
        parts.config["vision_config"]["fullatt_block_indexes"] = json!([0, 1, 2, 3]);
    }),
    ("windows in the last layer", |parts| {
        parts.config["vision_config"]["fullatt_block_indexes"] = json!([1]);
    }),
    ("the kernel of the first frame alone", |parts| {
        parts.change("patch_embed.proj.weight", |kernel| {
            let first = kernel.narrow(2, 0, 1).unwrap();
            Tensor::cat(&[&first, &first.zeros_like().unwrap()], 2).unwrap()
        });
    }),
    ("gates without their bias", |parts| {
        parts.change("mlp.gate_proj.bias", |tensor| tensor.zeros_like().unwrap());
    }),
];

/// Errors in the decoder's weights and configuration.
const DECODER_FAULTS: [Fault; 3] = [
    ("another base of the rotary embedding", |parts| {
        parts.config["text_config"]["rope_parameters"]["rope_theta"] = json!(10_000);
    }),
    ("other sections of the axes", |parts| {
        parts.config["text_config"]["rope_parameters"]["mrope_section"] = json!([4, 2, 2]);
    }),
    ("queries without their bias", |parts| {
        parts.change("self_attn.q_proj.bias", |tensor| {
            tensor.zeros_like().unwrap()
        });
    }),
];

#[test]
fn errors_that_are_easily_made_lead_far_away() {
    let prompts = Prompts::from_fixture("tiny_qwen2_5_vl");
    let run = SecondImage::from_prompts(&prompts);
    let pixels = raster_pixels(&prompts.reference, "second_", PATCH);
    let right = assembled(&Parts::from_folder(&prompts.folder));
    let features = right.encoder.encode(&pixels).unwrap();
    run.logits(&right, &features).assert_none("nothing wrong");
    for (what, fault) in IMAGE_FAULTS {
        let model = assembled(&Parts::wrong(&prompts.folder, fault));
        run.logits(&model, &model.encoder.encode(&pixels).unwrap())
            .assert_far(what);
    }
    for (what, fault) in DECODER_FAULTS {
        let model = assembled(&Parts::wrong(&prompts.folder, fault));
        run.logits(&model, &model.encoder.encode(&pixels).unwrap())
            .assert_logits_far(what);
    }
    let mut turned = features.clone();
    let layout = &mut turned.layouts[0];
    std::mem::swap(&mut layout.rows, &mut layout.columns);
    run.logits(&right, &turned)
        .assert_logits_far("rows and columns exchanged");
    for (what, wrong) in run.wrong_positions(&right) {
        run.placed(&right, &features, wrong).assert_logits_far(what);
    }
}
