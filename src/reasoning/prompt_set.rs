//! Prompt sets: folders of templates with a `set.toml`, two of them built in.

use super::error::PromptError;
use super::round::Round;
use super::templates::Templates;
use crate::environment::text::TextForm;
use minijinja::Value;
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// File names of the templates.
const TEMPLATES: [&str; 5] = ["system", "understanding", "instruction", "code", "feedback"];

/// The form of answers in round 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum UnderstandingForm {
    /// In sentences.
    Free,
    /// `key=value` for each question, under a grammar.
    Choices,
}

/// The form of answers in round 2.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, serde::Serialize)]
#[serde(rename_all = "snake_case")]
pub enum InstructionForm {
    /// Two lines with a reason in free text, under a grammar.
    Reasoned,
    /// `key=value`, under a grammar.
    Choices,
}

/// `set.toml`.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize, serde::Serialize)]
#[serde(deny_unknown_fields)]
pub struct PromptForms {
    /// Form of the lane-graph text.
    pub scene_text: TextForm,
    pub understanding: UnderstandingForm,
    pub instruction: InstructionForm,
}

/// A set of prompts: its forms and its compiled templates.
#[derive(Debug)]
pub struct PromptSet {
    forms: PromptForms,
    templates: Templates,
}

macro_rules! built_in {
    ($name:literal) => {
        (
            $name,
            include_str!(concat!("../../prompts/", $name, "/set.toml")),
            [
                include_str!(concat!("../../prompts/", $name, "/system.jinja")),
                include_str!(concat!("../../prompts/", $name, "/understanding.jinja")),
                include_str!(concat!("../../prompts/", $name, "/instruction.jinja")),
                include_str!(concat!("../../prompts/", $name, "/code.jinja")),
                include_str!(concat!("../../prompts/", $name, "/feedback.jinja")),
            ],
        )
    };
}

/// The sets that are compiled into the program: name, settings, templates in the order of [`TEMPLATES`].
const BUILT_IN: [(&str, &str, [&str; 5]); 2] = [built_in!("paper"), built_in!("compact")];

impl PromptSet {
    /// A built-in set by name, or the set in a folder.
    pub fn open(name_or_folder: &str) -> Result<Self, PromptError> {
        if let Some((name, settings, sources)) = BUILT_IN.iter().find(|(name, ..)| *name == name_or_folder) {
            return Self::compile(name, Path::new("set.toml"), settings, sources.map(str::to_owned));
        }
        let folder = Path::new(name_or_folder);
        let settings_path = folder.join("set.toml");
        if !settings_path.is_file() {
            return Err(PromptError::Unknown(name_or_folder.to_owned()));
        }
        let read = |path: PathBuf| std::fs::read_to_string(&path).map_err(|source| PromptError::Read { path, source });
        let settings = read(settings_path.clone())?;
        let mut sources: [String; 5] = Default::default();
        for (source, name) in sources.iter_mut().zip(TEMPLATES) {
            *source = read(folder.join(name).with_extension("jinja"))?;
        }
        Self::compile(name_or_folder, &settings_path, &settings, sources)
    }

    fn compile(name: &str, path: &Path, settings: &str, sources: [String; 5]) -> Result<Self, PromptError> {
        let forms = toml::from_str(settings)
            .map_err(|source| PromptError::Settings { path: path.to_owned(), source: Box::new(source) })?;
        Ok(Self { forms, templates: Templates::compile(name, TEMPLATES.into_iter().zip(sources))? })
    }

    /// The name or folder that it was opened by.
    pub fn name(&self) -> &str {
        self.templates.set()
    }

    pub fn forms(&self) -> &PromptForms {
        &self.forms
    }

    pub(super) fn system(&self, context: Value) -> Result<String, PromptError> {
        self.templates.render("system", context)
    }

    pub(super) fn round(&self, round: Round, context: Value) -> Result<String, PromptError> {
        self.templates.render(round.as_str(), context)
    }

    pub(super) fn feedback(&self, context: Value) -> Result<String, PromptError> {
        self.templates.render("feedback", context)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn built_in_sets_compile() {
        for (name, ..) in BUILT_IN {
            assert_eq!(PromptSet::open(name).unwrap().name(), name);
        }
    }

    #[test]
    fn wrong_sets_say_what_is_wrong() {
        assert!(matches!(PromptSet::open("nowhere"), Err(PromptError::Unknown(_))));
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("set.toml"), "scene_text = 'compact'\nunderstandng = 'free'").unwrap();
        let missing = PromptSet::open(folder.path().to_str().unwrap()).unwrap_err().to_string();
        assert!(missing.contains("system.jinja"), "{missing}");
        for name in TEMPLATES {
            std::fs::write(folder.path().join(name).with_extension("jinja"), "x").unwrap();
        }
        let settings = PromptSet::open(folder.path().to_str().unwrap()).unwrap_err().to_string();
        assert!(settings.contains("understandng"), "{settings}");
    }
}
