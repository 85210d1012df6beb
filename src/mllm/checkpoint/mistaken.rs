//! What lies under the name of weights or of a small file and is something else, as downloads by a
//! wrong address leave it.

/// Bytes that decide.
pub(crate) const LOOKED_AT: usize = 512;

/// Texts that the hub and its mirrors answer with instead of a file.
const ANSWERS: [&str; 6] = [
    "Entry not found",
    "Repository not found",
    "Not Found",
    "Invalid username or password",
    "Invalid credentials",
    "Access to model",
];
/// Files of other kinds by their first bytes.
const KINDS: [(&[u8], &str); 5] = [
    (b"GGUF", "a GGUF file; its name must end in .gguf"),
    (
        b"PK\x03\x04",
        "a zip archive, as torch's pickles are; take a repository or revision with safetensors",
    ),
    (
        b"\x80\x02",
        "a Python pickle, which may run code; take a repository or revision with safetensors",
    ),
    (b"\x1f\x8b", "compressed by gzip; decompress it first"),
    (
        b"\x28\xb5\x2f\xfd",
        "compressed by Zstandard; decompress it first",
    ),
];

/// What a file is, by its beginning, instead of weights or JSON; none if nothing is known.
pub(crate) fn what_instead(beginning: &[u8]) -> Option<String> {
    const AGAIN: &str = "download the file again";
    if let Some((_, kind)) = KINDS.iter().find(|(magic, _)| beginning.starts_with(magic)) {
        return Some(format!("this is {kind}"));
    }
    let beginning = beginning
        .strip_prefix("\u{feff}".as_bytes())
        .unwrap_or(beginning);
    let text = String::from_utf8_lossy(beginning.get(..LOOKED_AT).unwrap_or(beginning));
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
