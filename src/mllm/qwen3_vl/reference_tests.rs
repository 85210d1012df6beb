//! Parity with Hugging Face transformers and llama.cpp's files (`tests/fixtures/tiny_qwen3_vl`).

use super::config::{QWEN3_VL, Qwen3VlConfig};
use super::patches::PatchProcessor;
use super::{FAMILY, PatchEncoder, Qwen3Vl, take};
use crate::checkpoint::ConfigObject;
use crate::family::{ImageFeatures, ImageSettings};
use crate::local::test_faults::{Fault, Parts};
use crate::local::test_prompts::{Prompts, SecondImage, assert_resized, raster_pixels};
use crate::local::test_reference::difference;
use candle_core::Tensor;
use planagent_kernels::attention::RotarySections;
use serde_json::json;

/// A processor for images of so many pixels in patches of this side.
fn processor(pixels: [u64; 2], patch: u32) -> PatchProcessor {
    let keys = json!({"size": PatchProcessor::limits(pixels), "image_mean": [0.5, 0.5, 0.5], "image_std": [0.5, 0.5, 0.5]});
    PatchProcessor::read(&ConfigObject::root("".as_ref(), &keys).unwrap(), patch, 2).unwrap()
}

/// The limits of the reference, pixels.
const TINY: [u64; 2] = [1024, 12_288];
/// The side of its patches, pixels.
const PATCH: u32 = 8;

/// Opens a model from parts.
fn assembled(parts: &Parts) -> Qwen3Vl {
    assembled_after(parts, |_| {})
}

/// Opens a model from parts with a change of the validated configuration.
fn assembled_after(parts: &Parts, change: impl FnOnce(&mut Qwen3VlConfig)) -> Qwen3Vl {
    let mut config = Qwen3VlConfig::from_json(QWEN3_VL, &parts.path, &parts.config).unwrap();
    change(&mut config);
    take(&mut parts.weights(&FAMILY), &config, processor(TINY, PATCH)).unwrap()
}

#[test]
fn features_logits_and_greedy_tokens_of_both_layouts_are_those_of_transformers() {
    let prompts = Prompts::from_fixture("tiny_qwen3_vl");
    for folder in [".", "hub_style"] {
        prompts.check(&prompts.open(folder, ImageSettings::default()), |_| true);
    }
}

#[test]
fn llama_cpps_files_give_the_same() {
    let prompts = Prompts::from_fixture("tiny_qwen3_vl");
    let folder = prompts.gguf_with("preprocessor_config.json");
    prompts.check(&Prompts::open_at(folder.path()), |_| true);
}

#[test]
fn pixels_and_sizes_are_those_of_transformers() {
    let prompts = Prompts::from_fixture("tiny_qwen3_vl");
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
        processor([65_536, 16_777_216], 16).resized(width, height)
    });
}

/// Errors in configuration and weights on the way from pixels to features.
const IMAGE_FAULTS: [Fault; 4] = [
    ("quick_gelu in the place of gelu", |parts| {
        parts.config["vision_config"]["hidden_act"] = json!("quick_gelu");
    }),
    ("the kernel of the first frame alone", |parts| {
        parts.change("patch_embed.proj.weight", |kernel| {
            let first = kernel.narrow(2, 0, 1).unwrap();
            Tensor::cat(&[&first, &first.zeros_like().unwrap()], 2).unwrap()
        });
    }),
    ("no learned positions", |parts| {
        parts.change("pos_embed.weight", |tensor| tensor.zeros_like().unwrap());
    }),
    ("the learned positions by columns", |parts| {
        parts.change("pos_embed.weight", |tensor| {
            tensor
                .reshape((6, 6, 16))
                .unwrap()
                .transpose(0, 1)
                .unwrap()
                .reshape((36, 16))
                .unwrap()
        });
    }),
];

/// Errors in the decoder's weights and configuration.
const DECODER_FAULTS: [Fault; 2] = [
    ("another base of the rotary embedding", |parts| {
        parts.config["text_config"]["rope_parameters"]["rope_theta"] = json!(10_000);
    }),
    ("queries that are not normalized by weight", |parts| {
        parts.change("self_attn.q_norm.weight", |tensor| {
            tensor.ones_like().unwrap()
        });
    }),
];

#[test]
fn errors_that_are_easily_made_lead_far_away() {
    let prompts = Prompts::from_fixture("tiny_qwen3_vl");
    let run = SecondImage::from_prompts(&prompts);
    let pixels = raster_pixels(&prompts.reference, "second_", PATCH);
    let parts = || Parts::from_folder(&prompts.folder);
    let right = assembled(&parts());
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
    let blocks = assembled_after(&parts(), |config| {
        config.text.rope.sections = Some(RotarySections {
            lengths: [6, 5, 5],
            interleaved: false,
        });
    });
    run.logits(&blocks, &features)
        .assert_logits_far("sections in blocks");
    let shallow = ImageFeatures {
        deep: Vec::new(),
        ..features.clone()
    };
    run.logits(&right, &shallow)
        .assert_logits_far("no DeepStack");
    let mut mixed = features.clone();
    mixed.deep.rotate_left(1);
    run.logits(&right, &mixed)
        .assert_logits_far("the outputs of the tower's layers for other layers");
    // A grid of 3 by 8 tokens for one of 8 by 3.
    let mut turned = features.clone();
    let layout = &mut turned.layouts[0];
    std::mem::swap(&mut layout.rows, &mut layout.columns);
    run.logits(&right, &turned)
        .assert_logits_far("rows and columns exchanged");
    for (what, wrong) in run.wrong_positions(&right) {
        run.placed(&right, &features, wrong).assert_logits_far(what);
    }
}
