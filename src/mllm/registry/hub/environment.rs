//! The environment variables of `huggingface_hub`, read as its `constants.py` reads them.

use std::path::PathBuf;

/// The public hub.
pub(super) const PUBLIC_HUB: &str = "https://huggingface.co";
/// A value of the first hides the second, whatever it says.
const OFFLINE: [&str; 2] = ["HF_HUB_OFFLINE", "TRANSFORMERS_OFFLINE"];
/// The folder of the cache, newest name first.
const CACHE: [&str; 2] = ["HF_HUB_CACHE", "HUGGINGFACE_HUB_CACHE"];
/// An access token, newest name first.
const TOKEN: [&str; 2] = ["HF_TOKEN", "HUGGING_FACE_HUB_TOKEN"];
/// Largest file of a token, bytes.
const MAX_TOKEN_BYTES: u64 = 64 << 10;
/// Waits for a connection and for more bytes, seconds.
const DEFAULT_WAIT_S: u64 = 10;

/// The values of variables by name; an empty value counts as none.
pub(super) struct Environment<'a>(pub(super) &'a dyn Fn(&str) -> Option<String>);

/// A variable of this process.
fn of_process(name: &str) -> Option<String> {
    std::env::var(name).ok()
}

/// The variable that switches the network off, if one does: `HF_HUB_OFFLINE`, else
/// `TRANSFORMERS_OFFLINE`, with the value 1, true, yes or on in any case.
pub fn offline_variable() -> Option<&'static str> {
    Environment::of_process().offline()
}

impl Environment<'static> {
    pub(super) fn of_process() -> Self {
        Self(&of_process)
    }
}

impl Environment<'_> {
    fn value(&self, name: &str) -> Option<String> {
        (self.0)(name).filter(|value| !value.trim().is_empty())
    }

    fn first(&self, names: &[&'static str]) -> Option<(&'static str, String)> {
        names
            .iter()
            .find_map(|name| Some((*name, self.value(name)?)))
    }

    fn is_true(value: &str) -> bool {
        ["1", "on", "yes", "true"]
            .iter()
            .any(|word| value.trim().eq_ignore_ascii_case(word))
    }

    pub(super) fn offline(&self) -> Option<&'static str> {
        let (name, value) = self.first(&OFFLINE)?;
        Self::is_true(&value).then_some(name)
    }

    /// The folder of the cache.
    pub(super) fn cache(&self) -> PathBuf {
        match self.first(&CACHE) {
            Some((_, folder)) => self.expanded(&folder),
            None => self.home().join("hub"),
        }
    }

    /// The folder of the cache and the token.
    fn home(&self) -> PathBuf {
        if let Some(home) = self.value("HF_HOME") {
            return self.expanded(&home);
        }
        let caches = self
            .value("XDG_CACHE_HOME")
            .unwrap_or_else(|| "~/.cache".to_owned());
        self.expanded(&caches).join("huggingface")
    }

    /// The address of the hub, without a slash at its end.
    pub(super) fn endpoint(&self) -> String {
        let Some(endpoint) = self.value("HF_ENDPOINT") else {
            return PUBLIC_HUB.to_owned();
        };
        let endpoint = endpoint.trim().trim_end_matches('/');
        if endpoint.contains("://") {
            endpoint.to_owned()
        } else {
            format!("https://{endpoint}")
        }
    }

    /// The access token: of a variable, else of the file that `hf auth login` writes.
    pub(super) fn token(&self) -> Option<String> {
        if self
            .value("HF_HUB_DISABLE_IMPLICIT_TOKEN")
            .is_some_and(|value| Self::is_true(&value))
        {
            return None;
        }
        let text = if let Some((_, token)) = self.first(&TOKEN) {
            token
        } else {
            let file = match self.value("HF_TOKEN_PATH") {
                Some(path) => self.expanded(&path),
                None => self.home().join("token"),
            };
            planagent_files::read_text(&file, MAX_TOKEN_BYTES).ok()?
        };
        let token: String = text
            .chars()
            .filter(|character| !character.is_control())
            .collect();
        let token = token.trim();
        (!token.is_empty()).then(|| token.to_owned())
    }

    /// The longest wait for an answer to a request, and for more bytes of a file, seconds.
    pub(super) fn waits_s(&self) -> [u64; 2] {
        ["HF_HUB_ETAG_TIMEOUT", "HF_HUB_DOWNLOAD_TIMEOUT"].map(|name| {
            self.value(name)
                .and_then(|value| value.trim().parse().ok())
                .filter(|seconds| *seconds > 0)
                .unwrap_or(DEFAULT_WAIT_S)
        })
    }

    /// A path with its `~` and its variables (`$NAME`, `${NAME}`) replaced; unknown ones stay.
    fn expanded(&self, path: &str) -> PathBuf {
        let home = || self.value("HOME").or_else(|| self.value("USERPROFILE"));
        let path = match path.strip_prefix('~') {
            Some(rest) if rest.is_empty() || rest.starts_with(['/', '\\']) => {
                home().map_or_else(|| path.to_owned(), |home| format!("{home}{rest}"))
            }
            _ => path.to_owned(),
        };
        let mut expanded = String::new();
        let mut rest = path.as_str();
        while let Some((before, after)) = rest.split_once('$') {
            expanded.push_str(before);
            let (name, behind) = variable(after);
            if let Some(value) = self.value(name) {
                expanded.push_str(&value);
            } else {
                expanded.push('$');
                expanded.push_str(&after[..after.len() - behind.len()]);
            }
            rest = behind;
        }
        expanded.push_str(rest);
        PathBuf::from(expanded)
    }
}

/// The name of a variable behind `$`, and what follows it.
fn variable(text: &str) -> (&str, &str) {
    if let Some((name, behind)) = text
        .strip_prefix('{')
        .and_then(|inner| inner.split_once('}'))
    {
        return (name, behind);
    }
    let end = text
        .find(|character: char| !character.is_ascii_alphanumeric() && character != '_')
        .unwrap_or(text.len());
    text.split_at(end)
}

#[cfg(test)]
#[allow(
    clippy::redundant_closure_for_method_calls,
    reason = "the path of a method has one lifetime, and a closure any"
)]
mod tests {
    use super::*;
    use std::path::Path;

    fn with<T>(variables: &[(&str, &str)], work: impl Fn(&Environment<'_>) -> T) -> T {
        let get = |name: &str| {
            let found = variables.iter().find(|(known, _)| *known == name);
            found.map(|(_, value)| (*value).to_owned())
        };
        work(&Environment(&get))
    }

    #[test]
    fn offline_is_read_as_the_tools_of_the_hub_read_it() {
        let offline = |variables: &[(&str, &str)]| with(variables, |e| e.offline());
        for value in ["1", "true", "TRUE", "yes", "On", " 1 "] {
            assert_eq!(
                offline(&[("HF_HUB_OFFLINE", value)]),
                Some("HF_HUB_OFFLINE"),
                "{value}"
            );
            assert_eq!(
                offline(&[("HF_HUB_OFFLINE", ""), ("TRANSFORMERS_OFFLINE", value)]),
                Some("TRANSFORMERS_OFFLINE"),
                "{value}"
            );
        }
        for value in ["0", "false", "no", "off", "2", ""] {
            assert_eq!(offline(&[("HF_HUB_OFFLINE", value)]), None, "{value}");
        }
        assert_eq!(
            offline(&[("HF_HUB_OFFLINE", "0"), ("TRANSFORMERS_OFFLINE", "1")]),
            None,
            "the first hides the second"
        );
    }

    #[test]
    fn the_cache_is_where_the_variables_say() {
        let home = ("HOME", "/home/u");
        for (variables, expected) in [
            (&[home][..], "/home/u/.cache/huggingface/hub"),
            (&[home, ("XDG_CACHE_HOME", "/x")], "/x/huggingface/hub"),
            (
                &[home, ("XDG_CACHE_HOME", "/x"), ("HF_HOME", "~/hf")],
                "/home/u/hf/hub",
            ),
            (
                &[home, ("HF_HOME", "/h"), ("HUGGINGFACE_HUB_CACHE", "/old")],
                "/old",
            ),
            (
                &[
                    home,
                    ("HUGGINGFACE_HUB_CACHE", "/old"),
                    ("HF_HUB_CACHE", "/new"),
                ],
                "/new",
            ),
            (&[home, ("HF_HUB_CACHE", ""), ("HF_HOME", "/h")], "/h/hub"),
            (
                &[
                    home,
                    ("SCRATCH", "/s"),
                    ("HF_HUB_CACHE", "$SCRATCH/a/${SCRATCH}b"),
                ],
                "/s/a//sb",
            ),
            (&[home, ("HF_HOME", "/a/$NONE/${NO}")], "/a/$NONE/${NO}/hub"),
            (&[home, ("HF_HOME", "~")], "/home/u/hub"),
        ] {
            assert_eq!(
                with(variables, |e| e.cache()),
                Path::new(expected),
                "{variables:?}"
            );
        }
    }

    #[test]
    fn the_token_is_of_a_variable_or_a_file() {
        let folder = tempfile::tempdir().unwrap();
        let home = folder.path().to_str().unwrap();
        let path = folder.path().join("elsewhere");
        std::fs::write(folder.path().join("token"), "of-home\n").unwrap();
        std::fs::write(&path, "\r\nof-path\r\n").unwrap();
        let path = path.to_str().unwrap();
        for (variables, expected) in [
            (&[("HF_HOME", home)][..], Some("of-home")),
            (
                &[("HF_HOME", home), ("HF_TOKEN_PATH", path)],
                Some("of-path"),
            ),
            (
                &[("HF_HOME", home), ("HUGGING_FACE_HUB_TOKEN", "old")],
                Some("old"),
            ),
            (
                &[("HUGGING_FACE_HUB_TOKEN", "old"), ("HF_TOKEN", " new\n")],
                Some("new"),
            ),
            (
                &[
                    ("HF_TOKEN", "new"),
                    ("HF_HUB_DISABLE_IMPLICIT_TOKEN", "yes"),
                ],
                None,
            ),
            (&[("HF_HOME", "/nowhere")], None),
        ] {
            assert_eq!(
                with(variables, |e| e.token()).as_deref(),
                expected,
                "{variables:?}"
            );
        }
    }

    #[test]
    fn the_address_of_a_mirror_needs_no_scheme() {
        let endpoint = |value: &str| with(&[("HF_ENDPOINT", value)], |e| e.endpoint());
        assert_eq!(endpoint(""), PUBLIC_HUB);
        assert_eq!(endpoint("https://m.example/"), "https://m.example");
        assert_eq!(endpoint("m.example"), "https://m.example");
    }
}
