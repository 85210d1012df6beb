//! A model whose steps are timed.

use super::step::{PassTime, Step, StepTime};
use crate::decoder::Logits;
use crate::family::{ImageFeatures, VisionLanguageModel};
use crate::local::Sequence;
use crate::sampling::Sampler;
use crate::{Deadline, Loading, MllmError, ModelPlace, Sampling, WeightFormat, milliseconds};
use candle_core::Tensor;
use image::RgbImage;
use planagent_kernels::Work;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::time::Instant;

/// Tokens of a pass within an answer, at most; longer ones begin a prompt.
const LONGEST_ANSWER_PASS: usize = 32;

/// A model with one sequence of tokens, whose steps are timed.
#[derive(Debug)]
pub struct LatencyProbe {
    weight_format: WeightFormat,
    model: Box<dyn VisionLanguageModel>,
    sequence: Sequence,
    /// Tokens that are appended and not computed yet.
    pending: Vec<u32>,
    /// Input rows of the image that was encoded last.
    features: Option<ImageFeatures>,
    image: RgbImage,
    words: Pcg64Mcg,
}

impl LatencyProbe {
    /// Opens a model; `seed` draws the tokens that it reads.
    pub fn open(place: &ModelPlace, loading: &Loading, seed: u64) -> Result<Self, MllmError> {
        let mut checkpoint = loading.checkpoint(place)?;
        let mut model = checkpoint.open_model()?;
        model.set_images(loading.image)?;
        let formats = &checkpoint.weights.report().weight_formats;
        let mut words = Pcg64Mcg::seed_from_u64(seed);
        let side = model.info().image_size.map_or(0, |side| side as u32);
        let image = RgbImage::from_fn(side, side, |_, _| image::Rgb(words.random()));
        Ok(Self {
            weight_format: formats
                .first()
                .map_or_else(WeightFormat::default, |share| share.weight_format),
            sequence: Sequence::new(&*model),
            model,
            pending: Vec::new(),
            features: None,
            image,
            words,
        })
    }

    /// The model that is measured.
    pub fn model(&self) -> &dyn VisionLanguageModel {
        &*self.model
    }

    /// The format of most weights.
    pub fn weight_format(&self) -> WeightFormat {
        self.weight_format
    }

    /// Tokens that the image becomes; 0 in a model that reads text alone.
    pub fn image_tokens(&self) -> Result<usize, MllmError> {
        Ok(self.model.drawn_layout()?.map_or(0, |image| image.tokens))
    }

    /// Runs a step. After an error the sequence cannot be used.
    pub fn run(&mut self, step: Step) -> Result<StepTime, MllmError> {
        let (start, before) = (Instant::now(), Work::so_far());
        let mut time = StepTime::default();
        match step {
            Step::Keep(tokens) => {
                self.pending = self.sequence.cut(tokens);
            }
            Step::Encode if self.model.info().image_size.is_none() => {}
            Step::Encode => self.features = Some(self.model.encode_image(&self.image)?),
            Step::Image => {
                let tokens = self.image_tokens()?;
                self.pending
                    .extend(std::iter::repeat_n(self.model.info().image_token, tokens));
            }
            Step::Text(tokens) | Step::FastForwarded(tokens) => {
                for _ in 0..tokens {
                    let word = self.word();
                    self.pending.push(word);
                }
            }
            Step::Sampled(tokens) => {
                for _ in 0..tokens {
                    let logits = self.compute(Logits::Last, &mut time)?;
                    let word = self.choose(logits)?;
                    self.pending.push(word);
                    time.first_token_ms
                        .get_or_insert_with(|| milliseconds(start.elapsed()));
                }
            }
            Step::Verified { drafted, accepted } => {
                for _ in 0..drafted {
                    let word = self.word();
                    self.pending.push(word);
                }
                let logits = self.compute(Logits::Tail(1 + drafted), &mut time)?;
                let rejected = drafted.saturating_sub(accepted);
                self.pending = self.sequence.cut(self.sequence.ids().len() - rejected);
                // Every accepted draft is one that was sampled.
                let mut next = None;
                for row in 0..=drafted - rejected {
                    let logits = logits.as_ref().map(|logits| logits.get(row)).transpose()?;
                    next = Some(self.choose(logits)?);
                }
                self.pending.extend(next);
                time.first_token_ms
                    .get_or_insert_with(|| milliseconds(start.elapsed()));
            }
            Step::Compute => {
                self.compute(Logits::None, &mut time)?;
                self.sequence.mark();
            }
        }
        time.ms = milliseconds(start.elapsed());
        time.work = Work::so_far() - before;
        Ok(time)
    }

    /// The numbers of an image's tokens, those for early layers of the decoder behind the others,
    /// of at most `most` tokens at even distances, and the number of all tokens. The image is a
    /// square of `side` pixels with a ramp in each channel: no filter changes it much.
    pub fn features(&self, side: u32, most: usize) -> Result<(usize, Vec<f32>), MllmError> {
        let ramp = |x: u32, y: u32, channel: u32| {
            let steps =
                u64::from(x) * u64::from(channel + 1) + u64::from(y) * u64::from(3 - channel);
            (steps * 255 / (4 * u64::from(side.max(1)))) as u8
        };
        let image = RgbImage::from_fn(side, side, |x, y| {
            image::Rgb([0, 1, 2].map(|c| ramp(x, y, c)))
        });
        let features = self.model.encode_image(&image)?;
        let tokens = features.rows.dim(0)?;
        let shown = tokens.min(most);
        let mut numbers = Vec::new();
        for row in (0..shown).map(|index| index * tokens / shown) {
            for part in std::iter::once(&features.rows).chain(&features.deep) {
                numbers.extend(part.get(row)?.to_vec1::<f32>()?);
            }
        }
        Ok((tokens, numbers))
    }

    /// The logits behind a prompt, computed alone, and the likeliest tokens that follow it. The
    /// sequence is empty afterwards.
    pub fn answer(
        &mut self,
        prompt: &[u32],
        count: usize,
    ) -> Result<(Vec<f32>, Vec<u32>), MllmError> {
        let mut time = StepTime::default();
        self.sequence.begin(&*self.model, prompt, &[]);
        self.sequence.cut(0);
        self.pending = prompt.to_vec();
        let (mut first, mut tokens) = (Vec::new(), Vec::new());
        while tokens.len() < count {
            let logits = self.compute(Logits::Last, &mut time)?;
            if tokens.is_empty() {
                first = logits.as_ref().map_or_else(
                    || Ok(Vec::new()),
                    |logits| logits.flatten_all()?.to_vec1::<f32>(),
                )?;
            }
            let token = self.choose(logits)?;
            tokens.push(token);
            self.pending = vec![token];
        }
        self.pending.clear();
        self.sequence.cut(0);
        Ok((first, tokens))
    }

    /// Computes the pending tokens.
    fn compute(
        &mut self,
        wanted: Logits,
        time: &mut StepTime,
    ) -> Result<Option<Tensor>, MllmError> {
        let (start, before) = (Instant::now(), Work::so_far());
        // As a conversation marks its prompts.
        if self.pending.len() > LONGEST_ANSWER_PASS {
            let image_token = self.model.info().image_token;
            self.sequence.mark_prompt(image_token, &self.pending);
        }
        let logits = self.sequence.append_in_passes(
            &*self.model,
            &self.pending,
            self.features.as_ref(),
            wanted,
            Deadline::NONE,
        )?;
        time.add_pass(PassTime {
            tokens: self.pending.len(),
            ms: milliseconds(start.elapsed()),
            work: Work::so_far() - before,
        });
        self.pending.clear();
        Ok(logits)
    }

    /// The most likely token.
    fn choose(&self, logits: Option<Tensor>) -> Result<u32, MllmError> {
        let Some(logits) = logits else {
            return Err(MllmError::Request {
                problem: "cannot sample: the sequence is empty".into(),
            });
        };
        let position = self.sequence.ids().len().saturating_sub(1);
        let logits = logits.flatten_all()?.to_vec1()?;
        Sampler::new(Sampling::Greedy, 0)?.choose(
            logits,
            None,
            self.model.info().image_token,
            position,
        )
    }

    /// A random token other than that of the image.
    fn word(&mut self) -> u32 {
        let info = self.model.info();
        loop {
            let word = self.words.random_range(0..info.vocabulary as u32);
            if word != info.image_token {
                return word;
            }
        }
    }
}
