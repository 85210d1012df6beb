//! The words that people use for a repository of the hub: ids, and the forms of `huggingface_hub`,
//! llama.cpp and Ollama.

use std::path::Path;

/// What a word names.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub(in crate::registry) struct HubName {
    /// `organization/name`, or `name` alone.
    pub id: String,
    /// Branch, tag or commit.
    pub revision: Option<String>,
    /// A GGUF file by its path in the repository.
    pub file: Option<String>,
    /// A GGUF file by its weight format, as llama.cpp names it behind a colon.
    pub quant: Option<String>,
}

impl HubName {
    /// The word that names the same without a scheme.
    pub(in crate::registry) fn word(&self) -> String {
        let mut word = self.id.clone();
        let parts = [('@', &self.revision), ('/', &self.file), (':', &self.quant)];
        for (mark, part) in parts {
            if let Some(part) = part {
                word.push(mark);
                word.push_str(part);
            }
        }
        word
    }
}

/// `organization/name`, perhaps with `@revision`, and with `:QUANT` or `/file.gguf`; or the name of
/// its folder in a cache.
pub(in crate::registry) fn plain(word: &str) -> Option<HubName> {
    let word = word.trim().trim_end_matches('/');
    if let Some(folder) = word.strip_prefix("models--") {
        return of_uri(&folder.replace("--", "/"));
    }
    // A name with the extension of a file means a file that does not exist.
    if split_id(word).is_some() && is_gguf_word(word) {
        return None;
    }
    of_uri(word)
}

/// The form of `hf://` addresses, without the prefix.
pub(super) fn of_uri(body: &str) -> Option<HubName> {
    let body = body.strip_prefix("models/").unwrap_or(body);
    let owner_end = body.find('/')?;
    let name_end = body[owner_end + 1..]
        .find(['@', ':', '/'])
        .map_or(body.len(), |end| owner_end + 1 + end);
    let (id, rest) = body.split_at(name_end);
    split_id(id)?;
    with_rest(id, rest)
}

/// The form of `hf://` addresses for a repository without an organization.
pub(super) fn of_bare_uri(body: &str) -> Option<HubName> {
    let (id, rest) = body.split_at(body.find(['@', ':', '/']).unwrap_or(body.len()));
    is_bare(id).then(|| with_rest(id, rest)).flatten()
}

/// A repository with what follows its id: `@revision`, and `:QUANT` or `/file.gguf`.
fn with_rest(id: &str, mut rest: &str) -> Option<HubName> {
    let mut name = HubName {
        id: id.to_owned(),
        ..HubName::default()
    };
    if let Some(behind) = rest.strip_prefix('@') {
        let end = end_of_revision(behind);
        let (revision, behind) = behind.split_at(end);
        name.revision = Some(revision_of(revision)?);
        rest = behind;
    }
    if let Some(quant) = rest.strip_prefix(':') {
        let plain = |byte: u8| byte.is_ascii_alphanumeric() || b"_-.".contains(&byte);
        if quant.is_empty() || !quant.bytes().all(plain) {
            return None;
        }
        // Ollama's word for the default; the files of the repository are listed then.
        name.quant = (!quant.eq_ignore_ascii_case("latest")).then(|| quant.to_owned());
    } else if let Some(file) = rest.strip_prefix('/') {
        name.file = Some(file_of(file)?);
    } else if !rest.is_empty() {
        return None;
    }
    Some(name)
}

/// Where a revision behind `@` ends: at a slash or a colon, but not inside `refs/pr/1`.
fn end_of_revision(text: &str) -> usize {
    let special = ["refs/pr/", "refs/convert/", "refs/heads/", "refs/tags/"]
        .iter()
        .find(|prefix| text.starts_with(**prefix))
        .map_or(0, |prefix| prefix.len());
    text[special..]
        .find(['/', ':'])
        .map_or(text.len(), |end| special + end)
}

/// A revision, with `%2F` as a slash. It becomes a part of a path.
pub(super) fn revision_of(text: &str) -> Option<String> {
    let text = decoded(text);
    let part = |part: &str| !part.is_empty() && !part.starts_with('.');
    let plain = |c: char| c.is_ascii_alphanumeric() || "._-+/".contains(c);
    (text.chars().all(plain) && text.split('/').all(part)).then_some(text)
}

/// The path of a GGUF file inside a repository.
pub(super) fn file_of(path: &str) -> Option<String> {
    let part = |part: &str| !part.is_empty() && !part.starts_with('.') && !part.contains('\\');
    (is_gguf_word(path) && path.split('/').all(part)).then(|| path.to_owned())
}

fn is_gguf_word(path: &str) -> bool {
    is_gguf(Path::new(path))
}

/// A text with its `%XX` replaced; broken ones stay.
pub(super) fn decoded(text: &str) -> String {
    let bytes = text.as_bytes();
    let (mut out, mut at) = (Vec::new(), 0);
    while let Some(&byte) = bytes.get(at) {
        let hex = bytes
            .get(at + 1..at + 3)
            .and_then(|hex| std::str::from_utf8(hex).ok())
            .and_then(|hex| u8::from_str_radix(hex, 16).ok());
        match hex {
            Some(value) if byte == b'%' => {
                out.push(value);
                at += 3;
            }
            _ => {
                out.push(byte);
                at += 1;
            }
        }
    }
    String::from_utf8(out).unwrap_or_else(|_| text.to_owned())
}

/// Whether a path names a GGUF file.
pub(in crate::registry) fn is_gguf(path: &Path) -> bool {
    path.extension()
        .is_some_and(|extension| extension.eq_ignore_ascii_case("gguf"))
}

/// Splits `organization/name`.
pub(super) fn split_id(id: &str) -> Option<(&str, &str)> {
    id.split_once('/')
        .filter(|(owner, name)| is_part(owner) && is_part(name))
}

/// Whether an id is one without an organization. Two hyphens would make its folder in a cache that
/// of another id.
pub(super) fn is_bare(id: &str) -> bool {
    is_part(id) && !id.contains("--") && !is_gguf_word(id)
}

/// Whether a text may be an organization or the name of a repository.
fn is_part(text: &str) -> bool {
    !text.is_empty()
        && !text.starts_with(['.', '-'])
        && text
            .chars()
            .all(|character| character.is_ascii_alphanumeric() || ".-_".contains(character))
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    pub(in crate::registry::hub) fn name(
        id: &str,
        revision: &str,
        file: &str,
        quant: &str,
    ) -> HubName {
        let some = |text: &str| (!text.is_empty()).then(|| text.to_owned());
        HubName {
            id: id.to_owned(),
            revision: some(revision),
            file: some(file),
            quant: some(quant),
        }
    }

    #[test]
    fn plain_words_have_a_revision_a_file_or_a_format() {
        for (word, expected) in [
            ("org/n", name("org/n", "", "", "")),
            ("org/n@v1", name("org/n", "v1", "", "")),
            ("org/n:Q8_0", name("org/n", "", "", "Q8_0")),
            ("org/n:UD-Q4_K_XL", name("org/n", "", "", "UD-Q4_K_XL")),
            (
                "org/n@refs/pr/1:Q8_0",
                name("org/n", "refs/pr/1", "", "Q8_0"),
            ),
            ("org/n/a.gguf", name("org/n", "", "a.gguf", "")),
            ("org/n@v1/b/a.GGUF", name("org/n", "v1", "b/a.GGUF", "")),
        ] {
            assert_eq!(plain(word), Some(expected.clone()), "{word}");
            assert_eq!(plain(&expected.word()), Some(expected), "{word}");
        }
        for word in [
            "",
            "a b",
            "org",
            "org/n.gguf",
            "org/n/c",
            "org/n/../c.gguf",
            "org/n:",
            "org/n:a b",
            "org/n@",
            "org/n@../..",
            "a/b/../c.gguf",
            "C:/n/a.gguf",
            "org/n/b\\a.gguf",
        ] {
            assert_eq!(plain(word), None, "{word}");
        }
    }

    #[test]
    fn a_broken_escape_stays() {
        assert_eq!(decoded("a%2Fb%zz%4"), "a/b%zz%4");
        assert_eq!(decoded("%C3%A9%"), "é%");
        assert_eq!(decoded("%FF"), "%FF");
    }
}
