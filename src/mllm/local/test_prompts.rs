//! Parity with the references of today's families (`tests/fixtures/make_modern.py`): two images,
//! and several chats.

use super::test_faults::{Deviation, Fault, Parts};
use super::test_reference::{
    FEATURE_TOLERANCE, LOGIT_TOLERANCE, Reference, assert_greedy, assert_logits_within, data,
    difference, feature_difference, fixture, last_rows, logits_in_pieces,
};
use super::{Loading, LocalModel, Sequence};
use crate::checkpoint::{ModelFiles, read_json};
use crate::decoder::{DecoderInput, Logits, Position};
use crate::family::{
    Chat, ChatImage, Family, ImageFeatures, ImageSettings, PlacedImage, Positions,
    VisionLanguageModel,
};
use crate::source::ModelPlace;
use crate::{MllmError, Turn};
use candle_core::{Device, Tensor};
use image::RgbImage;
use serde_json::Value;
use std::collections::{BTreeMap, HashMap, HashSet};
use std::fs;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// A reference folder.
pub(crate) struct Prompts {
    pub folder: PathBuf,
    texts: Value,
    pub reference: Reference,
}

/// The largest deviations of a model from its reference.
#[derive(Debug, Default, Clone, Copy)]
pub(crate) struct Worst {
    /// Of features, relative to the largest.
    pub features: f32,
    pub logits: f32,
}

impl Worst {
    fn or(self, features: f32, logits: f32) -> Self {
        Self {
            features: self.features.max(features),
            logits: self.logits.max(logits),
        }
    }
}

impl Prompts {
    /// The reference in a folder of `tests/fixtures`.
    pub(crate) fn from_fixture(name: &str) -> Self {
        Self::of_folder(fixture(name))
    }

    /// The reference of a family in the data folder, which is not part of the project.
    pub(crate) fn from_data(name: &str) -> Self {
        Self::of_folder(data().join("mllm_reference").join(name))
    }

    fn of_folder(folder: PathBuf) -> Self {
        let texts = read_json(&folder.join("prompts.json")).unwrap();
        let reference = Reference::open(&folder.join("reference.safetensors"));
        Self {
            folder,
            texts,
            reference,
        }
    }

    /// Checks that each fault in the parts of a language model changes its logits by far more than the
    /// tolerance.
    pub(crate) fn assert_noticed(&self, family: &Family, faults: &[Fault]) {
        let ids = self.reference.ids("chat_input_ids", 0);
        let expected = self.reference.tensor("chat_logits");
        let deviation = |parts: &Parts| {
            let files = [("config.json".to_owned(), parts.config.to_string())];
            let files = ModelFiles::packed(Path::new("model"), files.into());
            let model = (family.open)(&files, &mut parts.weights(family)).unwrap();
            let logits = logits_in_pieces(&*model, &ids, None, &[]);
            difference(&last_rows(&logits, expected), expected)
        };
        assert!(deviation(&Parts::from_folder(&self.folder)) < LOGIT_TOLERANCE);
        for (what, fault) in faults {
            let found = deviation(&Parts::wrong(&self.folder, *fault));
            println!("  {what:48} {found:>10.1e}");
            assert!(
                found > 100.0 * LOGIT_TOLERANCE,
                "{what} is hardly noticed: {found}"
            );
        }
    }

    /// The model in a layout: that of the folder, `.`, or of a folder below it.
    pub(crate) fn open(&self, layout: &str, image: ImageSettings) -> LocalModel {
        let copy = self.in_layout(layout);
        Self::load(&ModelPlace::Folder(copy.path().to_path_buf()), image)
    }

    /// A copy of the folder in a layout: with the configuration of the folder below it, and tensors
    /// as its `names.json` says.
    pub(crate) fn in_layout(&self, layout: &str) -> tempfile::TempDir {
        let copy = tempfile::tempdir().unwrap();
        let other = self.folder.join(layout);
        for entry in [&self.folder, &other]
            .into_iter()
            .flat_map(|folder| fs::read_dir(folder).unwrap())
        {
            let from = entry.unwrap().path();
            if from.is_file() && !from.ends_with(NAMES) {
                fs::copy(&from, copy.path().join(from.file_name().unwrap())).unwrap();
            }
        }
        if other.join(NAMES).exists() {
            rename(
                &copy.path().join("model.safetensors"),
                json_of(&other, NAMES),
            );
        }
        copy
    }

    /// The model in llama.cpp's files.
    pub(crate) fn open_gguf(&self, image: ImageSettings) -> LocalModel {
        let gguf = self.folder.join("gguf");
        Self::load(
            &ModelPlace::Gguf {
                model: gguf.join("model.gguf"),
                mmproj: Some(gguf.join("mmproj-model.gguf")),
            },
            image,
        )
    }

    /// A folder with llama.cpp's files and a file of the reference beside them.
    pub(crate) fn gguf_with(&self, file: &str) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        for name in ["gguf/model.gguf", "gguf/mmproj-model.gguf", file] {
            let from = self.folder.join(name);
            fs::copy(&from, folder.path().join(from.file_name().unwrap())).unwrap();
        }
        folder
    }

    /// A model in any folder.
    pub(crate) fn open_at(folder: &Path) -> LocalModel {
        Self::load(
            &ModelPlace::Folder(folder.to_path_buf()),
            ImageSettings::default(),
        )
    }

    pub(crate) fn load(place: &ModelPlace, image: ImageSettings) -> LocalModel {
        LocalModel::load(
            "tiny",
            place,
            &Loading {
                image,
                ..Loading::default()
            },
        )
        .unwrap()
    }

    pub(crate) fn image(&self, index: u64) -> RgbImage {
        image::open(self.folder.join(format!("image_{index}.png")))
            .unwrap()
            .into_rgb8()
    }

    /// Checks ids, positions, features, logits and greedy tokens of the runs whose names `wanted`
    /// takes.
    pub(crate) fn check(&self, local: &LocalModel, wanted: impl Fn(&str) -> bool) -> Worst {
        self.check_within(LOGIT_TOLERANCE, local, wanted)
    }

    /// As [`Self::check`], against a reference whose logits are themselves further from exact ones.
    pub(crate) fn check_within(
        &self,
        tolerance: f32,
        local: &LocalModel,
        wanted: impl Fn(&str) -> bool,
    ) -> Worst {
        let model = &*local.model;
        let mut worst = Worst::default();
        let runs = self.texts["runs"].as_object().unwrap();
        let mut checked = 0;
        for (name, run) in runs.iter().filter(|(name, _)| wanted(name)) {
            let index = run["image"].as_u64();
            let image = index.map(|index| self.image(index));
            let layout = |image: &RgbImage| {
                let layout = model.image_layout(image.width(), image.height());
                ChatImage::first(layout.unwrap())
            };
            let shown = image.as_ref().map(layout);
            let ids = local
                .prompt_ids(&self.chat(name, shown.as_slice(), &self.turns(name)))
                .unwrap();
            let expected = self.reference.ids(&format!("{name}input_ids"), 0);
            assert_eq!(ids, expected, "{name}");
            let logits = self.reference.tensor(&format!("{name}logits"));
            let features = image.map(|image| model.encode_image(&image).unwrap());
            let mut apart = 0.0;
            if let (Some(features), Some(index)) = (&features, index) {
                let base = self.features_of(name, index);
                apart = feature_difference(
                    &features.rows,
                    self.reference.tensor(&format!("{base}features")),
                );
                for (layer, deep) in features.deep.iter().enumerate() {
                    let expected = self.reference.tensor(&format!("{base}deepstack_{layer}"));
                    apart = apart.max(feature_difference(deep, expected));
                }
                assert!(
                    apart < FEATURE_TOLERANCE,
                    "{name}: the features differ by {apart}"
                );
                self.check_positions(
                    model,
                    name,
                    &ids,
                    PlacedImage {
                        first: 0,
                        layout: features.layouts[0],
                    },
                );
            }
            let logits = assert_logits_within(tolerance, model, &ids, features.as_ref(), logits);
            assert_greedy(
                model,
                &ids,
                features.as_ref(),
                &self.reference.ids(&format!("{name}generated"), 0),
            );
            worst = worst.or(apart, logits);
            checked += 1;
        }
        assert!(checked > 0, "no run was checked");
        println!(
            "{}: worst features {:.1e}, logits {:.1e}",
            self.folder.display(),
            worst.features,
            worst.logits
        );
        worst
    }

    /// The prefix of the features of a run's image.
    fn features_of(&self, name: &str, image: u64) -> String {
        let own = format!("{name}features");
        if self.reference.contains(&own) {
            name.to_string()
        } else {
            ["", "second_"][image as usize].to_string()
        }
    }

    fn turns(&self, name: &str) -> Vec<Turn> {
        let text = |value: &Value| value.as_str().unwrap().to_string();
        let first = Turn {
            prompt: text(&self.texts["prompts"][0]),
            answer: text(&self.texts["first_answer"]),
        };
        if name == "chat_" {
            vec![first]
        } else {
            Vec::new()
        }
    }

    fn chat<'a>(&'a self, name: &str, images: &'a [ChatImage], turns: &'a [Turn]) -> Chat<'a> {
        let plain = name == "nosystem_";
        let prompt = usize::from(plain || name == "chat_");
        Chat {
            system: if plain {
                ""
            } else {
                self.texts["system"].as_str().unwrap()
            },
            images,
            turns,
            prompt: self.texts["prompts"][prompt].as_str().unwrap(),
        }
    }

    /// Checks the positions on all axes, of the whole chat and of its parts.
    fn check_positions(
        &self,
        model: &dyn VisionLanguageModel,
        name: &str,
        ids: &[u32],
        mut image: PlacedImage,
    ) {
        image.first = ids
            .iter()
            .position(|id| *id == model.info().image_token)
            .unwrap();
        let stored = format!("{name}position_ids");
        // Some references have no positions: their tokens stand one behind the other.
        if !self.reference.contains(&stored) {
            let plain = Positions::plain(0..ids.len() as u32).rotary;
            assert_eq!(model.positions(0..ids.len(), &[image]).rotary, plain);
            return;
        }
        let expected = self.reference.tensor(&stored);
        let expected = expected.flatten_all().unwrap().to_vec1::<i64>().unwrap();
        let axis = |axis: usize| {
            if expected.len() == ids.len() {
                &expected[..]
            } else {
                &expected[axis * ids.len()..]
            }
        };
        let expected: Vec<[u32; 3]> = (0..ids.len())
            .map(|token| [0, 1, 2].map(|number| u32::try_from(axis(number)[token]).unwrap()))
            .collect();
        for part in [0..ids.len(), 0..9, 9..21, 21..ids.len()] {
            let found = model.positions(part.clone(), &[image]).rotary;
            assert_eq!(found, expected[part.clone()], "{name}: {part:?}");
        }
    }
}

/// The file that says which stored tensors are a tensor of another layout.
const NAMES: &str = "names.json";

/// Renames the tensors of a file: each name is given to some of them, one below the other. Tensors
/// that are not named stay.
fn rename(path: &Path, names: Value) {
    let stored = candle_core::safetensors::load(path, &Device::Cpu).unwrap();
    let names: BTreeMap<String, Vec<String>> = serde_json::from_value(names).unwrap();
    let used: HashSet<&String> = names.values().flatten().collect();
    let kept = stored.iter().filter(|(name, _)| !used.contains(name));
    let mut tensors: HashMap<String, Tensor> = kept
        .map(|(name, tensor)| (name.clone(), tensor.clone()))
        .collect();
    tensors.extend(names.iter().map(|(name, parts)| {
        let parts: Vec<&Tensor> = parts.iter().map(|part| &stored[part]).collect();
        (name.clone(), Tensor::cat(&parts, 0).unwrap())
    }));
    candle_core::safetensors::save(&tensors, path).unwrap();
}

/// One view of each image in the place of tiles.
pub(crate) const ONE_TILE: ImageSettings = ImageSettings {
    size: None,
    tiles: Some(1),
};

/// Whether a run is one of a model whose images are not cut.
pub(crate) fn is_unsplit(name: &str) -> bool {
    name.starts_with("unsplit_")
}

/// A file of a reference folder.
pub(crate) fn json_of(folder: &Path, name: &str) -> Value {
    read_json(&folder.join(name)).unwrap()
}

/// The pixels of a run's image, (3, height, width), from the rows of patches that Qwen's processors
/// write: blocks of 2 by 2 patches in raster order, each patch as channel, row and column (the
/// reference has the first of two equal frames).
pub(crate) fn raster_pixels(reference: &Reference, name: &str, patch: u32) -> Tensor {
    let patch = patch as usize;
    let grid = reference
        .tensor(&format!("{name}image_grid_thw"))
        .flatten_all()
        .unwrap()
        .to_vec1::<i64>()
        .unwrap();
    let [rows, columns] = [1, 2].map(|axis| usize::try_from(grid[axis]).unwrap());
    let patches = reference.tensor(&format!("{name}pixel_values"));
    patches
        .reshape(vec![rows / 2, columns / 2, 2, 2, 3, patch, patch])
        .unwrap()
        .permute(vec![4, 0, 2, 5, 1, 3, 6])
        .unwrap()
        .reshape((3, rows * patch, columns * patch))
        .unwrap()
}

/// Checks the sizes of resized images in `resize.json`.
pub(crate) fn assert_resized(
    folder: &Path,
    key: &str,
    resized: impl Fn(u32, u32) -> Result<(u32, u32), MllmError>,
) {
    let cases = json_of(folder, "resize.json");
    let cases = cases["cases"].as_array().unwrap();
    assert!(cases.len() > 40);
    for case in cases {
        let number = |value: &Value| u32::try_from(value.as_u64().unwrap()).unwrap();
        let expected = (number(&case[key][0]), number(&case[key][1]));
        assert_eq!(
            resized(number(&case["width"]), number(&case["height"])).unwrap(),
            expected,
            "{case}"
        );
    }
}

/// The run of the second image, which is no square.
pub(crate) struct SecondImage<'a> {
    reference: &'a Reference,
    ids: Vec<u32>,
}

impl<'a> SecondImage<'a> {
    pub(crate) fn from_prompts(prompts: &'a Prompts) -> Self {
        Deviation::print_heading(&prompts.folder);
        Self {
            reference: &prompts.reference,
            ids: prompts.reference.ids("second_input_ids", 0),
        }
    }

    /// The deviation of a model with these features.
    pub(crate) fn logits(
        &self,
        model: &dyn VisionLanguageModel,
        features: &ImageFeatures,
    ) -> Deviation {
        let input = Sequence::new(model)
            .decoder_input(model, &self.ids, Some(features))
            .unwrap();
        self.deviation(model, features, &input)
    }

    /// Checks that a model of the reference's parts does not deviate, and that each fault of encoder or
    /// decoder leads far away. Gives the right model with its features.
    pub(crate) fn check_faults<M: VisionLanguageModel>(
        &self,
        prompts: &Prompts,
        assembled: fn(&Parts) -> M,
        [of_image, of_decoder]: [&[Fault]; 2],
    ) -> (M, ImageFeatures) {
        let right = assembled(&Parts::from_folder(&prompts.folder));
        let image = prompts.image(1);
        let features = right.encode_image(&image).unwrap();
        self.logits(&right, &features).assert_none("nothing wrong");
        for &(what, fault) in of_image {
            let model = assembled(&Parts::wrong(&prompts.folder, fault));
            self.logits(&model, &model.encode_image(&image).unwrap())
                .assert_far(what);
        }
        for &(what, fault) in of_decoder {
            let model = assembled(&Parts::wrong(&prompts.folder, fault));
            self.logits(&model, &features).assert_logits_far(what);
        }
        (right, features)
    }

    /// The deviation of a model whose tokens stand elsewhere.
    pub(crate) fn placed(
        &self,
        model: &dyn VisionLanguageModel,
        features: &ImageFeatures,
        positions: Vec<Position>,
    ) -> Deviation {
        let input = Sequence::new(model)
            .decoder_input(model, &self.ids, Some(features))
            .unwrap();
        self.deviation(model, features, &DecoderInput { positions, ..input })
    }

    /// The deviation of a model whose tokens of an image are others.
    pub(crate) fn seeing(
        &self,
        model: &dyn VisionLanguageModel,
        features: &ImageFeatures,
        change: impl Fn(Range<usize>) -> Range<usize>,
    ) -> Deviation {
        let input = Sequence::new(model)
            .decoder_input(model, &self.ids, Some(features))
            .unwrap();
        let vision = input.vision.iter().cloned().map(change).collect();
        self.deviation(model, features, &DecoderInput { vision, ..input })
    }

    fn deviation(
        &self,
        model: &dyn VisionLanguageModel,
        features: &ImageFeatures,
        input: &DecoderInput,
    ) -> Deviation {
        let decoder = model.decoder();
        let logits = decoder
            .forward(input, &mut decoder.new_cache(self.ids.len()), Logits::All)
            .unwrap()
            .unwrap();
        let expected = self.reference.tensor("second_logits");
        Deviation {
            features: feature_difference(&features.rows, self.reference.tensor("second_features")),
            logits: difference(&last_rows(&logits, expected), expected),
        }
    }

    /// Positions that are easily wrong.
    pub(crate) fn wrong_positions(
        &self,
        model: &dyn VisionLanguageModel,
    ) -> Vec<(&'static str, Vec<Position>)> {
        let image_token = model.info().image_token;
        let flat = self
            .reference
            .tensor("second_position_ids")
            .flatten_all()
            .unwrap()
            .to_vec1::<i64>()
            .unwrap();
        let count = self.ids.len();
        let right: Vec<Position> = (0..count)
            .map(|token| [0, 1, 2].map(|axis| flat[axis * count + token] as u32))
            .collect();
        let image = |token: &usize| self.ids[*token] == image_token;
        let end = (0..count).filter(image).max().unwrap() + 1;
        let tokens = (0..count).filter(image).count() as u32;
        let taken = right[end][0] - right[end - tokens as usize][0];
        let further = |[t, h, w]: Position| [t, h, w].map(|axis| axis + tokens - taken);
        let behind = right
            .iter()
            .enumerate()
            .map(|(token, place)| if token < end { *place } else { further(*place) });
        vec![
            (
                "one position a token",
                (0..count as u32).map(|token| [token; 3]).collect(),
            ),
            (
                "height and width exchanged",
                right.iter().map(|[t, h, w]| [*t, *w, *h]).collect(),
            ),
            ("text behind the image's number of tokens", behind.collect()),
        ]
    }
}
