//! What lies under the name of weights or of a small file and is something else, as downloads by a
//! wrong address leave it.

use planagent_files::{KIND_BYTES, binary_kind_of, is_pickle};

/// Texts that the hub and its mirrors answer with instead of a file.
const ANSWERS: [&str; 6] = [
    "Entry not found",
    "Repository not found",
    "Not Found",
    "Invalid username or password",
    "Invalid credentials",
    "Access to model",
];
/// Kinds of which more is to be said than what they are.
const ADVISED: [(&[u8], &str); 2] = [
    (b"GGUF", "a GGUF file; its name must end in .gguf"),
    (
        b"PK\x03\x04",
        "a zip archive, as torch's pickles are; take a repository or revision with safetensors",
    ),
];
const PICKLE: &str =
    "a Python pickle, which may run code; take a repository or revision with safetensors";

/// What a file is, by its beginning, instead of weights or JSON; none if nothing is known.
pub(crate) fn what_instead(beginning: &[u8]) -> Option<String> {
    const AGAIN: &str = "download the file again";
    // First the kinds with their own advice; the general list knows some of them by name alone.
    let advised = ADVISED
        .iter()
        .find(|(magic, _)| beginning.starts_with(magic));
    let kind = advised
        .map(|(_, kind)| *kind)
        .or_else(|| is_pickle(beginning).then_some(PICKLE))
        .or_else(|| binary_kind_of(beginning));
    if let Some(kind) = kind {
        return Some(format!("this is {kind}"));
    }
    let beginning = beginning
        .strip_prefix("\u{feff}".as_bytes())
        .unwrap_or(beginning);
    let text = String::from_utf8_lossy(beginning.get(..KIND_BYTES).unwrap_or(beginning));
    let text = text.trim_start();
    let line: String = text
        .lines()
        .next()
        .unwrap_or_default()
        .chars()
        .take(60)
        .collect();
    let line = line.escape_debug();
    if text.starts_with('<') {
        return Some(format!(
            "this is a web page (it begins with '{line}'), not the file; {AGAIN}"
        ));
    }
    if ANSWERS.iter().any(|answer| text.starts_with(answer)) {
        return Some(format!(
            "this is a server's answer ('{line}'), not the file; {AGAIN}"
        ));
    }
    None
}

/// The same for a file that must not be text: JSON is none either.
pub(crate) fn what_instead_of_weights(beginning: &[u8]) -> Option<String> {
    what_instead(beginning).or_else(|| {
        let text = String::from_utf8_lossy(beginning);
        let text = text.trim_start_matches('\u{feff}').trim_start();
        text.starts_with(['{', '['])
            .then(|| "this is JSON text, not weights; download the file again".to_owned())
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_file_of_weights_is_called_what_it_is() {
        for (beginning, said) in [
            (
                &b"<!DOCTYPE html>\n<html>"[..],
                "a web page (it begins with '<!DOCTYPE html>')",
            ),
            (b"\xef\xbb\xbf  <html lang=en>", "a web page"),
            (b"<?xml version=\"1.0\"?><Error>", "a web page"),
            (b"Entry not found", "a server's answer ('Entry not found')"),
            (
                b"Access to model org/name is restricted",
                "a server's answer",
            ),
            (b"{\"error\": \"Repository not found\"}", "JSON text"),
            (b"GGUF\x03\0\0\0", "a GGUF file"),
            (b"PK\x03\x04....", "a zip archive"),
            (b"\x80\x02}q\0", "a Python pickle"),
            (b"\x1f\x8b\x08", "gzip"),
            (&[0; 512], "full of zeros"),
            (b"tjgg\x03\0\0\0", "llama.cpp from before GGUF"),
            (b"\x89HDF\r\n\x1a\n", "an HDF5 file"),
        ] {
            let found = what_instead_of_weights(beginning).unwrap();
            assert!(
                found.starts_with("this is ") || found.contains("gzip"),
                "{found}"
            );
            assert!(found.contains(said), "{found}");
        }
        assert_eq!(what_instead_of_weights(b"\x40\0\0\0\0\0\0\0{\"a\":"), None);
        assert_eq!(what_instead(b"{}"), None);
        assert_eq!(what_instead_of_weights(b""), None);
    }
}
