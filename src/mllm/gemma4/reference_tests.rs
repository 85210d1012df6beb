//! Parity with Hugging Face transformers and llama.cpp's files (`tests/fixtures/tiny_gemma4`).

use super::FAMILY;
use super::config::Gemma4Config;
use super::model::Gemma4;
use super::processor::PictureProcessor;
use crate::checkpoint::{ConfigObject, ImageMask, LayerKeys, ModelFiles};
use crate::decoder::Logits;
use crate::family::{ImageSettings, VisionLanguageModel};
use crate::local::Sequence;
use crate::local::test_faults::{Fault, Parts};
use crate::local::test_prompts::{Prompts, SecondImage, assert_resized};
use crate::local::test_reference::{difference, whole};
use crate::vision::unfold;
use candle_core::{Device, Tensor};
use serde_json::json;
use std::ops::Range;
use std::path::Path;

const FIXTURE: &str = "tiny_gemma4";
/// Side of a patch, pixels, and of the blocks of patches that become a token.
const PATCH: usize = 4;
const POOL: usize = 3;
/// Width of the tower.
const TOWER: usize = 24;

/// Which positions of a prompt see one another, from those that should.
type Seen = fn(Range<usize>) -> Range<usize>;

/// Opens a model from parts.
fn assembled(parts: &Parts) -> Gemma4 {
    let config = Gemma4Config::from_json(&parts.path, &parts.config).unwrap();
    let tower = config.tower.clone().unwrap();
    let files = ModelFiles::folder(parts.path.parent().unwrap()).unwrap();
    let processor = PictureProcessor::open(&files, &tower).unwrap();
    Gemma4::take(&mut parts.weights(&FAMILY), &config, &tower, processor).unwrap()
}

#[test]
fn features_logits_and_greedy_tokens_of_both_layouts_are_those_of_transformers() {
    let prompts = Prompts::from_fixture(FIXTURE);
    for folder in [".", "hub_style"] {
        prompts.check(&prompts.open(folder, ImageSettings::default()), |_| true);
    }
}

/// The number of tokens of an image is in no key of theirs.
#[test]
fn llama_cpps_files_give_the_same() {
    let prompts = Prompts::from_fixture(FIXTURE);
    let folder = prompts.gguf_with("preprocessor_config.json");
    prompts.check(&Prompts::open_at(folder.path()), |_| true);
}

#[test]
fn pixels_and_sizes_are_those_of_transformers() {
    let prompts = Prompts::from_fixture(FIXTURE);
    let model = assembled(&Parts::from_folder(&prompts.folder));
    for (name, index) in [("", 0), ("second_", 1)] {
        let found = model.preprocess(&prompts.image(index)).unwrap();
        // A patch is stored by pixel, then by channel, and the image is filled up to the most.
        let patches = unfold(&found.pixels[0], PATCH).unwrap();
        let count = patches.dims()[0];
        let by_pixel = patches.reshape((count, 3, PATCH * PATCH)).unwrap();
        let by_pixel = by_pixel.transpose(1, 2).unwrap().contiguous().unwrap();
        let stored = prompts.reference.tensor(&format!("{name}pixel_values"));
        let stored = stored.get(0).unwrap().narrow(0, 0, count).unwrap();
        let found = difference(&by_pixel, &stored);
        assert!(found < 1e-6, "{name}: the pixels differ by {found}");
    }
    for (key, patch, tokens) in [("tiny", PATCH, 12), ("real", 16, 280)] {
        let config = json!({"vision_config": {"patch_size": patch}});
        let config = Gemma4Config::from_json(Path::new("config.json"), &config).unwrap();
        let keys = json!({"max_soft_tokens": tokens, "patch_size": patch});
        let object = ConfigObject::root(Path::new("preprocessor_config.json"), &keys).unwrap();
        let processor = PictureProcessor::read(&object, &config.tower.unwrap()).unwrap();
        assert_resized(&prompts.folder, key, |width, height| {
            processor.resized(width, height)
        });
    }
}

/// A folder whose configuration names no tower is a language model, whatever else lies in it.
#[test]
fn without_a_tower_text_is_read() {
    let prompts = Prompts::from_fixture(FIXTURE);
    let folder = prompts.in_layout(".");
    let path = folder.path().join("config.json");
    let mut config = Parts::from_folder(&prompts.folder).config;
    config["vision_config"] = json!(null);
    std::fs::write(&path, config.to_string()).unwrap();
    let local = Prompts::open_at(folder.path());
    assert_eq!(local.model().info().image_size, None);
    prompts.check(&local, |run| run == "text_");
}

/// E models' files have projections that layers with the keys of others do not use.
#[test]
fn weights_that_no_layer_uses_are_passed_over() {
    let prompts = Prompts::from_fixture(FIXTURE);
    let folder = prompts.in_layout(".");
    let path = folder.path().join("model.safetensors");
    let mut tensors = candle_core::safetensors::load(&path, &Device::Cpu).unwrap();
    for part in ["k_proj", "v_proj", "k_norm"] {
        let name = format!("model.language_model.layers.5.self_attn.{part}.weight");
        let like = format!("model.language_model.layers.0.self_attn.{part}.weight");
        tensors.insert(name, tensors[&like].clone());
    }
    tensors.insert(
        "model.embed_audio.embedding_projection.weight".into(),
        Tensor::zeros((2, 2), candle_core::DType::F32, &Device::Cpu).unwrap(),
    );
    candle_core::safetensors::save(&tensors, &path).unwrap();
    prompts.check(&Prompts::open_at(folder.path()), |run| run == "second_");
}

#[test]
fn a_number_of_tokens_is_chosen_by_the_size_of_the_image() {
    let prompts = Prompts::from_fixture(FIXTURE);
    let mut model = assembled(&Parts::from_folder(&prompts.folder));
    assert_eq!(model.info().image_size, Some(36));
    let sized = |model: &mut Gemma4, size| {
        model.set_images(ImageSettings {
            size: Some(size),
            tiles: None,
        })
    };
    sized(&mut model, 36).unwrap();
    assert_eq!(model.info().max_image_tokens, 12);
    sized(&mut model, 90).unwrap();
    assert_eq!(model.info().max_image_tokens, 70);
    assert_eq!(model.image_layout(90, 90).unwrap().tokens, 64);
    assert!(sized(&mut model, 1000).is_err() && sized(&mut model, 0).is_err());
    let tiles = ImageSettings {
        size: None,
        tiles: Some(2),
    };
    assert!(model.set_images(tiles).is_err());
}

/// However the tokens are appended and cut back, those behind an image see all of it.
#[test]
fn an_image_that_was_computed_in_parts_is_computed_once_more() {
    let prompts = Prompts::from_fixture(FIXTURE);
    let model = assembled(&Parts::from_folder(&prompts.folder));
    let ids = prompts.reference.ids("second_input_ids", 0);
    let features = model.encode_image(&prompts.image(1)).unwrap();
    let append = |sequence: &mut Sequence, ids: &[u32]| -> Vec<u32> {
        let logits = sequence.append(&model, ids, Some(&features), Logits::Last);
        let row: Vec<f32> = logits
            .unwrap()
            .unwrap()
            .flatten_all()
            .unwrap()
            .to_vec1()
            .unwrap();
        row.iter().map(|value| value.to_bits()).collect()
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
}

fn text(parts: &mut Parts) -> &mut serde_json::Value {
    &mut parts.config["text_config"]
}

/// Errors on the way from pixels to features.
const IMAGE_FAULTS: [Fault; 9] = [
    ("a patch by channel, then by pixel", |parts| {
        parts.change("input_proj.weight", |rows| {
            let outputs = rows.dims()[0];
            let rows = rows.reshape((outputs, PATCH * PATCH, 3)).unwrap();
            let rows = rows.transpose(1, 2).unwrap().contiguous().unwrap();
            rows.reshape((outputs, 3 * PATCH * PATCH)).unwrap()
        });
    }),
    ("columns and rows exchanged", |parts| {
        parts.change("position_embedding_table", |table| {
            table.flip(&[0]).unwrap()
        });
    }),
    ("pixels from −0.5 to 0.5", |parts| {
        parts.change("input_proj.weight", |rows| (rows * 0.5).unwrap());
    }),
    ("the base of the decoder", |parts| {
        parts.config["vision_config"]["rope_parameters"]["rope_theta"] = json!(1e4);
    }),
    ("layers that clamp nothing", |parts| {
        parts.config["vision_config"]["use_clipped_linears"] = json!(false);
    }),
    ("averages as they are", |parts| {
        parts.config["vision_config"]["standardize"] = json!(false);
    }),
    ("norms by 1 + w", |parts| {
        for norm in ["input_layernorm", "post_attention_layernorm"] {
            for layer in 0..2 {
                let name = format!("vision_tower.encoder.layers.{layer}.{norm}.weight");
                parts.change(&name, |weight| (weight + 1.0).unwrap());
            }
        }
    }),
    ("scores divided by the root of the width", |parts| {
        for layer in 0..2 {
            let name = format!("vision_tower.encoder.layers.{layer}.self_attn.q_norm.weight");
            parts.change(&name, |weight| (weight * 8_f64.sqrt().recip()).unwrap());
        }
    }),
    ("gates and values exchanged", |parts| {
        for layer in 0..2 {
            let name = |part| {
                format!("model.vision_tower.encoder.layers.{layer}.mlp.{part}_proj.linear.weight")
            };
            parts.swap(&name("gate"), &name("up"));
        }
    }),
];

/// Errors in the decoder's weights and configuration.
const DECODER_FAULTS: [Fault; 16] = [
    ("norms by 1 + w", |parts| {
        for norm in ["language_model.norm.weight", "_projection_norm.weight"] {
            parts.change(norm, |weight| (weight + 1.0).unwrap());
        }
    }),
    ("scores divided by the root of the width", |parts| {
        for layer in 0..7 {
            let name = format!("language_model.layers.{layer}.self_attn.q_norm.weight");
            parts.change(&name, |weight| (weight * 0.25).unwrap());
        }
    }),
    ("no factors of layers", |parts| {
        parts.change("layer_scalar", |scalar| scalar.ones_like().unwrap());
    }),
    ("no bound of logits", |parts| {
        text(parts)["final_logit_softcapping"] = json!(null);
    }),
    ("another bound of logits", |parts| {
        text(parts)["final_logit_softcapping"] = json!(30.0);
    }),
    ("rows of tokens for layers without their factor", |parts| {
        parts.change("embed_tokens_per_layer.weight", |rows| {
            (rows * 8_f64.sqrt().recip()).unwrap()
        });
    }),
    ("no window", |parts| {
        text(parts)["sliding_window"] = json!(1024);
    }),
    ("a window that is one wider", |parts| {
        text(parts)["sliding_window"] = json!(8);
    }),
    ("a window that is one narrower", |parts| {
        text(parts)["sliding_window"] = json!(6);
    }),
    ("the image seen causally", |parts| {
        text(parts)["use_bidirectional_attention"] = json!(null);
    }),
    ("the whole head of global layers rotated", |parts| {
        text(parts)["rope_parameters"]["full_attention"]["partial_rotary_factor"] = json!(1.0);
    }),
    ("half as many pairs", |parts| {
        text(parts)["rope_parameters"]["full_attention"]["partial_rotary_factor"] = json!(0.25);
    }),
    ("the base of local layers in global ones", |parts| {
        text(parts)["rope_parameters"]["full_attention"]["rope_theta"] = json!(1e4);
    }),
    ("the base of global layers in local ones", |parts| {
        text(parts)["rope_parameters"]["sliding_attention"]["rope_theta"] = json!(1e6);
    }),
    ("the row of another token for images", |parts| {
        text(parts)["pad_token_id"] = json!(3);
    }),
    ("gates and values exchanged", |parts| {
        for layer in 0..7 {
            let name = |part| format!("model.language_model.layers.{layer}.mlp.{part}_proj.weight");
            parts.swap(&name("gate"), &name("up"));
        }
    }),
];

#[test]
fn errors_that_are_easily_made_lead_far_away() {
    let prompts = Prompts::from_fixture(FIXTURE);
    let run = SecondImage::from_prompts(&prompts);
    let (right, features) = run.check_faults(&prompts, assembled, [&IMAGE_FAULTS, &DECODER_FAULTS]);
    let seen: [(&str, Seen); 1] = [("begin and end among the image's tokens", |image| {
        image.start - 1..image.end + 1
    })];
    for (what, change) in seen {
        run.seeing(&right, &features, change)
            .assert_logits_far(what);
    }
    let scale = 32_f64.sqrt();
    let scaled = whole((&features.rows * scale).unwrap());
    run.logits(&right, &scaled)
        .assert_far("features times the root of the width");
    wrong_averages(
        &run,
        &right,
        &right.preprocess(&prompts.image(1)).unwrap().pixels[0],
    );
}

/// Errors in the averages of blocks of patches.
fn wrong_averages(run: &SecondImage<'_>, right: &Gemma4, pixels: &Tensor) {
    let grid = [1, 2].map(|axis| pixels.dims()[axis] / PATCH);
    let states = right.encoder.patch_states(pixels, grid).unwrap();
    let [rows, columns] = grid.map(|side| side / POOL);
    let blocks = states
        .reshape(vec![rows, POOL, columns, POOL, TOWER])
        .unwrap();
    let encoded = |blocks: Tensor| {
        let wide = blocks
            .broadcast_as(vec![rows, POOL, columns, POOL, TOWER])
            .unwrap()
            .contiguous()
            .unwrap();
        let states = wide.reshape((rows * POOL * columns * POOL, TOWER)).unwrap();
        whole(
            right
                .encoder
                .projected(&right.encoder.pooled(&states, grid).unwrap())
                .unwrap(),
        )
    };
    let first = blocks.narrow(1, 0, 1).unwrap().narrow(3, 0, 1).unwrap();
    run.logits(right, &encoded(first))
        .assert_far("one patch in the place of the average");
    let most = blocks.max_keepdim(3).unwrap().max_keepdim(1).unwrap();
    run.logits(right, &encoded(most))
        .assert_far("the maximum in the place of the average");
}

/// What configurations change alone: which layer's keys are shared, and what values are.
#[test]
fn keys_are_those_of_the_last_layer_of_a_kind_and_values_are_normed() {
    let prompts = Prompts::from_fixture(FIXTURE);
    let parts = Parts::from_folder(&prompts.folder);
    let config = Gemma4Config::from_json(&parts.path, &parts.config).unwrap();
    let keys = (0..7).map(|layer| config.text.shape(layer).keys);
    assert_eq!(
        keys.collect::<Vec<_>>(),
        [
            LayerKeys::Projected,
            LayerKeys::AsValues,
            LayerKeys::Projected,
            LayerKeys::AsValues,
            LayerKeys::Of(2),
            LayerKeys::Of(2),
            LayerKeys::Of(3),
        ]
    );
    let run = SecondImage::from_prompts(&prompts);
    let right = assembled(&parts);
    let features = right.encode_image(&prompts.image(1)).unwrap();
    let wrong = |change: fn(&mut Gemma4Config)| {
        let mut config = config.clone();
        change(&mut config);
        let tower = config.tower.clone().unwrap();
        let files = ModelFiles::folder(parts.path.parent().unwrap()).unwrap();
        let processor = PictureProcessor::open(&files, &tower).unwrap();
        Gemma4::take(&mut parts.weights(&FAMILY), &config, &tower, processor).unwrap()
    };
    let earlier = wrong(|config| {
        let gemma = config.text.gemma.as_mut().unwrap();
        gemma.shapes.as_mut().unwrap().shared = [0, 1];
    });
    run.logits(&earlier, &features)
        .assert_logits_far("the keys of the first layer of a kind");
    let raw = wrong(|config| config.text.value_norms = false);
    run.logits(&raw, &features)
        .assert_logits_far("values that are not normed");
    let everywhere = wrong(|config| {
        let gemma = config.text.gemma.as_mut().unwrap();
        gemma.image_mask = ImageMask::All;
    });
    run.logits(&everywhere, &features)
        .assert_logits_far("the image seen at once in global layers too");
}
