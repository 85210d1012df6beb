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
}
