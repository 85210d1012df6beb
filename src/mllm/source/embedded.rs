//! Models whose files are compiled into the program.

use super::Checkpoint;
use crate::MllmError;
use crate::checkpoint::{ModelFiles, safetensors_folder};
use crate::families::Families;
use planagent_kernels::matrix::WeightFormat;
use std::fmt;
use std::path::Path;

/// A model whose files are compiled into the program.
#[derive(PartialEq, Eq)]
pub struct EmbeddedModel {
    /// Its name in descriptions.
    pub name: &'static str,
    /// Its description, as in `models/NAME.toml`.
    pub(crate) description: &'static str,
    /// Its small files by name.
    texts: &'static [(&'static str, &'static str)],
    /// Its `model.safetensors`.
    pub(super) weights: &'static [u8],
}

impl fmt::Debug for EmbeddedModel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "EmbeddedModel({})", self.name)
    }
}

#[cfg(feature = "nano")]
macro_rules! texts {
    ($($file:literal),* $(,)?) => {
        &[$(($file, include_str!(concat!("../../../models/nano/", $file)))),*]
    };
}

static EMBEDDED: &[EmbeddedModel] = &[
    #[cfg(feature = "nano")]
    EmbeddedModel {
        name: "nano",
        description: include_str!("../../../models/nano.toml"),
        texts: texts![
            "chat_template.jinja",
            "config.json",
            "generation_config.json",
            "preprocessor_config.json",
            "processor_config.json",
            "tokenizer.json",
            "tokenizer_config.json",
        ],
        weights: include_bytes!("../../../models/nano/model.safetensors"),
    },
];

impl EmbeddedModel {
    pub fn all() -> &'static [Self] {
        EMBEDDED
    }

    /// Its small files: names and texts.
    pub(crate) fn texts(&self) -> &'static [(&'static str, &'static str)] {
        self.texts
    }

    pub fn find(name: &str) -> Option<&'static Self> {
        EMBEDDED.iter().find(|model| model.name == name)
    }

    pub(super) fn checkpoint(
        &self,
        quantize: Option<WeightFormat>,
        families: &Families,
    ) -> Result<Checkpoint, MllmError> {
        let texts = self
            .texts
            .iter()
            .map(|&(name, text)| (name.to_owned(), text.to_owned()))
            .collect();
        let files = ModelFiles::packed(Path::new(self.name), texts);
        let family = families.detect_in(&files)?;
        let canonical_name = family.family().canonical_name;
        let weights = safetensors_folder::of_bytes(
            Path::new(self.name),
            self.weights,
            quantize,
            canonical_name,
        )?;
        Ok(Checkpoint {
            family,
            files,
            weights,
        })
    }
}
