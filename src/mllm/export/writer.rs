//! The writer of GGUF files, version 3.

use crate::checkpoint::in_four_dimensions;
use crate::gguf::{DEFAULT_ALIGNMENT, Entries, number_of};
use planagent_kernels::matrix::StoredFormat;
use serde_json::Value;
use std::io::{self, Write};

/// A file without the tensors' data.
#[derive(Debug, Default)]
pub(super) struct Layout {
    pub metadata: Entries,
    pub tensors: Vec<PlannedTensor>,
}

/// A tensor without its data.
#[derive(Debug, Clone)]
pub(super) struct PlannedTensor {
    pub name: String,
    /// Number format of its blocks.
    pub format: StoredFormat,
    /// Shape, the slowest dimension first.
    pub shape: Vec<usize>,
}

impl PlannedTensor {
    pub(super) fn bytes(&self) -> u64 {
        let elements = self.shape.iter().product::<usize>() as u64;
        elements / self.format.block_size() as u64 * self.format.type_size() as u64
    }
}

impl Layout {
    /// Writes the header, and pads it so that the data begins at a multiple of the alignment.
    pub(super) fn write_header(&self, out: &mut dyn Write) -> io::Result<()> {
        let mut header = b"GGUF".to_vec();
        header.extend(3_u32.to_le_bytes());
        header.extend((self.tensors.len() as u64).to_le_bytes());
        header.extend((self.metadata.len() as u64).to_le_bytes());
        for (key, value) in &self.metadata {
            put_text(&mut header, key);
            put_value(&mut header, value)
                .map_err(|error| io::Error::other(format!("metadata {key}: {error}")))?;
        }
        let mut offset = 0_u64;
        for tensor in &self.tensors {
            put_text(&mut header, &tensor.name);
            let shape = in_four_dimensions(&tensor.shape);
            header.extend((shape.len() as u32).to_le_bytes());
            // GGUF lists dimensions from the innermost one on.
            for side in shape.iter().rev() {
                header.extend((*side as u64).to_le_bytes());
            }
            let number = number_of(tensor.format).ok_or_else(|| {
                io::Error::other(format!(
                    "{} is no format of GGUF files",
                    tensor.format.name()
                ))
            })?;
            header.extend(number.to_le_bytes());
            header.extend(offset.to_le_bytes());
            offset += tensor.bytes().next_multiple_of(DEFAULT_ALIGNMENT);
        }
        out.write_all(&header)?;
        pad(out, header.len() as u64)
    }

    /// Writes the data of a tensor, and pads it.
    pub(super) fn write_data(out: &mut dyn Write, data: &[u8]) -> io::Result<()> {
        out.write_all(data)?;
        pad(out, data.len() as u64)
    }
}

fn pad(out: &mut dyn Write, written: u64) -> io::Result<()> {
    let missing = written.next_multiple_of(DEFAULT_ALIGNMENT) - written;
    out.write_all(&vec![0; missing as usize])
}

fn put_text(out: &mut Vec<u8>, text: &str) {
    out.extend((text.len() as u64).to_le_bytes());
    out.extend(text.as_bytes());
}

/// The type of a value in a file. Integers take 32 bits where they fit, because llama.cpp reads
/// these.
fn kind_of(value: &Value) -> u32 {
    match value {
        Value::Bool(_) => 7,
        Value::Number(number) if number.is_f64() => 6,
        Value::Number(number) => match (number.as_u64(), number.as_i64()) {
            (Some(number), _) if u32::try_from(number).is_ok() => 4,
            (Some(_), _) => 10,
            (None, Some(number)) if i32::try_from(number).is_ok() => 5,
            _ => 11,
        },
        Value::Array(_) => 9,
        _ => 8,
    }
}

/// The type of a list's elements: signed integers, else the type of the first.
fn kind_of_elements(list: &[Value]) -> u32 {
    let fits = |value: &Value| {
        value
            .as_i64()
            .is_some_and(|number| i32::try_from(number).is_ok())
    };
    match list.first() {
        None => 8,
        Some(first) if !first.is_i64() && !first.is_u64() => kind_of(first),
        Some(_) if list.iter().all(fits) => 5,
        Some(_) => 11,
    }
}

/// Writes a value with its type.
fn put_value(out: &mut Vec<u8>, value: &Value) -> io::Result<()> {
    out.extend(kind_of(value).to_le_bytes());
    let Value::Array(list) = value else {
        return put_plain(out, kind_of(value), value);
    };
    let kind = kind_of_elements(list);
    out.extend(kind.to_le_bytes());
    out.extend((list.len() as u64).to_le_bytes());
    list.iter()
        .try_for_each(|element| put_plain(out, kind, element))
}

/// Writes a value that is no list as `kind`.
fn put_plain(out: &mut Vec<u8>, kind: u32, value: &Value) -> io::Result<()> {
    let unfit = || {
        io::Error::other(format!(
            "{value} does not fit the type of its list; write a list of one type of numbers"
        ))
    };
    match (kind, value) {
        (8, Value::String(text)) => put_text(out, text),
        (7, Value::Bool(flag)) => out.push(u8::from(*flag)),
        (6, Value::Number(number)) => {
            out.extend((number.as_f64().ok_or_else(unfit)? as f32).to_le_bytes());
        }
        (4, Value::Number(number)) => {
            out.extend((number.as_u64().ok_or_else(unfit)? as u32).to_le_bytes());
        }
        (5, Value::Number(number)) => {
            out.extend((number.as_i64().ok_or_else(unfit)? as i32).to_le_bytes());
        }
        (10, Value::Number(number)) => out.extend(number.as_u64().ok_or_else(unfit)?.to_le_bytes()),
        (11, Value::Number(number)) => out.extend(number.as_i64().ok_or_else(unfit)?.to_le_bytes()),
        _ => return Err(io::Error::other(format!("{value} has no type in GGUF"))),
    }
    Ok(())
}
