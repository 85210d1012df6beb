//! How a description names an adapter.

use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// An adapter that is merged into a model.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "Form", into = "Form")]
pub struct AdapterSpec {
    /// A folder of PEFT, or a GGUF file of llama.cpp; in a description, a relative path starts at it.
    pub path: PathBuf,
    /// Whether the model is the base that the trainer changed first, as `PiSSA` and `OLoRA` do.
    pub changed_base: bool,
}

/// A path, or a table.
#[derive(Serialize, Deserialize)]
#[serde(
    untagged,
    expecting = "expected the path of an adapter, or a table with path and changed_base"
)]
enum Form {
    Path(PathBuf),
    Table(Table),
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Table {
    #[serde(alias = "folder", alias = "file")]
    path: PathBuf,
    #[serde(default)]
    changed_base: bool,
}

impl AdapterSpec {
    /// An adapter of the model as its makers published it.
    pub fn new(path: impl Into<PathBuf>) -> Self {
        Self {
            path: path.into(),
            changed_base: false,
        }
    }

    /// Makes a relative path start at a folder.
    pub(crate) fn start_at(&mut self, folder: &Path) {
        self.path = folder.join(&self.path);
    }
}

impl From<Form> for AdapterSpec {
    fn from(form: Form) -> Self {
        match form {
            Form::Path(path) => Self::new(path),
            Form::Table(Table { path, changed_base }) => Self { path, changed_base },
        }
    }
}

impl From<AdapterSpec> for Form {
    fn from(spec: AdapterSpec) -> Self {
        match spec {
            AdapterSpec {
                path,
                changed_base: false,
            } => Self::Path(path),
            AdapterSpec { path, changed_base } => Self::Table(Table { path, changed_base }),
        }
    }
}
