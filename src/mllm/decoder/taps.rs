//! A causal convolution of each channel over the last positions.

use super::recurrence::Recurrence;
use crate::MllmError;
use crate::checkpoint::Weights;

/// The weights of a convolution of each channel by itself over its last values. The last tap is
/// that of the present.
#[derive(Debug)]
pub(super) struct Taps {
    channels: usize,
    /// (taps, channels)
    weights: Vec<f32>,
    bias: Option<Vec<f32>>,
}

impl Taps {
    /// Takes a tensor of shape (channels, 1, taps); in GGUF files it has no side of 1.
    pub(super) fn take(
        weights: &mut Weights,
        name: &str,
        channels: usize,
        taps: usize,
        bias: bool,
    ) -> Result<Self, MllmError> {
        let shape = [channels, 1, taps];
        let stored: Vec<f32> = weights
            .take_of_any_rank(&format!("{name}.weight"), &shape)?
            .flatten_all()?
            .to_vec1()?;
        let tap = |tap: usize| stored.iter().skip(tap).step_by(taps).copied();
        let bias = bias
            .then(|| weights.take(&format!("{name}.bias"), &[channels]))
            .transpose()?
            .map(|bias| bias.to_vec1())
            .transpose()?;
        Ok(Self {
            channels,
            weights: (0..taps).flat_map(tap).collect(),
            bias,
        })
    }

    /// Convolves a row with the `earlier` ones, which it joins: (taps - 1, channels).
    pub(super) fn step(&self, earlier: &mut [f32], row: &[f32], out: &mut [f32]) {
        match &self.bias {
            Some(bias) => out.copy_from_slice(bias),
            None => out.fill(0.0),
        }
        let rows = earlier.chunks_exact(self.channels).chain([row]);
        for (row, weights) in rows.zip(self.weights.chunks_exact(self.channels)) {
            for ((out, value), weight) in out.iter_mut().zip(row).zip(weights) {
                *out += value * weight;
            }
        }
        if let Some(last) = earlier.len().checked_sub(self.channels) {
            earlier.copy_within(self.channels.., 0);
            if let Some(last) = earlier.get_mut(last..) {
                last.copy_from_slice(row);
            }
        }
    }

    /// Numbers of the rows that it keeps.
    pub(super) fn state_numbers(&self) -> usize {
        self.weights.len().saturating_sub(self.channels)
    }
}

impl Recurrence for Taps {
    fn state(&self) -> usize {
        self.state_numbers()
    }

    fn row(&self) -> usize {
        self.channels
    }

    fn out(&self) -> usize {
        self.channels
    }

    fn run(&self, state: &mut [f32], rows: &[f32], out: &mut [f32]) {
        let rows = rows.chunks_exact(self.channels);
        for (row, out) in rows.zip(out.chunks_exact_mut(self.channels)) {
            self.step(state, row, out);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_last_tap_is_that_of_the_present() {
        let taps = Taps {
            channels: 2,
            weights: vec![1.0, 10.0, 2.0, 20.0, 3.0, 30.0],
            bias: Some(vec![0.5, 0.0]),
        };
        let rows = [1.0, 1.0, 0.0, 0.0, 0.0, 2.0, 0.0, 0.0];
        let (mut state, mut out) = (vec![0.0; taps.state()], [0.0; 8]);
        taps.run(&mut state, &rows, &mut out);
        assert_eq!(out.to_vec(), [3.5, 30.0, 2.5, 20.0, 1.5, 70.0, 0.5, 40.0]);
        assert_eq!(state, [0.0, 2.0, 0.0, 0.0]);
    }

    #[test]
    fn one_tap_keeps_nothing() {
        let taps = Taps {
            channels: 2,
            weights: vec![2.0, 3.0],
            bias: None,
        };
        let mut out = [0.0; 4];
        assert_eq!(taps.state(), 0);
        taps.run(&mut [], &[1.0, 2.0, 3.0, 4.0], &mut out);
        assert_eq!(out.to_vec(), [2.0, 6.0, 6.0, 12.0]);
    }
}
