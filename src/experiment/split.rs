//! Lists of scenarios that have a name: the published nuPlan splits, filter files, and the suites of generated scenes.

use super::nuplan_data::{NuPlanData, Searched};
use super::source::ScenarioSource;
use super::suite::Suite;
use crate::scenario::nuplan::{Exclusions, FilterError, FilterFile, NuPlanError, Token};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::path::{Path, PathBuf};

/// Folder for filter files that is looked into first; then `splits`, then `splits` in `$PLANAGENT_DATA`.
const SPLITS_ROOT: &str = "NUPLAN_SPLITS_ROOT";

/// A published list of nuPlan scenarios.
struct Published {
    /// Its name on the command line.
    name: &'static str,
    /// Names of the file that holds it.
    files: &'static [&'static str],
    /// Where it is published.
    origin: &'static str,
    /// Number of its tokens.
    tokens: usize,
    /// BLAKE3 of the sorted tokens, each followed by a newline.
    blake3: &'static str,
}

/// The published lists, as downloaded from the repositories named.
const PUBLISHED: [Published; 3] = [
    Published {
        name: "val14",
        files: &["val14_split.yaml", "tuplan_garage__val14_split.yaml", "val14.yaml"],
        origin: "autonomousvision/tuplan_garage: val14_split.yaml",
        tokens: 1118,
        blake3: "e20b650606d77b6ce6b83d6286ca5504bc15b5d100e6964f88d4ec81fe8669cb",
    },
    Published {
        name: "reduced-val14",
        files: &["reduced_val14_split.yaml", "tuplan_garage__reduced_val14_split.yaml"],
        origin: "autonomousvision/tuplan_garage: reduced_val14_split.yaml",
        tokens: 318,
        blake3: "fd3bcbe460caca701859b47a08251643fe50dc01c9b2c14825133e9809269b88",
    },
    Published {
        name: "test14-hard",
        files: &["test14-hard.yaml", "planTF__test14-hard.yaml"],
        origin: "jchengai/planTF: test14-hard.yaml",
        tokens: 272,
        blake3: "5baddae5b2ecc5667d7b7c19984da56f955f0d6c9eafe9581fef202c4465db1f",
    },
];

/// The scenarios of a list.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Split {
    /// Those that there are.
    pub sources: Vec<ScenarioSource>,
    /// Those that there are not: a run of the list is not the whole list.
    pub missing: MissingTokens,
    /// The file that holds the list, if one does.
    pub file: Option<PathBuf>,
    /// What a user should know, for example that a file is not the published one.
    pub notes: Vec<String>,
}

/// Scenarios that a list names and that are not there.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MissingTokens {
    /// The list: its name, or its file.
    pub split: String,
    /// How many tokens it has.
    pub wanted: usize,
    /// Those that no log holds.
    pub absent: Vec<String>,
    /// Those that a log holds but that are no scenario.
    pub refused: Vec<RefusedToken>,
}

/// A token that a log holds and that is no scenario.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RefusedToken {
    /// Which.
    pub token: String,
    /// Why, in words.
    pub reason: String,
}

impl MissingTokens {
    /// Whether every token gives a scenario.
    pub fn is_empty(&self) -> bool {
        self.absent.is_empty() && self.refused.is_empty()
    }
}

impl fmt::Display for MissingTokens {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let missing = self.absent.len() + self.refused.len();
        write!(f, "split {}: {missing} of {} scenarios are missing", self.split, self.wanted)?;
        if !self.absent.is_empty() {
            write!(f, "; {} in no log: {}", self.absent.len(), first_of(&self.absent, Clone::clone))?;
        }
        if !self.refused.is_empty() {
            let named = first_of(&self.refused, |refused| format!("{} ({})", refused.token, refused.reason));
            write!(f, "; {} that are no scenario: {named}", self.refused.len())?;
        }
        Ok(())
    }
}

/// The first few of a list in words.
fn first_of<T>(list: &[T], word: impl Fn(&T) -> String) -> String {
    /// So many are named.
    const NAMED: usize = 5;
    let more = if list.len() > NAMED { ", ..." } else { "" };
    list.iter().take(NAMED).map(word).collect::<Vec<_>>().join(", ") + more
}

/// Why there is no list.
#[derive(Debug, thiserror::Error)]
pub enum SplitError {
    /// No such name.
    #[error("unknown split `{name}`: there are {}; or name a scenario filter as FILE.yaml", known.join(", "))]
    Unknown {
        /// The name.
        name: String,
        /// The known ones.
        known: Vec<&'static str>,
    },
    /// The file of a published list is nowhere.
    #[error("split {name} is published in {origin}; put that file into one of {}, or name it as FILE.yaml",
        folders.iter().map(|f| f.display().to_string()).collect::<Vec<_>>().join(", "))]
    NoFile {
        /// The name.
        name: &'static str,
        /// Where it is published.
        origin: &'static str,
        /// Where it was looked for.
        folders: Vec<PathBuf>,
    },
    /// The file cannot be used.
    #[error(transparent)]
    Filter(#[from] FilterError),
    /// The logs cannot be searched.
    #[error(transparent)]
    NuPlan(#[from] NuPlanError),
    /// None of its tokens is there.
    #[error("no scenario found: {missing}{}; is --data-root the folder with its logs?", and_unreadable(unreadable))]
    NothingThere {
        /// What was looked for.
        missing: MissingTokens,
        /// Why logs cannot be read, a line each.
        unreadable: Vec<String>,
    },
    /// Nothing passes a filter that names no tokens.
    #[error("split {name}: no scenario found: {left_out}{}", and_unreadable(unreadable))]
    NothingFound {
        /// The name.
        name: String,
        /// What was looked at.
        left_out: Exclusions,
        /// Why logs cannot be read, a line each.
        unreadable: Vec<String>,
    },
}

/// Logs that cannot be read, in words.
fn and_unreadable(unreadable: &[String]) -> String {
    let Some(first) = unreadable.first() else { return String::new() };
    format!("; {} logs cannot be read, for example {first}", unreadable.len())
}

/// The scenarios of a split: a suite of generated scenes or a published split by its name, or those of a scenario filter
/// `FILE.yaml`. `progress` is told how many logs of how many are searched.
///
/// # Errors
/// When there is no such split, its file cannot be used, the logs cannot be read, or they hold none of its scenarios.
pub fn split(name: &str, data: &NuPlanData, progress: &(dyn Fn(usize, usize) + Sync)) -> Result<Split, SplitError> {
    if let Some(suite) = Suite::named(name) {
        let sources = suite.specs().into_iter().map(ScenarioSource::Generated).collect();
        return Ok(Split { sources, ..Split::default() });
    }
    let is_file = Path::new(name).extension().is_some_and(|ending| ending == "yaml" || ending == "yml");
    let published = PUBLISHED.iter().find(|published| published.name == name);
    let (path, file, mut notes) = match published {
        _ if is_file => (PathBuf::from(name), FilterFile::open(Path::new(name))?, Vec::new()),
        Some(published) => published.open()?,
        None => {
            let suites = Suite::ALL.map(Suite::name).into_iter();
            let known = suites.chain(PUBLISHED.iter().map(|published| published.name)).collect();
            return Err(SplitError::Unknown { name: name.to_owned(), known });
        }
    };
    notes.extend(file.notes);
    let Searched { mut sources, absent, refused, left_out, unreadable, notes: found_notes } =
        data.search(&file.filter, progress)?;
    notes.extend(found_notes);
    let refused = refused.into_iter();
    let missing = MissingTokens {
        split: name.to_owned(),
        wanted: file.filter.scenario_tokens.as_ref().map_or(0, Vec::len),
        absent: absent.iter().map(Token::to_string).collect(),
        refused: refused
            .map(|(token, why)| RefusedToken { token: token.to_string(), reason: why.to_string() })
            .collect(),
    };
    let causes = unreadable.iter().filter_map(|source| match source {
        ScenarioSource::Unreadable { cause, .. } => Some(cause.clone()),
        _ => None,
    });
    if sources.is_empty() {
        let (name, unreadable) = (name.to_owned(), causes.collect());
        return Err(if missing.is_empty() {
            SplitError::NothingFound { name, left_out, unreadable }
        } else {
            SplitError::NothingThere { missing, unreadable }
        });
    }
    // When every token of the list is found, a log that cannot be read holds none of them.
    if missing.wanted > 0 && missing.absent.is_empty() {
        notes.extend(causes.map(|cause| format!("a log that holds nothing of this list is passed over: {cause}")));
    } else {
        sources.extend(unreadable);
    }
    Ok(Split { sources, missing, file: Some(path), notes })
}

impl Published {
    /// Its file with what that holds, and a note when that is not what was published.
    fn open(&self) -> Result<(PathBuf, FilterFile, Vec<String>), SplitError> {
        let folders = folders();
        let path = folders.iter().flat_map(|folder| self.files.iter().map(|file| folder.join(file)));
        let Some(path) = path.into_iter().find(|path| path.is_file()) else {
            return Err(SplitError::NoFile { name: self.name, origin: self.origin, folders });
        };
        let file = FilterFile::open(&path)?;
        let tokens = file.filter.scenario_tokens.as_deref().unwrap_or_default();
        let note = (digest(tokens) != self.blake3).then(|| {
            format!(
                "{}: not the published list {}: {} tokens instead of {}, or others; results do not compare",
                path.display(),
                self.name,
                tokens.len(),
                self.tokens
            )
        });
        Ok((path, file, note.into_iter().collect()))
    }
}

fn folders() -> Vec<PathBuf> {
    let variable = |name: &str| std::env::var_os(name).filter(|value| !value.is_empty()).map(PathBuf::from);
    let data = variable("PLANAGENT_DATA").map(|data| data.join("splits"));
    variable(SPLITS_ROOT).into_iter().chain([PathBuf::from("splits")]).chain(data).collect()
}

/// BLAKE3 of the sorted tokens, each followed by a newline.
fn digest(tokens: &[Token]) -> String {
    let mut lines: Vec<String> = tokens.iter().map(|token| format!("{token}\n")).collect();
    lines.sort();
    blake3::hash(lines.concat().as_bytes()).to_hex().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::nuplan::DataRoots;

    fn no_data() -> NuPlanData {
        NuPlanData::new(DataRoots::default())
    }

    #[test]
    fn the_generated_split_has_ten_seeds_of_each_type() {
        let sources = split("generated", &no_data(), &|_, _| {}).unwrap().sources;
        assert_eq!(sources.len(), 160);
        assert_eq!(sources[0].to_string(), "generated/starting_left_turn/0");
        assert_eq!(sources[159].to_string(), "generated/traversing_roundabout/9");
    }

    #[test]
    fn unknown_names_and_files_say_what_to_do() {
        let told = |name: &str| split(name, &no_data(), &|_, _| {}).unwrap_err().to_string();
        assert!(told("val15").contains("generated-14, generated-14-hard"), "{}", told("val15"));
        assert!(told("nowhere.yaml").contains("nowhere.yaml: cannot open"));
    }

    #[test]
    fn published_lists_are_known_by_their_tokens() {
        let Some(folder) = crate::outside::data("splits") else { return };
        for published in &PUBLISHED {
            let file = published.files.iter().map(|file| folder.join(file)).find(|path| path.is_file());
            let Some(file) = file else {
                crate::outside::skipped(format!("no file of split {} in {}", published.name, folder.display()));
                continue;
            };
            let filter = FilterFile::open(&file).unwrap().filter;
            let tokens = filter.scenario_tokens.unwrap();
            assert_eq!((tokens.len(), digest(&tokens).as_str()), (published.tokens, published.blake3));
            assert_ne!(digest(&tokens[1..]), published.blake3);
            assert_eq!(filter.scenario_types.unwrap().len(), 14);
            assert!(filter.remove_invalid_goals && filter.timestamp_threshold_s == Some(15.0));
        }
    }
}
