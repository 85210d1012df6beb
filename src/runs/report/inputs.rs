//! What a run reads besides its settings: recordings, prompts, the small files of its model. Two
//! sessions of one run must read the same, or its tables mix two configurations.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Start of the keys of [`Inputs::description`] that describe a server.
const SERVER_KEYS: &str = "server.";

/// Digests of what a run reads.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Inputs {
    /// BLAKE3 of the files of the prompt set, by path; none if no planner needs a model.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub prompts: BTreeMap<String, String>,
    /// BLAKE3 of the small files of the model, by path: configurations, tokenizer, chat template.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub model: BTreeMap<String, String>,
    /// BLAKE3 of the values of the model's description that determine answers, by key.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub description: BTreeMap<String, String>,
    /// The files of the recordings that this run simulates, by path.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub data: BTreeMap<String, DataFile>,
}

/// A file of recordings or a map.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DataFile {
    /// Bytes.
    pub size: u64,
    /// Time of the last change, nanoseconds since 1970.
    pub modified_ns: i64,
    /// BLAKE3; none for a large file, whose size and time stand for it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub blake3: Option<String>,
}

/// Changes of the inputs that a user accepted.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct AcceptedChanges {
    /// When the run was resumed with them: `YYYY.MM.DD.hh.mm.ss`, UTC.
    pub resumed: String,
    /// The changes, one a line.
    pub changes: Vec<String>,
}

impl DataFile {
    /// Whether size and time are equal, so that nothing has to be read.
    pub(crate) fn same_stamp(&self, other: &Self) -> bool {
        (self.size, self.modified_ns) == (other.size, other.modified_ns)
    }

    /// Whether two files are taken to have equal contents.
    fn same(&self, other: &Self) -> bool {
        match (&self.blake3, &other.blake3) {
            (Some(one), Some(other)) => one == other,
            _ => self.same_stamp(other),
        }
    }
}

impl Inputs {
    /// What changed until `now`, one line a file or key.
    pub fn changes(&self, now: &Self) -> Vec<String> {
        let mut lines = self.changes_of_model(now);
        let gone: Vec<(&String, &DataFile)> = self
            .data
            .iter()
            .filter(|(path, _)| !now.data.contains_key(*path))
            .collect();
        let mut moved = BTreeSet::new();
        for (path, file) in &now.data {
            match self.data.get(path) {
                Some(before) if before.same(file) => {}
                Some(_) => lines.push(format!("recording changed: {}", shown(path))),
                None => match gone.iter().find(|(_, before)| before.same(file)) {
                    Some((before, _)) => {
                        moved.insert(*before);
                    }
                    None => lines.push(format!("recording changed: {} is new", shown(path))),
                },
            }
        }
        let missing = gone
            .iter()
            .map(|(path, _)| *path)
            .filter(|path| !moved.contains(path));
        lines.extend(missing.map(|path| format!("recording changed: {} is missing", shown(path))));
        lines
    }

    /// What differs between two runs, which may read other recordings, on other machines. A
    /// recording of both must have the same content.
    pub fn conflicts(&self, other: &Self) -> Vec<String> {
        let mut lines = self.changes_of_model(other);
        for (path, file) in &other.data {
            let differs = |before: &DataFile| match (&before.blake3, &file.blake3) {
                (Some(before), Some(now)) => before != now,
                _ => before.size != file.size,
            };
            if self.data.get(path).is_some_and(differs) {
                lines.push(format!("recording changed: {}", shown(path)));
            }
        }
        lines
    }

    fn changes_of_model(&self, now: &Self) -> Vec<String> {
        let mut lines = changed("prompt set", &self.prompts, &now.prompts);
        lines.extend(changed("model", &self.model, &now.model));
        for key in differing(&self.description, &now.description) {
            lines.push(match key.strip_prefix(SERVER_KEYS) {
                Some(field) => format!("server description changed: {field}"),
                None => format!("model description changed: {key}"),
            });
        }
        lines
    }
}

fn changed(
    what: &str,
    then: &BTreeMap<String, String>,
    now: &BTreeMap<String, String>,
) -> Vec<String> {
    let line = |key: &String| {
        let state = match (then.contains_key(key), now.contains_key(key)) {
            (false, _) => " is new",
            (_, false) => " is missing",
            _ => "",
        };
        format!("{what} changed: {}{state}", shown(key))
    };
    differing(then, now).into_iter().map(line).collect()
}

/// The keys whose values differ, sorted.
fn differing<'a>(
    then: &'a BTreeMap<String, String>,
    now: &'a BTreeMap<String, String>,
) -> BTreeSet<&'a String> {
    then.keys()
        .chain(now.keys())
        .filter(|key| then.get(*key) != now.get(*key))
        .collect()
}

/// A path as a user in the working directory writes it.
fn shown(path: &str) -> String {
    let below = std::env::current_dir()
        .ok()
        .and_then(|here| Path::new(path).strip_prefix(here).ok().map(Path::to_owned));
    below.map_or_else(|| path.to_owned(), |below| below.display().to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(size: u64, modified_ns: i64, blake3: Option<&str>) -> DataFile {
        DataFile {
            size,
            modified_ns,
            blake3: blake3.map(str::to_owned),
        }
    }

    fn inputs() -> Inputs {
        let map = |key: &str| BTreeMap::from([(key.to_owned(), "0".to_owned())]);
        let data = [("a", file(1, 1, Some("x"))), ("large", file(9, 9, None))];
        Inputs {
            prompts: map("mine/code.jinja"),
            model: map("m/tokenizer.json"),
            description: map("server.grammar"),
            data: data.map(|(path, file)| (path.to_owned(), file)).into(),
        }
    }

    #[test]
    fn every_kind_of_change_is_named() {
        let (then, mut now) = (inputs(), inputs());
        assert!(then.changes(&now).is_empty());
        now.prompts
            .insert("mine/code.jinja".to_owned(), "1".to_owned());
        now.model.clear();
        now.description
            .insert("generation".to_owned(), "1".to_owned());
        now.description
            .insert("server.grammar".to_owned(), "1".to_owned());
        now.data.insert("a".to_owned(), file(1, 1, Some("y")));
        let expected = [
            "prompt set changed: mine/code.jinja",
            "model changed: m/tokenizer.json is missing",
            "model description changed: generation",
            "server description changed: grammar",
            "recording changed: a",
        ];
        assert_eq!(then.changes(&now), expected);
        assert_eq!(then.conflicts(&now), expected);
    }

    #[test]
    fn a_recording_is_what_it_holds_and_not_when_or_where_it_was_written() {
        let (then, mut now) = (inputs(), inputs());
        now.data = [("b", file(1, 7, Some("x"))), ("large", file(9, 9, None))]
            .map(|(p, f)| (p.to_owned(), f))
            .into();
        assert!(then.changes(&now).is_empty(), "moved and touched");
        now.data.insert("large".to_owned(), file(9, 10, None));
        assert_eq!(
            then.changes(&now),
            ["recording changed: large"],
            "without a digest the time stands for the content"
        );
        assert!(
            then.conflicts(&now).is_empty(),
            "another machine has other times"
        );
        now.data.remove("b");
        assert_eq!(
            then.changes(&now).last().unwrap(),
            "recording changed: a is missing"
        );
        now.data.insert("c".to_owned(), file(1, 1, Some("z")));
        assert!(
            then.changes(&now)
                .contains(&"recording changed: c is new".to_owned())
        );
    }
}
