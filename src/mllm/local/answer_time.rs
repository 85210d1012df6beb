//! How long an answer will take on this machine, by two short passes.

use super::{LocalModel, PictureNeed, Sequence};
use crate::conversation::AnswerTime;
use crate::decoder::Logits;
use crate::family::ImageSettings;
use crate::source::Checkpoint;
use std::time::{Duration, Instant};

/// Tokens of the longer pass that is timed.
const BATCH: usize = 16;
/// Weights of a model whose answers take no time worth a word, on any machine.
const MIN_WEIGHTS: u64 = 50_000_000;

/// The work of an answer, in weights that are multiplied.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct AnswerWork {
    /// Patches of the drawn picture, each multiplied by the weights of the tower.
    patches: u64,
    tower: u64,
    decoder: u64,
}

impl AnswerWork {
    /// The work of a checkpoint whose weights are not taken yet; none for a small model.
    pub(super) fn from_checkpoint(checkpoint: &Checkpoint, image: ImageSettings) -> Option<Self> {
        let (mut tower, mut decoder) = (0_u64, 0_u64);
        for (name, shape) in checkpoint.weights.shapes() {
            let elements = shape.iter().product::<usize>() as u64;
            if name.starts_with("vision") {
                tower = tower.saturating_add(elements);
            } else if !name.ends_with("embed_tokens.weight") {
                decoder = decoder.saturating_add(elements);
            }
        }
        if tower.saturating_add(decoder) < MIN_WEIGHTS || decoder == 0 {
            return None;
        }
        Some(Self {
            patches: PictureNeed::estimate(checkpoint, image).patches,
            tower,
            decoder,
        })
    }

    /// The picture's patches in tokens of the decoder that take as long.
    fn as_tokens(self) -> f64 {
        self.patches as f64 * self.tower as f64 / self.decoder as f64
    }
}

impl LocalModel {
    /// Times two passes, and gives what an answer of `new` tokens to `text` tokens and the drawn
    /// picture takes. None for a small model.
    pub(super) fn time_answer(&self, text: usize, new: usize) -> Option<AnswerTime> {
        let work = self.work?;
        let model = &*self.model;
        let info = model.info();
        let image = model.drawn_layout().ok()?.map_or(0, |image| image.tokens);
        let word = u32::from(info.image_token == 0);
        let mut sequence = Sequence::new(model);
        let mut timed = |words: &[u32], wanted: Logits| {
            let started = Instant::now();
            // The answer itself says why a pass fails.
            sequence.append(model, words, None, wanted).ok()?;
            Some(started.elapsed().as_secs_f64())
        };
        let batch = timed(&[word; BATCH], Logits::None)? / BATCH as f64;
        let single = timed(&[word], Logits::Last)?;
        let first = batch * ((text + image) as f64 + work.as_tokens());
        let seconds = |time: f64| Duration::try_from_secs_f64(time).unwrap_or(Duration::MAX);
        Some(AnswerTime {
            first_token: seconds(first),
            whole: seconds(first + single * new as f64),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::local::test_reference::{fixture, open_checkpoint};

    #[test]
    fn longer_answers_take_longer_and_small_models_are_not_timed() {
        let checkpoint = open_checkpoint(&fixture("tiny_llava"));
        assert_eq!(
            AnswerWork::from_checkpoint(&checkpoint, ImageSettings::default()),
            None
        );
        let mut model = LocalModel::open("tiny", &fixture("tiny_llava")).unwrap();
        assert_eq!(model.time_answer(10, 10), None);
        model.work = Some(AnswerWork {
            patches: 16,
            tower: 1000,
            decoder: 2000,
        });
        assert_eq!(model.work.unwrap().as_tokens() as u64, 8);
        let time = model.time_answer(100, 1000).unwrap();
        assert!(time.first_token > Duration::ZERO && time.whole > time.first_token);
    }
}
