//! Estimated seconds of a planning call, from the sizes of a model and the speeds that were measured with others.

use super::budget::{CallBudget, Layout};
use planagent_mllm::{FormatOutline, MatrixShare, ModelOutline, Step, WeightFormat};

/// Whose speeds estimates take.
pub const ESTIMATED_ON: &str = "two cores of an Intel Xeon with AVX-512";

/// Measured speed of matrices in one format.
#[derive(Debug, Clone, Copy)]
struct Speed {
    /// Multiplications and additions of prompts, 1/s.
    operations: f64,
    /// Weights that decoding reads, bytes/s.
    bytes: f64,
}

/// Of the tables of docs/latency.md: `llava-1.5-7b` in `q4_k` and `llava-1.1b` in `q8_0`, two cores of an Intel Xeon, 512
/// tokens. Prefill of 38.4 and 246 tokens/s is 2 operations for each of 6.48 and 0.97 billion weights of the layers; decoding
/// of 4.24 and 20.3 tokens/s reads 3.75 and 1.10 GB.
const Q4_K: Speed = Speed { operations: 0.497e12, bytes: 15.9e9 };
const Q8_0: Speed = Speed { operations: 0.476e12, bytes: 22.3e9 };
/// Vision towers, whose weights have 8 bits: 405 billion operations of LLaVA 1.5 in 1.131 s, same place.
const IMAGE_OPERATIONS: f64 = 0.358e12;

/// The measured formats of an estimate.
pub const ESTIMATED_FORMATS: [WeightFormat; 2] = [WeightFormat::Q4K, WeightFormat::Q8_0];

/// Weights of the smallest model that is estimated. The fixed costs of a pass outweigh those of fewer.
const MIN_WEIGHTS: u64 = 100_000_000;

fn speed(weight_format: WeightFormat) -> Speed {
    match weight_format {
        // 5 bits, and the 6 bits of an output layer, are read as fast as 4 bits are.
        WeightFormat::Q3K
        | WeightFormat::Q4_0
        | WeightFormat::Q4K
        | WeightFormat::Q4_1
        | WeightFormat::Q5_0
        | WeightFormat::Q5K
        | WeightFormat::Q5_1
        | WeightFormat::Q6K => Q4_K,
        // Floats in a quantized model are a few matrices whose widths do not fit: as much work as in 8 bits, and more bytes.
        WeightFormat::Q8_0 | WeightFormat::F16 | WeightFormat::F32 => Q8_0,
    }
}

/// Estimated seconds of a planning call with a model in one of [`ESTIMATED_FORMATS`]; none for other formats, whose speed was
/// not measured, and for small models.
pub fn estimated_seconds(model: &ModelOutline, weight_format: WeightFormat, budget: &CallBudget) -> Option<f64> {
    let estimated = ESTIMATED_FORMATS.contains(&weight_format) && model.parameters >= MIN_WEIGHTS;
    let format = model.format(weight_format).filter(|_| estimated)?;
    let layout = if model.image_first { Layout::ImageFirst } else { Layout::PrefixFirst };
    let pass = Pass::of(format);
    let (mut seconds, mut pending) = (0.0, 0);
    for step in budget.call_steps(layout, model.image_tokens) {
        match step {
            // What a kept prefix leaves behind is never computed.
            Step::Keep(_) => pending = 0,
            Step::Encode => seconds += format.image_operations / IMAGE_OPERATIONS,
            Step::Image => pending += model.image_tokens,
            Step::Text(tokens) | Step::FastForwarded(tokens) => pending += tokens,
            Step::Compute => seconds += pass.seconds(std::mem::take(&mut pending)),
            Step::Verified { drafted, .. } => seconds += pass.seconds(std::mem::replace(&mut pending, 1) + drafted),
            Step::Sampled(tokens) => {
                // A sampled token is computed by the pass of the next.
                seconds += pass.seconds(pending) + pass.seconds(1) * tokens.saturating_sub(1) as f64;
                pending = 1;
            }
        }
    }
    Some(seconds)
}

/// The time of a pass of the decoder.
#[derive(Debug, Clone, Copy)]
struct Pass {
    /// Reading all weights, s.
    read: f64,
    /// Products of a token with the layers, s.
    token: f64,
    /// Products of a token with the output layer, s.
    output: f64,
}

impl Pass {
    fn of(format: &FormatOutline) -> Self {
        let sum = |shares: &[MatrixShare], time: fn(MatrixShare, Speed) -> f64| -> f64 {
            shares.iter().map(|share| time(*share, speed(share.weight_format))).sum()
        };
        let read = |share: MatrixShare, speed: Speed| bytes(share) / speed.bytes;
        let products = |share: MatrixShare, speed: Speed| 2.0 * share.weights as f64 / speed.operations;
        Self {
            read: sum(&format.layers, read) + sum(&format.output, read),
            token: sum(&format.layers, products),
            output: sum(&format.output, products),
        }
    }

    /// Reading or multiplying, whichever takes longer.
    fn seconds(self, tokens: usize) -> f64 {
        if tokens == 0 { 0.0 } else { self.read.max(self.token * tokens as f64 + self.output) }
    }
}

fn bytes(share: MatrixShare) -> f64 {
    share.weights as f64 * share.weight_format.bits() / 8.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use planagent_mllm::{ModelShape, PromptSet};

    /// Measured calls of docs/latency.md on the same machine: seconds.
    #[test]
    fn estimates_are_near_the_measured_calls() {
        for (name, weight_format, prompts, measured) in [
            ("llava-1.5-7b", WeightFormat::Q4K, PromptSet::Paper, 142.665),
            ("llava-1.5-13b", WeightFormat::Q4K, PromptSet::Paper, 283.825),
            ("cogvlm-chat-17b", WeightFormat::Q4K, PromptSet::Paper, 214.339),
            ("llava-1.1b", WeightFormat::Q4K, PromptSet::Paper, 26.069),
            ("llava-1.1b", WeightFormat::Q8_0, PromptSet::Paper, 35.022),
        ] {
            let outline = ModelOutline::of_shape(ModelShape::find(name).unwrap()).unwrap();
            let estimate = estimated_seconds(&outline, weight_format, &CallBudget::of(prompts)).unwrap();
            println!("{name} {weight_format}: estimated {estimate:.2} s, measured {measured:.2} s");
            assert!((0.8..1.2).contains(&(estimate / measured)), "{name} {weight_format}: {estimate}, {measured}");
        }
    }

    #[test]
    fn formats_without_a_measured_speed_and_small_models_have_no_estimate() {
        let budget = CallBudget::of(PromptSet::Paper);
        let estimate = |name: &str, weight_format| {
            let outline = ModelOutline::of_shape(ModelShape::find(name).unwrap()).unwrap();
            estimated_seconds(&outline, weight_format, &budget)
        };
        assert!(estimate("smolvlm2-256m", WeightFormat::Q4K).is_some());
        assert!(estimate("smolvlm2-256m", WeightFormat::F16).is_none());
        assert!(estimate("smolvlm2-256m", WeightFormat::F32).is_none());
        assert!(estimate("nano", WeightFormat::Q8_0).is_none());
    }
}
