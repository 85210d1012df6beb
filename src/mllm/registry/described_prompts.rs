//! The prompts of a description: a set of the program, or a folder of one's own.

use planagent_files::word_of;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// The prompt sets of `prompts/`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PromptSet {
    /// Plain English in few tokens, for general models on a small computer.
    Brief,
    /// Few tokens, for models trained on them.
    Compact,
    /// The same with estimates of unknown limits and three more questions.
    #[serde(rename = "compact-2")]
    Compact2,
    /// The paper's wording, for general models.
    Paper,
}

impl PromptSet {
    pub(super) const ALL: [Self; 4] = [Self::Brief, Self::Compact, Self::Compact2, Self::Paper];

    /// Its name in `prompts/`.
    pub fn name(self) -> &'static str {
        match self {
            Self::Brief => "brief",
            Self::Compact => "compact",
            Self::Compact2 => "compact-2",
            Self::Paper => "paper",
        }
    }

    /// The set of a name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|set| set.name() == name)
    }
}

/// The prompts that a description names: a set of `prompts/`, or a folder of templates.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "String", into = "String")]
pub enum DescribedPrompts {
    /// A set that the program has.
    Known(PromptSet),
    /// A set of one's own.
    Own {
        /// The folder as the description names it.
        word: String,
        /// The folder; a relative path starts at the description.
        folder: PathBuf,
    },
}

impl DescribedPrompts {
    /// The name or the folder that opens the set.
    pub fn opened_by(&self) -> String {
        match self {
            Self::Known(set) => set.name().to_owned(),
            Self::Own { folder, .. } => word_of(folder.as_os_str()),
        }
    }

    /// Makes a relative path start at the folder of the description.
    pub(super) fn start_at(&mut self, base: &Path) -> Result<(), String> {
        let Self::Own { word, folder } = self else {
            return Ok(());
        };
        let found = base.join(&*folder);
        if found.is_dir() {
            // The path opens the set, so it must not look like a name.
            *folder = std::path::absolute(&found).unwrap_or(found);
            return Ok(());
        }
        let known = PromptSet::ALL.map(PromptSet::name).join(", ");
        Err(format!(
            "prompt_set '{word}' is neither {known} nor a folder at {}",
            found.display()
        ))
    }
}

impl From<String> for DescribedPrompts {
    fn from(word: String) -> Self {
        PromptSet::named(&word).map_or_else(
            || Self::Own {
                folder: PathBuf::from(&word),
                word: word.clone(),
            },
            Self::Known,
        )
    }
}

impl From<DescribedPrompts> for String {
    fn from(prompts: DescribedPrompts) -> Self {
        match prompts {
            DescribedPrompts::Known(set) => set.name().to_owned(),
            DescribedPrompts::Own { word, .. } => word,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::registry::ModelSpec;

    #[test]
    fn a_description_names_a_set_of_prompts_of_its_own() {
        let work = tempfile::tempdir().unwrap();
        std::fs::create_dir(work.path().join("my_prompts")).unwrap();
        let file = work.path().join("mine.toml");
        let text =
            |set: &str| format!("name = 'n'\nsource = {{ folder = 'f' }}\nprompt_set = '{set}'\n");
        let spec = ModelSpec::parse(&file, &text("my_prompts")).unwrap();
        let prompts = spec.prompt_set.unwrap();
        let folder = work.path().join("my_prompts").display().to_string();
        assert_eq!(prompts.opened_by(), folder);
        // A moved description has the same digest.
        assert_eq!(serde_json::to_string(&prompts).unwrap(), "\"my_prompts\"");
        let known = ModelSpec::parse(&file, &text("compact-2")).unwrap();
        assert_eq!(
            known.prompt_set,
            Some(DescribedPrompts::Known(PromptSet::Compact2))
        );
        let error = ModelSpec::parse(&file, &text("compct")).unwrap_err();
        let error = error.to_string();
        assert!(
            error.contains("'compct'")
                && error.contains("compact-2")
                && error.contains("mine.toml"),
            "{error}"
        );
    }
}
