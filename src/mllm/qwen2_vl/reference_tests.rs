//! Parity with Hugging Face transformers and llama.cpp's files (`tests/fixtures/tiny_qwen2_vl`).

use super::config::Qwen2VlConfig;
use super::{FAMILY, Qwen2Vl, take};
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
fn assembled(parts: &Parts) -> Qwen2Vl {
    let config = Qwen2VlConfig::from_json(&parts.path, &parts.config).unwrap();
    take(&mut parts.weights(&FAMILY), &config, processor(TINY, PATCH)).unwrap()
}

#[test]
fn features_logits_and_greedy_tokens_of_both_layouts_are_those_of_transformers() {
    let prompts = Prompts::from_fixture("tiny_qwen2_vl");
    for folder in [".", "hub_style"] {
        prompts.check(&prompts.open(folder, ImageSettings::default()), |_| true);
    }
}

#[test]
fn llama_cpps_files_give_the_same() {
    let prompts = Prompts::from_fixture("tiny_qwen2_vl");
    let folder = prompts.gguf_with("preprocessor_config.json");
    prompts.check(&Prompts::open_at(folder.path()), |_| true);
}

#[test]
fn pixels_and_sizes_are_those_of_transformers() {
    let prompts = Prompts::from_fixture("tiny_qwen2_vl");
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

#[test]
fn a_drawn_map_of_512_pixels_becomes_324_tokens() {
    let published = processor([3136, 12_845_056], 14);
    for (side, tokens) in [(512, 324), (448, 256)] {
        assert_eq!(published.layout(side, side).unwrap().tokens, tokens);
    }
}

/// Errors in configuration and weights on the way from pixels to features.
const IMAGE_FAULTS: [Fault; 5] = [
    ("gelu in the place of quick_gelu", |parts| {
        parts.config["vision_config"]["hidden_act"] = json!("gelu");
    }),
    ("the tanh form of gelu", |parts| {
        parts.config["vision_config"]["hidden_act"] = json!("gelu_pytorch_tanh");
    }),
    ("silu in the place of quick_gelu", |parts| {
        parts.config["vision_config"]["hidden_act"] = json!("silu");
    }),
    ("the kernel of the first frame alone", |parts| {
        parts.change("patch_embed.proj.weight", |kernel| {
            let first = kernel.narrow(2, 0, 1).unwrap();
            Tensor::cat(&[&first, &first.zeros_like().unwrap()], 2).unwrap()
        });
    }),
    ("norms without their bias", |parts| {
        for norm in ["norm1.bias", "norm2.bias", "ln_q.bias"] {
            parts.change(norm, |tensor| tensor.zeros_like().unwrap());
        }
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

/// The rows of patches in the order of the processor's blocks, where raster order is right.
fn in_block_order(pixels: &Tensor) -> Tensor {
    let patch = PATCH as usize;
    let [rows, columns] = [1, 2].map(|axis| pixels.dims()[axis] / patch);
    pixels
        .reshape(vec![3, rows / 2, 2, patch, columns / 2, 2, patch])
        .unwrap()
        .permute(vec![1, 4, 2, 5, 0, 3, 6])
        .unwrap()
        .reshape(vec![rows, columns, 3, patch, patch])
        .unwrap()
        .permute(vec![2, 0, 3, 1, 4])
        .unwrap()
        .reshape((3, rows * patch, columns * patch))
        .unwrap()
}

#[test]
fn errors_that_are_easily_made_lead_far_away() {
    let prompts = Prompts::from_fixture("tiny_qwen2_vl");
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
    let blocks = right.encoder.encode(&in_block_order(&pixels)).unwrap();
    run.logits(&right, &blocks)
        .assert_far("patches in the order of blocks");
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
