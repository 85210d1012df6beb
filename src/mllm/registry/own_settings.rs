//! What the files of a model say about how it is asked: `planagent.json` in its folder, or in the
//! metadata of its GGUF file. Training and `models quantize` write it, so that a model without a
//! description is asked as it was trained.

use super::described_prompts::PromptSet;
use super::description::with_new_name;
use super::generation::GenerationSettings;
use crate::MllmError;
use crate::source::ModelPlace;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Name of the file.
pub(super) const OWN_SETTINGS: &str = "planagent.json";

/// How a model is asked.
#[derive(Debug, Clone, PartialEq)]
pub struct Asking {
    /// Name of its prompt set.
    pub prompt_set: String,
    pub named_by: NamedBy,
    pub generation: GenerationSettings,
}

/// What names the prompt set of a model.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NamedBy {
    Description,
    /// `planagent.json` among its files.
    ModelFiles,
    /// Nothing: the paper's prompts.
    Default,
}

impl fmt::Display for NamedBy {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(match self {
            Self::Description => "the model's description",
            Self::ModelFiles => "planagent.json of the model",
            Self::Default => "default",
        })
    }
}

/// The file.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct OwnSettings {
    prompt_set: String,
    #[serde(default)]
    generation: GenerationSettings,
}

impl Asking {
    /// The paper's prompts, for a model of which nothing else is known.
    pub(super) fn plain() -> Self {
        let (prompt_set, named_by) = (PromptSet::Paper.name().to_owned(), NamedBy::Default);
        Self {
            prompt_set,
            named_by,
            generation: GenerationSettings::default(),
        }
    }

    /// What the files of a model say; the paper's prompts where they say nothing.
    pub(super) fn of_files(place: &ModelPlace) -> Result<Self, MllmError> {
        let Some(text) = place.small_file(OWN_SETTINGS)? else {
            return Ok(Self::plain());
        };
        let broken = |error: serde_json::Error| {
            let problem = with_new_name(error.to_string());
            MllmError::Description {
                path: place.path().join(OWN_SETTINGS),
                problem,
            }
        };
        let OwnSettings {
            prompt_set,
            generation,
        } = serde_json::from_str(&text).map_err(broken)?;
        Ok(Self {
            prompt_set,
            named_by: NamedBy::ModelFiles,
            generation,
        })
    }

    /// The file that says the same.
    pub(super) fn to_file(&self) -> (String, String) {
        let own = OwnSettings {
            prompt_set: self.prompt_set.clone(),
            generation: self.generation,
        };
        let text =
            serde_json::to_string_pretty(&own).expect("names and numbers can be written as JSON");
        (OWN_SETTINGS.to_owned(), text + "\n")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{HubAccess, ModelRegistry};
    use std::path::Path;

    fn registry() -> ModelRegistry {
        let models = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../models");
        ModelRegistry::new(
            models,
            HubAccess {
                offline: true,
                ..HubAccess::default()
            },
        )
    }

    #[test]
    fn the_folder_of_nano_says_what_its_description_says() {
        let registry = registry();
        let described = registry.asking(&registry.find("nano").unwrap()).unwrap();
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../models/nano");
        let own = registry
            .asking(&registry.find(folder.to_str().unwrap()).unwrap())
            .unwrap();
        assert_eq!(
            (own.named_by, described.named_by),
            (NamedBy::ModelFiles, NamedBy::Description)
        );
        assert_eq!(
            Asking {
                named_by: NamedBy::Description,
                ..own
            },
            described
        );
    }

    #[test]
    fn a_folder_that_says_nothing_gets_the_prompts_of_the_paper_and_a_broken_file_is_an_error() {
        let (registry, folder) = (registry(), tempfile::tempdir().unwrap());
        let asking = || registry.asking(&registry.find(folder.path().to_str().unwrap()).unwrap());
        let plain = asking().unwrap();
        assert_eq!(
            (plain.prompt_set.as_str(), plain.named_by),
            ("paper", NamedBy::Default)
        );
        let write = |text: &str| std::fs::write(folder.path().join(OWN_SETTINGS), text).unwrap();
        write(
            "{\"prompt_set\": \"compact\", \"generation\": {\"max_new_tokens\": {\"code\": 40}}}",
        );
        let own = asking().unwrap();
        assert_eq!(
            (own.prompt_set.as_str(), own.generation.max_new_tokens.code),
            ("compact", 40)
        );
        assert_eq!(
            serde_json::from_str::<OwnSettings>(&own.to_file().1)
                .unwrap()
                .prompt_set,
            "compact"
        );
        write("{\"prompts\": \"compact\"}");
        let broken = asking().unwrap_err().to_string();
        assert!(
            broken.contains("planagent.json") && broken.contains("prompts"),
            "{broken}"
        );
        write(
            "{\"prompt_set\": \"compact\", \"generation\": {\"max_new_tokens\": {\"scene\": 40}}}",
        );
        let old = asking().unwrap_err().to_string();
        assert!(
            old.contains("planagent.json") && old.contains("scene is called understanding now"),
            "{old}"
        );
    }
}
