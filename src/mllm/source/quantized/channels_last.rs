//! Kernels of convolutions as MLX stores them: the channels behind rows and columns.

use super::table::Part;
use crate::MllmError;
use crate::checkpoint::{TensorPlace, TensorSource};
use std::path::Path;

/// Channels of a picture.
const CHANNELS: usize = 3;

/// The kernel of a patch embedding, read with its channels in the second place, as the folders of
/// transformers have them.
#[derive(Debug)]
pub(super) struct ChannelsLast(Part);

impl ChannelsLast {
    /// The kernel that a tensor is, if it has its channels behind square patches.
    pub(super) fn find(part: &Part) -> Option<Self> {
        let is_kernel = match part.shape() {
            &[_, rows, columns, channels] | &[_, _, rows, columns, channels] => {
                rows == columns && channels == CHANNELS
            }
            _ => false,
        };
        let before = part.shape().get(1) != Some(&CHANNELS);
        (is_kernel && before).then(|| Self(part.clone()))
    }

    /// Its place with the channels moved.
    pub(super) fn place(&self) -> Result<TensorPlace, MllmError> {
        let mut place = self.0.tensor.plain(self.0.file.path())?;
        place.shape[1..].rotate_right(1);
        Ok(place)
    }
}

impl TensorSource for ChannelsLast {
    fn path(&self) -> &Path {
        self.0.file.path()
    }

    fn bytes(&self, place: &TensorPlace) -> Result<Vec<u8>, MllmError> {
        let bytes = self.0.bytes()?;
        let outputs = place.shape.first().copied().unwrap_or(1);
        let places = place.shape.iter().skip(2).product::<usize>();
        Ok(moved(&bytes, outputs, places))
    }

    /// The file that it lies in is a source of its own.
    fn hash(&self, _: &mut blake3::Hasher) -> Result<(), MllmError> {
        Ok(())
    }
}

/// Moves the channels of [outputs, places, channels] before the places.
fn moved(bytes: &[u8], outputs: usize, places: usize) -> Vec<u8> {
    let width = bytes.len() / (outputs * places * CHANNELS).max(1);
    let mut out = Vec::with_capacity(bytes.len());
    for output in bytes.chunks_exact((places * CHANNELS * width).max(1)) {
        for channel in 0..CHANNELS {
            for place in output.chunks_exact((CHANNELS * width).max(1)) {
                out.extend_from_slice(&place[channel * width..(channel + 1) * width]);
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn channels_are_moved_before_the_places() {
        let bytes: Vec<u8> = (0..12).collect();
        assert_eq!(moved(&bytes, 1, 2), [0, 1, 6, 7, 2, 3, 8, 9, 4, 5, 10, 11]);
        assert_eq!(moved(&bytes, 2, 2), [0, 3, 1, 4, 2, 5, 6, 9, 7, 10, 8, 11]);
    }
}
