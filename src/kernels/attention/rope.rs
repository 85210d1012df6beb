//! Settings of rotary position embeddings.

/// Rotary position embedding: base and scaling of its frequencies.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Rope {
    /// Base of the frequencies.
    pub theta: f64,
    /// Scaling of the frequencies.
    pub scaling: RopeScaling,
    /// How the pairs of a head are shared by the axes of a position; none for one axis.
    pub sections: Option<RotarySections>,
}

/// The pairs of a head's channels that each axis of a position turns: time, height, width
/// (`mrope_section`).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RotarySections {
    /// Pairs of time, height and width.
    pub lengths: [usize; 3],
    /// Whether the axes take turns, pair by pair (Qwen3-VL); otherwise each has one block
    /// (Qwen2.5-VL).
    pub interleaved: bool,
}

impl Default for Rope {
    fn default() -> Self {
        Self {
            theta: 10_000.0,
            scaling: RopeScaling::None,
            sections: None,
        }
    }
}

/// How the frequencies are scaled for contexts longer than in training (`rope_type`).
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum RopeScaling {
    /// The frequencies of the training.
    None,
    /// All frequencies are divided by the factor.
    Linear {
        /// Divisor of the frequencies.
        factor: f64,
    },
    /// Low frequencies are divided by the factor, high ones kept, those between interpolated.
    Llama3 {
        /// Divisor of low frequencies.
        factor: f64,
        /// Wavelengths above `original_context / low_freq_factor` are scaled fully.
        low_freq_factor: f64,
        /// Wavelengths below `original_context / high_freq_factor` are kept.
        high_freq_factor: f64,
        /// Context of the first training.
        original_context: f64,
    },
    /// `YaRN`: low frequencies are divided, high ones kept, and the scores of attention grow.
    Yarn(Yarn),
    /// The first pairs are turned, by the frequencies of the whole head, and the others are not
    /// (`proportional`).
    Proportional {
        /// Part of the pairs that is turned, up to 1.
        part: f64,
        /// Divisor of the frequencies.
        factor: f64,
    },
    /// Beyond the training's context the base grows with the prompt (`dynamic`).
    Dynamic {
        /// How fast the base grows.
        factor: f64,
        /// Context of the training.
        original_context: f64,
    },
}

/// Settings of `YaRN` (B. Peng et al., arXiv:2309.00071).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Yarn {
    /// Divisor of low frequencies.
    pub factor: f64,
    /// Context of the first training.
    pub original_context: f64,
    /// Frequencies that turn more often within that context are kept; 32 where a file says nothing.
    pub beta_fast: f64,
    /// Frequencies that turn less often within that context are divided; 1 where a file says nothing.
    pub beta_slow: f64,
    /// Whether the two borders are whole pairs (`truncate`), as they are in llama.cpp.
    pub truncate: bool,
    /// Factor of queries and keys (`attention_factor`).
    pub attention: f64,
}

impl Yarn {
    /// The factor of queries and keys that the paper advises for a divisor of frequencies, times
    /// `weight` above 1 (`get_mscale` in transformers).
    pub fn advised_attention(factor: f64, weight: f64) -> f64 {
        if factor <= 1.0 {
            1.0
        } else {
            0.1 * weight * factor.ln() + 1.0
        }
    }
}
