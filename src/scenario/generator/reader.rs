//! Generated scenarios in the registry of readers.

use super::{SOURCE, Spec, generate};
use crate::{ReaderError, ScenarioReader, ScenarioRef};

/// Takes words of the form `generated/TYPE/SEED[.TRAFFIC]`.
pub(crate) struct GeneratedReader;

impl ScenarioReader for GeneratedReader {
    fn recognizes(&self, word: &str) -> bool {
        word.strip_prefix(SOURCE)
            .is_some_and(|rest| rest.starts_with('/'))
    }

    fn list(&self, word: &str) -> Result<Vec<ScenarioRef>, ReaderError> {
        let spec: Spec = word.parse().map_err(ReaderError::new)?;
        Ok(vec![spec.into()])
    }

    fn absolute_word(&self, word: &str) -> String {
        word.to_owned()
    }
}

impl From<Spec> for ScenarioRef {
    fn from(spec: Spec) -> Self {
        Self::new(spec.to_string(), move || {
            generate(&spec).map_err(ReaderError::new)
        })
        .with_id(spec.to_string())
        .with_type(spec.scenario_type.name())
        .with_log_name(spec.log_name())
    }
}
