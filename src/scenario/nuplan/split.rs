//! Lists of nuPlan scenarios that have a name: the published splits and filter files.

use super::search::SearchResult;
use super::{Exclusions, FilterError, FilterFile, NuPlanError, ScenarioFilter, Token};
use crate::{ExcludedToken, MissingTokens, ScenarioRef, Split};
use std::path::{Path, PathBuf};

/// Folder of filter files that is searched first; then `splits`, then `splits` in
/// `$PLANAGENT_DATA`.
const SPLITS_ROOT: &str = "NUPLAN_SPLITS_ROOT";

/// A published list of nuPlan scenarios.
pub struct PublishedSplit {
    /// The name that `--split` takes.
    pub name: &'static str,
    /// Names of the file that holds it.
    pub files: &'static [&'static str],
    /// The repository of GitHub that publishes it, under the first of these names.
    repository: &'static str,
    /// Number of its tokens.
    tokens: usize,
    /// BLAKE3 of the sorted tokens, each followed by a newline.
    blake3: &'static str,
}

/// The published lists, as downloaded from the repositories named.
pub const PUBLISHED_SPLITS: [PublishedSplit; 3] = [
    PublishedSplit {
        name: "val14",
        files: &[
            "val14_split.yaml",
            "tuplan_garage__val14_split.yaml",
            "val14.yaml",
        ],
        repository: "autonomousvision/tuplan_garage",
        tokens: 1118,
        blake3: "e20b650606d77b6ce6b83d6286ca5504bc15b5d100e6964f88d4ec81fe8669cb",
    },
    PublishedSplit {
        name: "reduced-val14",
        files: &[
            "reduced_val14_split.yaml",
            "tuplan_garage__reduced_val14_split.yaml",
        ],
        repository: "autonomousvision/tuplan_garage",
        tokens: 318,
        blake3: "fd3bcbe460caca701859b47a08251643fe50dc01c9b2c14825133e9809269b88",
    },
    PublishedSplit {
        name: "test14-hard",
        files: &["test14-hard.yaml", "planTF__test14-hard.yaml"],
        repository: "jchengai/planTF",
        tokens: 272,
        blake3: "5baddae5b2ecc5667d7b7c19984da56f955f0d6c9eafe9581fef202c4465db1f",
    },
];

/// Why a list gives no scenarios.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message of a variant says what it is")]
pub enum SplitError {
    #[error(
        "the split {name} is a list of {tokens} scenarios, and its file is not on this machine. Get {file} from \
         https://github.com/{repository} and put it into the folder {folder}, or name it by --split path/to/{file}. The \
         scenarios themselves are in nuPlan's logs, which --data-root names"
    )]
    NoFile {
        name: &'static str,
        tokens: usize,
        file: &'static str,
        repository: &'static str,
        folder: String,
    },
    #[error(transparent)]
    Filter(#[from] FilterError),
    #[error(transparent)]
    NuPlan(#[from] NuPlanError),
    /// No log holds any of its tokens.
    #[error(
        "no scenario found: {missing}{}; is --data-root the folder with its logs?",
        and_unreadable(unreadable)
    )]
    NothingThere {
        missing: MissingTokens,
        unreadable: Vec<String>,
    },
    /// Nothing passes a filter that names no tokens.
    #[error(
        "split {name}: no scenario found: {exclusions}{}",
        and_unreadable(unreadable)
    )]
    NothingFound {
        name: String,
        exclusions: Exclusions,
        unreadable: Vec<String>,
    },
}

fn and_unreadable(unreadable: &[String]) -> String {
    let Some(first) = unreadable.first() else {
        return String::new();
    };
    format!(
        "; {} logs cannot be read, for example {first}",
        unreadable.len()
    )
}

/// A filter file, and what a user should know about it.
pub(super) struct FilterList {
    name: String,
    path: PathBuf,
    pub(super) filter: ScenarioFilter,
    notes: Vec<String>,
}

/// The names of the published lists.
pub(super) fn names() -> Vec<&'static str> {
    PUBLISHED_SPLITS
        .iter()
        .map(|published| published.name)
        .collect()
}

/// The list of a published split or of a filter file; `None` for any other name.
pub(super) fn open(name: &str) -> Option<Result<FilterList, SplitError>> {
    let is_file = Path::new(name)
        .extension()
        .is_some_and(|ending| ending == "yaml" || ending == "yml");
    if is_file {
        let file = FilterFile::open(Path::new(name)).map_err(SplitError::from);
        return Some(file.map(|file| FilterList::new(name, PathBuf::from(name), file, None)));
    }
    PUBLISHED_SPLITS
        .iter()
        .find(|published| published.name == name)
        .map(PublishedSplit::open)
}

impl FilterList {
    fn new(name: &str, path: PathBuf, file: FilterFile, note: Option<String>) -> Self {
        let notes = note.into_iter().chain(file.notes).collect();
        Self {
            name: name.to_owned(),
            path,
            filter: file.filter,
            notes,
        }
    }

    /// The split of what a search for the list found.
    pub(super) fn split(
        self,
        result: SearchResult,
        mut scenarios: Vec<ScenarioRef>,
        unreadable: Vec<ScenarioRef>,
    ) -> Result<Split, SplitError> {
        let reason = |(token, exclusion): (Token, super::Exclusion)| ExcludedToken {
            token: token.to_string(),
            reason: exclusion.to_string(),
        };
        let missing = MissingTokens {
            split: self.name.clone(),
            wanted: self.filter.scenario_tokens.as_ref().map_or(0, Vec::len),
            absent: result.absent.iter().map(Token::to_string).collect(),
            excluded: result.excluded.into_iter().map(reason).collect(),
        };
        let mut notes = self.notes;
        let faults = unreadable
            .iter()
            .filter_map(ScenarioRef::fault)
            .map(str::to_owned);
        if scenarios.is_empty() {
            let unreadable = faults.collect();
            return Err(if missing.is_empty() {
                SplitError::NothingFound {
                    name: self.name,
                    exclusions: result.exclusions,
                    unreadable,
                }
            } else {
                SplitError::NothingThere {
                    missing,
                    unreadable,
                }
            });
        }
        // When every token of the list is found, an unreadable log holds none of them.
        if missing.wanted > 0 && missing.absent.is_empty() {
            notes.extend(faults.map(|fault| {
                format!("a log that holds nothing of this list is passed over: {fault}")
            }));
        } else {
            scenarios.extend(unreadable);
        }
        Ok(Split {
            scenarios,
            missing,
            file: Some(self.path),
            notes,
        })
    }

    /// With notes of the search.
    pub(super) fn noting(mut self, notes: Vec<String>) -> Self {
        self.notes.extend(notes);
        self
    }
}

impl PublishedSplit {
    fn open(&self) -> Result<FilterList, SplitError> {
        let folders = folders();
        let path = folders
            .iter()
            .flat_map(|folder| self.files.iter().map(|file| folder.join(file)));
        let Some(path) = path.into_iter().find(|path| path.is_file()) else {
            let Self {
                name,
                tokens,
                repository,
                ..
            } = *self;
            let (file, folder) = (
                self.files[0],
                folders
                    .first()
                    .map_or_else(String::new, |f| f.display().to_string()),
            );
            return Err(SplitError::NoFile {
                name,
                tokens,
                file,
                repository,
                folder,
            });
        };
        let file = FilterFile::open(&path)?;
        let tokens = file.filter.scenario_tokens.as_deref().unwrap_or_default();
        // A note and no error: a list of the user's own may run under this name, but does not
        // compare.
        let note = (!self.is_published(tokens)).then(|| {
            format!(
                "{}: not the published list {}: {} tokens instead of {}, or others; results do not compare",
                path.display(),
                self.name,
                tokens.len(),
                self.tokens
            )
        });
        Ok(FilterList::new(self.name, path, file, note))
    }

    /// Whether these are the tokens of the published list, in any order.
    pub fn is_published(&self, tokens: &[Token]) -> bool {
        digest(tokens) == self.blake3
    }
}

fn folders() -> Vec<PathBuf> {
    let variable = |name: &str| {
        std::env::var_os(name)
            .filter(|value| !value.is_empty())
            .map(PathBuf::from)
    };
    let data = variable("PLANAGENT_DATA").map(|data| data.join("splits"));
    variable(SPLITS_ROOT)
        .into_iter()
        .chain([PathBuf::from("splits")])
        .chain(data)
        .collect()
}

/// BLAKE3 of the sorted tokens, each followed by a newline.
fn digest(tokens: &[Token]) -> String {
    let mut lines: Vec<String> = tokens.iter().map(|token| format!("{token}\n")).collect();
    lines.sort();
    blake3::hash(lines.concat().as_bytes()).to_hex().to_string()
}
