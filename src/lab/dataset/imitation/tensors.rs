//! Samples as tensors: those of a shard are concatenated along the first dimension.

use safetensors::tensor::{Dtype, TensorView};
use safetensors::{SafeTensorError, SafeTensors};
use std::collections::BTreeMap;
use std::path::Path;

/// Largest shard that is read, bytes. One of 500 samples has at most some hundred megabytes.
const MAX_SHARD_BYTES: u64 = 8 << 30;
/// The tensor that has one row a sample in every dataset.
const COUNTED: &str = "target";

/// The numbers of a column.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Numbers {
    F32(Vec<f32>),
    U8(Vec<u8>),
}

/// A column of one sample: its rows, with the shape of a row.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Column {
    row: Vec<usize>,
    numbers: Numbers,
}

/// The columns of one sample by name.
#[derive(Debug, Clone, PartialEq, Default)]
pub(super) struct Columns(BTreeMap<&'static str, Column>);

impl Columns {
    /// With one more column of f32; the number of rows follows from that of numbers.
    pub(super) fn with(mut self, name: &'static str, row: &[usize], numbers: Vec<f32>) -> Self {
        self.0.insert(
            name,
            Column {
                row: row.to_vec(),
                numbers: Numbers::F32(numbers),
            },
        );
        self
    }

    /// The same of small integers and flags.
    pub(super) fn with_small(
        mut self,
        name: &'static str,
        row: &[usize],
        numbers: Vec<u8>,
    ) -> Self {
        self.0.insert(
            name,
            Column {
                row: row.to_vec(),
                numbers: Numbers::U8(numbers),
            },
        );
        self
    }
}

/// A shard of samples of the same planner.
pub(super) fn serialized(samples: &[Columns]) -> Result<Vec<u8>, SafeTensorError> {
    let mut joined: BTreeMap<&str, (Dtype, &[usize], Vec<u8>)> = BTreeMap::new();
    for (name, Column { row, numbers }) in samples.iter().flat_map(|sample| &sample.0) {
        let (dtype, bytes): (Dtype, Vec<u8>) = match numbers {
            Numbers::F32(values) => (
                Dtype::F32,
                values
                    .iter()
                    .flat_map(|value| value.to_le_bytes())
                    .collect(),
            ),
            Numbers::U8(values) => (Dtype::U8, values.clone()),
        };
        joined
            .entry(*name)
            .or_insert_with(|| (dtype, row, Vec::new()))
            .2
            .extend(bytes);
    }
    let views = joined.iter().map(|(name, (dtype, row, bytes))| {
        let size = if *dtype == Dtype::F32 { 4 } else { 1 };
        let rows = bytes.len() / (size * row.iter().product::<usize>()).max(1);
        let shape = std::iter::once(rows).chain(row.iter().copied()).collect();
        TensorView::new(*dtype, shape, bytes).map(|view| (*name, view))
    });
    safetensors::serialize(views.collect::<Result<Vec<_>, _>>()?, None)
}

/// The number of samples of a complete shard.
pub(super) fn samples_in(path: &Path) -> Option<usize> {
    let bytes = planagent_files::read(path, MAX_SHARD_BYTES).ok()?;
    let file = SafeTensors::deserialize(&bytes).ok()?;
    // A shard whose scenarios were all discarded holds nothing.
    file.tensor(COUNTED)
        .map_or(Some(0), |target| target.shape().first().copied())
}
