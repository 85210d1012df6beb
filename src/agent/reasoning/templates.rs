//! Compiled prompt templates.

use super::error::PromptError;
use minijinja::{Environment, UndefinedBehavior, Value};

/// The templates of one set. A template that names a missing value cannot be rendered.
#[derive(Debug)]
pub(super) struct Templates {
    set: String,
    environment: Environment<'static>,
}

impl Templates {
    /// Compiles the templates of the set of this name.
    pub(super) fn compile(
        set: &str,
        templates: impl IntoIterator<Item = (&'static str, String)>,
    ) -> Result<Self, PromptError> {
        let mut environment = Environment::new();
        environment.set_undefined_behavior(UndefinedBehavior::Strict);
        for (name, source) in templates {
            environment
                .add_template_owned(name, source)
                .map_err(|source| PromptError::Template {
                    set: set.to_owned(),
                    name,
                    source,
                })?;
        }
        Ok(Self {
            set: set.to_owned(),
            environment,
        })
    }

    pub(super) fn set(&self) -> &str {
        &self.set
    }

    /// The text of a template, without white space around it.
    pub(super) fn render(&self, name: &'static str, context: Value) -> Result<String, PromptError> {
        let rendered = self
            .environment
            .get_template(name)
            .and_then(|template| template.render(context));
        rendered
            .map(|text| text.trim().to_owned())
            .map_err(|source| PromptError::Template {
                set: self.set.clone(),
                name,
                source,
            })
    }
}
