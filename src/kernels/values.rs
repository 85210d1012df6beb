//! Access to the numbers of a tensor without a copy.

use candle_core::{Result, Storage, Tensor, bail};
use rayon::prelude::*;
use std::mem::MaybeUninit;

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

/// As [`with_values`], of a tensor that may be absent.
pub(crate) fn with_optional<T>(
    tensor: Option<&Tensor>,
    read: impl FnOnce(Option<&[f32]>) -> Result<T>,
) -> Result<T> {
    match tensor {
        Some(tensor) => with_values(tensor, |values| read(Some(values))),
        None => read(None),
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
        let count = values.len() / inputs * outputs;
        let out = if count < 2 * TASK_NUMBERS {
            let mut out = vec![0f32; count];
            apply(&mut out, values);
            out
        } else {
            let rows = (TASK_NUMBERS / outputs).max(1);
            in_parts(count, rows * outputs, |part, out| {
                let first = part * rows * inputs;
                apply(out, &values[first..first + out.len() / outputs * inputs]);
            })
        };
        Tensor::from_vec(out, shape, x.device())
    })
}

/// Clamps numbers to a least and a greatest one; where the first is above the second, to the second.
/// NaN stays, so that the result shows it.
#[inline(always)]
#[allow(
    clippy::inline_always,
    reason = "kernels must be inlined into the functions that enable the instructions"
)]
pub(crate) fn clamp(values: &mut [f32], [least, greatest]: [f32; 2]) {
    for value in values {
        let raised = if *value < least { least } else { *value };
        *value = if raised > greatest { greatest } else { raised };
    }
}

/// As [`row_by_row`], of two tensors whose rows have as many numbers as the rows to write.
pub(crate) fn both_row_by_row(
    a: &Tensor,
    b: &Tensor,
    width: usize,
    apply: impl Fn(&mut [f32], &[f32], &[f32]) + Sync,
) -> Result<Tensor> {
    if a.dims() != b.dims() || a.dims().last() != Some(&width) || width == 0 {
        bail!(
            "expected rows of {width} numbers, found {:?} and {:?}",
            a.shape(),
            b.shape()
        );
    }
    with_values(a, |first| {
        with_values(b, |second| {
            let part = (TASK_NUMBERS / width).max(1) * width;
            let out = in_parts(first.len(), part, |index, out| {
                let numbers = index * part..index * part + out.len();
                apply(out, &first[numbers.clone()], &second[numbers]);
            });
            Tensor::from_vec(out, a.dims(), a.device())
        })
    })
}

/// `count` numbers that the threads fill in parts of `part`. `fill` takes the index of a part and
/// the part, which its thread has set to zeros. One thread that zeroed everything first would take
/// as long as a whole norm or activation.
#[allow(unsafe_code, reason = "all parts are written before they are read")]
pub(crate) fn in_parts<T: Copy + Default + Send>(
    count: usize,
    part: usize,
    fill: impl Fn(usize, &mut [T]) + Sync,
) -> Vec<T> {
    let mut numbers = Vec::with_capacity(count);
    let parts = numbers.spare_capacity_mut()[..count].par_chunks_mut(part.max(1));
    parts.enumerate().for_each(|(index, part)| {
        part.fill(MaybeUninit::new(T::default()));
        // SAFETY: the line above has written all of them.
        fill(index, unsafe { part.assume_init_mut() });
    });
    // SAFETY: each part is written.
    unsafe { numbers.set_len(count) };
    numbers
}
