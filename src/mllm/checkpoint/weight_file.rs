//! Weight files, read a tensor at a time.
//!
//! Files are read, not mapped: pages of a mapped file count as the program's own memory, and a file
//! that shrinks under a mapping ends the program.

use super::packed::{PackedBlocks, PackedForm};
use crate::MllmError;
use planagent_kernels::matrix::StoredFormat;
use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Where and how a tensor lies in a file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct TensorPlace {
    /// Number format of its blocks.
    pub format: StoredFormat,
    /// Shape, the slowest dimension first.
    pub shape: Vec<usize>,
    /// First byte in the file.
    pub begin: u64,
    /// Number of bytes.
    pub bytes: u64,
}

/// Where the bytes of tensors come from: a weight file, or a generator of random weights.
pub(crate) trait TensorSource: std::fmt::Debug + Send + Sync {
    /// What messages call it.
    fn path(&self) -> &Path;

    fn bytes(&self, place: &TensorPlace) -> Result<Vec<u8>, MllmError>;

    /// Whether [`Self::bytes`] also reads some of a tensor's bytes.
    fn reads_parts(&self) -> bool {
        false
    }

    /// How a quantizer packed a tensor; none for plain numbers. The bytes of a packed tensor are
    /// its numbers in f32.
    fn packed(&self, place: &TensorPlace) -> Option<&PackedForm> {
        let _ = place;
        None
    }

    /// A packed tensor as blocks of [`PackedForm::weight_format`], which holds it
    /// (but for the rounding of its scales).
    fn blocks(&self, place: &TensorPlace) -> Result<PackedBlocks, MllmError> {
        Ok(PackedBlocks {
            bytes: self.bytes(place)?,
            largest_error: 0.0,
        })
    }

    /// Adds its whole content to a hash.
    fn hash(&self, hasher: &mut blake3::Hasher) -> Result<(), MllmError>;
}

impl<S: TensorSource> TensorSource for Arc<S> {
    fn path(&self) -> &Path {
        (**self).path()
    }

    fn bytes(&self, place: &TensorPlace) -> Result<Vec<u8>, MllmError> {
        (**self).bytes(place)
    }

    fn reads_parts(&self) -> bool {
        (**self).reads_parts()
    }

    fn packed(&self, place: &TensorPlace) -> Option<&PackedForm> {
        (**self).packed(place)
    }

    fn blocks(&self, place: &TensorPlace) -> Result<PackedBlocks, MllmError> {
        (**self).blocks(place)
    }

    fn hash(&self, hasher: &mut blake3::Hasher) -> Result<(), MllmError> {
        (**self).hash(hasher)
    }
}

/// The beginning of a file that stands for another in a repository of git-lfs.
const LFS_POINTER: &[u8] = b"version https://git-lfs.github.com/spec/";

/// Whether a file is only a pointer of git-lfs.
pub(crate) fn is_lfs_pointer(bytes: &[u8]) -> bool {
    bytes.starts_with(LFS_POINTER)
}

#[derive(Debug)]
pub(crate) struct WeightFile {
    path: PathBuf,
    file: File,
    bytes: u64,
}

impl WeightFile {
    pub(crate) fn open(path: &Path) -> Result<Self, MllmError> {
        let failed = |source| MllmError::Read {
            path: path.to_path_buf(),
            source,
        };
        let file = planagent_files::open(path).map_err(failed)?;
        let bytes = file.metadata().map_err(failed)?.len();
        let file = Self {
            path: path.to_path_buf(),
            file,
            bytes,
        };
        let mut beginning = Vec::new();
        file.reader()?
            .take(LFS_POINTER.len() as u64)
            .read_to_end(&mut beginning)
            .map_err(failed)?;
        if is_lfs_pointer(&beginning) {
            return Err(MllmError::LfsPointer {
                path: path.to_path_buf(),
            });
        }
        Ok(file)
    }

    /// Its length, bytes.
    pub(crate) fn len(&self) -> u64 {
        self.bytes
    }

    /// Reads it from its beginning.
    pub(crate) fn reader(&self) -> Result<impl Read, MllmError> {
        self.seek(0)?;
        Ok(BufReader::with_capacity(1 << 20, &self.file))
    }

    /// Reads some of its bytes.
    pub(crate) fn part(&self, begin: u64, bytes: u64) -> Result<Vec<u8>, MllmError> {
        self.seek(begin)?;
        let mut part = vec![0; bytes as usize];
        (&self.file)
            .read_exact(&mut part)
            .map_err(|source| self.failed(source))?;
        Ok(part)
    }

    fn seek(&self, position: u64) -> Result<(), MllmError> {
        (&self.file)
            .seek(SeekFrom::Start(position))
            .map_err(|source| self.failed(source))?;
        Ok(())
    }

    fn failed(&self, source: io::Error) -> MllmError {
        MllmError::Read {
            path: self.path.clone(),
            source,
        }
    }
}

impl TensorSource for WeightFile {
    fn path(&self) -> &Path {
        &self.path
    }

    fn bytes(&self, place: &TensorPlace) -> Result<Vec<u8>, MllmError> {
        self.part(place.begin, place.bytes)
    }

    fn reads_parts(&self) -> bool {
        true
    }

    fn hash(&self, hasher: &mut blake3::Hasher) -> Result<(), MllmError> {
        self.seek(0)?;
        hasher
            .update_reader(&self.file)
            .map_err(|source| self.failed(source))?;
        Ok(())
    }
}

/// A tensor that no file of a model has.
#[derive(Debug)]
pub(crate) struct ComputedTensor {
    /// The model.
    pub place: PathBuf,
    pub bytes: Vec<u8>,
}

impl TensorSource for ComputedTensor {
    fn path(&self) -> &Path {
        &self.place
    }

    fn bytes(&self, _place: &TensorPlace) -> Result<Vec<u8>, MllmError> {
        Ok(self.bytes.clone())
    }

    fn hash(&self, hasher: &mut blake3::Hasher) -> Result<(), MllmError> {
        hasher.update(&self.bytes);
        Ok(())
    }
}

/// A shape with at most four dimensions, which GGUF allows: those behind the first are merged.
pub(crate) fn in_four_dimensions(shape: &[usize]) -> Vec<usize> {
    let extra = shape.len().saturating_sub(4);
    let Some((first, rest)) = shape.split_first().filter(|_| extra > 0) else {
        return shape.to_vec();
    };
    let (merged, last) = rest.split_at(extra + 1);
    [&[*first, merged.iter().product()], last].concat()
}
