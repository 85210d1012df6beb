//! Parity with Hugging Face transformers and llama.cpp's files (`tests/fixtures/tiny_qwen3_5`).

use super::{FAMILY, KIND, Qwen35, take};
use crate::checkpoint::{ConfigObject, Weights};
use crate::decoder::Logits;
use crate::family::{ImageFeatures, ImageSettings};
use crate::local::test_faults::{Fault, Parts};
use crate::local::test_prompts::{Prompts, SecondImage, assert_resized, raster_pixels};
use crate::local::test_reference::{LOGIT_TOLERANCE, difference, logits_in_pieces};
use crate::local::{Loading, LocalModel, Sequence};
use crate::qwen3_vl::{PatchEncoder, PatchProcessor, Qwen3VlConfig};
use crate::source::ModelPlace;
use crate::{Constraint, Deadline, Mllm, PromptPrefix, Request, Sampling};
use candle_core::{DType, Tensor};
use planagent_kernels::attention::RotarySections;
use planagent_kernels::matrix::WeightFormat;
use serde_json::json;

const FIXTURE: &str = "tiny_qwen3_5";
/// The limits of the reference, pixels.
const TINY: [u64; 2] = [1024, 12_288];
/// The side of its patches, pixels.
const PATCH: u32 = 8;

/// A processor for images of so many pixels in patches of this side.
fn processor(pixels: [u64; 2], patch: u32) -> PatchProcessor {
    let keys = json!({"size": PatchProcessor::limits(pixels), "image_mean": [0.5, 0.5, 0.5], "image_std": [0.5, 0.5, 0.5]});
    PatchProcessor::read(&ConfigObject::root("".as_ref(), &keys).unwrap(), patch, 2).unwrap()
}

/// Opens a model from parts, with changes of the validated configuration and of the weights.
fn assembled_after(
    parts: &Parts,
    change: impl FnOnce(&mut Qwen3VlConfig),
    prepare: impl FnOnce(&mut Weights),
) -> Qwen35 {
    let mut config = Qwen3VlConfig::from_json(KIND, &parts.path, &parts.config).unwrap();
    change(&mut config);
    let mut weights = parts.weights(&FAMILY);
    prepare(&mut weights);
    take(&mut weights, &config, processor(TINY, PATCH)).unwrap()
}

fn assembled(parts: &Parts) -> Qwen35 {
    assembled_after(parts, |_| {}, |_| {})
}

#[test]
fn features_logits_and_greedy_tokens_of_both_layouts_are_those_of_transformers() {
    let prompts = Prompts::from_fixture(FIXTURE);
    for folder in [".", "hub_style"] {
        prompts.check(&prompts.open(folder, ImageSettings::default()), |_| true);
    }
}

/// They have a block that predicts further tokens, value heads in another order, and norms with 1
/// added.
#[test]
fn llama_cpps_files_give_the_same() {
    let prompts = Prompts::from_fixture(FIXTURE);
    let folder = prompts.gguf_with("preprocessor_config.json");
    prompts.check(&Prompts::open_at(folder.path()), |_| true);
}

#[test]
fn pixels_and_sizes_are_those_of_transformers() {
    let prompts = Prompts::from_fixture(FIXTURE);
    for (name, index) in [("", 0), ("second_", 1)] {
        let found = processor(TINY, PATCH).process(&prompts.image(index));
        let expected = raster_pixels(&prompts.reference, name, PATCH);
        let found = difference(&found.unwrap(), &expected);
        assert!(found < 1e-6, "{name}: the pixels differ by {found}");
    }
    assert_resized(&prompts.folder, "tiny", |width, height| {
        processor(TINY, PATCH).resized(width, height)
    });
    assert_resized(&prompts.folder, "real", |width, height| {
        processor([65_536, 16_777_216], 16).resized(width, height)
    });
}

/// Errors on the way from pixels to features.
const IMAGE_FAULTS: [Fault; 2] = [
    ("the kernel of the first frame alone", |parts| {
        parts.change("patch_embed.proj.weight", |kernel| {
            let first = kernel.narrow(2, 0, 1).unwrap();
            Tensor::cat(&[&first, &first.zeros_like().unwrap()], 2).unwrap()
        });
    }),
    ("no learned positions", |parts| {
        parts.change("pos_embed.weight", |tensor| tensor.zeros_like().unwrap());
    }),
];

/// The rows of the queries' projection, (heads, 2, width, inputs), in another order.
fn queries(order: [usize; 4]) -> impl Fn(&Tensor) -> Tensor {
    move |rows| {
        let [outputs, inputs] = [0, 1].map(|side| rows.dims()[side]);
        let rows = rows.reshape((2, 2, outputs / 4, inputs)).unwrap();
        let rows = rows.permute((order[0], order[1], order[2], order[3]));
        rows.unwrap()
            .contiguous()
            .unwrap()
            .reshape((outputs, inputs))
            .unwrap()
    }
}

fn plus(number: f64) -> impl Fn(&Tensor) -> Tensor {
    move |tensor| (tensor + number).unwrap()
}

/// Errors in the decoder's weights and configuration.
const DECODER_FAULTS: [Fault; 14] = [
    ("norms without the 1", |parts| {
        parts.change("layernorm.weight", plus(-1.0));
    }),
    ("1 added to norms twice", |parts| {
        parts.change("layernorm.weight", plus(1.0));
    }),
    ("the norms of queries and keys without the 1", |parts| {
        for part in ["q_norm.weight", "k_norm.weight"] {
            parts.change(part, plus(-1.0));
        }
    }),
    ("1 added to the norm of the rule", |parts| {
        parts.change("linear_attn.norm.weight", plus(1.0));
    }),
    ("the decay taken for its logarithm", |parts| {
        parts.change("A_log", |log| log.exp().unwrap().neg().unwrap());
    }),
    ("learning and forgetting exchanged", |parts| {
        for layer in [0, 1, 3, 4] {
            let name = |part| {
                format!("model.language_model.layers.{layer}.linear_attn.in_proj_{part}.weight")
            };
            parts.swap(&name("a"), &name("b"));
        }
    }),
    ("taps reversed", |parts| {
        parts.change("conv1d.weight", |taps| taps.flip(&[2]).unwrap());
    }),
    ("no bias of forgetting", |parts| {
        parts.change("dt_bias", |bias| bias.zeros_like().unwrap());
    }),
    ("keys before queries", |parts| {
        parts.change("in_proj_qkv.weight", |rows| {
            let part = |first, count| rows.narrow(0, first, count).unwrap();
            Tensor::cat(&[part(48, 48), part(0, 48), part(96, 72)], 0).unwrap()
        });
    }),
    ("queries and gates exchanged", |parts| {
        parts.change("q_proj.weight", |rows| {
            let outputs = rows.dims()[0];
            let parts = rows.reshape((2, 2, outputs / 4, rows.dims()[1])).unwrap();
            let part = |index| parts.narrow(1, index, 1).unwrap();
            let turned = Tensor::cat(&[part(1), part(0)], 1).unwrap();
            turned.reshape(rows.dims()).unwrap()
        });
    }),
    ("all queries, then all gates", |parts| {
        parts.change("q_proj.weight", queries([1, 0, 2, 3]));
    }),
    ("the same gate for all", |parts| {
        parts.change("q_proj.weight", |rows| {
            let outputs = rows.dims()[0];
            let parts = rows.reshape((2, 2, outputs / 4, rows.dims()[1])).unwrap();
            let query = parts.narrow(1, 0, 1).unwrap();
            let open = query.zeros_like().unwrap();
            Tensor::cat(&[query, open], 1)
                .unwrap()
                .reshape(rows.dims())
                .unwrap()
        });
    }),
    ("the base of the class", |parts| {
        parts.config["text_config"]["rope_parameters"]["rope_theta"] = json!(1e4);
    }),
    ("a quarter of a head rotated", |parts| {
        parts.config["text_config"]["rope_parameters"]["partial_rotary_factor"] = json!(0.25);
        parts.config["text_config"]["rope_parameters"]["mrope_section"] = json!([1, 1, 1]);
    }),
];

#[test]
fn errors_that_are_easily_made_lead_far_away() {
    let prompts = Prompts::from_fixture(FIXTURE);
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
        run.logits(&model, &features).assert_logits_far(what);
    }
    let tiled = assembled_after(&parts(), |_| {}, Weights::set_heads_are_tiled);
    run.logits(&tiled, &features)
        .assert_logits_far("value heads of a key apart");
    let stored = assembled_after(&parts(), |_| {}, Weights::set_norms_have_one);
    run.logits(&stored, &features)
        .assert_logits_far("norms read as llama.cpp's");
    let whole = |config: &mut Qwen3VlConfig| {
        config.text.rotated = config.text.head_dim;
        config.text.rope.sections = Some(RotarySections {
            lengths: [6, 4, 2],
            interleaved: true,
        });
    };
    run.logits(&assembled_after(&parts(), whole, |_| {}), &features)
        .assert_logits_far("the whole head rotated");
    let blocks = |config: &mut Qwen3VlConfig| {
        config.text.rope.sections = Some(RotarySections {
            lengths: [3, 2, 1],
            interleaved: false,
        });
    };
    run.logits(&assembled_after(&parts(), blocks, |_| {}), &features)
        .assert_logits_far("sections in blocks");
    let mut turned: ImageFeatures = features.clone();
    let layout = &mut turned.layouts[0];
    std::mem::swap(&mut layout.rows, &mut layout.columns);
    run.logits(&right, &turned)
        .assert_logits_far("rows and columns exchanged");
    for (what, wrong) in run.wrong_positions(&right) {
        run.placed(&right, &features, wrong).assert_logits_far(what);
    }
}

/// What the rule keeps is part of the sequence: with that of a longer or another one, the next
/// tokens are far off, and a cut that goes back gives the bits of a sequence that was never longer.
#[test]
fn a_lost_or_stale_state_is_noticed() {
    let prompts = Prompts::from_fixture(FIXTURE);
    let local = prompts.open(".", ImageSettings::default());
    let model = local.model();
    let ids = prompts.reference.ids("text_input_ids", 0);
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
    let mut sequence = Sequence::new(model);
    sequence.append(model, &ids, None, Logits::None).unwrap();
    let again = [sequence.cut(known.len()).as_slice(), next].concat();
    let logits = sequence.append(model, &again, None, Logits::Tail(next.len()));
    assert_eq!(difference(&right, &logits.unwrap().unwrap()).to_bits(), 0);
}

/// A chat's history has no empty thinking, so that each round parts from the one before in the
/// opening of its answer. No more than that is computed again, however long the answer was.
#[test]
fn a_next_round_computes_little_of_the_round_before_again() {
    let prompts = Prompts::from_fixture(FIXTURE);
    let local = prompts.open(".", ImageSettings::default());
    let prefix = PromptPrefix {
        system: "Drive safely.".into(),
        image: Some(prompts.image(0).into()),
    };
    let request = Request {
        constraint: Constraint::Regex("[a-f]{80}".into()),
        max_new_tokens: 100,
        sampling: Sampling::Greedy,
        deadline: Deadline::NONE,
        draft: None,
    };
    let mut conversation = local.converse(&prefix, 0).unwrap();
    let first = conversation.ask("What is ahead of the car?", &request);
    let first = first.unwrap().tokens;
    let second = conversation.ask("And now?", &request).unwrap().tokens;
    let prompt = first.cached + first.text + first.image;
    assert!(
        second.cached + 16 > prompt && second.cached < prompt,
        "{first:?} {second:?}"
    );
}

/// Products of blocks round activations, but a pass of several tokens as passes of one.
#[test]
fn weights_in_blocks_give_the_same_bits_in_any_passes() {
    let prompts = Prompts::from_fixture(FIXTURE);
    let ids = prompts.reference.ids("text_input_ids", 0);
    let expected = prompts.reference.tensor("text_logits");
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
        let (one, three) = (logits(1), logits(3));
        assert_eq!(difference(&one, &three).to_bits(), 0, "{format}");
        let kept = expected.dims()[0];
        let last = one.narrow(0, ids.len() - kept, kept).unwrap();
        let apart = difference(&last, expected) / spread;
        println!("{format}: {apart:.3} of the largest logit");
        assert!(apart > 0.0 && apart < 2.0, "{format}: {apart}");
    }
}
