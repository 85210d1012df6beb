//! Parity with Hugging Face transformers: pixels of tiles, packed features, logits, greedy tokens.

use super::config::LlavaNextConfig;
use super::grid::{Resolution, TileGrids};
use super::preprocess::AnyresImageProcessor;
use super::{FAMILY, LlavaNext};
use crate::checkpoint::read_json;
use crate::family::{ImageFeatures, Tiles, VisionLanguageModel};
use crate::llava::FeatureSelect;
use crate::local::LocalModel;
use crate::local::test_faults::{
    Deviation, Fault, LLAVA_DECODER_FAULTS, LLAVA_IMAGE_FAULTS, Parts, one_further,
};
use crate::local::test_reference::{
    Reference, Run, assert_chat, difference, fixture, open_checkpoint, synthetic, whole,
};
use crate::vision::{Filter, PixelScale};
use candle_core::{DType, Tensor};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Opens a model from parts with a change of the validated configuration.
fn assembled_after(parts: &Parts, change: impl FnOnce(&mut LlavaNextConfig)) -> LlavaNext {
    let mut config = LlavaNextConfig::from_json(&parts.path, &parts.config).unwrap();
    change(&mut config);
    let processor = AnyresImageProcessor {
        filter: Filter::Bicubic,
        scale: PixelScale::CLIP,
    };
    LlavaNext::take(&mut parts.weights(&FAMILY), config, processor).unwrap()
}

/// Opens a model from parts.
fn assembled(parts: &Parts) -> LlavaNext {
    assembled_after(parts, |_| {})
}

/// A reference, and the size of its image.
struct Case {
    folder: PathBuf,
    run: Run,
    size: Resolution,
}

impl Case {
    fn all() -> impl Iterator<Item = Self> {
        let fixed = |name, height, width| {
            let folder = fixture(name);
            let run = Run::open(&folder.join("reference.safetensors"), 0);
            Self {
                folder,
                run,
                size: Resolution { height, width },
            }
        };
        [
            fixed("tiny_llava_next", 53, 75),
            fixed("tiny_llava_next_mistral", 53, 75),
        ]
        .into_iter()
    }

    fn tiles(&self) -> Tiles {
        Tiles {
            pixels: self.run.pixels.clone(),
            width: self.size.width,
            height: self.size.height,
        }
    }

    fn features(&self, model: &LlavaNext) -> ImageFeatures {
        model.encode(&self.tiles()).unwrap()
    }
}

#[test]
fn complete_folders_give_the_pixels_ids_logits_and_tokens_of_transformers() {
    for (name, rounds) in [
        ("tiny_llava_next", &["", "chat_"][..]),
        ("tiny_llava_next_mistral", &[""]),
    ] {
        let folder = fixture(name);
        let reference = Reference::open(&folder.join("reference.safetensors"));
        let mut checkpoint = open_checkpoint(&folder);
        let model = LlavaNext::open(&checkpoint.files, &mut checkpoint.weights).unwrap();
        let image = image::open(folder.join("image.png")).unwrap().into_rgb8();
        let tiling = model.grids.tiling(Resolution {
            height: image.height(),
            width: image.width(),
        });
        let pixels = model.processor.process(&image, &tiling, 32).unwrap();
        let found = difference(
            &Tensor::stack(&pixels, 0).unwrap(),
            reference.tensor("pixel_values"),
        );
        assert!(found < 1e-5, "the pixels differ by {found}");
        assert_chat(&folder, rounds);
    }
}

#[test]
fn features_logits_and_greedy_tokens_are_those_of_transformers() {
    for case in Case::all() {
        let model = assembled(&Parts::from_folder(&case.folder));
        case.run.assert_same(&model, &case.features(&model));
    }
}

#[test]
fn errors_that_are_easily_made_lead_far_away() {
    for case in Case::all() {
        let Case { folder, run, .. } = &case;
        Deviation::print_heading(folder);
        let right = assembled(&Parts::from_folder(folder));
        Deviation::from_run(run, &right, &case.features(&right)).assert_none("nothing wrong");
        let no_newline: Fault = ("zeros in the place of the newline", |parts| {
            parts.change("image_newline", |newline| newline.zeros_like().unwrap());
        });
        for (what, fault) in LLAVA_IMAGE_FAULTS.into_iter().chain([no_newline]) {
            let model = assembled(&Parts::wrong(folder, fault));
            Deviation::from_run(run, &model, &case.features(&model)).assert_far(what);
        }
        let with_class = assembled_after(&Parts::from_folder(folder), |config| {
            config.llava.feature_select = FeatureSelect::Full;
        });
        Deviation::from_run(run, &right, &case.features(&with_class))
            .assert_far("the class tokens kept in the grid");
        let mut swapped = case.tiles();
        swapped.pixels.swap(1, 2);
        let swapped = right.encode(&swapped).unwrap();
        Deviation::from_run(run, &right, &swapped).assert_far("two tiles swapped");
        for (what, fault) in LLAVA_DECODER_FAULTS {
            let model = assembled(&Parts::wrong(folder, fault));
            Deviation::from_run(run, &model, &case.features(&model)).assert_logits_far(what);
        }
        let image = run.image(right.info().image_token);
        let own: Vec<u32> = (0..run.ids.len() as u32).collect();
        let shifted = |part| {
            Deviation::of_placed(
                run,
                &right,
                &right.core.decoder,
                one_further(&own, &part),
                0..0,
            )
        };
        // Only differences of positions count.
        shifted(0..own.len()).assert_none("every position one further");
        shifted(image.end..own.len()).assert_logits_far("the text behind the image one further");
        shifted(image).assert_logits_far("the image one further");
    }
}

#[test]
fn a_window_that_is_left_out_is_noticed() {
    let folder = fixture("tiny_llava_next_mistral");
    let run = Run::open(&folder.join("reference.safetensors"), 0);
    let no_window = Parts::wrong(&folder, |parts| {
        parts.config["text_config"]["sliding_window"] = Value::Null;
    });
    Deviation::from_run(&run, &assembled(&no_window), &whole(run.features.clone()))
        .assert_logits_far("no sliding window");
}

/// The size in a name `HEIGHTxWIDTH`.
fn size(name: &str) -> Option<(u32, u32)> {
    let (height, width) = name.split_once('x')?;
    Some((height.parse().ok()?, width.parse().ok()?))
}

#[test]
fn tiles_of_odd_images_have_the_pixels_of_transformers() {
    let folder = fixture("tiny_llava_next");
    let model = assembled(&Parts::from_folder(&folder));
    let expected = candle_core::safetensors::load(
        folder.join("anyres.safetensors"),
        &candle_core::Device::Cpu,
    )
    .unwrap();
    assert!(expected.len() >= 7);
    for (name, expected) in expected {
        let (height, width) = size(&name).unwrap();
        let tiling = model.grids.tiling(Resolution { height, width });
        let pixels = raw_processor()
            .process(&synthetic(height, width), &tiling, 32)
            .unwrap();
        let pixels = Tensor::stack(&pixels, 0).unwrap();
        assert_eq!(pixels.dims(), expected.dims(), "{name}");
        let found = difference(&pixels, &expected.to_dtype(DType::F32).unwrap());
        assert!(found == 0.0, "{name}: the pixels differ by {found}");
    }
}

/// A processor that keeps the 8-bit values.
fn raw_processor() -> AnyresImageProcessor {
    let path = Path::new("preprocessor_config.json");
    let raw = json!({"do_rescale": false, "do_normalize": false});
    let object = crate::checkpoint::ConfigObject::root(path, &raw).unwrap();
    AnyresImageProcessor {
        filter: Filter::Bicubic,
        scale: PixelScale::read(&object).unwrap(),
    }
}

#[test]
fn the_grids_of_the_real_models_are_those_of_transformers() {
    let anyres = read_json(&fixture("tiny_llava_next").join("anyres.json")).unwrap();
    let resolutions = [(336, 672), (672, 336), (672, 672), (1008, 336), (336, 1008)]
        .map(|(height, width)| Resolution { height, width })
        .to_vec();
    let grids = TileGrids::new(resolutions, 336, 24).unwrap();
    let number = |value: &Value| u32::try_from(value.as_u64().unwrap()).unwrap();
    let sizes = anyres["sizes"].as_array().unwrap();
    assert!(sizes.len() > 100);
    for row in sizes {
        let [height, width, best_height, best_width, tokens] =
            [0, 1, 2, 3, 4].map(|index| number(&row[index]));
        let tiling = grids.tiling(Resolution { height, width });
        assert_eq!(
            tiling.target,
            Resolution {
                height: best_height,
                width: best_width
            },
            "{height} x {width}"
        );
        assert_eq!(grids.tokens(&tiling), tokens as usize, "{height} x {width}");
    }

    let sums = &anyres["sums"];
    let (height, width) = (number(&sums["size"][0]), number(&sums["size"][1]));
    let tiling = grids.tiling(Resolution { height, width });
    let tiles = raw_processor()
        .process(&synthetic(height, width), &tiling, 336)
        .unwrap();
    for (key, axis) in [("rows", 2), ("columns", 1)] {
        for (tile, pixels) in tiles.iter().enumerate() {
            let found = pixels.sum(axis).unwrap().to_vec2::<f32>().unwrap();
            let expected: Vec<Vec<f32>> = serde_json::from_value(sums[key][tile].clone()).unwrap();
            assert_eq!(found, expected, "{key} of tile {tile}");
        }
    }
}

#[test]
fn broken_configurations_are_named() {
    let path = fixture("tiny_llava_next").join("config.json");
    let config = read_json(&path).unwrap();
    for (key, value) in [
        ("image_grid_pinpoints", json!([])),
        ("image_grid_pinpoints", json!([[32, 50]])),
        ("image_grid_pinpoints", json!([[32, 64, 96]])),
        ("image_grid_pinpoints", json!([[0, 64]])),
        ("image_grid_pinpoints", json!([[32, 1_u64 << 40]])),
        ("image_grid_pinpoints", json!("all")),
        ("vision_feature_select_strategy", json!("full")),
    ] {
        let mut changed = config.clone();
        changed[key] = value;
        match LlavaNextConfig::from_json(&path, &changed) {
            Err(crate::MllmError::Config { key: named, .. }) => assert_eq!(named, key),
            other => panic!("{key}: {other:?}"),
        }
    }
    assert!(LocalModel::open("next", path.parent().unwrap()).is_ok());
}
