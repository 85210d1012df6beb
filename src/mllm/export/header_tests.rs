//! Valid and hostile headers of GGUF files.

use super::writer::{Layout, PlannedTensor};
use crate::MllmError;
use crate::gguf::Header;
use candle_core::quantized::{GgmlDType, gguf_file};
use proptest::prelude::*;
use serde_json::{Value, json};
use std::path::Path;

fn parse(bytes: &[u8]) -> Result<Header, MllmError> {
    Header::read(Path::new("m.gguf"), &mut &*bytes, bytes.len() as u64)
}

fn problem(bytes: &[u8]) -> String {
    match parse(bytes) {
        Err(MllmError::Gguf { problem, .. }) => problem,
        other => panic!("{other:?}"),
    }
}

/// A value of every kind.
fn metadata() -> Vec<(String, Value)> {
    [
        ("general.architecture", json!("llama")),
        ("count", json!(7)),
        ("large", json!(1_u64 << 40)),
        ("signed", json!(-3)),
        ("low", json!(-(1_i64 << 40))),
        ("float", json!(1e-5)),
        ("flag", json!(true)),
        ("texts", json!(["a", "", "\u{2581}b"])),
        ("floats", json!([0.5, -1.0])),
        ("integers", json!([1, -2])),
        ("wide", json!([1_i64 << 40])),
    ]
    .map(|(key, value)| (key.to_string(), value))
    .to_vec()
}

fn tensor(name: &str, format: GgmlDType, shape: &[usize]) -> PlannedTensor {
    let format = format.into();
    PlannedTensor {
        name: name.to_string(),
        format,
        shape: shape.to_vec(),
    }
}

/// A file with two tensors.
fn file() -> Vec<u8> {
    let tensors = vec![
        tensor("a", GgmlDType::F32, &[2, 3]),
        tensor("b", GgmlDType::Q8_0, &[2, 32]),
    ];
    let layout = Layout {
        metadata: metadata(),
        tensors,
    };
    let mut bytes = Vec::new();
    layout.write_header(&mut bytes).unwrap();
    for tensor in &layout.tensors {
        Layout::write_data(&mut bytes, &vec![1; tensor.bytes() as usize]).unwrap();
    }
    bytes
}

/// A header, field by field.
struct Raw(Vec<u8>);

impl Raw {
    fn new(tensors: u64, entries: u64) -> Self {
        let mut bytes = b"GGUF".to_vec();
        bytes.extend(3_u32.to_le_bytes());
        Self(bytes).u64(tensors).u64(entries)
    }

    fn u32(mut self, number: u32) -> Self {
        self.0.extend(number.to_le_bytes());
        self
    }

    fn u64(mut self, number: u64) -> Self {
        self.0.extend(number.to_le_bytes());
        self
    }

    fn text(self, text: &[u8]) -> Self {
        let mut raw = self.u64(text.len() as u64);
        raw.0.extend(text);
        raw
    }

    fn tensor(self, name: &str, shape: &[u64], format: u32, offset: u64) -> Self {
        let raw = self.text(name.as_bytes()).u32(shape.len() as u32);
        shape
            .iter()
            .fold(raw, |raw, side| raw.u64(*side))
            .u32(format)
            .u64(offset)
    }

    /// Appends so many bytes of data.
    fn data(mut self, bytes: usize) -> Vec<u8> {
        self.0.resize(self.0.len().next_multiple_of(32) + bytes, 0);
        self.0
    }
}

#[test]
fn what_is_written_is_read_back() {
    let bytes = file();
    let header = parse(&bytes).unwrap();
    assert_eq!(header.metadata, metadata().into_iter().collect());
    let (a, b) = (&header.tensors["a"], &header.tensors["b"]);
    assert_eq!(
        (a.format, a.shape.as_slice(), a.bytes),
        (GgmlDType::F32.into(), &[2, 3][..], 24)
    );
    assert_eq!(
        (b.format, b.shape.as_slice(), b.bytes),
        (GgmlDType::Q8_0.into(), &[2, 32][..], 68)
    );
    assert_eq!((b.begin - a.begin, b.begin + 96), (32, bytes.len() as u64));
}

#[test]
fn another_reader_reads_the_same() {
    let bytes = file();
    let ours = parse(&bytes).unwrap();
    let other = gguf_file::Content::read(&mut std::io::Cursor::new(&bytes)).unwrap();
    assert_eq!(other.metadata.len(), ours.metadata.len());
    assert_eq!(
        other.metadata["float"].to_f32().unwrap().to_bits(),
        1e-5_f32.to_bits()
    );
    assert_eq!(other.metadata["count"].to_u32().unwrap(), 7);
    assert_eq!(
        other.metadata["texts"].to_vec().unwrap()[2]
            .to_string()
            .unwrap(),
        "\u{2581}b"
    );
    for (name, place) in &ours.tensors {
        let info = &other.tensor_infos[name];
        assert_eq!(
            (info.shape.dims(), info.ggml_dtype.into()),
            (place.shape.as_slice(), place.format)
        );
        assert_eq!(other.tensor_data_offset + info.offset, place.begin);
    }
}

/// The reasons for a reader of our own.
#[test]
fn candles_reader_does_not_refuse_what_it_should() {
    let read = |bytes: Vec<u8>| gguf_file::Content::read(&mut std::io::Cursor::new(bytes));
    let alignment = Raw::new(0, 1)
        .text(b"general.alignment")
        .u32(4)
        .u32(0)
        .data(0);
    assert!(
        std::panic::catch_unwind(|| read(alignment)).is_err(),
        "it divides by the alignment"
    );
    let twice = read(
        Raw::new(2, 0)
            .tensor("t", &[8], 0, 0)
            .tensor("t", &[8], 0, 32)
            .data(64),
    )
    .unwrap();
    assert_eq!(
        twice.tensor_infos.len(),
        1,
        "the second tensor replaces the first"
    );
    let overlap = Raw::new(2, 0)
        .tensor("t", &[16], 0, 0)
        .tensor("u", &[8], 0, 32)
        .data(64);
    assert_eq!(read(overlap).unwrap().tensor_infos.len(), 2);
    let text = read(Raw::new(0, 1).text(b"k").u32(8).text(b"\xff").data(8)).unwrap();
    assert_eq!(text.metadata["k"].to_string().unwrap(), "\u{fffd}");
}

#[test]
fn what_cannot_be_right_is_named() {
    let alignment = |value: u32| {
        Raw::new(0, 1)
            .text(b"general.alignment")
            .u32(4)
            .u32(value)
            .data(0)
    };
    let list = |kind: u32, count: u64| {
        Raw::new(0, 1)
            .text(b"k")
            .u32(9)
            .u32(kind)
            .u64(count)
            .data(64)
    };
    let twice = Raw::new(0, 2).text(b"k").u32(7).u32(0x0100_0000);
    for (bytes, expected) in [
        (b"GGML".to_vec(), "GGUF"),
        (vec![], "truncated"),
        (b"GGUF\x01\0\0\0".to_vec(), "version 1"),
        (b"GGUF\0\0\0\x03".to_vec(), "big-endian"),
        (Raw::new(u64::MAX, 0).data(100), "tensors are announced"),
        (Raw::new(1 << 40, 0).data(100), "tensors are announced"),
        (
            Raw::new(0, u64::MAX / 2).data(100),
            "metadata entries are announced",
        ),
        (
            Raw::new(0, 1).u64(u64::MAX).data(100),
            "bytes of a metadata key are announced",
        ),
        (
            Raw::new(0, 1).text(b"\xff\xfe").u32(4).u32(1).data(9),
            "UTF-8",
        ),
        (Raw::new(0, 1).text(b"k").u32(13).data(64), "type 13"),
        (
            Raw::new(0, 1).text(b"k").u32(8).text(b"\xc3").data(64),
            "metadata k: at byte",
        ),
        (
            Raw::new(0, 1).text(b"k").u32(7).u32(2).data(64),
            "boolean is 2",
        ),
        (list(8, 1 << 60), "values of a list are announced"),
        (list(4, u64::MAX), "values of a list are announced"),
        (list(99, 1), "list is of type 99"),
        (
            Raw::new(0, 1)
                .text(b"k")
                .u32(9)
                .u32(9)
                .u64(1)
                .u32(9)
                .u64(1)
                .u32(9)
                .u64(0)
                .data(64),
            "nested too deeply",
        ),
        (alignment(0), "power of two"),
        (alignment(33), "power of two"),
        (alignment(1 << 30), "power of two"),
        (twice.text(b"k").u32(7).data(9), ""),
        (
            Raw::new(1, 0).tensor("t", &[1; 5], 0, 0).data(64),
            "5 dimensions",
        ),
        (
            Raw::new(1, 0).tensor("t", &[], 0, 0).data(64),
            "0 dimensions",
        ),
        (
            Raw::new(1, 0).tensor("t", &[4], 99, 0).data(64),
            "number format 99",
        ),
        (
            Raw::new(1, 0).tensor("t", &[0], 0, 0).data(64),
            "cannot lie",
        ),
        (
            Raw::new(1, 0).tensor("t", &[u64::MAX, 2], 0, 0).data(64),
            "cannot lie",
        ),
        (
            Raw::new(1, 0).tensor("t", &[1 << 40], 0, 0).data(64),
            "cannot lie",
        ),
        (
            Raw::new(1, 0).tensor("t", &[31, 2], 8, 0).data(999),
            "cannot lie",
        ),
        (
            Raw::new(1, 0).tensor("t", &[16], 0, 1 << 20).data(64),
            "truncated",
        ),
        (
            Raw::new(1, 0).tensor("t", &[16], 0, u64::MAX - 8).data(64),
            "truncated",
        ),
        (
            Raw::new(1, 0).tensor("t", &[16], 0, 0).data(63),
            "truncated",
        ),
        (
            Raw::new(1, 0).tensor("t", &[8], 0, 8).data(64),
            "no multiple of 32",
        ),
        (
            Raw::new(2, 0)
                .tensor("t", &[16], 0, 0)
                .tensor("u", &[8], 0, 32)
                .data(64),
            "shares bytes",
        ),
        (
            Raw::new(2, 0)
                .tensor("t", &[8], 0, 0)
                .tensor("t", &[8], 0, 32)
                .data(64),
            "occurs twice",
        ),
    ] {
        let problem = problem(&bytes);
        assert!(problem.contains(expected), "{expected}: {problem}");
    }
}

proptest! {
    #[test]
    fn any_bytes_are_an_error_or_a_header(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
        let _ = parse(&bytes);
        let _ = parse(&[b"GGUF\x03\0\0\0", bytes.as_slice()].concat());
    }

    #[test]
    fn changed_bytes_are_an_error_or_a_header(
        changes in proptest::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..4),
        cut in any::<prop::sample::Index>(),
    ) {
        let mut bytes = file();
        for (at, value) in changes {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        let _ = parse(&bytes);
        let length = cut.index(bytes.len());
        let _ = parse(&bytes[..length]);
    }
}
