//! The prompts of a language agent beside PlanAgent: a folder of templates with one question each.
//! They are no part of a prompt set, so that a run without their agent does not depend on them.

use super::error::PromptError;
use super::prompt_source::PromptFiles;
use super::templates::Templates;
use minijinja::Value;
use std::collections::BTreeMap;

/// Compiled prompts of one agent.
#[derive(Debug)]
pub struct QuestionPrompts {
    templates: Templates,
    digests: BTreeMap<String, String>,
}

impl QuestionPrompts {
    /// The prompts of a name, with the program's texts by file (`NAME.jinja`). `prompts/NAME`, in
    /// the working directory or where `PLANAGENT_PROMPTS` says, overrides them.
    pub fn open(name: &str, texts: &[(&'static str, &'static str)]) -> Result<Self, PromptError> {
        let files = PromptFiles::find_or(name, texts)?;
        Ok(Self {
            templates: Templates::compile(&files.name, files.templates(), |_| None)?,
            digests: files.digests().into_iter().collect(),
        })
    }

    /// The text of a template (`system` for `system.jinja`), without white space around it.
    pub fn render(&self, template: &'static str, context: Value) -> Result<String, PromptError> {
        self.templates.render(template, context)
    }

    /// BLAKE3 of each file, hexadecimal, by name and file.
    pub fn digests(&self) -> &BTreeMap<String, String> {
        &self.digests
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use minijinja::context;

    #[test]
    fn templates_are_the_programs_without_a_folder_of_their_name() {
        let texts = [("system.jinja", "Drive at {{ speed }}.\n")];
        let prompts = QuestionPrompts::open("no_such_agent", &texts).unwrap();
        assert_eq!(
            prompts.render("system", context! { speed => 3 }).unwrap(),
            "Drive at 3."
        );
        assert_eq!(
            prompts.digests().keys().collect::<Vec<_>>(),
            ["no_such_agent/system.jinja"]
        );
        let missing = prompts.render("system", context! {}).unwrap_err();
        assert!(missing.to_string().contains("no_such_agent"), "{missing}");
    }
}
