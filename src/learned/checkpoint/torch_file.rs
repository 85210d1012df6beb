//! PyTorch's files: a ZIP archive with a pickle of the structure and one file for the numbers of
//! each storage.

use super::pickle::{Element, Pickle, PickleError, TensorPlace};
use candle_core::{Device, Tensor};
use half::{bf16, f16};
use std::collections::BTreeMap;
use std::io::{Cursor, Read};
use std::rc::Rc;
use zip::ZipArchive;
use zip::result::ZipError;

/// Largest structure that is read, bytes; that of a Lightning checkpoint has less than one.
const MAX_PICKLE_BYTES: u64 = 64 << 20;
/// Maximum number of elements in all tensors: ten times those of the largest model.
const MAX_NUMBERS: usize = 1 << 28;
/// Name of the structure below the archive's one folder.
const PICKLE: &str = "/data.pkl";

/// Why a file gives no tensors.
#[derive(Debug, thiserror::Error)]
pub(super) enum TorchFileError {
    #[error("its archive is broken: {0}")]
    Zip(#[from] ZipError),
    #[error("it is an archive without data.pkl")]
    NoPickle,
    #[error("its entry {name} has {bytes} bytes; at most {max_bytes} are read")]
    TooLarge {
        name: String,
        bytes: u64,
        max_bytes: u64,
    },
    #[error("its archive cannot be read: {0}")]
    Read(#[from] std::io::Error),
    #[error("its data.pkl {0}")]
    Pickle(#[from] PickleError),
    #[error("its tensor {0} lies outside its storage")]
    OutsideStorage(String),
    #[error("its tensors hold more than {MAX_NUMBERS} numbers")]
    TooManyNumbers,
    #[error("its tensor {name} cannot be made: {source}")]
    Tensor {
        name: String,
        source: candle_core::Error,
    },
}

/// All tensors of the state dictionary.
pub(super) fn tensors(bytes: &[u8]) -> Result<BTreeMap<String, Tensor>, TorchFileError> {
    let mut archive = ZipArchive::new(Cursor::new(bytes))?;
    let entry = (0..archive.len()).find_map(|i| {
        let name = archive.by_index_raw(i).ok()?.name().ok()?.into_owned();
        name.ends_with(PICKLE).then_some(name)
    });
    let entry = entry.ok_or(TorchFileError::NoPickle)?;
    let folder = entry
        .strip_suffix(PICKLE)
        .expect("the entry was found by this ending")
        .to_owned();
    let structure = read(&mut archive, &entry, MAX_PICKLE_BYTES)?;
    let mut storages: BTreeMap<Rc<str>, Vec<u8>> = BTreeMap::new();
    let mut left = bytes.len() as u64;
    let (mut tensors, mut numbers) = (BTreeMap::new(), 0usize);
    for (name, place) in Pickle::read(&structure)?.state() {
        numbers = place
            .count()
            .and_then(|count| numbers.checked_add(count))
            .ok_or(TorchFileError::TooManyNumbers)?;
        if numbers > MAX_NUMBERS {
            return Err(TorchFileError::TooManyNumbers);
        }
        if !storages.contains_key(&place.storage) {
            // Storages lie side by side; those that share bytes could fill the memory.
            let stored = read(
                &mut archive,
                &format!("{folder}/data/{}", place.storage),
                left,
            )?;
            left -= stored.len() as u64;
            storages.insert(place.storage.clone(), stored);
        }
        let stored = storages
            .get(&place.storage)
            .map(Vec::as_slice)
            .expect("the storage was read above");
        let values =
            values(stored, &place).ok_or_else(|| TorchFileError::OutsideStorage(name.clone()))?;
        let tensor = Tensor::from_vec(values, place.shape.as_slice(), &Device::Cpu);
        let tensor = tensor.map_err(|source| TorchFileError::Tensor {
            name: name.clone(),
            source,
        })?;
        tensors.insert(name, tensor);
    }
    Ok(tensors)
}

fn read(
    archive: &mut ZipArchive<Cursor<&[u8]>>,
    name: &str,
    max_bytes: u64,
) -> Result<Vec<u8>, TorchFileError> {
    let entry = archive.by_name(name)?;
    if entry.size() > max_bytes {
        return Err(TorchFileError::TooLarge {
            name: name.to_owned(),
            bytes: entry.size(),
            max_bytes,
        });
    }
    let mut bytes = Vec::new();
    entry.take(max_bytes).read_to_end(&mut bytes)?;
    Ok(bytes)
}

/// The numbers of a tensor in row-major order as f32; `None` where it reaches beyond its storage,
/// or has more numbers than it.
fn values(stored: &[u8], place: &TensorPlace) -> Option<Vec<f32>> {
    let size = place.element.bytes();
    let (count, available) = (place.count()?, stored.len() / size);
    if count > available {
        return None;
    }
    let mut values = Vec::with_capacity(count);
    let mut index = vec![0usize; place.shape.len()];
    for _ in 0..count {
        let mut at = place.offset;
        for (i, stride) in index.iter().zip(&place.strides) {
            at = at.checked_add(i.checked_mul(*stride)?)?;
        }
        if at >= available {
            return None;
        }
        values.push(number(
            stored.get(at * size..(at + 1) * size)?,
            place.element,
        )?);
        for (i, length) in index.iter_mut().zip(&place.shape).rev() {
            *i += 1;
            if *i < *length {
                break;
            }
            *i = 0;
        }
    }
    Some(values)
}

fn number(bytes: &[u8], element: Element) -> Option<f32> {
    Some(match element {
        Element::F32 => f32::from_le_bytes(bytes.try_into().ok()?),
        Element::F64 => f64::from_le_bytes(bytes.try_into().ok()?) as f32,
        Element::F16 => f16::from_le_bytes(bytes.try_into().ok()?).to_f32(),
        Element::Bf16 => bf16::from_le_bytes(bytes.try_into().ok()?).to_f32(),
        Element::I64 => i64::from_le_bytes(bytes.try_into().ok()?) as f32,
        Element::I32 => i32::from_le_bytes(bytes.try_into().ok()?) as f32,
        Element::U8 => f32::from(*bytes.first()?),
    })
}
