//! Compiled prompt templates.

use super::error::PromptError;
use minijinja::Value;
use planagent_mllm::TemplateEngine;

/// The templates of one set. A template that names a missing value cannot be rendered.
#[derive(Debug)]
pub(super) struct Templates {
    set: String,
    engine: TemplateEngine,
}

impl Templates {
    /// Compiles the templates of the set of this name.
    pub(super) fn compile(
        set: &str,
        templates: impl IntoIterator<Item = (&'static str, String)>,
    ) -> Result<Self, PromptError> {
        let mut engine = TemplateEngine::of_prompts();
        for (name, source) in templates {
            engine
                .add(name, source)
                .map_err(|source| PromptError::Template {
                    set: set.to_owned(),
                    name,
                    source,
                })?;
        }
        Ok(Self {
            set: set.to_owned(),
            engine,
        })
    }

    pub(super) fn set(&self) -> &str {
        &self.set
    }

    /// The text of a template, without white space around it.
    pub(super) fn render(&self, name: &'static str, context: Value) -> Result<String, PromptError> {
        self.engine
            .render(name, context, 0)
            .map(|text| text.trim().to_owned())
            .map_err(|source| PromptError::Template {
                set: self.set.clone(),
                name,
                source,
            })
    }
}
