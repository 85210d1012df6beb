//! The header of a GGUF file: metadata, and the places of tensors. A downloaded file is hostile
//! input.
//!
//! Every count and length is checked against the bytes that are left before anything is allocated.
//! `candle_core`'s reader would need a second reader in front of it (a test shows why): it panics
//! at an alignment of 0, keeps the last of two equal keys or tensors, replaces text that is not
//! UTF-8, bounds lists by the file's size alone, and checks neither the product of a shape nor
//! whether tensors overlap.

use crate::MllmError;
use crate::checkpoint::{TensorPlace, what_instead_of_weights};
use candle_core::quantized::GgmlDType;
use planagent_kernels::matrix::StoredFormat;
use serde_json::{Number, Value};
use std::collections::{BTreeMap, BTreeSet};
use std::io::Read as _;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

/// First bytes of a GGUF file.
const MAGIC: &[u8; 4] = b"GGUF";
/// Supported versions. 3 allows big-endian files, which are not supported.
const VERSIONS: [u32; 2] = [2, 3];
/// Default alignment of the data, bytes.
pub(crate) const DEFAULT_ALIGNMENT: u64 = 32;
/// Largest alignment, bytes: beyond it a file is taken for broken.
const MAX_ALIGNMENT: u64 = 1 << 20;
/// Dimensions of a tensor (`GGML_MAX_DIMS`).
const MAX_DIMENSIONS: u32 = 4;
/// Longest name of a tensor, bytes (`GGML_MAX_NAME` without its end mark, with room for newer
/// writers).
const MAX_NAME: u64 = 1 << 10;
/// Depth of nested lists; llama.cpp writes none.
const MAX_DEPTH: u8 = 2;
/// Longest header, bytes. It bounds the allocation; a model with 256 thousand tokens needs 20 MB.
const MAX_HEADER: u64 = 1 << 28;

/// Elements of all lists of a header. Each takes about 80 bytes in memory; a model with 256
/// thousand tokens has a million.
const MAX_ELEMENTS: u64 = 1 << 22;

/// The part of a file before the tensors' data.
#[derive(Debug)]
pub struct Header {
    pub(crate) path: PathBuf,
    pub(crate) metadata: BTreeMap<String, Value>,
    pub(crate) tensors: BTreeMap<String, TensorPlace>,
    /// The file of each tensor that is not in the first.
    pub(super) parts: BTreeMap<String, usize>,
    /// The keys that some code asked for.
    pub(super) asked: Mutex<BTreeSet<String>>,
}

impl Header {
    /// A header of these entries and tensors.
    pub(crate) fn new(
        path: &Path,
        metadata: BTreeMap<String, Value>,
        tensors: BTreeMap<String, TensorPlace>,
    ) -> Self {
        Self {
            path: path.to_path_buf(),
            metadata,
            tensors,
            parts: BTreeMap::new(),
            asked: Mutex::default(),
        }
    }

    /// Reads the header of a file of `file_bytes` bytes. Errors name the byte.
    pub(crate) fn read(
        path: &Path,
        source: &mut dyn std::io::Read,
        file_bytes: u64,
    ) -> Result<Self, MllmError> {
        Reader {
            path,
            source,
            position: 0,
            file_bytes,
            elements: 0,
        }
        .header()
    }
}

/// A reader with its position.
struct Reader<'a> {
    path: &'a Path,
    source: &'a mut dyn std::io::Read,
    position: u64,
    file_bytes: u64,
    /// Elements of all lists so far.
    elements: u64,
}

/// A tensor before the place of the data is known.
struct Declared {
    name: String,
    format: StoredFormat,
    shape: Vec<usize>,
    offset: u64,
    bytes: u64,
}

impl Reader<'_> {
    fn header(mut self) -> Result<Header, MllmError> {
        let magic = self.array::<4>()?;
        if &magic != MAGIC {
            let mut beginning = magic.to_vec();
            // What cannot be read does not change what the file is not.
            let _ = (&mut *self.source)
                .take(MAX_NAME)
                .read_to_end(&mut beginning);
            // The header of a safetensors file follows its length of eight bytes.
            let is_safetensors = beginning.get(8..10) == Some(b"{\"");
            let instead = what_instead_of_weights(&beginning).unwrap_or_else(|| {
                if is_safetensors {
                    "this is a safetensors file: its name must end in .safetensors, in a folder with its config.json".into()
                } else {
                    "it does not begin with GGUF".into()
                }
            });
            return Err(self.error(instead));
        }
        let version = self.u32()?;
        if !VERSIONS.contains(&version) {
            return Err(self.error(if VERSIONS.contains(&version.swap_bytes()) {
                "big-endian files are not supported".into()
            } else {
                format!("version {version} is not supported; 2 and 3 are")
            }));
        }
        // Smallest tensor: length of its name, dimensions, type, offset. Smallest entry: length of
        // its key, type, value.
        let tensors = self.count("tensors", 24)?;
        let entries = self.count("metadata entries", 13)?;
        let mut metadata = BTreeMap::new();
        for _ in 0..entries {
            let key = self.text("a metadata key")?;
            let kind = self.u32()?;
            let value = self.value(kind, 0).map_err(|error| in_entry(error, &key))?;
            if metadata.insert(key.clone(), value).is_some() {
                return Err(self.error(format!(
                    "the metadata key '{}' occurs twice",
                    key.escape_debug()
                )));
            }
        }
        let declared = (0..tensors)
            .map(|_| self.tensor())
            .collect::<Result<Vec<_>, _>>()?;
        let alignment = self.alignment(&metadata)?;
        let tensors = self.places(
            declared,
            self.position.next_multiple_of(alignment),
            alignment,
        )?;
        Ok(Header::new(self.path, metadata, tensors))
    }

    fn alignment(&self, metadata: &BTreeMap<String, Value>) -> Result<u64, MllmError> {
        const KEY: &str = "general.alignment";
        let Some(value) = metadata.get(KEY) else {
            return Ok(DEFAULT_ALIGNMENT);
        };
        value
            .as_u64()
            .filter(|alignment| alignment.is_power_of_two() && *alignment <= MAX_ALIGNMENT)
            .ok_or_else(|| {
                self.error(format!(
                    "{KEY} is {value}, expected a power of two up to {MAX_ALIGNMENT}"
                ))
            })
    }

    fn tensor(&mut self) -> Result<Declared, MllmError> {
        let name = self.text("the name of a tensor")?;
        if name.len() as u64 > MAX_NAME {
            return Err(self.error(format!("the name of a tensor has {} bytes", name.len())));
        }
        let dimensions = self.u32()?;
        if dimensions == 0 || dimensions > MAX_DIMENSIONS {
            return Err(self.error(format!(
                "tensor {name} has {dimensions} dimensions, expected 1 to {MAX_DIMENSIONS}"
            )));
        }
        let mut shape = Vec::with_capacity(dimensions as usize);
        for _ in 0..dimensions {
            shape.push(self.u64()?);
        }
        let number = self.u32()?;
        let offset = self.u64()?;
        let format = match format_of(number) {
            Ok(format) => format,
            Err(Some(format)) => {
                return Err(MllmError::GgufFormat {
                    path: self.path.to_path_buf(),
                    name,
                    format,
                });
            }
            Err(None) => {
                return Err(self.error(format!(
                    "tensor {name} has the unknown number format {number}"
                )));
            }
        };
        // The first dimension of the file is the fastest, and rows consist of whole blocks.
        let fastest = shape
            .first()
            .copied()
            .expect("a tensor has one dimension at least");
        let elements = shape
            .iter()
            .try_fold(1_u64, |product, side| product.checked_mul(*side));
        let bytes = elements
            .filter(|elements| *elements > 0 && fastest.is_multiple_of(format.block_size() as u64))
            .and_then(|elements| {
                (elements / format.block_size() as u64).checked_mul(format.type_size() as u64)
            })
            .filter(|bytes| *bytes <= self.file_bytes);
        let Some(bytes) = bytes else {
            return Err(self.error(format!(
                "tensor {name} of shape {shape:?} in {} cannot lie in a file of {} bytes",
                format.name(),
                self.file_bytes
            )));
        };
        let shape = shape.into_iter().rev().map(|side| side as usize).collect();
        Ok(Declared {
            name,
            format,
            shape,
            offset,
            bytes,
        })
    }

    /// Checks that every tensor lies within the file, is aligned, and shares no byte with another.
    fn places(
        &self,
        mut declared: Vec<Declared>,
        data: u64,
        alignment: u64,
    ) -> Result<BTreeMap<String, TensorPlace>, MllmError> {
        // In the order of the file, one pass finds tensors that share bytes.
        declared.sort_by_key(|tensor| tensor.offset);
        let mut tensors = BTreeMap::new();
        let mut free = 0;
        for Declared {
            name,
            format,
            shape,
            offset,
            bytes,
        } in declared
        {
            let begin = data.checked_add(offset);
            let end = begin
                .and_then(|begin| begin.checked_add(bytes))
                .filter(|end| *end <= self.file_bytes);
            let (Some(begin), Some(_)) = (begin, end) else {
                return Err(self.broken(format!(
                    "tensor {name} takes {bytes} bytes from byte {offset} of the data, behind the file's end ({} bytes): it \
                     is truncated",
                    self.file_bytes
                )));
            };
            if !offset.is_multiple_of(alignment) {
                return Err(self.broken(format!(
                    "tensor {name} begins at byte {offset}, no multiple of {alignment}"
                )));
            }
            if offset < free {
                return Err(
                    self.broken(format!("tensor {name} shares bytes with the one before it"))
                );
            }
            free = offset + bytes;
            if tensors
                .insert(
                    name.clone(),
                    TensorPlace {
                        format,
                        shape,
                        begin,
                        bytes,
                    },
                )
                .is_some()
            {
                return Err(self.broken(format!("tensor {name} occurs twice")));
            }
        }
        Ok(tensors)
    }

    fn value(&mut self, kind: u32, depth: u8) -> Result<Value, MllmError> {
        Ok(match kind {
            0 => u8::from_le_bytes(self.array()?).into(),
            1 => i8::from_le_bytes(self.array()?).into(),
            2 => u16::from_le_bytes(self.array()?).into(),
            3 => i16::from_le_bytes(self.array()?).into(),
            4 => self.u32()?.into(),
            5 => i32::from_le_bytes(self.array()?).into(),
            6 => shortest(f32::from_le_bytes(self.array()?)),
            7 => match u8::from_le_bytes(self.array()?) {
                0 => false.into(),
                1 => true.into(),
                other => return Err(self.error(format!("a boolean is {other}, expected 0 or 1"))),
            },
            8 => self.text("a text")?.into(),
            9 => self.list(depth)?,
            10 => self.u64()?.into(),
            11 => i64::from_le_bytes(self.array()?).into(),
            12 => f64::from_le_bytes(self.array()?).into(),
            other => {
                return Err(self.error(format!(
                    "a value is of type {other}, which GGUF does not have"
                )));
            }
        })
    }

    fn list(&mut self, depth: u8) -> Result<Value, MllmError> {
        if depth >= MAX_DEPTH {
            return Err(self.error("lists are nested too deeply"));
        }
        let kind = self.u32()?;
        let least = match kind {
            0 | 1 | 7 => 1,
            2 | 3 => 2,
            4..=6 => 4,
            8 | 10..=12 => 8,
            9 => 12,
            other => {
                return Err(self.error(format!(
                    "a list is of type {other}, which GGUF does not have"
                )));
            }
        };
        let count = self.count("values of a list", least)?;
        self.elements += count;
        if self.elements > MAX_ELEMENTS {
            return Err(self.error(format!("the lists have more than {MAX_ELEMENTS} elements")));
        }
        (0..count).map(|_| self.value(kind, depth + 1)).collect()
    }

    /// A number of items of at least `least` bytes each, which must fit into the rest of the file.
    fn count(&mut self, what: &str, least: u64) -> Result<u64, MllmError> {
        let count = self.u64()?;
        let left = self
            .file_bytes
            .min(MAX_HEADER)
            .saturating_sub(self.position);
        if count.checked_mul(least).is_none_or(|bytes| bytes > left) {
            return Err(self.error(format!(
                "{count} {what} are announced, but only {left} bytes are left for them; if the download was cut off, \
                 repeat it"
            )));
        }
        Ok(count)
    }

    fn text(&mut self, what: &str) -> Result<String, MllmError> {
        let length = self.count(&format!("bytes of {what}"), 1)?;
        let mut bytes = vec![0; length as usize];
        self.fill(&mut bytes)?;
        String::from_utf8(bytes).map_err(|_| self.error(format!("{what} is not UTF-8")))
    }

    fn u32(&mut self) -> Result<u32, MllmError> {
        Ok(u32::from_le_bytes(self.array()?))
    }

    fn u64(&mut self) -> Result<u64, MllmError> {
        Ok(u64::from_le_bytes(self.array()?))
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], MllmError> {
        let mut bytes = [0; N];
        self.fill(&mut bytes)?;
        Ok(bytes)
    }

    fn fill(&mut self, bytes: &mut [u8]) -> Result<(), MllmError> {
        self.source
            .read_exact(bytes)
            .map_err(|source| match source.kind() {
                std::io::ErrorKind::UnexpectedEof => {
                    self.error("the file is truncated within its header; download it again")
                }
                _ => MllmError::Read {
                    path: self.path.to_path_buf(),
                    source,
                },
            })?;
        self.position += bytes.len() as u64;
        Ok(())
    }

    fn error(&self, problem: impl AsRef<str>) -> MllmError {
        self.broken(format!("at byte {}: {}", self.position, problem.as_ref()))
    }

    fn broken(&self, problem: String) -> MllmError {
        MllmError::Gguf {
            path: self.path.to_path_buf(),
            problem,
        }
    }
}

/// The shortest decimal that rounds to a 32-bit float, which is what its writer had; null if it is
/// not finite.
fn shortest(number: f32) -> Value {
    number
        .to_string()
        .parse()
        .ok()
        .and_then(Number::from_f64)
        .map_or(Value::Null, Value::Number)
}

fn in_entry(error: MllmError, key: &str) -> MllmError {
    match error {
        MllmError::Gguf { path, problem } => MllmError::Gguf {
            path,
            problem: format!("metadata {key}: {problem}"),
        },
        other => other,
    }
}

/// Number formats by their `ggml_type`.
const FORMATS: [(u32, GgmlDType); 14] = [
    (0, GgmlDType::F32),
    (1, GgmlDType::F16),
    (2, GgmlDType::Q4_0),
    (3, GgmlDType::Q4_1),
    (6, GgmlDType::Q5_0),
    (7, GgmlDType::Q5_1),
    (8, GgmlDType::Q8_0),
    (10, GgmlDType::Q2K),
    (11, GgmlDType::Q3K),
    (12, GgmlDType::Q4K),
    (13, GgmlDType::Q5K),
    (14, GgmlDType::Q6K),
    (15, GgmlDType::Q8K),
    (30, GgmlDType::BF16),
];

/// Formats that candle does not have, by their `ggml_type`.
const FURTHER: [(u32, StoredFormat); 3] = [
    (20, StoredFormat::Iq4Nl),
    (23, StoredFormat::Iq4Xs),
    (39, StoredFormat::Mxfp4),
];

/// Formats that are not read, by their `ggml_type`. Those of one to three bits have tables of their
/// own.
const UNREAD: [(u32, &str); 17] = [
    (9, "Q8_1"),
    (16, "IQ2_XXS"),
    (17, "IQ2_XS"),
    (18, "IQ3_XXS"),
    (19, "IQ1_S"),
    (21, "IQ3_S"),
    (22, "IQ2_S"),
    (24, "I8"),
    (25, "I16"),
    (26, "I32"),
    (27, "I64"),
    (28, "F64"),
    (29, "IQ1_M"),
    (31, "Q4_0_4_4"),
    (34, "TQ1_0"),
    (35, "TQ2_0"),
    (40, "NVFP4"),
];

/// The format of a `ggml_type`, or the name of one that is not read.
fn format_of(number: u32) -> Result<StoredFormat, Option<&'static str>> {
    let by_number = |known: &u32| *known == number;
    let known = FORMATS
        .iter()
        .find(|(known, _)| by_number(known))
        .map(|(_, format)| StoredFormat::Ggml(*format));
    let known = known.or_else(|| {
        FURTHER
            .iter()
            .find(|(known, _)| by_number(known))
            .map(|(_, format)| *format)
    });
    known.ok_or_else(|| {
        UNREAD
            .iter()
            .find(|(known, _)| by_number(known))
            .map(|(_, name)| *name)
    })
}

/// The `ggml_type` of a format.
pub(crate) fn number_of(format: StoredFormat) -> Option<u32> {
    let further = || FURTHER.iter().copied();
    let known = FORMATS
        .iter()
        .map(|(number, format)| (*number, StoredFormat::Ggml(*format)));
    known
        .chain(further())
        .find(|(_, known)| *known == format)
        .map(|(number, _)| number)
}
