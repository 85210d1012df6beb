//! Shared parts of the parity tests of all families: reference files, and ways to compute the same
//! logits.

use super::{LocalModel, Sequence};
use crate::Turn;
use crate::checkpoint::read_json;
use crate::decoder::Logits;
use crate::families::Families;
use crate::family::{Chat, ChatImage, ImageFeatures, VisionLanguageModel};
use crate::source::{Checkpoint, ModelPlace};
use candle_core::{Device, Tensor};
use std::path::{Path, PathBuf};

/// Tolerance for image features, relative to the largest feature. torch's own f32 results differ
/// from its f64 results by up to 1e-5 where features reach 11 (`mllm_reference/llava_next`).
pub(crate) const FEATURE_TOLERANCE: f32 = 1e-5;
/// Tolerance for logits.
pub(crate) const LOGIT_TOLERANCE: f32 = 1e-4;

/// A folder of `tests/fixtures`.
pub(crate) fn fixture(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../tests/fixtures")
        .join(name)
}

/// The data folder, which is not part of the project: `$PLANAGENT_DATA`, else `../shared/data`.
pub(crate) fn data() -> PathBuf {
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data");
    std::env::var_os("PLANAGENT_DATA").map_or_else(beside, PathBuf::from)
}

/// The checkpoint of a folder.
pub(crate) fn open_checkpoint(folder: &Path) -> Checkpoint {
    Checkpoint::open(
        &ModelPlace::Folder(folder.to_path_buf()),
        None,
        &Families::default(),
    )
    .unwrap()
}

/// The tensors of a reference file.
pub(crate) struct Reference(std::collections::HashMap<String, Tensor>);

impl Reference {
    pub(crate) fn open(path: &Path) -> Self {
        Self(candle_core::safetensors::load(path, &Device::Cpu).unwrap())
    }

    pub(crate) fn contains(&self, name: &str) -> bool {
        self.0.contains_key(name)
    }

    pub(crate) fn names(&self) -> impl Iterator<Item = &str> {
        self.0.keys().map(String::as_str)
    }

    pub(crate) fn tensor(&self, name: &str) -> &Tensor {
        &self.0[name]
    }

    /// Token ids; a negative one stands for a token of the image.
    pub(crate) fn ids(&self, name: &str, image_token: u32) -> Vec<u32> {
        let ids = self
            .tensor(name)
            .flatten_all()
            .unwrap()
            .to_vec1::<i64>()
            .unwrap();
        ids.into_iter()
            .map(|id| {
                if id < 0 {
                    image_token
                } else {
                    u32::try_from(id).unwrap()
                }
            })
            .collect()
    }
}

/// Inputs and outputs of a reference implementation for one prompt with an image.
pub(crate) struct Run {
    /// Pixels of the image, or of its tiles, (3, side, side) each.
    pub pixels: Vec<Tensor>,
    pub ids: Vec<u32>,
    /// Features of the image, (image tokens, hidden).
    pub features: Tensor,
    /// Logits of the prompt's last positions.
    pub logits: Tensor,
    /// Greedy tokens that follow the prompt.
    pub greedy: Vec<u32>,
}

impl Run {
    /// Reads a run by any generator script.
    pub(crate) fn open(path: &Path, image_token: u32) -> Self {
        let reference = Reference::open(path);
        let any = |names: &[&'static str]| {
            *names
                .iter()
                .find(|name| reference.0.contains_key(**name))
                .unwrap()
        };
        let pixels = reference.tensor("pixel_values");
        let (side, features) = (
            pixels.dims()[pixels.rank() - 1],
            reference.tensor(any(&["features", "packed", "image_embeds"])),
        );
        let pixels = pixels.reshape(((), 3, side, side)).unwrap();
        let mut ids = reference.ids("input_ids", image_token);
        if reference.0.contains_key("token_type_ids") {
            let kinds = reference.ids("token_type_ids", 0);
            ids.iter_mut()
                .zip(kinds)
                .filter(|(_, kind)| *kind == 1)
                .for_each(|(id, _)| *id = image_token);
        }
        let greedy = reference.ids(any(&["generated", "gen"]), image_token);
        Self {
            pixels: (0..pixels.dims()[0])
                .map(|image| pixels.get(image).unwrap())
                .collect(),
            features: features.flatten_to(features.rank() - 2).unwrap(),
            logits: reference.tensor("logits").clone(),
            greedy: greedy
                .strip_prefix(ids.as_slice())
                .unwrap_or(&greedy)
                .to_vec(),
            ids,
        }
    }

    /// The tokens of the prompt that stand for the image.
    pub(crate) fn image(&self, image_token: u32) -> std::ops::Range<usize> {
        let first = self.ids.iter().position(|id| *id == image_token).unwrap();
        first..first + self.features.dims()[0]
    }

    /// Checks that a model gives the same outputs.
    pub(crate) fn assert_same(&self, model: &dyn VisionLanguageModel, features: &ImageFeatures) {
        let found = feature_difference(&features.rows, &self.features);
        assert!(found < FEATURE_TOLERANCE, "the features differ by {found}");
        assert_logits(model, &self.ids, Some(features), &self.logits);
        assert_greedy(model, &self.ids, Some(features), &self.greedy);
    }

    /// Largest difference between the logits of the whole prompt and the reference.
    pub(crate) fn logits_difference(&self, logits: &Tensor) -> f32 {
        difference(&last_rows(logits, &self.logits), &self.logits)
    }
}

/// The features of an image in one piece.
pub(crate) fn whole(rows: Tensor) -> ImageFeatures {
    ImageFeatures::whole(rows).unwrap()
}

/// Largest difference between two tensors with equally many elements.
pub(crate) fn difference(found: &Tensor, expected: &Tensor) -> f32 {
    let found = found.flatten_all().unwrap();
    let expected = expected.flatten_all().unwrap();
    assert_eq!(found.dims(), expected.dims());
    let difference = (found - expected).unwrap().abs().unwrap().max(0).unwrap();
    difference.to_scalar().unwrap()
}

/// Difference of image features relative to the largest one, or to 1 if that is larger.
pub(crate) fn feature_difference(found: &Tensor, expected: &Tensor) -> f32 {
    let largest = expected
        .abs()
        .unwrap()
        .flatten_all()
        .unwrap()
        .max(0)
        .unwrap()
        .to_scalar::<f32>()
        .unwrap();
    difference(found, expected) / largest.max(1.0)
}

/// The logits of all positions when the ids are appended in pieces.
pub(crate) fn logits_in_pieces(
    model: &dyn VisionLanguageModel,
    ids: &[u32],
    features: Option<&ImageFeatures>,
    pieces: &[usize],
) -> Tensor {
    let mut sequence = Sequence::new(model);
    let mut rows = Vec::new();
    let mut rest = ids;
    for piece in pieces.iter().copied().chain([ids.len()]) {
        let (now, later) = rest.split_at(piece.min(rest.len()));
        rows.extend(sequence.append(model, now, features, Logits::All).unwrap());
        rest = later;
    }
    assert_eq!(sequence.ids(), ids);
    Tensor::cat(&rows, 0).unwrap()
}

/// Greedy tokens that follow a sequence and `ids`.
pub(crate) fn greedy(
    model: &dyn VisionLanguageModel,
    sequence: &mut Sequence,
    ids: &[u32],
    features: Option<&ImageFeatures>,
    count: usize,
) -> Vec<u32> {
    let mut tokens: Vec<u32> = Vec::new();
    let mut next = ids.to_vec();
    while tokens.len() < count {
        let logits = sequence
            .append(model, &next, features, Logits::Last)
            .unwrap()
            .unwrap();
        let token = logits.argmax(1).unwrap().to_vec1::<u32>().unwrap()[0];
        tokens.push(token);
        next = vec![token];
    }
    tokens
}

/// Checks the logits of the reference's last positions, computed in one piece, in several, and
/// token by token. Returns the largest difference.
pub(crate) fn assert_logits(
    model: &dyn VisionLanguageModel,
    ids: &[u32],
    features: Option<&ImageFeatures>,
    expected: &Tensor,
) -> f32 {
    assert_logits_within(LOGIT_TOLERANCE, model, ids, features, expected)
}

/// As [`assert_logits`], against a reference that is itself further from exact numbers.
pub(crate) fn assert_logits_within(
    tolerance: f32,
    model: &dyn VisionLanguageModel,
    ids: &[u32],
    features: Option<&ImageFeatures>,
    expected: &Tensor,
) -> f32 {
    let one_by_one = vec![1; ids.len()];
    let mut worst = 0f32;
    for pieces in [&[][..], &[1], &[4, 3, 9], &[7, 12], &one_by_one] {
        let logits = logits_in_pieces(model, ids, features, pieces);
        let found = if pieces.is_empty() || !model.image_at_once() {
            difference(&last_rows(&logits, expected), expected)
        } else {
            text_difference(model, ids, &last_rows(&logits, expected), expected)
        };
        assert!(
            found < tolerance,
            "in pieces of {pieces:?} the logits differ by {found}"
        );
        worst = worst.max(found);
    }
    worst
}

/// Largest difference between the logits of text. Those of an image whose tokens see one another are
/// others as long as some of them are lacking.
fn text_difference(
    model: &dyn VisionLanguageModel,
    ids: &[u32],
    found: &Tensor,
    expected: &Tensor,
) -> f32 {
    let kept = &ids[ids.len() - found.dims()[0]..];
    let rows: Vec<u32> = (0..kept.len() as u32)
        .filter(|row| kept[*row as usize] != model.info().image_token)
        .collect();
    let count = rows.len();
    let rows = Tensor::from_vec(rows, count, &Device::Cpu).unwrap();
    let text = |logits: &Tensor| {
        let logits = logits.reshape((kept.len(), ())).unwrap();
        logits.index_select(&rows, 0).unwrap()
    };
    difference(&text(found), &text(expected))
}

/// Largest difference between the logits of the whole prompt and the reference.
pub(crate) fn logits_deviation(
    model: &dyn VisionLanguageModel,
    ids: &[u32],
    features: &ImageFeatures,
    expected: &Tensor,
) -> f32 {
    difference(
        &last_rows(&logits_in_pieces(model, ids, Some(features), &[]), expected),
        expected,
    )
}

/// The logits of the last positions, of which the reference has these.
pub(crate) fn last_rows(logits: &Tensor, expected: &Tensor) -> Tensor {
    let vocabulary = logits.dims()[1];
    let kept = expected.elem_count() / vocabulary;
    logits.narrow(0, logits.dims()[0] - kept, kept).unwrap()
}

/// Checks greedy tokens, also after a truncation and from a copy.
pub(crate) fn assert_greedy(
    model: &dyn VisionLanguageModel,
    ids: &[u32],
    features: Option<&ImageFeatures>,
    expected: &[u32],
) {
    let mut sequence = Sequence::new(model);
    let count = expected.len();
    assert_eq!(greedy(model, &mut sequence, ids, features, count), expected);
    // A truncation leaves no trace; 7 lies within an image at the beginning.
    let again = [sequence.cut(7).as_slice(), &ids[7..]].concat();
    assert_eq!(
        greedy(model, &mut sequence, &again, features, count),
        expected
    );
    let again = [sequence.cut(20).as_slice(), &ids[20..]].concat();
    let mut copy = sequence.clone();
    assert_eq!(greedy(model, &mut copy, &again, features, count), expected);
}

/// Checks a complete folder: ids, features, logits and greedy tokens of the chat in its
/// `prompts.json`.
pub(crate) fn assert_chat(folder: &Path, rounds: &[&str]) {
    let reference = Reference::open(&folder.join("reference.safetensors"));
    let texts = read_json(&folder.join("prompts.json")).unwrap();
    let text = |value: &serde_json::Value| value.as_str().unwrap().to_string();
    let system = text(&texts["system"]);
    let prompts = [text(&texts["prompts"][0]), text(&texts["prompts"][1])];
    let local = LocalModel::open("tiny", folder).unwrap();
    let model = &*local.model;

    let image = image::open(folder.join("image.png")).unwrap().into_rgb8();
    let features = model.encode_image(&image).unwrap();
    let layout = model.image_layout(image.width(), image.height()).unwrap();
    assert_eq!(features.rows.dims()[0], layout.tokens);
    let found = feature_difference(&features.rows, reference.tensor("features"));
    assert!(found < FEATURE_TOLERANCE, "the features differ by {found}");

    let first = Turn {
        prompt: prompts[0].clone(),
        answer: text(&texts["first_answer"]),
    };
    for name in rounds {
        let (turns, prompt) = if *name == "chat_" {
            (vec![first.clone()], &prompts[1])
        } else {
            (vec![], &prompts[0])
        };
        let image = (*name != "text_").then_some(ChatImage::first(layout));
        let ids = local
            .prompt_ids(&Chat {
                system: &system,
                images: image.as_slice(),
                turns: &turns,
                prompt,
            })
            .unwrap();
        assert_eq!(
            ids,
            reference.ids(&format!("{name}input_ids"), model.info().image_token),
            "{name}"
        );
        assert_logits(
            model,
            &ids,
            Some(&features),
            reference.tensor(&format!("{name}logits")),
        );
        if image.is_some() {
            assert_greedy(
                model,
                &ids,
                Some(&features),
                &reference.ids(&format!("{name}generated"), 0),
            );
        }
    }
}

/// The image of noise and edges of `synthetic` in the generator scripts.
pub(crate) fn synthetic(height: u32, width: u32) -> image::RgbImage {
    image::RgbImage::from_fn(width, height, |x, y| {
        image::Rgb(
            [0, 1, 2].map(|c| ((x * 7 + y * 13 + c * 29 + (x * y) % 31 * 5 + (x ^ y)) % 256) as u8),
        )
    })
}
