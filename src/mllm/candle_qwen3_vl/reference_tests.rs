//! candle-transformers' Qwen3-VL on the reference that checks ours
//! (`tests/fixtures/tiny_qwen3_vl`): how far its logits are from transformers'. docs/models.md has
//! the figures.

use crate::checkpoint::ModelFiles;
use crate::families::{Architecture, Families};
use crate::family::{ImageFeatures, VisionLanguageModel};
use crate::local::test_prompts::Prompts;
use crate::local::test_reference::{LOGIT_TOLERANCE, difference, greedy, logits_in_pieces};
use crate::local::{Loading, LocalModel, Sequence};
use crate::source::{Checkpoint, ModelPlace};
use candle_core::Tensor;

fn model(prompts: &Prompts, architecture: &str) -> Box<dyn VisionLanguageModel> {
    let families = Families::default().preferring(Architecture::named(architecture).unwrap());
    let place = ModelPlace::Folder(prompts.folder.clone());
    Checkpoint::open(&place, None, &families)
        .unwrap()
        .open_model()
        .unwrap()
}

/// The largest difference of the logits behind the image, and how many of the greedy tokens are the
/// same, for a run and its image.
fn deviation(
    model: &dyn VisionLanguageModel,
    prompts: &Prompts,
    name: &str,
    image: Option<u64>,
) -> (f32, usize) {
    let ids = prompts.reference.ids(&format!("{name}input_ids"), 0);
    let features: Option<ImageFeatures> =
        image.map(|index| model.encode_image(&prompts.image(index)).unwrap());
    let expected = prompts.reference.tensor(&format!("{name}logits"));
    let text = ids
        .iter()
        .rev()
        .take_while(|id| **id != model.info().image_token)
        .count();
    let rows = text.min(expected.dims()[0]);
    let behind = |logits: &Tensor| logits.narrow(0, logits.dims()[0] - rows, rows).unwrap();
    let logits = logits_in_pieces(model, &ids, features.as_ref(), &[]);
    let tokens = prompts.reference.ids(&format!("{name}generated"), 0);
    let mut sequence = Sequence::new(model);
    let found = greedy(model, &mut sequence, &ids, features.as_ref(), tokens.len());
    let same = found
        .iter()
        .zip(&tokens)
        .filter(|(found, expected)| found == expected)
        .count();
    // Pieces, an image cut among them, give the same.
    let again = logits_in_pieces(model, &ids, features.as_ref(), &[7, 12]);
    assert!(
        difference(&behind(&again), &behind(&logits)) < LOGIT_TOLERANCE,
        "{name}: other logits in pieces"
    );
    (difference(&behind(&logits), &behind(expected)), same)
}

#[test]
fn candles_qwen3_vl_is_right_for_texts_and_wrong_for_images() {
    let prompts = Prompts::from_fixture("tiny_qwen3_vl");
    let [ours, candles] = ["qwen3-vl", "candle-qwen3-vl"].map(|name| model(&prompts, name));
    // The last two numbers stand in docs/models.md: difference of candle's logits, and greedy
    // tokens that are the same.
    for (name, image, apart, same) in [
        ("text_", None, 0.0, 20),
        ("", Some(0), 3.91, 3),
        ("second_", Some(1), 4.42, 1),
    ] {
        let ours = deviation(&*ours, &prompts, name, image);
        let candle = deviation(&*candles, &prompts, name, image);
        println!(
            "run '{name}': logits ours {:.1e}, candle {:.2e}; same greedy tokens {}, {}",
            ours.0, candle.0, ours.1, candle.1
        );
        assert!(ours.0 < LOGIT_TOLERANCE, "{name}: {}", ours.0);
        let tolerance = if image.is_none() {
            LOGIT_TOLERANCE
        } else {
            0.01
        };
        assert!(
            (candle.0 - apart).abs() < tolerance && candle.1 == same,
            "{name}: {candle:?}"
        );
    }
}

#[test]
fn a_description_chooses_candles_model() {
    let prompts = Prompts::from_fixture("tiny_qwen3_vl");
    let families = Families::default();
    let place = ModelPlace::Folder(prompts.folder.clone());
    let candles = Architecture::named("candle-qwen3-vl").unwrap();
    let loading = |families| Loading {
        expected: Some((candles, "mine".into())),
        families,
        ..Loading::default()
    };
    let open = |families| LocalModel::load("tiny", &place, &loading(families));
    assert!(
        open(families.clone())
            .unwrap_err()
            .to_string()
            .contains("says candle-qwen3-vl")
    );
    assert!(open(families.clone().preferring(candles)).is_ok());
    let files = ModelFiles::folder(&prompts.folder).unwrap();
    assert_eq!(families.detect_in(&files).unwrap().name(), "qwen3-vl");
}
