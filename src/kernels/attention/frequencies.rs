//! Frequencies of rotary position embeddings, and how they are scaled for long contexts
//! (`ROPE_INIT_FUNCTIONS` in transformers 5.24.0).

use super::rope::{Rope, RopeScaling, Yarn};
use std::f64::consts::PI;

/// Angle per position of each pair of channels, rounded to f32 as in transformers.
pub fn frequencies(rope: &Rope, head_width: usize) -> Vec<f32> {
    (0..head_width / 2)
        .map(|pair| {
            let frequency = 1.0 / rope.theta.powf(2.0 * pair as f64 / head_width as f64);
            (match rope.scaling {
                RopeScaling::Yarn(yarn) => {
                    let kept = 1.0 - yarn.divided(pair, rope.theta, head_width);
                    frequency / yarn.factor * (1.0 - kept) + frequency * kept
                }
                RopeScaling::Proportional { part, .. }
                    if pair as f64 >= (part * head_width as f64 / 2.0).floor() =>
                {
                    0.0
                }
                scaling => scaled(frequency, scaling),
            }) as f32
        })
        .collect()
}

/// The factor of queries and keys.
pub(super) fn magnitude(rope: &Rope) -> f32 {
    match rope.scaling {
        RopeScaling::Yarn(yarn) => yarn.attention as f32,
        _ => 1.0,
    }
}

/// The embedding for a prompt of `length` positions, where the base grows with it.
pub(super) fn extended(rope: &Rope, head_width: usize, length: usize) -> Rope {
    let RopeScaling::Dynamic {
        factor,
        original_context,
    } = rope.scaling
    else {
        return *rope;
    };
    let length = (length as f64).max(original_context);
    let growth = factor * length / original_context - (factor - 1.0);
    let width = head_width as f64;
    Rope {
        theta: rope.theta * growth.powf(width / (width - 2.0)),
        ..*rope
    }
}

/// The divisor of each pair's frequency, where a configuration scales them one by one (Llama 3.1).
pub fn frequency_factors(rope: &Rope, head_width: usize) -> Option<Vec<f32>> {
    matches!(rope.scaling, RopeScaling::Llama3 { .. }).then(|| {
        let unscaled = frequencies(
            &Rope {
                scaling: RopeScaling::None,
                ..*rope
            },
            head_width,
        );
        unscaled
            .iter()
            .zip(frequencies(rope, head_width))
            .map(|(unscaled, scaled)| unscaled / scaled)
            .collect()
    })
}

impl Yarn {
    /// How much of a pair's frequency is divided, from 0 to 1.
    fn divided(&self, pair: usize, theta: f64, head_width: usize) -> f64 {
        let width = head_width as f64;
        // The pair that turns so often within the context of the training.
        let border = |turns: f64| {
            width * (self.original_context / (turns * 2.0 * PI)).ln() / (2.0 * theta.ln())
        };
        let (mut low, mut high) = (border(self.beta_fast), border(self.beta_slow));
        if self.truncate {
            (low, high) = (low.floor(), high.ceil());
        }
        let low = low.max(0.0);
        let mut high = high.min(width - 1.0);
        if (high - low).abs() < f64::EPSILON {
            high += 0.001;
        }
        ((pair as f64 - low) / (high - low)).clamp(0.0, 1.0)
    }
}

/// Scaling of a frequency that does not depend on its pair.
fn scaled(frequency: f64, scaling: RopeScaling) -> f64 {
    match scaling {
        // A dynamic base is that of the training up to its context.
        RopeScaling::None | RopeScaling::Dynamic { .. } | RopeScaling::Yarn(_) => frequency,
        RopeScaling::Linear { factor } | RopeScaling::Proportional { factor, .. } => {
            frequency / factor
        }
        RopeScaling::Llama3 {
            factor,
            low_freq_factor,
            high_freq_factor,
            original_context,
        } => {
            let wavelength = 2.0 * PI / frequency;
            if wavelength > original_context / low_freq_factor {
                frequency / factor
            } else if wavelength < original_context / high_freq_factor {
                frequency
            } else {
                let smooth = (original_context / wavelength - low_freq_factor)
                    / (high_freq_factor - low_freq_factor);
                (1.0 - smooth) * frequency / factor + smooth * frequency
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rope(theta: f64, scaling: RopeScaling) -> Rope {
        Rope {
            theta,
            scaling,
            sections: None,
        }
    }

    const LLAMA3: RopeScaling = RopeScaling::Llama3 {
        factor: 8.0,
        low_freq_factor: 1.0,
        high_freq_factor: 4.0,
        original_context: 8192.0,
    };

    fn assert_near(found: &[f32], expected: &[f64]) {
        assert_eq!(found.len(), expected.len());
        for (found, expected) in found.iter().zip(expected) {
            assert!(
                (f64::from(*found) / expected - 1.0).abs() < 1e-6,
                "{found} instead of {expected}"
            );
        }
    }

    #[test]
    fn frequencies_fall_from_one_by_the_base() {
        let found = frequencies(&rope(10_000.0, RopeScaling::None), 8);
        assert_near(&found, &[1.0, 0.1, 0.01, 0.001]);
    }

    #[test]
    fn llama3_keeps_high_and_divides_low_frequencies() {
        assert!((scaled(1.0, LLAMA3) - 1.0).abs() < 1e-12);
        assert!((scaled(1e-5, LLAMA3) - 1.25e-6).abs() < 1e-12);
        // torch: _compute_llama3_parameters at wavelength 4096: smooth = (2 - 1) / 3.
        let middle = 2.0 * PI / 4096.0;
        let expected = middle * (2.0 / 3.0 / 8.0 + 1.0 / 3.0);
        assert!((scaled(middle, LLAMA3) - expected).abs() < 1e-12);
    }

    #[test]
    fn factors_of_frequencies_are_those_of_the_configuration() {
        let factors = frequency_factors(&rope(500_000.0, LLAMA3), 128).unwrap();
        assert!(
            (factors[0] - 1.0).abs() < 1e-6 && (factors[63] - 8.0).abs() < 1e-4,
            "{factors:?}"
        );
        assert!(frequency_factors(&rope(500_000.0, RopeScaling::None), 128).is_none());
    }

    const YARN: Yarn = Yarn {
        factor: 4.0,
        original_context: 64.0,
        beta_fast: 32.0,
        beta_slow: 1.0,
        truncate: true,
        attention: 1.0,
    };

    #[test]
    fn yarn_keeps_high_and_divides_low_frequencies() {
        // By hand: borders at 8 ln(64 / 64 pi) / ln 1e8 and 8 ln(64 / 2 pi) / ln 1e8, -0.50 and
        // 1.008, so from pair 0 to pair 2.
        let found = frequencies(&rope(10_000.0, RopeScaling::Yarn(YARN)), 8);
        assert_near(&found, &[1.0, 0.1 * (0.5 + 0.5 / 4.0), 0.0025, 0.000_25]);
        let exact = Yarn {
            truncate: false,
            ..YARN
        };
        let found = frequencies(&rope(10_000.0, RopeScaling::Yarn(exact)), 8);
        let divided = 1.0 / (8.0 * (64.0 / (2.0 * PI)).ln() / (2.0 * 10_000_f64.ln()));
        assert_near(
            &found,
            &[1.0, 0.1 * (1.0 - divided + divided / 4.0), 0.0025, 0.000_25],
        );
    }

    #[test]
    fn yarn_advises_a_factor_of_attention() {
        assert!((Yarn::advised_attention(4.0, 1.0) - 1.138_629_436_111_989).abs() < 1e-12);
        assert!((Yarn::advised_attention(0.5, 1.0) - 1.0).abs() < 1e-12);
        assert!((Yarn::advised_attention(4.0, 0.5) - 1.069_314_718_055_994).abs() < 1e-12);
    }

    #[test]
    fn a_dynamic_base_grows_behind_the_context() {
        let dynamic = rope(
            10_000.0,
            RopeScaling::Dynamic {
                factor: 2.0,
                original_context: 32.0,
            },
        );
        let base = |length| extended(&dynamic, 8, length).theta;
        assert!((base(20) - 10_000.0).abs() < 1e-6);
        assert!((base(32) - 10_000.0).abs() < 1e-6);
        // 2 * 48 / 32 - 1 = 2, to the power of 8 / 6.
        assert!((base(48) - 10_000.0 * 2_f64.powf(4.0 / 3.0)).abs() < 1e-6);
    }
}
