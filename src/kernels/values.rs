//! Access to the numbers of a tensor without a copy.

use candle_core::{Result, Storage, Tensor, bail};
use rayon::prelude::*;

/// Numbers that a thread computes at once in elementwise work. Twice as many are worth waking other
/// threads for.
pub(crate) const TASK_NUMBERS: usize = 1 << 15;

/// Runs `read` on the row-major numbers of a contiguous f32 tensor on the CPU, without a copy.
pub(crate) fn with_contiguous<T>(
    tensor: &Tensor,
    read: impl FnOnce(&[f32]) -> Result<T>,
) -> Result<T> {
    let (storage, layout) = tensor.storage_and_layout();
    let (Storage::Cpu(storage), Some((start, end))) = (&*storage, layout.contiguous_offsets())
    else {
        bail!("the tensor is not contiguous, or not on the CPU");
    };
    match storage.as_slice::<f32>()?.get(start..end) {
        Some(values) => read(values),
        None => bail!("the tensor extends beyond its storage"),
    }
}

/// Runs `read` on the row-major numbers of an f32 tensor, which is copied if it is not contiguous.
pub fn with_values<T>(tensor: &Tensor, read: impl FnOnce(&[f32]) -> Result<T>) -> Result<T> {
    with_contiguous(&tensor.contiguous()?, read)
}

/// Maps rows of `inputs` numbers, the last dimension of an f32 tensor, to rows of `outputs`
/// numbers, on all threads where that pays. `apply` takes the rows to write and as many rows to
/// read.
pub(crate) fn row_by_row(
    x: &Tensor,
    inputs: usize,
    outputs: usize,
    apply: impl Fn(&mut [f32], &[f32]) + Sync,
) -> Result<Tensor> {
    let mut shape = x.dims().to_vec();
    match shape.last_mut() {
        Some(width) if *width == inputs && inputs > 0 => *width = outputs,
        _ => bail!("expected rows of {inputs} numbers, found {:?}", x.shape()),
    }
    with_values(x, |values| {
        let mut out = vec![0f32; values.len() / inputs * outputs];
        if out.len() < 2 * TASK_NUMBERS {
            apply(&mut out, values);
        } else {
            let rows = (TASK_NUMBERS / outputs).max(1);
            out.par_chunks_mut(rows * outputs)
                .zip(values.par_chunks(rows * inputs))
                .for_each(|(out, x)| apply(out, x));
        }
        Tensor::from_vec(out, shape, x.device())
    })
}
