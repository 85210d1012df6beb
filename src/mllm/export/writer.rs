//! The writer of GGUF files, version 3.

use std::io::{self, Write};

use candle_core::quantized::GgmlDType;

use crate::mllm::gguf::{DEFAULT_ALIGNMENT, Value, number_of};

/// A file without the tensors' data.
#[derive(Debug, Default)]
pub(super) struct Layout {
    /// Metadata in the order of the file.
    pub metadata: Vec<(String, Value)>,
    /// Tensors in the order of the file.
    pub tensors: Vec<PlannedTensor>,
}

/// A tensor without its data.
#[derive(Debug, Clone)]
pub(super) struct PlannedTensor {
    /// Its name in the file.
    pub name: String,
    /// Number format of its blocks.
    pub format: GgmlDType,
    /// Shape, the slowest dimension first.
    pub shape: Vec<usize>,
}

impl PlannedTensor {
    /// Bytes of its data.
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
            put_value(&mut header, value)?;
        }
        let mut offset = 0_u64;
        for tensor in &self.tensors {
            put_text(&mut header, &tensor.name);
            header.extend((tensor.shape.len() as u32).to_le_bytes());
            for side in tensor.shape.iter().rev() {
                header.extend((*side as u64).to_le_bytes());
            }
            let number = number_of(tensor.format)
                .ok_or_else(|| io::Error::other(format!("{:?} is no format of GGUF files", tensor.format)))?;
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

/// Writes a value with its type. Integers take 32 bits where they fit, because llama.cpp reads these.
fn put_value(out: &mut Vec<u8>, value: &Value) -> io::Result<()> {
    let kind = |out: &mut Vec<u8>, kind: u32| out.extend(kind.to_le_bytes());
    match value {
        Value::Unsigned(number) => {
            if let Ok(number) = u32::try_from(*number) {
                kind(out, 4);
                out.extend(number.to_le_bytes());
            } else {
                kind(out, 10);
                out.extend(number.to_le_bytes());
            }
        }
        Value::Signed(number) => {
            if let Ok(number) = i32::try_from(*number) {
                kind(out, 5);
                out.extend(number.to_le_bytes());
            } else {
                kind(out, 11);
                out.extend(number.to_le_bytes());
            }
        }
        Value::Float(number) => {
            kind(out, 6);
            out.extend(number.to_le_bytes());
        }
        Value::Double(number) => {
            kind(out, 12);
            out.extend(number.to_le_bytes());
        }
        Value::Bool(truth) => {
            kind(out, 7);
            out.push(u8::from(*truth));
        }
        Value::Text(text) => {
            kind(out, 8);
            put_text(out, text);
        }
        Value::Integers(list) => {
            let narrow: Result<Vec<i32>, _> = list.iter().map(|number| i32::try_from(*number)).collect();
            put_list(out, if narrow.is_ok() { 5 } else { 11 }, list.len());
            match narrow {
                Ok(list) => out.extend(list.iter().flat_map(|number| number.to_le_bytes())),
                Err(_) => out.extend(list.iter().flat_map(|number| number.to_le_bytes())),
            }
        }
        Value::Floats(list) => {
            put_list(out, 6, list.len());
            out.extend(list.iter().flat_map(|number| number.to_le_bytes()));
        }
        Value::Texts(list) => {
            put_list(out, 8, list.len());
            for text in list {
                put_text(out, text);
            }
        }
        Value::List(_) => return Err(io::Error::other("lists of lists are not written")),
    }
    Ok(())
}

/// Writes the type and length of a list.
fn put_list(out: &mut Vec<u8>, kind: u32, count: usize) {
    out.extend(9_u32.to_le_bytes());
    out.extend(kind.to_le_bytes());
    out.extend((count as u64).to_le_bytes());
}
