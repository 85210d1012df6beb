//! Paths as words: of the command line, of manifests and of results, which are text. A path need
//! not be UTF-8.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};

/// First of the 128 private characters that stand for the bytes 0x80 to 0xff of a path that is not
/// UTF-8.
const FIRST: u32 = 0xef80;

/// A path as a word, from which [`path_of`] gives the path again.
#[cfg(unix)]
pub fn word_of(path: &OsStr) -> String {
    use std::os::unix::ffi::OsStrExt;
    let stand_in = |byte: &u8| {
        char::from_u32(FIRST + u32::from(*byte) - 0x80).unwrap_or(char::REPLACEMENT_CHARACTER)
    };
    let mut word = String::new();
    for chunk in path.as_bytes().utf8_chunks() {
        word.push_str(chunk.valid());
        word.extend(chunk.invalid().iter().map(stand_in));
    }
    word
}

/// A path as a word.
#[cfg(not(unix))]
pub fn word_of(path: &OsStr) -> String {
    path.to_string_lossy().into_owned()
}

/// The path of a word.
#[cfg(unix)]
pub fn path_of(word: &str) -> PathBuf {
    use std::ffi::OsString;
    use std::os::unix::ffi::OsStringExt;
    let byte = |c: char| u8::try_from(u32::from(c).checked_sub(FIRST)? + 0x80).ok();
    // A name may have these characters itself.
    if !word.chars().any(|c| byte(c).is_some()) || Path::new(word).exists() {
        return PathBuf::from(word);
    }
    let mut bytes = Vec::with_capacity(word.len());
    for c in word.chars() {
        match byte(c) {
            Some(byte) => bytes.push(byte),
            None => bytes.extend_from_slice(c.encode_utf8(&mut [0; 4]).as_bytes()),
        }
    }
    OsString::from_vec(bytes).into()
}

/// The path of a word.
#[cfg(not(unix))]
pub fn path_of(word: &str) -> PathBuf {
    PathBuf::from(word)
}

/// An optional path as a word, for serde.
pub mod serde_path {
    use serde::{Deserialize, Deserializer, Serialize, Serializer};
    use std::path::PathBuf;

    /// Writes the word of a path.
    #[allow(clippy::ref_option, reason = "serde passes a reference")]
    pub fn serialize<S: Serializer>(
        path: &Option<PathBuf>,
        serializer: S,
    ) -> Result<S::Ok, S::Error> {
        path.as_ref()
            .map(|path| super::word_of(path.as_os_str()))
            .serialize(serializer)
    }

    /// Reads the word of a path.
    pub fn deserialize<'de, D: Deserializer<'de>>(
        deserializer: D,
    ) -> Result<Option<PathBuf>, D::Error> {
        Ok(Option::<String>::deserialize(deserializer)?.map(|word| super::path_of(&word)))
    }
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use std::os::unix::ffi::OsStrExt;

    #[test]
    fn every_path_survives_as_a_word() {
        for bytes in [
            &b"a/b.db"[..],
            "ü/汉".as_bytes(),
            b"\xff\x80/\xc3(.tfrecord",
            b"\xe6\xb1",
            b"",
        ] {
            let path = OsStr::from_bytes(bytes);
            assert_eq!(path_of(&word_of(path)).as_os_str(), path);
        }
        assert_eq!(word_of(OsStr::new("a/ü")), "a/ü");
    }
}
