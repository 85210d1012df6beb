//! The Savitzky-Golay filter as scipy 1.9.1 computes it with `mode='interp'`, even windows
//! included.

use crate::metrics::MetricError;
use nalgebra::{DMatrix, RowDVector};
use planagent_world::{EgoState, MICROS_PER_SECOND};

/// A local polynomial fit, evaluated (or its derivative) at every sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct SavitzkyGolay {
    /// Samples in a fit; a shorter sequence is fitted as a whole.
    pub window: usize,
    /// Degree of the polynomial; must be less than the window and than the number of samples.
    pub order: usize,
    /// Which derivative: 0 smooths.
    pub derivative: usize,
}

impl SavitzkyGolay {
    /// Filters equally spaced values, `step` apart. The first and last half windows come from the
    /// fit to the first and last window; inside, an even window of size w around sample i spans i −
    /// w/2 + 1 … i + w/2 and is evaluated in its middle, half a sample late: scipy's behavior, on
    /// which nuPlan's accelerations rest.
    pub fn apply(&self, values: &[f64], step: f64) -> Result<Vec<f64>, MetricError> {
        let n = values.len();
        let window = self.window.min(n);
        let too_few = || MetricError::TooFewSamples {
            got: n,
            needed: self.order + 1,
        };
        let fit = Fit::new(window, self.order).ok_or_else(too_few)?;
        let half = window / 2;
        let middle = (window as f64 - 1.0) / 2.0;
        let inside = fit.weights(middle, self.derivative, step);
        let filtered = (0..n).map(|i| {
            if i < half {
                return fit.weights(i as f64, self.derivative, step).dot(values);
            }
            if i >= n - half {
                let start = n - window;
                return fit
                    .weights((i - start) as f64, self.derivative, step)
                    .dot(&values[start..]);
            }
            let start = i + 1 - window.div_ceil(2);
            inside.dot(&values[start..start + window])
        });
        Ok(filtered.collect())
    }
}

/// Least-squares polynomial fits to `window` equally spaced samples: the coefficients as linear
/// functions of the samples.
struct Fit {
    /// Coefficients by samples, for abscissas scaled to [−1, 1].
    solver: DMatrix<f64>,
    middle: f64,
    scale: f64,
}

impl Fit {
    fn new(window: usize, order: usize) -> Option<Self> {
        if order >= window {
            return None;
        }
        let middle = (window as f64 - 1.0) / 2.0;
        let scale = middle.max(1.0);
        let powers = DMatrix::from_fn(window, order + 1, |k, j| {
            ((k as f64 - middle) / scale).powi(j as i32)
        });
        let decomposed = powers.qr();
        let solver = decomposed
            .r()
            .solve_upper_triangular(&decomposed.q().transpose())?;
        Some(Self {
            solver,
            middle,
            scale,
        })
    }

    /// Weights of the samples in the derivative of the fit at a position counted in samples from
    /// the first of the window.
    fn weights(&self, position: f64, derivative: usize, step: f64) -> Weights {
        let x = (position - self.middle) / self.scale;
        let basis = RowDVector::from_fn(self.solver.nrows(), |_, j| {
            if j < derivative {
                return 0.0;
            }
            let factors: f64 = (j - derivative + 1..=j).map(|f| f as f64).product();
            factors * x.powi((j - derivative) as i32) / (self.scale * step).powi(derivative as i32)
        });
        Weights(basis * &self.solver)
    }
}

struct Weights(RowDVector<f64>);

impl Weights {
    fn dot(&self, values: &[f64]) -> f64 {
        self.0.iter().zip(values).map(|(w, v)| w * v).sum()
    }
}

/// Values rounded to 8 decimals, halves to even, as nuPlan rounds every filtered signal.
fn rounded(values: Vec<f64>) -> Vec<f64> {
    /// 8 decimals.
    const SCALE: f64 = 1e8;
    values
        .into_iter()
        .map(|v| (v * SCALE).round_ties_even() / SCALE)
        .collect()
}

/// A smoothed signal: order 2, `window` samples, rounded to 8 decimals.
pub(crate) fn smoothed(values: &[f64], window: usize) -> Result<Vec<f64>, MetricError> {
    SavitzkyGolay {
        window,
        order: 2,
        derivative: 0,
    }
    .apply(values, 1.0)
    .map(rounded)
}

/// A filtered derivative of a signal sampled every `step` seconds, rounded to 8 decimals.
pub(crate) fn differentiated(
    values: &[f64],
    step: f64,
    filter: SavitzkyGolay,
) -> Result<Vec<f64>, MetricError> {
    filter.apply(values, step).map(rounded)
}

/// Mean time between states, seconds; 0 for fewer than two. As nuPlan, it turns the times into
/// seconds before it takes their difference: with times since 1970 that rounds the step in the
/// tenth decimal, which shows in the eighth of a jerk.
pub(crate) fn mean_step_s(states: &[EgoState]) -> f64 {
    let seconds = |state: &EgoState| state.time_us as f64 / MICROS_PER_SECOND;
    match states {
        [first, .., last] => (seconds(last) - seconds(first)) / (states.len() - 1) as f64,
        _ => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_even_window_has_scipys_coefficients() {
        // (−3, 3, 7, 9, 9, 7, 3, −3)/32 over samples i−3 … i+4.
        let mut impulse = vec![0.0; 20];
        impulse[10] = 32.0;
        let filtered = SavitzkyGolay {
            window: 8,
            order: 2,
            derivative: 0,
        }
        .apply(&impulse, 1.0)
        .unwrap();
        let expected = [-3.0, 3.0, 7.0, 9.0, 9.0, 7.0, 3.0, -3.0];
        for (k, value) in expected.iter().enumerate() {
            assert!(
                (filtered[6 + k] - value).abs() < 1e-12,
                "{k}: {}",
                filtered[6 + k]
            );
        }
    }

    #[test]
    fn derivatives_of_a_parabola_are_exact() {
        let values: Vec<f64> = (0..30)
            .map(|i| 1.5 * (f64::from(i) * 0.1).powi(2))
            .collect();
        let slope = SavitzkyGolay {
            window: 5,
            order: 2,
            derivative: 1,
        }
        .apply(&values, 0.1)
        .unwrap();
        let bend = SavitzkyGolay {
            window: 5,
            order: 3,
            derivative: 2,
        }
        .apply(&values, 0.1)
        .unwrap();
        for i in 0..30 {
            assert!((slope[i] - 3.0 * i as f64 * 0.1).abs() < 1e-9);
            assert!((bend[i] - 3.0).abs() < 1e-8);
        }
    }

    #[test]
    fn too_short_a_sequence_is_an_error() {
        let filter = SavitzkyGolay {
            window: 5,
            order: 3,
            derivative: 2,
        };
        assert_eq!(
            filter.apply(&[1.0, 2.0, 3.0], 0.1),
            Err(MetricError::TooFewSamples { got: 3, needed: 4 })
        );
        assert!(filter.apply(&[1.0, 2.0, 3.0, 4.0], 0.1).is_ok());
    }
}
