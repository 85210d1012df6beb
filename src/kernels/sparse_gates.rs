//! Gates of which only the largest of a row count.

use super::values::row_by_row;
use candle_core::{D, Result, Tensor, bail};

/// Lowers the gates of rows (gate, value) by a cutoff, and those below it to 0; values stay.
/// Shape (tokens, 2 · width). The cutoff of a row is the mean of its gates and so many of their
/// standard deviations (`_gaussian_topk` in transformers, which divides by the width).
///
/// # Errors
/// When the rows have an odd width.
pub fn above_cutoff(gate_up: &Tensor, deviations: f32) -> Result<Tensor> {
    let both = gate_up.dim(D::Minus1)?;
    if both % 2 == 1 {
        bail!("rows of {both} numbers do not split into gates and values of equal width");
    }
    row_by_row(gate_up, both, both, |out, rows| {
        let rows = rows.chunks_exact(both);
        for (out, row) in out.chunks_exact_mut(both).zip(rows) {
            out.copy_from_slice(row);
            let (gates, _) = out.split_at_mut(both / 2);
            lower(gates, deviations);
        }
    })
}

fn lower(gates: &mut [f32], deviations: f32) {
    let count = gates.len() as f64;
    let mean = gates.iter().map(|gate| f64::from(*gate)).sum::<f64>() / count;
    let square = |gate: &f32| (f64::from(*gate) - mean).powi(2);
    let deviation = (gates.iter().map(square).sum::<f64>() / count).sqrt();
    let cutoff = (mean + deviation * f64::from(deviations)) as f32;
    for gate in gates {
        *gate = (*gate - cutoff).max(0.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::Device;

    #[test]
    fn gates_are_lowered_by_mean_and_deviations_and_values_stay() {
        // Mean 2, deviation 2 of the first row; of the second, 0 and 3.
        let rows = [
            0.0_f32, 4.0, 0.0, 4.0, 9.0, -9.0, 1.0, 0.5, 3.0, -3.0, -3.0, 3.0, 1.0, 2.0, 3.0, 4.0,
        ];
        let rows = Tensor::from_slice(&rows, (2, 8), &Device::Cpu).unwrap();
        let found = above_cutoff(&rows, 0.5).unwrap().flatten_all().unwrap();
        assert_eq!(
            found.to_vec1::<f32>().unwrap(),
            [
                0.0, 1.0, 0.0, 1.0, 9.0, -9.0, 1.0, 0.5, 1.5, 0.0, 0.0, 1.5, 1.0, 2.0, 3.0, 4.0
            ]
        );
        let odd = Tensor::zeros((1, 3), candle_core::DType::F32, &Device::Cpu).unwrap();
        assert!(above_cutoff(&odd, 0.5).is_err());
    }
}
