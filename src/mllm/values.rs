//! The numbers of a tensor, in place.

use candle_core::{Result, Storage, Tensor, bail};

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
