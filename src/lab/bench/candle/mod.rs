//! candle-transformers' own decoders as a second engine: Llama, Qwen 2, Qwen 3 and Gemma 3, from
//! safetensors and from GGUF files, as candle 0.11 has them.
//!
//! Its classes give the logits of the last token alone, and cannot go back in their caches. So a
//! kept prompt is computed again, in the step that keeps it.

mod config;
mod decoder;

#[cfg(test)]
mod tests;

use super::budget::Layout;
use super::protocol::{GgufPair, LoadRequest, Loaded, ModelChoice};
use decoder::Opened;
use planagent_mllm::{MllmError, ModelPlace, ModelRegistry, PassTime, Step, StepTime};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::io;
use std::path::Path;
use std::time::Instant;

/// The version of candle-transformers that `Cargo.toml` names.
const VERSION: &str = "candle-transformers 0.11";

/// Why candle could not measure a model.
#[derive(Debug, thiserror::Error)]
pub(super) enum CandleError {
    #[error(transparent)]
    Candle(#[from] candle_core::Error),
    #[error(transparent)]
    Model(#[from] MllmError),
    #[error("candle cannot be compared here: {0}")]
    Unsupported(String),
    #[error("cannot read {path}: {problem}")]
    Read { path: String, problem: String },
}

impl CandleError {
    fn read(path: &Path, error: &io::Error) -> Self {
        Self::Read {
            path: path.display().to_string(),
            problem: error.to_string(),
        }
    }
}

/// A decoder of candle with one sequence of tokens, whose steps are timed.
pub(super) struct CandleProbe {
    opened: Opened,
    /// The computed tokens.
    ids: Vec<u32>,
    /// Tokens that are appended and not computed yet.
    pending: Vec<u32>,
    words: Pcg64Mcg,
}

impl CandleProbe {
    /// Opens the files of a request.
    pub(super) fn open(
        registry: &ModelRegistry,
        request: &LoadRequest,
    ) -> Result<(Loaded, Self), CandleError> {
        let start = Instant::now();
        let place = match &request.model {
            ModelChoice::Named(name) => registry.place(&registry.find(name)?)?,
            ModelChoice::Gguf(GgufPair {
                decoder,
                projector: None,
            }) => ModelPlace::Decoder(decoder.clone()),
            ModelChoice::Gguf(_) | ModelChoice::Random(_) | ModelChoice::Exported(_) => {
                let problem = "its decoders read text alone, and from files".to_owned();
                return Err(CandleError::Unsupported(problem));
            }
        };
        let opened = match (place.decoder_and_tower()?, &place) {
            (Some((decoder, None)), _) => Opened::gguf(&decoder)?,
            (None, ModelPlace::Folder(folder)) => Opened::folder(folder)?,
            _ => {
                let problem = "its decoders read text alone".to_owned();
                return Err(CandleError::Unsupported(problem));
            }
        };
        let loaded = Loaded {
            parameters: opened.parameters,
            weight_format: opened.weight_format.clone(),
            image_side: 0,
            image_tokens: 0,
            vocabulary: opened.vocabulary,
            image_token: None,
            // No longer than the engine that it is compared with: both run the same workloads.
            context: request
                .like
                .map_or(opened.context, |like| like.context.min(opened.context)),
            layout: Layout::PrefixFirst,
            load_s: start.elapsed().as_secs_f64(),
            version: VERSION.to_owned(),
        };
        let probe = Self {
            opened,
            ids: Vec::new(),
            pending: Vec::new(),
            words: Pcg64Mcg::seed_from_u64(request.seed),
        };
        Ok((loaded, probe))
    }

    /// Runs a step. After an error the sequence cannot be used.
    pub(super) fn run(&mut self, step: Step) -> Result<StepTime, CandleError> {
        let start = Instant::now();
        let mut time = StepTime::default();
        match step {
            Step::Keep(tokens) => self.keep(tokens, &mut time)?,
            // Workloads are the same for all engines; a decoder of text has nothing to do for a
            // picture.
            Step::Encode | Step::Image => {}
            Step::Text(tokens) | Step::FastForwarded(tokens) => {
                let most = self.opened.vocabulary.max(1) as u32;
                for _ in 0..tokens {
                    self.pending.push(self.words.random_range(0..most));
                }
            }
            Step::Sampled(tokens) => {
                for _ in 0..tokens {
                    let token = likeliest(&self.compute(&mut time)?);
                    self.pending.push(token);
                    let passed = start.elapsed().as_secs_f64() * 1e3;
                    time.first_token_ms.get_or_insert(passed);
                }
            }
            Step::Compute => {
                self.compute(&mut time)?;
            }
            Step::Verified { .. } => {
                let problem = "it has no drafts".to_owned();
                return Err(CandleError::Unsupported(problem));
            }
        }
        time.ms = start.elapsed().as_secs_f64() * 1e3;
        Ok(time)
    }

    /// The logits behind a prompt, and the likeliest tokens that follow it.
    pub(super) fn answer(
        &mut self,
        prompt: &[u32],
        count: usize,
    ) -> Result<(Vec<f32>, Vec<u32>), CandleError> {
        let mut time = StepTime::default();
        self.keep(0, &mut time)?;
        self.pending = prompt.to_vec();
        let first = self.compute(&mut time)?;
        let mut tokens = vec![likeliest(&first)];
        while tokens.len() < count {
            self.pending.extend(tokens.last());
            tokens.push(likeliest(&self.compute(&mut time)?));
        }
        self.keep(0, &mut time)?;
        tokens.truncate(count);
        Ok((first, tokens))
    }

    fn keep(&mut self, tokens: usize, time: &mut StepTime) -> Result<(), CandleError> {
        self.pending.clear();
        if tokens < self.ids.len() {
            self.opened.forget()?;
            let mut kept = std::mem::take(&mut self.ids);
            kept.truncate(tokens);
            self.pending = kept;
            self.compute(time)?;
        }
        Ok(())
    }

    /// Computes the pending tokens; gives the logits behind them.
    fn compute(&mut self, time: &mut StepTime) -> Result<Vec<f32>, CandleError> {
        if self.pending.is_empty() {
            return Ok(Vec::new());
        }
        let start = Instant::now();
        let logits = self.opened.forward(&self.pending, self.ids.len())?;
        time.add_pass(PassTime {
            tokens: self.pending.len(),
            ms: start.elapsed().as_secs_f64() * 1e3,
            ..PassTime::default()
        });
        self.ids.append(&mut self.pending);
        Ok(logits)
    }
}

/// The likeliest token; 0 without logits.
fn likeliest(logits: &[f32]) -> u32 {
    let best = logits
        .iter()
        .enumerate()
        .max_by(|(_, one), (_, other)| one.total_cmp(other));
    best.map_or(0, |(token, _)| token as u32)
}
