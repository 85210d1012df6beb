//! The numbers of a tensor, in place.

use candle_core::{Result, Storage, Tensor, bail};
use rayon::prelude::*;

/// Numbers that a thread takes at once in work that goes number by number, and half of what is worth waking other threads
/// for.
pub(crate) const PIECE: usize = 1 << 15;

/// Runs `read` on the numbers of an f32 tensor, row-major.
///
/// # Errors
/// When it holds other numbers, or what `read` returns.
pub(crate) fn with_values<T>(tensor: &Tensor, read: impl FnOnce(&[f32]) -> Result<T>) -> Result<T> {
    let tensor = tensor.contiguous()?;
    let (storage, layout) = tensor.storage_and_layout();
    let (Storage::Cpu(storage), Some((start, end))) = (&*storage, layout.contiguous_offsets()) else {
        bail!("a tensor that is not on the CPU");
    };
    match storage.as_slice::<f32>()?.get(start..end) {
        Some(values) => read(values),
        None => bail!("a tensor beyond its storage"),
    }
}

/// Makes a row of `outputs` numbers of each row of `inputs` numbers of an f32 tensor, whose last dimension they are, on all
/// threads where that pays. `apply` gets whole rows, any number of them, to write and to read.
///
/// # Errors
/// When the tensor's rows are of another width, or it holds other numbers.
pub(crate) fn row_by_row(
    x: &Tensor,
    inputs: usize,
    outputs: usize,
    apply: impl Fn(&mut [f32], &[f32]) + Sync,
) -> Result<Tensor> {
    let mut shape = x.dims().to_vec();
    match shape.last_mut() {
        Some(width) if *width == inputs && inputs > 0 => *width = outputs,
        _ => bail!("rows of {inputs} numbers are expected, found {:?}", x.shape()),
    }
    with_values(x, |values| {
        let mut out = vec![0f32; values.len() / inputs * outputs];
        if out.len() < 2 * PIECE {
            apply(&mut out, values);
        } else {
            let rows = (PIECE / outputs).max(1);
            out.par_chunks_mut(rows * outputs).zip(values.par_chunks(rows * inputs)).for_each(|(out, x)| apply(out, x));
        }
        Tensor::from_vec(out, shape, x.device())
    })
}
