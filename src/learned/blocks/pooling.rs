//! Maxima over the rows of groups.

use candle_core::{Result, Tensor, bail};
use planagent_kernels::values::with_values;
use rayon::prelude::*;

/// Numbers for which other threads are worth waking.
const MIN_PARALLEL: usize = 1 << 16;

/// The largest numbers of each group (…, rows, width), column by column: (…, width).
pub(crate) fn largest(x: &Tensor) -> Result<Tensor> {
    pooled(x, |_| None)
}

/// As [`largest`], where a row counts as `hidden` if its mask (…, rows) is 0.
pub(crate) fn largest_where(x: &Tensor, mask: &Tensor, hidden: f32) -> Result<Tensor> {
    let mask = mask.flatten_all()?.to_vec1::<u8>()?;
    pooled(x, |row| {
        (mask.get(row).copied() == Some(0)).then_some(hidden)
    })
}

/// `counts_as` says what the numbers of a row count as, if not as themselves.
fn pooled(x: &Tensor, counts_as: impl Fn(usize) -> Option<f32> + Sync) -> Result<Tensor> {
    let &[ref outer @ .., rows, width] = x.dims() else {
        bail!("expected groups of rows, found {:?}", x.shape())
    };
    let shape = [outer, &[width]].concat();
    if rows * width == 0 {
        bail!("groups of {rows} rows of {width} numbers have no largest");
    }
    with_values(x, |values| {
        let mut out = vec![f32::NEG_INFINITY; values.len() / rows];
        let pool = |(group, (out, values)): (usize, (&mut [f32], &[f32]))| {
            for (row, values) in values.chunks_exact(width).enumerate() {
                match counts_as(group * rows + row) {
                    Some(hidden) => out.iter_mut().for_each(|out| *out = out.max(hidden)),
                    None => out
                        .iter_mut()
                        .zip(values)
                        .for_each(|(out, value)| *out = if *value > *out { *value } else { *out }),
                }
            }
        };
        // Few numbers are done before other threads have started.
        if values.len() < MIN_PARALLEL {
            out.chunks_exact_mut(width)
                .zip(values.chunks_exact(rows * width))
                .enumerate()
                .for_each(pool);
        } else {
            out.par_chunks_exact_mut(width)
                .zip(values.par_chunks_exact(rows * width))
                .enumerate()
                .for_each(pool);
        }
        Tensor::from_vec(out, shape, x.device())
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use candle_core::Device;

    fn scattered(shape: &[usize]) -> Tensor {
        let count: usize = shape.iter().product();
        let values: Vec<f32> = (0..count)
            .map(|i| ((i * 7919) % 1009) as f32 - 504.0)
            .collect();
        Tensor::from_vec(values, shape, &Device::Cpu).unwrap()
    }

    #[test]
    fn largest_is_the_maximum_that_candle_finds() {
        for shape in [&[3, 5, 7][..], &[2, 40, 20, 64]] {
            let x = scattered(shape);
            let found = largest(&x).unwrap();
            let expected = x.max(shape.len() - 2).unwrap();
            assert_eq!(found.dims(), expected.dims());
            assert_eq!(
                found.flatten_all().unwrap().to_vec1::<f32>().unwrap(),
                expected.flatten_all().unwrap().to_vec1::<f32>().unwrap()
            );
        }
        assert!(largest(&scattered(&[2, 0, 3])).is_err());
    }

    #[test]
    fn hidden_rows_count_as_what_is_given() {
        let x = Tensor::new(
            &[[[1f32, -3.0], [5.0, 5.0]], [[-1.0, -2.0], [9.0, 9.0]]],
            &Device::Cpu,
        )
        .unwrap();
        let mask = Tensor::new(&[[1u8, 1], [1, 0]], &Device::Cpu).unwrap();
        let of = |hidden| {
            largest_where(&x, &mask, hidden)
                .unwrap()
                .to_vec2::<f32>()
                .unwrap()
        };
        assert_eq!(of(0.0), [[5.0, 5.0], [0.0, 0.0]]);
        assert_eq!(of(f32::NEG_INFINITY), [[5.0, 5.0], [-1.0, -2.0]]);
    }
}
