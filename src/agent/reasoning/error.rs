//! Why a prompt cannot be written, or the model cannot be asked.

use planagent_mllm::MllmError;
use std::path::PathBuf;

/// Why a prompt set cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum PromptError {
    #[error(
        "prompt set '{name}' is neither built in ({}), nor a folder of prompts/, nor a folder of templates", known.join(", ")
    )]
    Unknown {
        name: String,
        known: Vec<&'static str>,
    },
    #[error("cannot read {path}: {source}")]
    Read {
        path: PathBuf,
        source: std::io::Error,
    },
    #[error("{path}: {source}")]
    Settings {
        path: PathBuf,
        source: Box<toml::de::Error>,
    },
    #[error("prompt template {name}.jinja of set '{set}': {source}")]
    Template {
        set: String,
        name: &'static str,
        source: minijinja::Error,
    },
}

/// Why reasoning failed as a whole. A wrong answer is no such failure.
#[derive(Debug, thiserror::Error)]
pub enum ReasoningError {
    #[error(transparent)]
    Model(#[from] MllmError),
    #[error("{source}; {}", shorter(fitting))]
    PromptTooLong {
        /// What the model says.
        source: Box<MllmError>,
        /// The built-in prompt sets that fit the context.
        fitting: Vec<&'static str>,
    },
    #[error(transparent)]
    Prompt(#[from] PromptError),
}

/// What to do where the prompts of a set are too long.
fn shorter(fitting: &[&str]) -> String {
    if fitting.is_empty() {
        "no built-in prompt set fits this context".to_owned()
    } else {
        format!(
            "prompt sets that fit: {} (--prompt-set {})",
            fitting.join(", "),
            fitting.first().unwrap_or(&"")
        )
    }
}
