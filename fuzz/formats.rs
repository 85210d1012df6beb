//! Files that are written from a text, with the lengths, checksums and pages of their format. A
//! changed byte of the text changes what the file says and leaves the file whole, so that an input
//! reaches what lies behind the outer shell of a format.
//!
//! What a text says wrongly is left out: a writer here never fails.

use arrow_array::{
    ArrayRef, BooleanArray, Float32Array, Float64Array, Int64Array, RecordBatch, StringArray,
    UInt8Array,
};
use arrow_ipc::writer::FileWriter;
use flate2::Compression;
use flate2::write::GzEncoder;
use parquet::arrow::ArrowWriter;
use rusqlite::Connection;
use rusqlite::limits::Limit;
use std::io::Write;
use std::path::Path;
use std::sync::Arc;

/// Steps of SQLite's machine that an input may take; about a tenth of a second.
const SQL_STEPS: i32 = 1_000_000;
/// Constant of TFRecord's checksum.
const MASK_DELTA: u32 = 0xa282_ead8;
/// Bytes of a row of a GGUF tensor for each 256 values, at most (f64).
const GGUF_MAX_BYTES: u64 = 1 << 20;

/// Records of a TFRecord. Lines of `---` divide messages; see [`message`].
pub(crate) fn tfrecord(text: &str) -> Vec<u8> {
    let checksum = |bytes: &[u8]| {
        crc32c::crc32c(bytes)
            .rotate_right(15)
            .wrapping_add(MASK_DELTA)
            .to_le_bytes()
    };
    let record = |text: &str| {
        let payload = message(text);
        let length = (payload.len() as u64).to_le_bytes();
        [
            &length[..],
            &checksum(&length),
            &payload,
            &checksum(&payload),
        ]
        .concat()
    };
    text.split("\n---\n").flat_map(record).collect()
}

/// A protocol-buffer message. A word is a field: `5"id"` has text, `6=1` a whole number, `2~0.5` a
/// double, `2^0.5` a float; `3{` begins a message, and `}` ends it.
fn message(text: &str) -> Vec<u8> {
    let mut open: Vec<(u64, Vec<u8>)> = vec![(0, Vec::new())];
    let close = |open: &mut Vec<(u64, Vec<u8>)>| {
        if open.len() > 1
            && let Some((field, inner)) = open.pop()
            && let Some((_, outer)) = open.last_mut()
        {
            with_length(outer, field, &inner);
        }
    };
    for word in text.split_whitespace() {
        if word == "}" {
            close(&mut open);
            continue;
        }
        let end = word
            .find(|c: char| !c.is_ascii_digit())
            .unwrap_or(word.len());
        let (number, value) = word.split_at(end);
        let Ok(field) = number.parse::<u32>().map(u64::from) else {
            continue;
        };
        let Some((_, bytes)) = open.last_mut() else {
            continue;
        };
        match value.split_at_checked(1) {
            Some(("{", _)) => open.push((field, Vec::new())),
            Some(("=", value)) => {
                varint(bytes, field << 3);
                varint(bytes, value.parse::<i64>().unwrap_or(0).cast_unsigned());
            }
            Some(("~", value)) => {
                varint(bytes, field << 3 | 1);
                bytes.extend(value.parse::<f64>().unwrap_or(0.0).to_le_bytes());
            }
            Some(("^", value)) => {
                varint(bytes, field << 3 | 5);
                bytes.extend(value.parse::<f32>().unwrap_or(0.0).to_le_bytes());
            }
            Some(("\"", value)) => {
                with_length(bytes, field, value.trim_end_matches('"').as_bytes());
            }
            _ => {}
        }
    }
    while open.len() > 1 {
        close(&mut open);
    }
    open.pop().map(|(_, bytes)| bytes).unwrap_or_default()
}

fn with_length(bytes: &mut Vec<u8>, field: u64, value: &[u8]) {
    varint(bytes, field << 3 | 2);
    varint(bytes, value.len() as u64);
    bytes.extend(value);
}

fn varint(bytes: &mut Vec<u8>, mut value: u64) {
    while value >= 1 << 7 {
        bytes.push((value & 0x7f) as u8 | 0x80);
        value >>= 7;
    }
    bytes.push(value as u8);
}

/// Changes a database by SQL, within a budget and inside its file.
pub(crate) fn change_database(path: &Path, sql: &str) {
    let Ok(mut database) = Connection::open(path) else {
        return;
    };
    let _ = database.set_limit(Limit::SQLITE_LIMIT_ATTACHED, 0);
    let _ = database.set_limit(Limit::SQLITE_LIMIT_LENGTH, 1 << 20);
    let _ = database.progress_handler(SQL_STEPS, Some(|| true));
    for statement in sql.split(';') {
        let _ = database.execute_batch(statement);
    }
}

/// A table of a Feather file (Arrow's IPC) or a Parquet file. The first line has the columns as
/// `name:type`, each further line a row; commas divide cells, and an empty cell is null. The types
/// are `f64`, `f32`, `i64`, `u8`, `bool` and `str`.
fn table(text: &str) -> Option<RecordBatch> {
    let mut lines = text.lines();
    let columns: Vec<&str> = lines.next()?.split(',').collect();
    let rows: Vec<Vec<&str>> = lines.map(|line| line.split(',').collect()).collect();
    let arrays = columns.iter().enumerate().map(|(i, column)| {
        let (name, kind) = column.split_once(':').unwrap_or((column, "str"));
        let cells = rows
            .iter()
            .map(|row| row.get(i).copied().filter(|cell| !cell.is_empty()));
        let array: ArrayRef = match kind {
            "f64" => Arc::new(
                cells
                    .map(|cell| cell?.parse::<f64>().ok())
                    .collect::<Float64Array>(),
            ),
            "f32" => Arc::new(
                cells
                    .map(|cell| cell?.parse::<f32>().ok())
                    .collect::<Float32Array>(),
            ),
            "i64" => Arc::new(
                cells
                    .map(|cell| cell?.parse::<i64>().ok())
                    .collect::<Int64Array>(),
            ),
            "u8" => Arc::new(
                cells
                    .map(|cell| cell?.parse::<u8>().ok())
                    .collect::<UInt8Array>(),
            ),
            "bool" => Arc::new(
                cells
                    .map(|cell| cell?.parse::<bool>().ok())
                    .collect::<BooleanArray>(),
            ),
            _ => Arc::new(cells.collect::<StringArray>()),
        };
        (name, array)
    });
    RecordBatch::try_from_iter(arrays).ok()
}

/// See [`table`].
pub(crate) fn feather(text: &str) -> Vec<u8> {
    let written = table(text).and_then(|batch| {
        let mut writer = FileWriter::try_new(Vec::new(), &batch.schema()).ok()?;
        writer.write(&batch).ok()?;
        writer.into_inner().ok()
    });
    written.unwrap_or_default()
}

/// See [`table`].
pub(crate) fn parquet(text: &str) -> Vec<u8> {
    let written = table(text).and_then(|batch| {
        let mut bytes = Vec::new();
        let mut writer = ArrowWriter::try_new(&mut bytes, batch.schema(), None).ok()?;
        writer.write(&batch).ok()?;
        writer.close().ok()?;
        Some(bytes)
    });
    written.unwrap_or_default()
}

/// A GGUF file whose tensors are zero. A line is an entry: `s KEY TEXT`, `u KEY NUMBER` (32 bits),
/// `f KEY NUMBER`, `b KEY true`, `as KEY WORD ...` (`␣` is a space of a word), `ai KEY NUMBER ...`,
/// `af KEY NUMBER ...`, `ab KEY true ...`, or a tensor `t NAME TYPE WIDTH ...`, TYPE being GGML's
/// number.
pub(crate) fn gguf(text: &str) -> Vec<u8> {
    let (mut entries, mut tensors) = (Vec::new(), Vec::new());
    let (mut entry_count, mut tensor_count, mut values) = (0_u64, 0_u64, 0_u64);
    let put = |bytes: &mut Vec<u8>, text: &str| {
        bytes.extend((text.len() as u64).to_le_bytes());
        bytes.extend(text.as_bytes());
    };
    for line in text.lines() {
        let mut words = line.splitn(3, ' ');
        let (Some(kind), Some(name), value) =
            (words.next(), words.next(), words.next().unwrap_or(""))
        else {
            continue;
        };
        if kind == "t" {
            let mut numbers = value
                .split(' ')
                .map(|word| word.parse::<u64>().unwrap_or(0));
            let (of_type, shape) = (
                numbers.next().unwrap_or(0) as u32,
                numbers.collect::<Vec<_>>(),
            );
            put(&mut tensors, name);
            tensors.extend((shape.len() as u32).to_le_bytes());
            tensors.extend(shape.iter().flat_map(|width| width.to_le_bytes()));
            tensors.extend(of_type.to_le_bytes());
            values = values.next_multiple_of(8);
            tensors.extend((values * 4).to_le_bytes());
            values = values.saturating_add(
                shape
                    .iter()
                    .fold(1, |product, width| product.saturating_mul(*width)),
            ) & 0xff_ffff;
            tensor_count += 1;
            continue;
        }
        put(&mut entries, name);
        let words = || value.split(' ');
        let list = |entries: &mut Vec<u8>, of_type: u32| {
            entries.extend([9_u32, of_type].map(u32::to_le_bytes).concat());
            entries.extend((words().count() as u64).to_le_bytes());
        };
        match kind {
            "u" => entries.extend(
                [4, value.parse().unwrap_or(0)]
                    .map(u32::to_le_bytes)
                    .concat(),
            ),
            "f" => entries.extend(
                [
                    6_u32.to_le_bytes(),
                    value.parse::<f32>().unwrap_or(0.0).to_le_bytes(),
                ]
                .concat(),
            ),
            "b" => {
                entries.extend([&7_u32.to_le_bytes()[..], &[u8::from(value == "true")]].concat());
            }
            "as" => {
                list(&mut entries, 8);
                words().for_each(|word| put(&mut entries, &word.replace('␣', " ")));
            }
            "ab" => {
                list(&mut entries, 7);
                entries.extend(words().map(|word| u8::from(word == "true")));
            }
            "ai" => {
                list(&mut entries, 5);
                words().for_each(|word| {
                    entries.extend(word.parse::<i32>().unwrap_or(0).to_le_bytes());
                });
            }
            "af" => {
                list(&mut entries, 6);
                words().for_each(|word| {
                    entries.extend(word.parse::<f32>().unwrap_or(0.0).to_le_bytes());
                });
            }
            _ => {
                entries.extend(8_u32.to_le_bytes());
                put(&mut entries, value);
            }
        }
        entry_count += 1;
    }
    let head = [
        &b"GGUF"[..],
        &3_u32.to_le_bytes(),
        &tensor_count.to_le_bytes(),
        &entry_count.to_le_bytes(),
    ]
    .concat();
    let mut bytes = [head, entries, tensors].concat();
    let data = (values * 4 + 64).min(GGUF_MAX_BYTES);
    bytes.resize(bytes.len().next_multiple_of(32) + data as usize, 0);
    bytes
}

/// Packs bytes as gzip does.
pub(crate) fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut packer = GzEncoder::new(Vec::new(), Compression::fast());
    packer
        .write_all(bytes)
        .and_then(|()| packer.finish())
        .unwrap_or_default()
}
