//! Replies in UTF-16 and UTF-32, which clients that guess the encoding of JSON read, as those in
//! Python do.

use std::io::{self, Chain, Cursor, Read};

/// Most bytes of such a text. The reader of its UTF-8 has a limit of its own.
const MAX_BYTES: u64 = 16 << 20;
/// What a text may begin with, to say the order of its bytes.
const ORDER_MARK: char = '\u{feff}';

type Bytes = Box<dyn Read + Send>;

/// Bytes that are UTF-8, whatever they were. A text of another encoding is read whole before its
/// first byte.
pub(super) enum Utf8 {
    Unseen(Bytes),
    Same(Chain<Cursor<Vec<u8>>, Bytes>),
    Turned(Cursor<String>),
}

impl Utf8 {
    pub(super) fn new(bytes: Bytes) -> Self {
        Self::Unseen(bytes)
    }

    fn seen(mut bytes: Bytes) -> io::Result<Self> {
        let mut first = Vec::new();
        bytes.by_ref().take(4).read_to_end(&mut first)?;
        let Some(read) = reader_of(&first) else {
            return Ok(Self::Same(Cursor::new(first).chain(bytes)));
        };
        bytes.take(MAX_BYTES).read_to_end(&mut first)?;
        let text = read(&first);
        let text = text.strip_prefix(ORDER_MARK).unwrap_or(&text);
        Ok(Self::Turned(Cursor::new(text.to_owned())))
    }
}

/// How a text with these first bytes is read; none for UTF-8. Without a mark, JSON begins with two
/// characters of ASCII (RFC 4627, 3).
fn reader_of(first: &[u8]) -> Option<fn(&[u8]) -> String> {
    const ASCII: std::ops::RangeInclusive<u8> = 1..=0x7f;
    Some(match *first {
        [0xff, 0xfe, 0, 0] => |text| of_utf32(text, u32::from_le_bytes),
        [0, 0, 0xfe, 0xff] => |text| of_utf32(text, u32::from_be_bytes),
        [one, 0, 0, 0] if ASCII.contains(&one) => |text| of_utf32(text, u32::from_le_bytes),
        [0, 0, 0, one] if ASCII.contains(&one) => |text| of_utf32(text, u32::from_be_bytes),
        [0xff, 0xfe, ..] => |text| of_utf16(text, u16::from_le_bytes),
        [0xfe, 0xff, ..] => |text| of_utf16(text, u16::from_be_bytes),
        [one, 0, ..] if ASCII.contains(&one) => |text| of_utf16(text, u16::from_le_bytes),
        [0, one, ..] if ASCII.contains(&one) => |text| of_utf16(text, u16::from_be_bytes),
        _ => return None,
    })
}

fn of_utf16(bytes: &[u8], unit: fn([u8; 2]) -> u16) -> String {
    let (units, _) = bytes.as_chunks();
    char::decode_utf16(units.iter().map(|bytes| unit(*bytes)))
        .map(|read| read.unwrap_or(char::REPLACEMENT_CHARACTER))
        .collect()
}

fn of_utf32(bytes: &[u8], unit: fn([u8; 4]) -> u32) -> String {
    let (units, _) = bytes.as_chunks();
    let read = units.iter().map(|bytes| char::from_u32(unit(*bytes)));
    read.map(|read| read.unwrap_or(char::REPLACEMENT_CHARACTER))
        .collect()
}

impl Read for Utf8 {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if let Self::Unseen(bytes) = self {
            *self = Self::seen(std::mem::replace(bytes, Box::new(io::empty())))?;
        }
        match self {
            Self::Unseen(bytes) => bytes.read(buffer),
            Self::Same(bytes) => bytes.read(buffer),
            Self::Turned(text) => text.read(buffer),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(bytes: Vec<u8>) -> String {
        let mut text = String::new();
        let mut utf8 = Utf8::new(Box::new(Cursor::new(bytes)));
        utf8.read_to_string(&mut text).unwrap();
        text
    }

    #[test]
    fn a_text_is_read_in_each_encoding() {
        let text = "{\"content\": \"links 😀 ä\"}";
        let marked = format!("{ORDER_MARK}{text}");
        let short = |text: &str, unit: fn(u16) -> [u8; 2]| {
            text.encode_utf16().flat_map(unit).collect::<Vec<_>>()
        };
        let long = |text: &str, unit: fn(u32) -> [u8; 4]| {
            let units = text.chars().map(u32::from);
            units.flat_map(unit).collect::<Vec<_>>()
        };
        assert_eq!(read(text.as_bytes().to_vec()), text);
        assert_eq!(
            read(marked.as_bytes().to_vec()),
            marked,
            "UTF-8 is passed on"
        );
        for text in [text, &marked] {
            for bytes in [
                short(text, u16::to_le_bytes),
                short(text, u16::to_be_bytes),
                long(text, u32::to_le_bytes),
                long(text, u32::to_be_bytes),
            ] {
                assert_eq!(read(bytes), text.trim_start_matches(ORDER_MARK));
            }
        }
        for short in ["", "a", "ab", "abc"] {
            assert_eq!(read(short.into()), short);
        }
    }
}
