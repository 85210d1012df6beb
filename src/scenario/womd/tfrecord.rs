//! The TFRecord container: framing and both checksums.
//!
//! A file is a row of records, each `{u64 length, u32 masked CRC32C of the length, payload, u32 masked CRC32C of the
//! payload}`, little endian. Both checksums are always verified, the length's before the length is believed.

use std::fs::File;
use std::io::{self, BufReader, Read};
use std::path::Path;

/// Added to a rotated checksum by the TFRecord format ("masking").
const MASK_DELTA: u32 = 0xa282_ead8;
/// Length field and its checksum, bytes.
const HEADER_BYTES: u64 = 12;
/// Checksum behind the payload, bytes.
const FOOTER_BYTES: u64 = 4;
/// Longest payload that is believed, bytes: protobuf's own limit.
const LONGEST_PAYLOAD: u64 = i32::MAX as u64;

/// What is wrong with the framing.
#[derive(Debug, thiserror::Error)]
pub enum FramingFault {
    /// The file ends inside the record.
    #[error("the file ends inside the {part}: {needed} bytes needed, {left} left")]
    Truncated {
        /// Which part of the record is cut.
        part: &'static str,
        /// Its bytes.
        needed: u64,
        /// Bytes left in the file.
        left: u64,
    },
    /// The length does not match its checksum.
    #[error("the checksum of the length does not match (stored {stored:#010x}, computed {computed:#010x})")]
    LengthChecksum {
        /// As stored in the file.
        stored: u32,
        /// As computed from the length.
        computed: u32,
    },
    /// A length with a good checksum that no record can have.
    #[error("a payload of {0} bytes is longer than a protobuf message can be")]
    AbsurdLength(u64),
    /// The payload does not match its checksum.
    #[error("the checksum of the payload does not match (stored {stored:#010x}, computed {computed:#010x})")]
    PayloadChecksum {
        /// As stored in the file.
        stored: u32,
        /// As computed from the payload.
        computed: u32,
    },
    /// The file cannot be read.
    #[error("cannot read: {0}")]
    Read(#[from] io::Error),
}

/// A broken record and where it stands.
#[derive(Debug, thiserror::Error)]
#[error("record {record} at byte {offset}: {fault}")]
pub struct TfRecordError {
    /// Number of the record, from 0.
    pub record: usize,
    /// Offset of its first byte.
    pub offset: u64,
    /// What is wrong.
    #[source]
    pub fault: FramingFault,
}

/// One record whose checksums hold.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Record {
    /// Its number in the file, from 0.
    pub number: usize,
    /// Offset of its first byte.
    pub offset: u64,
    /// The payload.
    pub payload: Vec<u8>,
}

/// Reads records one after the other; ends after the last, or after the first broken one.
#[derive(Debug)]
pub struct Records<R> {
    reader: R,
    /// Bytes of the whole source.
    total: u64,
    offset: u64,
    number: usize,
    broken: bool,
}

impl Records<BufReader<File>> {
    /// Records of a file.
    ///
    /// # Errors
    /// When the file cannot be opened.
    pub fn open(path: &Path) -> io::Result<Self> {
        let file = File::open(path)?;
        let metadata = file.metadata()?;
        if metadata.is_dir() {
            return Err(io::Error::from(io::ErrorKind::IsADirectory));
        }
        Ok(Self::new(BufReader::new(file), metadata.len()))
    }
}

impl<R: Read> Records<R> {
    /// Records of a source of `total` bytes.
    pub fn new(reader: R, total: u64) -> Self {
        Self { reader, total, offset: 0, number: 0, broken: false }
    }

    /// Whether the source has no bytes at all.
    pub fn is_empty(&self) -> bool {
        self.total == 0
    }

    fn read_record(&mut self) -> Result<Record, FramingFault> {
        let offset = self.offset;
        let header: [u8; HEADER_BYTES as usize] = self.read_array("length")?;
        let [l0, l1, l2, l3, l4, l5, l6, l7, c0, c1, c2, c3] = header;
        let length_bytes = [l0, l1, l2, l3, l4, l5, l6, l7];
        let (stored, computed) = (u32::from_le_bytes([c0, c1, c2, c3]), masked_crc(&length_bytes));
        if stored != computed {
            return Err(FramingFault::LengthChecksum { stored, computed });
        }
        let length = u64::from_le_bytes(length_bytes);
        if length > LONGEST_PAYLOAD {
            return Err(FramingFault::AbsurdLength(length));
        }
        self.demand("payload", length)?;
        let mut payload = Vec::new();
        let got = self.reader.by_ref().take(length).read_to_end(&mut payload)? as u64;
        if got < length {
            return Err(FramingFault::Truncated { part: "payload", needed: length, left: got });
        }
        self.offset += length;
        let stored = u32::from_le_bytes(self.read_array::<{ FOOTER_BYTES as usize }>("checksum of the payload")?);
        let computed = masked_crc(&payload);
        if stored != computed {
            return Err(FramingFault::PayloadChecksum { stored, computed });
        }
        Ok(Record { number: self.number, offset, payload })
    }

    fn read_array<const N: usize>(&mut self, part: &'static str) -> Result<[u8; N], FramingFault> {
        self.demand(part, N as u64)?;
        let mut bytes = [0; N];
        self.reader.read_exact(&mut bytes)?;
        self.offset += N as u64;
        Ok(bytes)
    }

    /// Checks against the size of the source before anything is allocated.
    fn demand(&self, part: &'static str, needed: u64) -> Result<(), FramingFault> {
        let left = self.total.saturating_sub(self.offset);
        if needed > left { Err(FramingFault::Truncated { part, needed, left }) } else { Ok(()) }
    }
}

impl<R: Read> Iterator for Records<R> {
    type Item = Result<Record, TfRecordError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.broken || self.offset >= self.total {
            return None;
        }
        let (record, offset) = (self.number, self.offset);
        let read = self.read_record().map_err(|fault| TfRecordError { record, offset, fault });
        self.broken = read.is_err();
        self.number += 1;
        Some(read)
    }
}

/// TFRecord's checksum: CRC32C, rotated right by 15 bits, plus a constant.
fn masked_crc(bytes: &[u8]) -> u32 {
    crc32c::crc32c(bytes).rotate_right(15).wrapping_add(MASK_DELTA)
}

/// Frames a payload as a record.
#[cfg(test)]
pub(super) fn frame(payload: &[u8]) -> Vec<u8> {
    let length = (payload.len() as u64).to_le_bytes();
    let mut bytes = length.to_vec();
    bytes.extend(masked_crc(&length).to_le_bytes());
    bytes.extend(payload);
    bytes.extend(masked_crc(payload).to_le_bytes());
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn records(bytes: &[u8]) -> Vec<Result<Record, TfRecordError>> {
        Records::new(bytes, bytes.len() as u64).collect()
    }

    fn two_records() -> Vec<u8> {
        [frame(b"first payload"), frame(b"second")].concat()
    }

    #[test]
    fn an_empty_source_has_no_records() {
        assert!(records(&[]).is_empty());
    }

    #[test]
    fn several_records_come_with_number_and_offset() {
        let read: Vec<Record> = records(&two_records()).into_iter().map(Result::unwrap).collect();
        assert_eq!(read.len(), 2);
        assert_eq!(read[0], Record { number: 0, offset: 0, payload: b"first payload".to_vec() });
        assert_eq!(read[1], Record { number: 1, offset: 29, payload: b"second".to_vec() });
    }

    #[test]
    fn every_truncation_is_told_with_its_place() {
        let whole = two_records();
        for end in 1..whole.len() {
            let read = records(&whole[..end]);
            if end == 29 {
                assert!(read.len() == 1 && read[0].is_ok());
                continue;
            }
            let error = read.into_iter().find_map(Result::err).unwrap();
            let expected = if end < 29 { (0, 0) } else { (1, 29) };
            assert_eq!((error.record, error.offset), expected, "cut at {end}");
            assert!(matches!(error.fault, FramingFault::Truncated { .. }), "cut at {end}: {error}");
        }
    }

    #[test]
    fn every_flipped_bit_is_noticed() {
        let whole = frame(b"some payload of a record");
        for bit in 0..whole.len() * 8 {
            let mut bytes = whole.clone();
            bytes[bit / 8] ^= 1 << (bit % 8);
            let read = records(&bytes);
            assert!(matches!(&read[..], [Err(_)]), "bit {bit}: {read:?}");
        }
    }

    #[test]
    fn an_absurd_length_with_a_good_checksum_is_refused() {
        let length = u64::MAX.to_le_bytes();
        let bytes = [length.to_vec(), masked_crc(&length).to_le_bytes().to_vec(), vec![0; 64]].concat();
        let error = records(&bytes).remove(0).unwrap_err();
        assert!(matches!(error.fault, FramingFault::AbsurdLength(u64::MAX)), "{error}");
    }

    #[test]
    fn reading_stops_after_a_broken_record() {
        let mut bytes = two_records();
        bytes[20] ^= 1;
        assert_eq!(records(&bytes).len(), 1);
    }

    proptest! {
        #[test]
        fn any_bytes_are_read_without_panic(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            let _ = records(&bytes);
        }

        #[test]
        fn framed_payloads_come_back(payloads in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..80), 0..6)) {
            let bytes: Vec<u8> = payloads.iter().flat_map(|p| frame(p)).collect();
            let read: Vec<Vec<u8>> = records(&bytes).into_iter().map(|r| r.unwrap().payload).collect();
            prop_assert_eq!(read, payloads);
        }
    }
}
