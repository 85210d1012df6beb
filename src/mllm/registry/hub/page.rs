//! Addresses of pages of the hub or of a mirror, and words with a prefix that names the hub.

use super::environment::{Environment, PUBLIC_HUB};
use super::name::{HubName, decoded, file_of, is_bare, of_bare_uri, of_uri, plain, revision_of};

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

/// A text without a prefix, whose case does not matter.
fn without_prefix<'a>(text: &'a str, prefix: &str) -> Option<&'a str> {
    let start = text.get(..prefix.len())?;
    start
        .eq_ignore_ascii_case(prefix)
        .then(|| &text[prefix.len()..])
}

#[cfg(test)]
mod tests {
    use super::super::name::tests::name;
    use super::*;

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
}
