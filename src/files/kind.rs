//! What a file is by its first bytes, for messages about files of another kind than their names
//! say: a download that is a web page, an archive, what a system leaves beside other files.

/// Bytes that decide.
pub const KIND_BYTES: usize = 512;
/// Bytes of a text that are looked at.
const TEXT_BYTES: usize = 64;
/// What a text is, of which nothing else is known.
pub const TEXT: &str = "a text";
/// Fewest bytes of a text: some bytes of a cut file may be letters by chance.
const MIN_TEXT_BYTES: usize = 8;

/// Kinds by their first bytes, the longer before the shorter.
const KINDS: &[(&[u8], &str)] = &[
    (
        b"\x00\x05\x16\x07",
        "what macOS keeps beside a file on other disks (._NAME)",
    ),
    (b"\x00\x00\x00\x01Bud1", "a .DS_Store of macOS"),
    (b"\xd0\xcf\x11\xe0", "a file of Windows, such as Thumbs.db"),
    (b"PK\x03\x04", "a ZIP archive: unpack it"),
    (b"PK\x05\x06", "an empty ZIP archive"),
    (b"\x1f\x8b", "compressed by gzip: unpack it"),
    (b"\x28\xb5\x2f\xfd", "compressed by Zstandard: unpack it"),
    (b"\x04\x22\x4d\x18", "compressed by LZ4: unpack it"),
    (b"BZh", "compressed by bzip2: unpack it"),
    (b"\xfd7zXZ\x00", "compressed by xz: unpack it"),
    (b"7z\xbc\xaf\x27\x1c", "a 7-Zip archive: unpack it"),
    (b"Rar!", "a RAR archive: unpack it"),
    (b"SQLite format 3\x00", "an SQLite database"),
    (b"PAR1", "a Parquet file"),
    (b"ARROW1", "a Feather file"),
    (b"FEA1", "a Feather file of version 1"),
    (b"\x89HDF\r\n", "an HDF5 file"),
    (b"\x89MCAP0", "an MCAP recording"),
    (b"#ROSBAG", "a ROS bag"),
    (b"GGUF", "a GGUF file, a language model"),
    (b"\x89PNG", "a PNG picture"),
    (b"\xff\xd8\xff", "a JPEG picture"),
    (b"%PDF", "a PDF document"),
    (b"tjgg", OLD_LLAMA),
    (b"fmgg", OLD_LLAMA),
    (b"lmgg", OLD_LLAMA),
    (b"algg", OLD_LLAMA),
    (
        b"version https://git-lfs",
        "a pointer of git-lfs: run `git lfs pull` in its repository",
    ),
];
/// Files with the marks `ggjt`, `ggmf`, `ggml` and `ggla`.
const OLD_LLAMA: &str = "a file of llama.cpp from before GGUF: take the model as GGUF";
/// A Python pickle begins with this byte, the version of its protocol, and a first instruction.
const PICKLE: u8 = 0x80;
const PICKLE_PROTOCOLS: std::ops::RangeInclusive<u8> = 2..=5;
/// What marks a tar archive, and where.
const TAR: (usize, &[u8]) = (257, b"ustar");

/// Whether a file begins as a Python pickle does. The length of the header of a safetensors file
/// may have the same first bytes: a zero follows there.
pub fn is_pickle(beginning: &[u8]) -> bool {
    matches!(beginning, [PICKLE, protocol, instruction, ..]
        if PICKLE_PROTOCOLS.contains(protocol) && *instruction != 0)
}

/// What a file with this beginning is, in words; `None` if nothing is known.
pub fn kind_of(beginning: &[u8]) -> Option<&'static str> {
    let looked_at = beginning.get(..KIND_BYTES).unwrap_or(beginning);
    binary_kind_of(beginning).or_else(|| of_text(looked_at))
}

/// As [`kind_of`], by marks alone: a text without a mark is of no known kind.
pub fn binary_kind_of(beginning: &[u8]) -> Option<&'static str> {
    if let Some((_, kind)) = KINDS.iter().find(|(magic, _)| beginning.starts_with(magic)) {
        return Some(kind);
    }
    if is_pickle(beginning) {
        return Some("a Python pickle");
    }
    let (at, mark) = TAR;
    if beginning
        .get(at..)
        .is_some_and(|rest| rest.starts_with(mark))
    {
        return Some("a tar archive: unpack it");
    }
    let looked_at = beginning.get(..KIND_BYTES).unwrap_or(beginning);
    if looked_at.len() >= TEXT_BYTES && looked_at.iter().all(|byte| *byte == 0) {
        return Some("full of zeros, as an unfinished download leaves it: download it again");
    }
    None
}

/// What a text is.
fn of_text(beginning: &[u8]) -> Option<&'static str> {
    let beginning = beginning.strip_prefix(b"\xef\xbb\xbf").unwrap_or(beginning);
    let looked_at = beginning.get(..TEXT_BYTES).unwrap_or(beginning);
    let text = match std::str::from_utf8(looked_at) {
        Ok(text) => text,
        // A character may be cut at the end.
        Err(error) if error.error_len().is_none() => {
            std::str::from_utf8(&looked_at[..error.valid_up_to()]).unwrap_or("")
        }
        Err(_) => return None,
    };
    let printable = |c: char| !c.is_control() || c.is_whitespace();
    if text.len() < MIN_TEXT_BYTES || !text.chars().all(printable) {
        return None;
    }
    let text = text.trim_start();
    if text.starts_with('<') {
        Some("a web page, perhaps the error of a download: download it again")
    } else if text.starts_with(['{', '[']) {
        Some("a JSON text")
    } else {
        Some(TEXT)
    }
}

/// Whether a file's name is one of those that systems hide: it begins with a dot.
pub fn is_hidden(name: &str) -> bool {
    name.starts_with('.')
}

/// Whether a name is that of a download that has not ended, as browsers and other programs write
/// it.
pub fn is_unfinished(name: &str) -> bool {
    const ENDINGS: [&str; 9] = [
        ".part",
        ".partial",
        ".crdownload",
        ".download",
        ".incomplete",
        ".aria2",
        ".opdownload",
        ".gstmp",
        ".tmp",
    ];
    let name = name.to_ascii_lowercase();
    ENDINGS.iter().any(|ending| name.ends_with(ending))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_are_called_what_they_are() {
        for (beginning, said) in [
            (&b"\x00\x05\x16\x07\x00\x02\x00\x00Mac OS X"[..], "macOS"),
            (b"\x00\x00\x00\x01Bud1\x00", "DS_Store"),
            (b"PK\x03\x04\x14\x00", "ZIP"),
            (b"\x1f\x8b\x08\x00", "gzip"),
            (b"SQLite format 3\x00\x10\x00", "SQLite"),
            (b"PAR1\x15\x04", "Parquet"),
            (b"<!DOCTYPE html>", "web page"),
            (b"\xef\xbb\xbf \n<html>", "web page"),
            (b"{\"error\": 1}", "JSON"),
            (b"Not Found", "a text"),
            ("Für alle".as_bytes(), "a text"),
            (b"version https://git-lfs.github.com/spec/v1\n", "git-lfs"),
            (&[0; 600], "zeros"),
            (b"\x80\x02}q\0", "pickle"),
            (b"\x80\x04\x95\x10", "pickle"),
            (b"tjgg\x03\0\0\0", "before GGUF"),
        ] {
            let kind = kind_of(beginning).unwrap_or_default();
            assert!(kind.contains(said), "{beginning:?}: {kind}");
        }
        let mut tar = vec![b'a'; 512];
        tar[100..124].fill(0);
        tar[257..262].copy_from_slice(b"ustar");
        assert_eq!(kind_of(&tar), Some("a tar archive: unpack it"));
        for unknown in [
            &b""[..],
            b"\x12\x00\x00\x00",
            b"\xd8\x02\x00\x00\x00\x00\x00\x00",
            b"\0\0",
            b"%\x02",
            b"abc",
            // Headers of safetensors of 640 and 642 bytes.
            b"\x80\x02\0\0\0\0\0\0{",
            b"\x82\x02\0\0\0\0\0\0{",
        ] {
            assert_eq!(kind_of(unknown), None, "{unknown:?}");
        }
    }

    #[test]
    fn unfinished_downloads_are_known_by_name() {
        for name in [
            "a.tfrecord-00000-of-00150.crdownload",
            "a.db.part",
            "a.tfrecord_.gstmp",
            "A.TFRECORD.TMP",
        ] {
            assert!(is_unfinished(name), "{name}");
        }
        assert!(!is_unfinished("a.tfrecord-00000-of-00150") && !is_unfinished("part.db"));
        assert!(is_hidden("._a.db") && is_hidden(".DS_Store") && !is_hidden("a.db"));
    }
}
