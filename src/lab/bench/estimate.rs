//! What a planning call will take on this machine, before a model is loaded.

use super::budget::{CallBudget, Layout};
use planagent_mllm::{Limits, ModelOutline, Step, WeightFormat};
use serde::Serialize;

/// Share of the limit of 8-bit products that vision towers reach. This and the next three were
/// fitted to `planagent bench` of the models in `docs/latency.md`.
const ENCODE: f64 = 0.52;
/// The same with AVX2: with its few registers, bytes of `q8_0` take the most instructions.
const ENCODE_WITH_AVX2: f64 = 0.22;
/// Share of the same limit that the tokens of a pass reach, the reading of weights apart.
const PREFILL: f64 = 0.54;
/// Share of a plain read at which a pass reads its weights.
const DECODE: f64 = 0.62;

/// The kernels of AVX2, as [`Limits::kernels`] names them.
const AVX2: &str = "AVX2";

/// Seconds of a planning call, by step. An estimate: shares of this machine's limits that other
/// models reached.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct CallEstimate {
    pub encode_s: f64,
    pub prefill_s: f64,
    pub decode_s: f64,
}

impl CallEstimate {
    /// A call with these token counts by a model whose weights are held in `format`; `None` for a
    /// format that the outline does not have.
    pub fn new(
        model: &ModelOutline,
        format: WeightFormat,
        budget: &CallBudget,
        limits: &Limits,
    ) -> Option<Self> {
        let mut outlines = model.formats.iter();
        let outline = outlines.find(|outline| outline.weight_format == format)?;
        let layout = if model.image_first {
            Layout::ImageFirst
        } else {
            Layout::PrefixFirst
        };
        let mut pass = Passes {
            token: model.work.token as f64 / (PREFILL * limits.operations_per_s),
            position: model.work.attention as f64 / (PREFILL * limits.operations_per_s),
            read: outline.token_bytes as f64 / (DECODE * limits.read_bytes_per_s),
            ..Passes::default()
        };
        for step in budget.call_steps(layout, model.image_tokens) {
            pass.add(step, model.image_tokens);
        }
        let encode = encode_share(limits) * limits.operations_per_s;
        Some(Self {
            encode_s: model.work.image as f64 / encode,
            ..pass.sum
        })
    }

    /// The whole call, seconds.
    pub fn seconds(self) -> f64 {
        self.encode_s + self.prefill_s + self.decode_s
    }
}

/// The share of the limit of 8-bit products that vision towers reach with a machine's kernels. Only
/// AVX-512 and AVX2 were measured; the others are taken to be like AVX-512.
fn encode_share(limits: &Limits) -> f64 {
    if limits.kernels == AVX2 {
        ENCODE_WITH_AVX2
    } else {
        ENCODE
    }
}

/// The passes of a decoder through a call.
#[derive(Default)]
struct Passes {
    /// Seconds that a token of a pass computes, without attention.
    token: f64,
    /// Seconds that it attends to one position.
    position: f64,
    /// Seconds that a pass reads weights.
    read: f64,
    /// Tokens that are computed.
    length: usize,
    /// Tokens that the next pass computes.
    appended: usize,
    /// Whether a prompt is among them.
    is_prompt: bool,
    sum: CallEstimate,
}

impl Passes {
    fn add(&mut self, step: Step, image_tokens: usize) {
        match step {
            Step::Keep(length) => (self.length, self.appended) = (length, 0),
            Step::Encode => {}
            Step::Image => self.append(image_tokens),
            Step::Text(tokens) => self.append(tokens),
            Step::FastForwarded(tokens) => self.appended += tokens,
            Step::Sampled(tokens) => (0..tokens).for_each(|_| self.sample()),
            Step::Verified { drafted, accepted } => {
                self.appended += drafted;
                self.sample();
                self.length -= drafted - accepted;
            }
            Step::Compute => self.compute(),
        }
    }

    /// Appends tokens of a prompt.
    fn append(&mut self, tokens: usize) {
        self.appended += tokens;
        self.is_prompt = true;
    }

    /// Computes what is appended and appends the sampled token.
    fn sample(&mut self) {
        self.compute();
        self.appended = 1;
    }

    /// A pass reads the weights once, and multiplies them with each of its tokens.
    fn compute(&mut self) {
        let tokens = self.appended as f64;
        let positions = tokens * (self.length as f64 + tokens / 2.0);
        let products = tokens * self.token + positions * self.position;
        let seconds = products + self.read;
        let part = if self.is_prompt {
            &mut self.sum.prefill_s
        } else {
            &mut self.sum.decode_s
        };
        *part += seconds;
        self.length += self.appended;
        (self.appended, self.is_prompt) = (0, false);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::{AnswerPart, RoundBudget};
    use planagent_mllm::{FormatOutline, MemoryNeed, ModelWork};

    fn model(image_tokens: usize) -> ModelOutline {
        ModelOutline {
            family: "llava",
            parameters: 0,
            image_size: Some(64),
            image_tokens,
            image_range: None,
            context: 4096,
            image_first: false,
            work: ModelWork {
                image: 39_000,
                token: 600,
                attention: 6,
            },
            adapter: None,
            formats: vec![FormatOutline {
                weight_format: WeightFormat::Q4K,
                memory: MemoryNeed {
                    weights: 0,
                    cache: 0,
                    work: 0,
                    picture: 0,
                },
                token_bytes: 8_000,
            }],
        }
    }

    fn limits(kernels: &str) -> Limits {
        Limits {
            kernels: kernels.into(),
            operations_per_s: 1e3,
            read_bytes_per_s: 1e4,
        }
    }

    #[test]
    fn a_pass_takes_its_products_and_its_reading() {
        let limits = limits("plain");
        let budget = CallBudget {
            prefix: 7,
            scene: 4,
            feedback: 0,
            rounds: vec![RoundBudget {
                question: 2,
                answer: vec![AnswerPart {
                    fast_forwarded: 1,
                    sampled: 3,
                }],
            }],
            rethinks: 0,
            accepted: None,
        };
        let estimate =
            |tokens| CallEstimate::new(&model(tokens), WeightFormat::Q4K, &budget, &limits);
        let found = estimate(10).unwrap();
        let close = |found: f64, expected: f64| assert!((found / expected - 1.0).abs() < 1e-9);
        close(found.encode_s, 39_000.0 / (ENCODE * 1e3));
        // 17 tokens behind the 7 that are kept, then one behind 24 and one behind 25 of them.
        let pass = |tokens: f64, behind: f64| {
            let operations = tokens * (600.0 + 6.0 * (behind + tokens / 2.0));
            operations / (PREFILL * 1e3) + 8_000.0 / (DECODE * 1e4)
        };
        close(found.prefill_s, pass(17.0, 7.0));
        close(found.decode_s, pass(1.0, 24.0) + pass(1.0, 25.0));
        assert!((found.seconds() - found.encode_s - found.prefill_s - found.decode_s).abs() < 1e-9);
        assert_eq!(
            CallEstimate::new(&model(10), WeightFormat::F16, &budget, &limits),
            None
        );
    }

    #[test]
    #[cfg(target_arch = "x86_64")]
    fn kernels_decide_what_a_picture_takes() {
        assert_eq!(planagent_mllm::Instructions::Avx2.name(), AVX2);
        let budget = CallBudget {
            prefix: 0,
            scene: 0,
            feedback: 0,
            rounds: Vec::new(),
            rethinks: 0,
            accepted: None,
        };
        let encode = |kernels| {
            let limits = limits(kernels);
            CallEstimate::new(&model(10), WeightFormat::Q4K, &budget, &limits)
                .map(|all| all.encode_s)
        };
        assert_eq!(encode(AVX2), Some(39_000.0 / (ENCODE_WITH_AVX2 * 1e3)));
        assert_eq!(encode("plain"), Some(39_000.0 / (ENCODE * 1e3)));
    }
}
