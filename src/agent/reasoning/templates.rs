//! Compiled prompt templates.

use super::error::PromptError;
use minijinja::{Error, ErrorKind, Value};
use planagent_mllm::TemplateEngine;

/// The templates of one set. A template that names a missing value cannot be rendered.
#[derive(Debug)]
pub(super) struct Templates {
    set: String,
    engine: TemplateEngine,
}

impl Templates {
    /// Compiles the templates of the set of this name. `known` gives the variables of a
    /// template; one that names another is refused. `None` where they are not known.
    pub(super) fn compile(
        set: &str,
        templates: impl IntoIterator<Item = (&'static str, String)>,
        known: impl Fn(&str) -> Option<&'static [&'static str]>,
    ) -> Result<Self, PromptError> {
        let mut engine = TemplateEngine::of_prompts();
        for (name, source) in templates {
            let added = engine.add(name, source.clone());
            let checked = added.and_then(|()| match known(name) {
                Some(known) => check_variables(&engine, name, &source, known),
                None => Ok(()),
            });
            checked.map_err(|source| PromptError::Template {
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

/// Refuses a template that names a variable which is not among the known ones.
fn check_variables(
    engine: &TemplateEngine,
    name: &str,
    source: &str,
    known: &[&str],
) -> Result<(), Error> {
    let is_known = |variable: &str| {
        let first = variable.split('.').next().unwrap_or(variable);
        let map = format!("{first}.");
        // A text or a list has methods; only a map of ours has fields.
        if known.iter().any(|own| own.starts_with(&map)) {
            variable == first || known.contains(&variable)
        } else {
            known.contains(&first)
        }
    };
    let variables = engine.variables(name)?;
    let Some(unknown) = variables.iter().find(|variable| !is_known(variable)) else {
        return Ok(());
    };
    let line = source
        .lines()
        .position(|line| names(line, unknown))
        .map_or_else(String::new, |line| format!("line {}: ", line + 1));
    let problem = format!(
        "{line}there is no variable {unknown}; there are {}",
        known.join(", ")
    );
    Err(Error::new(ErrorKind::UndefinedError, problem))
}

/// Whether a line has a variable as a word of its own.
fn names(line: &str, variable: &str) -> bool {
    let is_part = |c: char| c.is_alphanumeric() || c == '_';
    line.match_indices(variable).any(|(at, found)| {
        let (before, behind) = (&line[..at], &line[at + found.len()..]);
        !before.ends_with(is_part) && !behind.starts_with(is_part)
    })
}
