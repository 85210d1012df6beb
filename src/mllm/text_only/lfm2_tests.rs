//! Parity of LFM2 with Hugging Face transformers (`tests/fixtures/make_lfm2.py`), and the errors
//! that are easily made with it.

use super::LFM2;
use crate::checkpoint::read_json;
use crate::decoder::Logits;
use crate::export::export_model;
use crate::family::ImageSettings;
use crate::local::test_faults::Fault;
use crate::local::test_prompts::Prompts;
use crate::local::test_reference::{LOGIT_TOLERANCE, difference, logits_in_pieces};
use crate::local::{Loading, LocalModel, Sequence};
use crate::source::ModelPlace;
use candle_core::{DType, Device, Tensor};
use planagent_kernels::matrix::WeightFormat;
use serde_json::json;
use std::fs::File;
use std::io::Write;
use std::path::Path;

const FIXTURE: &str = "tiny_lfm2";

#[test]
fn logits_and_greedy_tokens_are_those_of_transformers() {
    let prompts = Prompts::from_fixture(FIXTURE);
    let worst = prompts.check(&prompts.open(".", ImageSettings::default()), |_| true);
    println!("logits differ by {:.1e}", worst.logits);
}

fn export(from: &Path, to: &Path, format: WeightFormat) -> ModelPlace {
    let model = to.join("m.gguf");
    let loading = Loading {
        quantize: Some(format),
        ..Loading::default()
    };
    export_model(
        "tiny",
        &ModelPlace::Folder(from.to_path_buf()),
        &loading,
        &[],
        &mut |_| Ok(Box::new(File::create(&model)?) as Box<dyn Write>),
        &mut |_, _| {},
    )
    .unwrap();
    ModelPlace::Gguf {
        model,
        mmproj: None,
    }
}

/// A copy of the fixture whose convolutions have no biases, as those of all published models.
fn without_biases(prompts: &Prompts) -> tempfile::TempDir {
    let copy = prompts.in_layout(".");
    let path = copy.path().join("config.json");
    let mut config = read_json(&path).unwrap();
    config["conv_bias"] = json!(false);
    std::fs::write(&path, config.to_string()).unwrap();
    let weights = copy.path().join("model.safetensors");
    let mut tensors = candle_core::safetensors::load(&weights, &Device::Cpu).unwrap();
    tensors.retain(|name, _| name.rsplit('.').next() != Some("bias"));
    candle_core::safetensors::save(&tensors, &weights).unwrap();
    copy
}

/// llama.cpp has no biases of convolutions, so that the fixture becomes a file for this program
/// alone; without them, the file is llama.cpp's.
#[test]
fn exported_files_give_the_same_logits() {
    let prompts = Prompts::from_fixture(FIXTURE);
    let ids = prompts.reference.ids("chat_input_ids", 0);
    let folders = [prompts.in_layout("."), without_biases(&prompts)];
    for (copy, architecture) in folders.iter().zip(["planagent", "lfm2"]) {
        let folder = tempfile::tempdir().unwrap();
        let place = export(copy.path(), folder.path(), WeightFormat::F32);
        let (header, _) = crate::gguf::open_header(place.path()).unwrap();
        assert_eq!(header.architecture().unwrap(), architecture);
        if architecture == "lfm2" {
            let kernel = &header.tensors["blk.0.shortconv.conv.weight"];
            assert_eq!(kernel.shape, [32, 4]);
        }
        let models = [ModelPlace::Folder(copy.path().to_path_buf()), place]
            .map(|place| Prompts::load(&place, ImageSettings::default()));
        let [folder, gguf] = models
            .each_ref()
            .map(|local| logits_in_pieces(local.model(), &ids, None, &[]));
        assert_eq!(difference(&folder, &gguf).to_bits(), 0, "{architecture}");
    }
}

/// Products of blocks round activations, but a pass of several tokens as passes of one.
#[test]
fn weights_in_blocks_give_the_same_bits_in_any_passes() {
    let prompts = Prompts::from_fixture(FIXTURE);
    let ids = prompts.reference.ids("chat_input_ids", 0);
    let expected = prompts.reference.tensor("chat_logits");
    let spread = expected.abs().unwrap().max_all().unwrap();
    let spread = spread.to_scalar::<f32>().unwrap();
    for format in [WeightFormat::Q8_0, WeightFormat::Q4K] {
        let loading = Loading {
            quantize: Some(format),
            ..Loading::default()
        };
        let place = ModelPlace::Folder(prompts.folder.clone());
        let local = LocalModel::load("tiny", &place, &loading).unwrap();
        let logits = |pass: usize| {
            let pieces = vec![pass; ids.len() / pass];
            logits_in_pieces(local.model(), &ids, None, &pieces)
        };
        let (one, two) = (logits(1), logits(2));
        assert_eq!(difference(&one, &two).to_bits(), 0, "{format}");
        let kept = expected.dims()[0];
        let last = one.narrow(0, ids.len() - kept, kept).unwrap();
        let apart = difference(&last, expected) / spread;
        println!("{format}: {apart:.3} of the largest logit");
        assert!(apart > 0.0 && apart < 2.0, "{format}: {apart}");
    }
}

fn thirds(order: [usize; 3]) -> impl Fn(&Tensor) -> Tensor {
    move |tensor| {
        let width = tensor.dims()[0] / 3;
        let parts = order.map(|part| tensor.narrow(0, part * width, width).unwrap());
        Tensor::cat(&parts, 0).unwrap()
    }
}

const FAULTS: [Fault; 12] = [
    ("C, B, x in the place of B, C, x", |parts| {
        parts.change("conv.in_proj.weight", thirds([1, 0, 2]));
        parts.change("conv.in_proj.bias", thirds([1, 0, 2]));
    }),
    ("x, B, C in the place of B, C, x", |parts| {
        parts.change("conv.in_proj.weight", thirds([2, 0, 1]));
        parts.change("conv.in_proj.bias", thirds([2, 0, 1]));
    }),
    ("taps reversed", |parts| {
        parts.change("conv.conv.weight", |taps| taps.flip(&[2]).unwrap());
    }),
    ("taps centered", |parts| {
        parts.change("conv.conv.weight", |taps| {
            let [first, rest] = [taps.narrow(2, 0, 1), taps.narrow(2, 1, 3)].map(Result::unwrap);
            Tensor::cat(&[rest, first], 2).unwrap()
        });
    }),
    ("convolutions without biases", |parts| {
        parts.change("conv.conv.bias", |bias| bias.zeros_like().unwrap());
    }),
    ("w1 and w3 exchanged", |parts| {
        for layer in 0..6 {
            let name = |part| format!("model.layers.{layer}.feed_forward.{part}.weight");
            parts.swap(&name("w1"), &name("w3"));
        }
    }),
    ("no norms of queries and keys", |parts| {
        for part in ["q_layernorm.weight", "k_layernorm.weight"] {
            parts.change(part, |weight| weight.ones_like().unwrap());
        }
    }),
    ("norms of queries and keys exchanged", |parts| {
        for layer in [1, 4] {
            let name = |part| format!("model.layers.{layer}.self_attn.{part}_layernorm.weight");
            parts.swap(&name("q"), &name("k"));
        }
    }),
    ("the final norm's weight left out", |parts| {
        parts.change("embedding_norm.weight", |weight| {
            weight.ones_like().unwrap()
        });
    }),
    (
        "the norm before the mixer in the place of the other",
        |parts| {
            for layer in 0..6 {
                let name = |part| format!("model.layers.{layer}.{part}_norm.weight");
                parts.swap(&name("operator"), &name("ffn"));
            }
        },
    ),
    ("the base of Llama", |parts| {
        parts.config["rope_parameters"]["rope_theta"] = json!(1e4);
    }),
    ("another epsilon", |parts| {
        parts.config["norm_eps"] = json!(1e-2);
    }),
];

#[test]
fn errors_that_are_easily_made_lead_far_away() {
    Prompts::from_fixture(FIXTURE).assert_noticed(&LFM2, &FAULTS);
}

/// What a convolution keeps is part of the sequence: without it, or with that of a longer one, the
/// next tokens are far off.
#[test]
fn a_lost_or_stale_state_is_noticed() {
    let prompts = Prompts::from_fixture(FIXTURE);
    let local = prompts.open(".", ImageSettings::default());
    let model = local.model();
    let ids = prompts.reference.ids("chat_input_ids", 0);
    let (known, next) = ids.split_at(ids.len() - 6);
    let last = |known: &[u32], next: &[u32]| {
        let mut sequence = Sequence::new(model);
        sequence.append(model, known, None, Logits::None).unwrap();
        let logits = sequence.append(model, next, None, Logits::All).unwrap();
        logits.unwrap().to_dtype(DType::F32).unwrap()
    };
    let right = last(known, next);
    // Another token before the cut stands for what a state of another sequence holds.
    let stale = [&known[..known.len() - 1], &[known[0]]].concat();
    let apart = difference(&right, &last(&stale, next));
    assert!(apart > 100.0 * LOGIT_TOLERANCE, "{apart}");
    // A cut that goes back gives the bits of a sequence that was never longer.
    let mut sequence = Sequence::new(model);
    sequence.append(model, &ids, None, Logits::None).unwrap();
    let again = [sequence.cut(known.len()).as_slice(), next].concat();
    let logits = sequence.append(model, &again, None, Logits::Tail(next.len()));
    assert_eq!(difference(&right, &logits.unwrap().unwrap()).to_bits(), 0);
}
