//! The header of a safetensors file.

use std::io::Read;
use std::path::Path;

use candle_core::quantized::GgmlDType;
use safetensors::Dtype;
use safetensors::tensor::Metadata;

use super::weight_file::TensorPlace;
use crate::mllm::MllmError;

/// Longest header, bytes (the format's own limit).
const MAX_HEADER: u64 = 100_000_000;
/// Bytes of the number that says how long the header is.
const LENGTH: u64 = 8;

/// Reads the header at the beginning of a file of `file_bytes` bytes: the tensors by their names in the file.
///
/// # Errors
/// When it is broken, its tensors do not fill the file exactly, or one is in a number format that is not read.
pub(super) fn read_header(
    path: &Path,
    source: &mut dyn Read,
    file_bytes: u64,
) -> Result<Vec<(String, TensorPlace)>, MllmError> {
    let broken = |problem: String| MllmError::Safetensors { path: path.to_path_buf(), problem };
    let failed = |error: std::io::Error| broken(format!("the header cannot be read: {error}"));
    let mut length = [0; LENGTH as usize];
    source.read_exact(&mut length).map_err(failed)?;
    let length = u64::from_le_bytes(length);
    if length > MAX_HEADER || length + LENGTH > file_bytes {
        return Err(broken(format!("a header of {length} bytes is announced in a file of {file_bytes}")));
    }
    let mut header = vec![0; length as usize];
    source.read_exact(&mut header).map_err(failed)?;
    let metadata: Metadata = serde_json::from_slice(&header).map_err(|error| broken(error.to_string()))?;
    let data = metadata.data_len() as u64;
    if (LENGTH + length).checked_add(data) != Some(file_bytes) {
        return Err(broken(format!(
            "its tensors take {data} bytes behind a header of {length}, but the file has {file_bytes}: it is truncated or \
             goes on behind its end"
        )));
    }
    let place = |(name, info): (String, &safetensors::tensor::TensorInfo)| {
        let (begin, end) = info.data_offsets;
        let format = match info.dtype {
            Dtype::F32 => GgmlDType::F32,
            Dtype::F16 => GgmlDType::F16,
            Dtype::BF16 => GgmlDType::BF16,
            other => {
                let found = format!("{other:?}");
                return Err(MllmError::TensorType { path: path.to_path_buf(), name, found });
            }
        };
        let place = TensorPlace {
            format,
            shape: info.shape.clone(),
            begin: LENGTH + length + begin as u64,
            bytes: (end - begin) as u64,
        };
        Ok((name, place))
    };
    metadata
        .tensors()
        .into_iter()
        // Buffers that are no weights may be of any type.
        .filter(|(name, _)| !super::weights::is_buffer(name))
        .map(place)
        .collect()
}
