//! Memories of agents: files that a command fills and that no simulation changes.

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Form of the files.
const FORMAT: u32 = 1;
/// Largest file that is read, bytes.
const MAX_BYTES: u64 = 64 << 20;
/// Most items of a memory.
const MAX_ITEMS: usize = 100_000;
/// Longest text of an item, bytes. A scene in words has about 2,000.
const MAX_TEXT: usize = 64 << 10;

/// A memory of one agent.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Memory<T> {
    /// Form of the file.
    pub format: u32,
    /// Name of the agent.
    pub agent: String,
    /// What was driven to fill it, in words.
    pub source: String,
    /// The items, in the order of the scenarios.
    pub items: Vec<T>,
}

/// What is remembered.
pub(crate) trait Remembered: DeserializeOwned {
    /// Its texts by the names of their fields. The model reads the first ones, and they must not be
    /// empty.
    fn texts(&self) -> [(&'static str, &str); 3];

    /// How many of its texts the model reads.
    const READ: usize;

    /// What is wrong with an item beside the length of its texts.
    fn fault(&self) -> Option<String>;
}

/// What tells whose memory a file is. It is read first, because the items of another agent have
/// other fields.
#[derive(Deserialize)]
struct Header {
    format: u32,
    agent: String,
}

/// Why a memory cannot be used.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs)]
pub(crate) enum MemoryError {
    #[error("cannot read the memory {}: {source}", path.display())]
    Read {
        path: PathBuf,
        source: std::io::Error,
    },
    #[error("in the memory {}: {source}", path.display())]
    Parse {
        path: PathBuf,
        source: serde_json::Error,
    },
    #[error(
        "the memory {} is of form {format} for {agent}, and this is form {FORMAT} for {expected}; fill one with \
         planagent memory fill", path.display()
    )]
    Other {
        path: PathBuf,
        format: u32,
        agent: String,
        expected: &'static str,
    },
    #[error("the memory {} has {count} items, and {MAX_ITEMS} are the limit", path.display())]
    TooLarge { path: PathBuf, count: usize },
    #[error(
        "in the memory {}: {field} of item {item} has {bytes} bytes, and {MAX_TEXT} are the limit", path.display()
    )]
    TooLong {
        path: PathBuf,
        item: usize,
        field: &'static str,
        bytes: usize,
    },
    #[error("the memory {} has no items; fill one with planagent memory fill", path.display())]
    Empty { path: PathBuf },
    #[error("in the memory {}: item {item}: {fault}", path.display())]
    Item {
        path: PathBuf,
        item: usize,
        fault: String,
    },
}

/// BLAKE3 of a file, hexadecimal; `None` where it cannot be read.
pub(crate) fn digest(file: &str) -> Option<String> {
    let mut hasher = blake3::Hasher::new();
    let file = planagent_files::open(Path::new(file)).ok()?;
    hasher.update_reader(file).ok()?;
    Some(hasher.finalize().to_hex().to_string())
}

impl<T> Memory<T> {
    /// A memory of an agent.
    pub fn new(agent: &str, source: String, items: Vec<T>) -> Self {
        Self {
            format: FORMAT,
            agent: agent.to_owned(),
            source,
            items,
        }
    }
}

/// Reads the memory of an agent; an agent without a file has none.
pub(crate) fn open<T: Remembered>(
    file: Option<&str>,
    agent: &'static str,
) -> Result<Memory<T>, MemoryError> {
    let Some(file) = file else {
        return Ok(Memory::new(agent, String::new(), Vec::new()));
    };
    let path = Path::new(file).to_owned();
    let text = match planagent_files::read_text(&path, MAX_BYTES) {
        Ok(text) => text,
        Err(source) => return Err(MemoryError::Read { path, source }),
    };
    // Whose it is comes before its items, which the wrong agent cannot read.
    let parsed = serde_json::from_str(&text);
    let Header {
        format,
        agent: whose,
    } = match parsed {
        Ok(header) => header,
        Err(source) => return Err(MemoryError::Parse { path, source }),
    };
    if format != FORMAT || whose != agent {
        return Err(MemoryError::Other {
            path,
            format,
            agent: whose,
            expected: agent,
        });
    }
    let memory: Memory<T> = match serde_json::from_str(&text) {
        Ok(memory) => memory,
        Err(source) => return Err(MemoryError::Parse { path, source }),
    };
    check(&memory, path)?;
    Ok(memory)
}

/// Whether items can be shown to a model: they become parts of prompts, and the file may come from a
/// stranger.
fn check<T: Remembered>(memory: &Memory<T>, path: PathBuf) -> Result<(), MemoryError> {
    match memory.items.len() {
        0 => return Err(MemoryError::Empty { path }),
        1..=MAX_ITEMS => {}
        count => return Err(MemoryError::TooLarge { path, count }),
    }
    for (i, item) in memory.items.iter().enumerate() {
        let (texts, number) = (item.texts(), i + 1);
        let long = |(_, text): &&(&str, &str)| text.len() > MAX_TEXT;
        if let Some(&(field, text)) = texts.iter().find(long) {
            return Err(MemoryError::TooLong {
                path,
                item: number,
                field,
                bytes: text.len(),
            });
        }
        // A blank text or a contradiction would teach the model nothing, or what is wrong.
        let blank = texts
            .iter()
            .take(T::READ)
            .find(|(_, text)| text.trim().is_empty());
        let fault = blank
            .map(|(field, _)| format!("{field} is empty"))
            .or_else(|| item.fault());
        if let Some(fault) = fault {
            return Err(MemoryError::Item {
                path,
                item: number,
                fault,
            });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::agent_driver::ExperienceItem;
    use crate::dilu::DiluItem;
    use planagent_agent::reasoning::DrivingAction;

    #[test]
    fn a_memory_is_read_as_it_was_written_and_another_agents_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let item = DiluItem {
            description: "a road".to_owned(),
            answer: "It is free.\n#### 3".to_owned(),
            action: DrivingAction::Faster,
            comment: "one".to_owned(),
        };
        let memory = Memory::new("dilu", "two scenes".to_owned(), vec![item]);
        let file = folder.path().join("memory.json");
        let name = file.to_str().unwrap();
        let write = |text: &str| std::fs::write(&file, text).unwrap();
        write(&serde_json::to_string(&memory).unwrap());
        assert_eq!(open(Some(name), "dilu").unwrap(), memory);
        let error = open::<DiluItem>(Some(name), "agent-driver").unwrap_err();
        assert!(error.to_string().contains("for dilu"), "{error}");
        write("{\"format\": 1, \"agent\": \"dilu\"");
        let error = open::<DiluItem>(Some(name), "dilu").unwrap_err();
        assert!(error.to_string().contains("line 1"), "{error}");
        let long = serde_json::to_string(&memory).unwrap();
        write(&long.replace("a road", &"road ".repeat(MAX_TEXT)));
        let error = open::<DiluItem>(Some(name), "dilu").unwrap_err();
        assert!(
            error.to_string().contains("description of item 1 has"),
            "{error}"
        );
        let missing = folder.path().join("nothing.json");
        let error = open::<DiluItem>(missing.to_str(), "dilu").unwrap_err();
        assert!(error.to_string().contains("nothing.json"), "{error}");
        assert_eq!(open::<DiluItem>(None, "dilu").unwrap().items, []);
    }

    #[test]
    fn damaged_foreign_and_empty_memories_are_refused_with_the_item() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("memory.json");
        let decision = r#"{"description": "a road", "answer": "Free.\n#### 3", "action": "faster", "comment": ""}"#;
        let motion = r#"{"text": "a drive", "motion": [0, 0, 0, 0, 0, 0, 0, 0, 0], "goal": "FORWARD",
            "past": [[0, -4], [0, -3], [0, -2], [0, -1]],
            "future": [[0, 1], [0, 2], [0, 3], [0, 4], [0, 5], [0, 6]], "source": ""}"#;
        let of = |agent: &str, items: &str| {
            format!(r#"{{"format": 1, "agent": "{agent}", "source": "", "items": [{items}]}}"#)
        };
        let write = |text: &str| {
            std::fs::write(&file, text).unwrap();
            file.to_str()
        };
        let two = format!("{decision}, {decision}");
        assert_eq!(
            open::<DiluItem>(write(&of("dilu", &two)), "dilu")
                .unwrap()
                .items
                .len(),
            2
        );
        for (text, why) in [
            (String::new(), "EOF"),
            ("null".to_owned(), "invalid type"),
            (of("dilu", ""), "has no items"),
            (of("agent-driver", motion), "is of form 1 for agent-driver"),
            (of("dilu", motion), "unknown field `text`"),
            (
                of("dilu", decision).replace("\"format\": 1", "\"format\": 2"),
                "of form 2",
            ),
            (of("dilu", &two) + "x", "trailing"),
            (
                of("dilu", &two).replacen("a road", " ", 1),
                "item 1: description is empty",
            ),
            (
                of(
                    "dilu",
                    &format!("{decision}, {}", decision.replace("#### 3", "#### 4")),
                ),
                "item 2: answer does not end with the action faster",
            ),
            (
                of("dilu", &decision.replace("faster", "fly")),
                "unknown variant `fly`",
            ),
            (
                of("dilu", decision).replace("\"source\"", "\"agent\""),
                "duplicate field `agent`",
            ),
        ] {
            let error = open::<DiluItem>(write(&text), "dilu").unwrap_err();
            assert!(error.to_string().contains(why), "{text}: {error}");
        }
        for (from, to, why) in [
            ("[0, 6]", "[0, 1e9]", "item 1: 1e9 is larger than 1000"),
            ("[0, 6]", "[0, 1e999]", "number out of range"),
            ("[0, 6]", "[0, NaN]", "expected"),
            (", [0, 6]", "", "invalid length 5"),
            ("a drive", "", "item 1: text is empty"),
        ] {
            let text = of("agent-driver", &motion.replace(from, to));
            let error = open::<ExperienceItem>(write(&text), "agent-driver").unwrap_err();
            assert!(error.to_string().contains(why), "{text}: {error}");
        }
    }
}
