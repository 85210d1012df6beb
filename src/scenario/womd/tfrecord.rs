//! The TFRecord container: framing and both checksums.
//!
//! A file is a sequence of records, each `{u64 length, u32 masked CRC32C of the length, payload,
//! u32 masked CRC32C of the payload}`, little endian. Both checksums are verified, that of the
//! length before the length is used. Of a file that is unpacked while it is read, the size is not
//! known before its end.

use std::io::{self, Read, Seek};

/// Added to a rotated checksum by the TFRecord format ("masking").
const MASK_DELTA: u32 = 0xa282_ead8;
/// Length field and its checksum, bytes.
const HEADER_BYTES: u64 = 12;
/// Checksum behind the payload, bytes.
const FOOTER_BYTES: u64 = 4;
/// Maximum length of a payload, bytes: protobuf's limit.
const MAX_PAYLOAD: u64 = i32::MAX as u64;
/// The same where the size of the file does not bound it: a few bytes may unpack to very many.
const MAX_UNPACKED_PAYLOAD: u64 = 256 << 20;

/// What is wrong with the framing.
#[derive(Debug, thiserror::Error)]
pub enum FramingFault {
    #[error("the file ends inside the {part}: {needed} bytes needed, {left} left")]
    Truncated {
        part: &'static str,
        needed: u64,
        left: u64,
    },
    #[error(
        "the checksum of the {part} does not match (stored {stored:#010x}, computed {computed:#010x})"
    )]
    Checksum {
        part: &'static str,
        stored: u32,
        computed: u32,
    },
    /// The checksum of the length matches.
    #[error("a payload of {0} bytes is longer than a protobuf message can be")]
    TooLong(u64),
    #[error("cannot read: {0}")]
    Read(#[from] io::Error),
}

/// A record, or the fault at its place.
#[derive(Debug)]
pub(super) struct Record {
    /// From 0.
    pub(super) number: usize,
    /// Offset of its first byte.
    pub(super) offset: u64,
    pub(super) payload: Result<Vec<u8>, FramingFault>,
}

/// Reads records one after the other. Ends after the last, or after the first broken one.
#[derive(Debug)]
pub(super) struct Records<R> {
    reader: R,
    /// Size of the source, bytes; none if only its end tells it.
    total: Option<u64>,
    /// The byte that was read to learn whether the source has ended.
    ahead: Option<u8>,
    offset: u64,
    number: usize,
    broken: bool,
}

impl<R: Read> Records<R> {
    /// The records of a source of this size, if it is known.
    pub(super) fn new(reader: R, total: impl Into<Option<u64>>) -> Self {
        Self {
            reader,
            total: total.into(),
            ahead: None,
            offset: 0,
            number: 0,
            broken: false,
        }
    }

    /// Whether there is no further record.
    pub(super) fn has_ended(&mut self) -> bool {
        if let Some(total) = self.total {
            return self.offset >= total;
        }
        if self.ahead.is_some() {
            return false;
        }
        let mut byte = [0];
        loop {
            match self.reader.read(&mut byte) {
                Ok(0) => {
                    self.total = Some(self.offset);
                    return true;
                }
                Ok(_) => {
                    self.ahead = Some(byte[0]);
                    return false;
                }
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                // The record that begins here has this error: a cut archive has no end.
                Err(_) => return false,
            }
        }
    }

    /// The length of the next payload, whose own checksum is verified.
    fn read_length(&mut self) -> Result<u64, FramingFault> {
        let header: [u8; HEADER_BYTES as usize] = self.read_array("length")?;
        let [l0, l1, l2, l3, l4, l5, l6, l7, c0, c1, c2, c3] = header;
        let length_bytes = [l0, l1, l2, l3, l4, l5, l6, l7];
        let (stored, computed) = (
            u32::from_le_bytes([c0, c1, c2, c3]),
            masked_crc(&length_bytes),
        );
        if stored != computed {
            return Err(FramingFault::Checksum {
                part: "length",
                stored,
                computed,
            });
        }
        let length = u64::from_le_bytes(length_bytes);
        let max = if self.total.is_some() {
            MAX_PAYLOAD
        } else {
            MAX_UNPACKED_PAYLOAD
        };
        if length > max {
            return Err(FramingFault::TooLong(length));
        }
        self.demand("payload", length)?;
        Ok(length)
    }

    fn read_payload(&mut self) -> Result<Vec<u8>, FramingFault> {
        let length = self.read_length()?;
        let mut payload = Vec::new();
        let got = self
            .reader
            .by_ref()
            .take(length)
            .read_to_end(&mut payload)? as u64;
        if got < length {
            return Err(FramingFault::Truncated {
                part: "payload",
                needed: length,
                left: got,
            });
        }
        self.offset += length;
        let stored = u32::from_le_bytes(
            self.read_array::<{ FOOTER_BYTES as usize }>("checksum of the payload")?,
        );
        let computed = masked_crc(&payload);
        if stored != computed {
            return Err(FramingFault::Checksum {
                part: "payload",
                stored,
                computed,
            });
        }
        Ok(payload)
    }

    fn read_array<const N: usize>(&mut self, part: &'static str) -> Result<[u8; N], FramingFault> {
        self.demand(part, N as u64)?;
        let mut bytes = [0; N];
        let mut filled = 0;
        if let (Some(byte), Some(first)) = (self.ahead.take(), bytes.first_mut()) {
            *first = byte;
            filled = 1;
        }
        self.reader
            .read_exact(&mut bytes[filled..])
            .map_err(|error| match error.kind() {
                io::ErrorKind::UnexpectedEof => FramingFault::Truncated {
                    part,
                    needed: N as u64,
                    left: filled as u64,
                },
                _ => FramingFault::Read(error),
            })?;
        self.offset += N as u64;
        Ok(bytes)
    }

    /// Checks against the size of the source before anything is allocated.
    fn demand(&self, part: &'static str, needed: u64) -> Result<(), FramingFault> {
        let Some(total) = self.total else {
            return Ok(());
        };
        let left = total.saturating_sub(self.offset);
        if needed > left {
            Err(FramingFault::Truncated { part, needed, left })
        } else {
            Ok(())
        }
    }
}

impl<R: Read + Seek> Records<R> {
    /// Skips records without reading their payloads, until the next one has this number. Gives the
    /// record whose length is broken, which is the last.
    pub(super) fn skip_to(&mut self, number: usize) -> Option<Record> {
        while self.number < number && !self.has_ended() {
            let (own, offset) = (self.number, self.offset);
            let skipped = self.read_length().and_then(|length| {
                let bytes = length + FOOTER_BYTES;
                self.demand("payload", bytes)?;
                self.reader.seek_relative(
                    i64::try_from(bytes).map_err(|_| FramingFault::TooLong(length))?,
                )?;
                self.offset += bytes;
                Ok(())
            });
            if let Err(fault) = skipped {
                self.broken = true;
                return Some(Record {
                    number: own,
                    offset,
                    payload: Err(fault),
                });
            }
            self.number += 1;
        }
        None
    }

    /// Number of the next record: after [`Self::skip_to`] beyond the end, the number of records.
    pub(super) fn number(&self) -> usize {
        self.number
    }
}

impl<R: Read> Iterator for Records<R> {
    type Item = Record;

    fn next(&mut self) -> Option<Self::Item> {
        if self.broken || self.has_ended() {
            return None;
        }
        let (number, offset) = (self.number, self.offset);
        let payload = self.read_payload();
        self.broken = payload.is_err();
        self.number += 1;
        Some(Record {
            number,
            offset,
            payload,
        })
    }
}

/// Whether a file with this beginning is one of records: the checksum of the first length matches.
pub(super) fn is_header(beginning: &[u8]) -> bool {
    let Some((header, _)) = beginning.split_first_chunk::<{ HEADER_BYTES as usize }>() else {
        return false;
    };
    let (length, stored) = header.split_at(8);
    stored == masked_crc(length).to_le_bytes()
}

/// TFRecord's checksum: CRC32C, rotated right by 15 bits, plus a constant.
fn masked_crc(bytes: &[u8]) -> u32 {
    crc32c::crc32c(bytes)
        .rotate_right(15)
        .wrapping_add(MASK_DELTA)
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

    fn records(bytes: &[u8]) -> Vec<Record> {
        Records::new(bytes, bytes.len() as u64).collect()
    }

    #[test]
    fn a_source_of_unknown_size_ends_where_its_bytes_end() {
        let whole = two_records();
        let read: Vec<Record> = Records::new(&whole[..], None::<u64>).collect();
        assert_eq!(read.len(), 2);
        assert_eq!((read[1].number, read[1].offset), (1, 29));
        assert!(read.iter().all(|record| record.payload.is_ok()));
        assert!(Records::new(&[][..], None::<u64>).next().is_none());
        for end in (1..whole.len()).filter(|end| *end != 29) {
            let broken = Records::new(&whole[..end], None::<u64>)
                .find(|record| record.payload.is_err())
                .unwrap();
            assert!(
                matches!(broken.payload, Err(FramingFault::Truncated { .. })),
                "cut at {end}: {broken:?}"
            );
        }
        let length = (1_u64 << 30).to_le_bytes();
        let absurd = [length.to_vec(), masked_crc(&length).to_le_bytes().to_vec()].concat();
        let payload = Records::new(&absurd[..], None::<u64>)
            .next()
            .unwrap()
            .payload;
        assert!(
            matches!(payload, Err(FramingFault::TooLong(_))),
            "{payload:?}"
        );
        assert!(is_header(&whole) && !is_header(&whole[1..]) && !is_header(b"short"));
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
        let read = records(&two_records());
        assert_eq!(read.len(), 2);
        assert_eq!((read[0].number, read[0].offset), (0, 0));
        assert_eq!((read[1].number, read[1].offset), (1, 29));
        let payloads: Vec<Vec<u8>> = read
            .into_iter()
            .map(|record| record.payload.unwrap())
            .collect();
        assert_eq!(payloads, [b"first payload".to_vec(), b"second".to_vec()]);
    }

    #[test]
    fn every_truncation_is_reported_with_its_place() {
        let whole = two_records();
        for end in 1..whole.len() {
            let read = records(&whole[..end]);
            if end == 29 {
                assert!(read.len() == 1 && read[0].payload.is_ok());
                continue;
            }
            let broken = read
                .into_iter()
                .find(|record| record.payload.is_err())
                .unwrap();
            let expected = if end < 29 { (0, 0) } else { (1, 29) };
            assert_eq!((broken.number, broken.offset), expected, "cut at {end}");
            assert!(
                matches!(broken.payload, Err(FramingFault::Truncated { .. })),
                "cut at {end}: {broken:?}"
            );
        }
    }

    #[test]
    fn every_flipped_bit_is_noticed() {
        let whole = frame(b"some payload of a record");
        for bit in 0..whole.len() * 8 {
            let mut bytes = whole.clone();
            bytes[bit / 8] ^= 1 << (bit % 8);
            let read = records(&bytes);
            assert!(
                matches!(
                    &read[..],
                    [Record {
                        payload: Err(_),
                        ..
                    }]
                ),
                "bit {bit}: {read:?}"
            );
        }
    }

    #[test]
    fn an_absurd_length_with_a_good_checksum_is_refused() {
        let length = u64::MAX.to_le_bytes();
        let bytes = [
            length.to_vec(),
            masked_crc(&length).to_le_bytes().to_vec(),
            vec![0; 64],
        ]
        .concat();
        let payload = records(&bytes).remove(0).payload;
        assert!(
            matches!(payload, Err(FramingFault::TooLong(u64::MAX))),
            "{payload:?}"
        );
    }

    #[test]
    fn a_record_is_reached_over_broken_payloads_before_it() {
        let mut bytes = two_records();
        bytes[20] ^= 1;
        let mut records = Records::new(io::Cursor::new(&bytes), bytes.len() as u64);
        assert!(records.skip_to(1).is_none());
        let second = records.next().unwrap();
        assert_eq!(
            (second.number, second.offset, second.payload.unwrap()),
            (1, 29, b"second".to_vec())
        );
        let mut records = Records::new(io::Cursor::new(&bytes), bytes.len() as u64);
        assert!(records.skip_to(9).is_none());
        assert!(records.number() == 2 && records.next().is_none());
        bytes[3] ^= 1;
        let mut records = Records::new(io::Cursor::new(&bytes), bytes.len() as u64);
        let broken = records.skip_to(1).unwrap();
        assert!(
            matches!(
                broken.payload,
                Err(FramingFault::Checksum { part: "length", .. })
            ) && records.next().is_none()
        );
        let cut = &two_records()[..27];
        let mut records = Records::new(io::Cursor::new(cut), cut.len() as u64);
        assert!(matches!(
            records.skip_to(1).unwrap().payload,
            Err(FramingFault::Truncated { .. })
        ));
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
            let read: Vec<Vec<u8>> = records(&bytes).into_iter().map(|r| r.payload.unwrap()).collect();
            prop_assert_eq!(read, payloads);
        }
    }
}
