//! The words that people use for a repository of the hub: ids, addresses of its pages, and the
//! forms of `huggingface_hub`, llama.cpp and Ollama.

use super::environment::{Environment, PUBLIC_HUB};
use std::path::Path;

/// Prefixes that leave no doubt, in small letters.
const HOSTS: [&str; 3] = ["huggingface.co", "www.huggingface.co", "hf.co"];
/// As people copy it from a command of llama.cpp.
const COMMANDS: [&str; 3] = ["-hf ", "-hfr ", "--hf-repo "];
/// What is not a model, as the hub's addresses name it.
const OTHER_KINDS: [(&str, &str); 5] = [
    ("datasets", "a dataset"),
    ("spaces", "a space"),
    ("kernels", "a kernel"),
    ("buckets", "a bucket"),
    ("collections", "a collection"),
];
/// Routes with a revision, and perhaps with a path behind it.
const ROUTES: [&str; 7] = [
    "blob", "resolve", "raw", "blame", "tree", "commit", "commits",
];
/// What follows the address of a server, not of a hub's mirror.
const OF_SERVERS: [&str; 2] = ["v1", "api"];

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
    /// The repository at a page: the segments of its path behind the id, and its query.
    fn at(mut self, path: &[&str], query: &str) -> Option<Self> {
        if let [route, revision, path @ ..] = path
            && ROUTES.contains(route)
        {
            // The revision may have slashes of its own.
            let (revision, path) = match (*revision, path) {
                ("refs", [kind, name, path @ ..]) => (format!("refs/{kind}/{name}"), path),
                (revision, path) => (revision.to_owned(), path),
            };
            let revision = revision_of(&revision)?;
            self.revision = (revision != "main").then_some(revision);
            self.file = file_of(&decoded(&path.join("/")));
        } else if let Some(file) = query
            .split('&')
            .find_map(|pair| pair.strip_prefix("show_file_info="))
        {
            self.file = file_of(&decoded(file));
        }
        if self.file.is_some() {
            self.quant = None;
        }
        Some(self)
    }

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

/// An address of the hub or of a mirror (`HF_ENDPOINT`), or a word with a prefix that names the
/// hub; `None` for other words. The error says which form is wanted.
pub(in crate::registry) fn addressed(word: &str) -> Option<Result<HubName, String>> {
    addressed_at(word, &Environment::of_process().endpoint())
}

fn addressed_at(word: &str, endpoint: &str) -> Option<Result<HubName, String>> {
    let word = word.trim();
    if let Some(body) = word.strip_prefix("hf://") {
        return Some(of_uri(body).ok_or_else(|| wanted(word)));
    }
    for prefix in COMMANDS {
        if let Some(body) = word.strip_prefix(prefix) {
            return Some(plain(body.trim()).ok_or_else(|| wanted(word)));
        }
    }
    if let Some(path) = public_path(word) {
        return Some(of_page(path).unwrap_or_else(|| Err(wanted(word))));
    }
    let path = mirror_path(word, endpoint)?;
    let first = path
        .split(['/', '?', '#'])
        .next()
        .expect("a split gives one part at least");
    if OF_SERVERS.contains(&first) {
        return None;
    }
    of_page(path)
}

/// A repository without an organization, as the hub's first models are named (`gpt2`): alone, with
/// what [`plain`] takes behind it, or as an address. An address may also be that of an organization,
/// so only a cache that has the repository decides.
pub(in crate::registry) fn without_owner(word: &str) -> Option<HubName> {
    without_owner_at(word, &Environment::of_process().endpoint())
}

fn without_owner_at(word: &str, endpoint: &str) -> Option<HubName> {
    let word = word.trim();
    for prefix in COMMANDS {
        if let Some(body) = word.strip_prefix(prefix) {
            return of_bare_uri(body.trim());
        }
    }
    if let Some(body) = word.strip_prefix("hf://") {
        return of_bare_uri(body.strip_prefix("models/").unwrap_or(body));
    }
    let Some(path) = page_path(word, endpoint) else {
        return of_bare_uri(word);
    };
    let (path, query) = path.split_once(['?', '#']).unwrap_or((path, ""));
    let segments = path.split('/').filter(|part| !part.is_empty());
    let segments: Vec<&str> = segments.skip_while(|part| *part == "models").collect();
    let (first, rest) = segments.split_first()?;
    let is_route = rest.first().is_none_or(|route| ROUTES.contains(route));
    is_route
        .then(|| of_bare_uri(first))
        .flatten()
        .and_then(|found| found.at(rest, query))
}

/// The path of an address of the public hub.
fn public_path(word: &str) -> Option<&str> {
    let bare = ["https://", "http://"]
        .iter()
        .find_map(|scheme| without_prefix(word, scheme))
        .unwrap_or(word);
    HOSTS.iter().find_map(|host| {
        let rest = without_prefix(bare, host)?;
        (rest.is_empty() || rest.starts_with(['/', '?', '#'])).then_some(rest)
    })
}

/// The path of an address of a mirror.
fn mirror_path<'a>(word: &'a str, endpoint: &str) -> Option<&'a str> {
    (endpoint != PUBLIC_HUB)
        .then(|| without_prefix(word, endpoint))
        .flatten()?
        .strip_prefix('/')
}

/// The path of an address of the hub or of a mirror.
fn page_path<'a>(word: &'a str, endpoint: &str) -> Option<&'a str> {
    public_path(word).or_else(|| mirror_path(word, endpoint))
}

/// `organization/name`, perhaps with `@revision`, and with `:QUANT` or `/file.gguf`.
pub(in crate::registry) fn plain(word: &str) -> Option<HubName> {
    // A name with the extension of a file means a file that does not exist.
    if split_id(word).is_some() && is_gguf_word(word) {
        return None;
    }
    of_uri(word)
}

/// The form of `hf://` addresses, without the prefix.
fn of_uri(body: &str) -> Option<HubName> {
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
fn of_bare_uri(body: &str) -> Option<HubName> {
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

/// The path of a page, with its query; `None` without `organization/name`.
fn of_page(path: &str) -> Option<Result<HubName, String>> {
    let (path, query) = match path.split_once(['?', '#']) {
        Some((path, query)) => (path, query),
        None => (path, ""),
    };
    let mut segments: Vec<&str> = path.split('/').filter(|part| !part.is_empty()).collect();
    let first = *segments.first()?;
    if let Some((_, kind)) = OTHER_KINDS.iter().find(|(known, _)| *known == first) {
        return Some(Err(format!(
            "this is the address of {kind}, not of a model"
        )));
    }
    if first == "models" {
        segments.remove(0);
    }
    let [owner, name, rest @ ..] = segments.as_slice() else {
        return None;
    };
    // A page of a repository without an organization.
    if ROUTES.contains(name) && is_bare(owner) && !rest.is_empty() {
        return None;
    }
    let found = plain(&format!("{owner}/{name}"))?;
    found.at(rest, query).map(Ok)
}

fn wanted(word: &str) -> String {
    let bare = word
        .rsplit_once("://")
        .map_or(word, |(_, rest)| rest)
        .trim_end_matches('/');
    format!(
        "'{bare}' has no ORG/NAME: write ORG/NAME, ORG/NAME/FILE.gguf, ORG/NAME:QUANT or https://huggingface.co/ORG/NAME"
    )
}

/// A revision, with `%2F` as a slash. It becomes a part of a path.
fn revision_of(text: &str) -> Option<String> {
    let text = decoded(text);
    let part = |part: &str| !part.is_empty() && !part.starts_with('.');
    let plain = |c: char| c.is_ascii_alphanumeric() || "._-+/".contains(c);
    (text.chars().all(plain) && text.split('/').all(part)).then_some(text)
}

/// The path of a GGUF file inside a repository.
fn file_of(path: &str) -> Option<String> {
    let part = |part: &str| !part.is_empty() && !part.starts_with('.') && !part.contains('\\');
    (is_gguf_word(path) && path.split('/').all(part)).then(|| path.to_owned())
}

fn is_gguf_word(path: &str) -> bool {
    is_gguf(Path::new(path))
}

/// A text without a prefix, whose case does not matter.
fn without_prefix<'a>(text: &'a str, prefix: &str) -> Option<&'a str> {
    let start = text.get(..prefix.len())?;
    start
        .eq_ignore_ascii_case(prefix)
        .then(|| &text[prefix.len()..])
}

/// A text with its `%XX` replaced; broken ones stay.
fn decoded(text: &str) -> String {
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
mod tests {
    use super::*;

    fn name(id: &str, revision: &str, file: &str, quant: &str) -> HubName {
        let some = |text: &str| (!text.is_empty()).then(|| text.to_owned());
        HubName {
            id: id.to_owned(),
            revision: some(revision),
            file: some(file),
            quant: some(quant),
        }
    }

    #[test]
    fn addresses_of_pages_name_a_repository() {
        for (word, expected) in [
            ("https://huggingface.co/org/n", name("org/n", "", "", "")),
            ("https://huggingface.co/org/n/", name("org/n", "", "", "")),
            (
                "HTTPS://HuggingFace.co/org/n?x=1",
                name("org/n", "", "", ""),
            ),
            (
                "http://www.huggingface.co/models/org/n",
                name("org/n", "", "", ""),
            ),
            ("huggingface.co/org/n/tree/main", name("org/n", "", "", "")),
            (
                "https://huggingface.co/org/n/tree/v1.0",
                name("org/n", "v1.0", "", ""),
            ),
            (
                "https://huggingface.co/org/n/blob/main/a-Q8_0.gguf",
                name("org/n", "", "a-Q8_0.gguf", ""),
            ),
            (
                "https://huggingface.co/org/n/resolve/0123abc/q4/a%20b.gguf?download=true",
                name("org/n", "0123abc", "q4/a b.gguf", ""),
            ),
            (
                "https://huggingface.co/org/n/blob/main/config.json",
                name("org/n", "", "", ""),
            ),
            (
                "https://huggingface.co/org/n/tree/refs%2Fpr%2F3",
                name("org/n", "refs/pr/3", "", ""),
            ),
            (
                "https://huggingface.co/org/n/blob/refs/pr/3/a.gguf",
                name("org/n", "refs/pr/3", "a.gguf", ""),
            ),
            (
                "https://huggingface.co/org/n/commit/0123abc",
                name("org/n", "0123abc", "", ""),
            ),
            (
                "https://huggingface.co/org/n/discussions/4",
                name("org/n", "", "", ""),
            ),
            (
                "https://huggingface.co/org/n?show_file_info=a.gguf",
                name("org/n", "", "a.gguf", ""),
            ),
            (
                "https://huggingface.co/org/n:Q4_K_M",
                name("org/n", "", "", "Q4_K_M"),
            ),
            ("hf.co/org/n:q4_k_m", name("org/n", "", "", "q4_k_m")),
            ("hf.co/org/n:latest", name("org/n", "", "", "")),
            ("https://hf.co/org/n", name("org/n", "", "", "")),
            ("hf://org/n", name("org/n", "", "", "")),
            (
                "hf://models/org/n@v1/a.gguf",
                name("org/n", "v1", "a.gguf", ""),
            ),
            ("-hf org/n:Q8_0", name("org/n", "", "", "Q8_0")),
            ("https://m.example/hf/org/n", name("org/n", "", "", "")),
        ] {
            let found = addressed_at(word, "https://m.example/hf");
            assert_eq!(found, Some(Ok(expected)), "{word}");
        }
    }

    #[test]
    fn what_is_no_model_of_the_hub_is_an_error_or_another_word() {
        for word in [
            "https://huggingface.co/datasets/org/n",
            "https://huggingface.co/spaces/org/n",
            "https://huggingface.co/org",
            "https://huggingface.co",
            "hf.co/",
            "hf://org",
            "hf://org/n@../x",
            "https://huggingface.co/org/n/tree/..%2F..",
            "-hf org",
        ] {
            let found = addressed_at(word, PUBLIC_HUB);
            assert!(matches!(found, Some(Err(_))), "{word}: {found:?}");
        }
        for word in [
            "http://127.0.0.1:8080/v1",
            "https://router.huggingface.co/v1",
            "hf.company.example/org/n",
            "org/n",
            "nano",
            "",
        ] {
            assert_eq!(addressed_at(word, PUBLIC_HUB), None, "{word}");
        }
        for word in ["http://127.0.0.1:80/v1", "http://127.0.0.1:80"] {
            assert_eq!(addressed_at(word, "http://127.0.0.1:80"), None, "{word}");
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
    fn a_repository_may_have_no_organization() {
        for (word, expected) in [
            ("gpt2", name("gpt2", "", "", "")),
            ("gpt2@v1", name("gpt2", "v1", "", "")),
            ("gpt2:Q8_0", name("gpt2", "", "", "Q8_0")),
            ("gpt2/a-Q8_0.gguf", name("gpt2", "", "a-Q8_0.gguf", "")),
            ("https://huggingface.co/gpt2", name("gpt2", "", "", "")),
            ("hf.co/models/gpt2/", name("gpt2", "", "", "")),
            (
                "https://huggingface.co/gpt2/tree/v1",
                name("gpt2", "v1", "", ""),
            ),
            (
                "https://huggingface.co/gpt2/blob/main/a.gguf",
                name("gpt2", "", "a.gguf", ""),
            ),
            ("hf://gpt2@v1", name("gpt2", "v1", "", "")),
            ("hf://models/gpt2", name("gpt2", "", "", "")),
            ("-hf gpt2:Q8_0", name("gpt2", "", "", "Q8_0")),
            ("https://m.example/hf/gpt2", name("gpt2", "", "", "")),
        ] {
            let found = without_owner_at(word, "https://m.example/hf");
            assert_eq!(found, Some(expected.clone()), "{word}");
            let again = without_owner_at(&expected.word(), PUBLIC_HUB);
            assert_eq!(again, Some(expected), "{word}");
        }
        for word in [
            "",
            "a b",
            ".",
            "..",
            "-x",
            "org/n",
            "org--n",
            "a.gguf",
            "gpt2@..",
            "gpt2/../a.gguf",
            "https://huggingface.co/",
            "https://huggingface.co/org/n",
            "http://127.0.0.1:8080/v1",
            "C:/n/a.gguf",
        ] {
            assert_eq!(without_owner_at(word, PUBLIC_HUB), None, "{word}");
        }
        let page = addressed_at("https://huggingface.co/gpt2/tree/main", PUBLIC_HUB);
        assert!(matches!(page, Some(Err(_))), "{page:?}");
    }

    #[test]
    fn a_broken_escape_stays() {
        assert_eq!(decoded("a%2Fb%zz%4"), "a/b%zz%4");
        assert_eq!(decoded("%C3%A9%"), "é%");
        assert_eq!(decoded("%FF"), "%FF");
    }
}
