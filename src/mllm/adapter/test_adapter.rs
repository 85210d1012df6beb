//! What tests of adapters share: a base without a family, and files of one's own making.

use super::BaseModel;
use crate::MllmError;
use crate::checkpoint::{ModelFiles, TensorPlace, TensorSource};
use crate::gguf::names::{DECODER_LAYERS, EMBEDDING, FINAL_NORM, Names, OUTPUT};
use crate::gguf::{Entries, GgufLayout, Header};
use std::collections::BTreeMap;
use std::path::Path;

/// A family whose canonical names are those of its files.
pub(super) fn identity(name: &str) -> Option<String> {
    Some(name.to_owned())
}

/// A base with these names, which llama.cpp does not know.
pub(super) fn merged(canonical: &dyn Fn(&str) -> Option<String>) -> BaseModel<'_> {
    BaseModel {
        family: "test",
        canonical_name: canonical,
        gguf: Err("tests"),
        architecture: None,
        heads: [4, 2],
    }
}

pub(super) fn names_of_llama() -> Names {
    Names {
        single: &[EMBEDDING, FINAL_NORM, OUTPUT],
        layers: &[DECODER_LAYERS],
    }
}

/// A text-only llama in llama.cpp's files.
pub(super) struct LlamaLayout;

impl GgufLayout for LlamaLayout {
    fn opens(&self, _: &Header, _: &Header) -> bool {
        false
    }

    fn small_files(
        &self,
        _: &Header,
        _: &Header,
        _: &mut Vec<String>,
    ) -> Result<BTreeMap<String, String>, MllmError> {
        Ok(BTreeMap::new())
    }

    fn canonical_name(&self, _: &Header, name: &str) -> Result<Option<String>, MllmError> {
        Ok(names_of_llama().to_canonical(name))
    }

    fn gguf_name(&self, canonical: &str) -> Option<String> {
        names_of_llama().in_gguf(canonical)
    }

    fn metadata(&self, _: &ModelFiles) -> Result<Result<[Entries; 2], &'static str>, MllmError> {
        Ok(Err("tests"))
    }
}

/// Numbers as a file of one tensor.
pub(super) fn in_memory(numbers: &[f32]) -> impl TensorSource + 'static {
    Memory(
        numbers
            .iter()
            .flat_map(|number| number.to_le_bytes())
            .collect(),
    )
}

#[derive(Debug)]
struct Memory(Vec<u8>);

impl TensorSource for Memory {
    fn path(&self) -> &Path {
        Path::new("memory")
    }

    fn bytes(&self, _: &TensorPlace) -> Result<Vec<u8>, MllmError> {
        Ok(self.0.clone())
    }

    fn hash(&self, _: &mut blake3::Hasher) -> Result<(), MllmError> {
        Ok(())
    }
}
