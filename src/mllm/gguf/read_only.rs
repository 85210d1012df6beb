//! Families whose files of llama.cpp are read but not written: a table of names, and how the
//! tower's metadata becomes the small files.

use super::names::Names;
use super::{Described, GgufLayout, Header, TextFiles, no_tower};
use crate::MllmError;
use crate::checkpoint::ModelFiles;
use serde_json::{Value, json};
use std::collections::BTreeMap;

/// How llama.cpp's files hold a family that this program writes into a file of its own.
pub(crate) struct ReadOnlyLayout {
    /// Architectures of its decoders.
    pub decoders: &'static [&'static str],
    /// Kind of its tower's projector.
    pub projector: &'static str,
    /// The `model_type` of its configuration.
    pub model_type: &'static str,
    /// The special token that stands for a token of the image.
    pub placeholder: &'static str,
    pub names: Names,
    /// The name in `names` of a tensor of a file; none for a tensor that is not used.
    pub renamed: fn(file: &Header, name: &str) -> Result<Option<String>, MllmError>,
    /// What a tower's file says about the image; a note says what it leaves open.
    pub vision: fn(tower: &Header, notes: &mut Vec<String>) -> Result<VisionFiles, MllmError>,
    /// What llama.cpp's converter changes in the decoder's numbers.
    pub changed: Changed,
    /// What a model may set and llama.cpp has no key for.
    pub lacking: &'static str,
}

/// What llama.cpp's converter changes in a decoder's numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Changed {
    Nothing,
    /// Norms have 1 added ([`GgufLayout::norms_have_one`]).
    Norms,
    /// And the value heads of a key lie apart ([`GgufLayout::heads_are_tiled`]).
    NormsAndHeads,
}

impl Changed {
    pub(crate) fn norms(self) -> bool {
        self != Self::Nothing
    }

    pub(crate) fn heads(self) -> bool {
        self == Self::NormsAndHeads
    }
}

/// The small files as far as a tower decides them.
pub(crate) struct VisionFiles {
    /// `config.json` without its decoder.
    pub config: Value,
    /// `preprocessor_config.json`.
    pub processor: Value,
}

/// The name of a tensor as it stands in a file.
#[expect(clippy::unnecessary_wraps, reason = "it is a `renamed` of a layout")]
pub(crate) fn as_stored(_file: &Header, name: &str) -> Result<Option<String>, MllmError> {
    Ok(Some(name.to_string()))
}

impl GgufLayout for ReadOnlyLayout {
    fn opens(&self, decoder: &Header, tower: Option<&Header>) -> bool {
        let projector = tower.and_then(|tower| tower.projector().ok().flatten());
        decoder
            .architecture()
            .is_ok_and(|decoder| self.decoders.contains(&decoder))
            && projector == Some(self.projector)
    }

    fn small_files(
        &self,
        decoder: &Header,
        tower: Option<&Header>,
        notes: &mut Vec<String>,
    ) -> Result<BTreeMap<String, String>, MllmError> {
        let tower = tower.ok_or_else(|| no_tower(decoder, "its configuration"))?;
        let mut files = TextFiles::read(decoder, notes)?;
        let VisionFiles {
            mut config,
            processor,
        } = (self.vision)(tower, notes)?;
        config["model_type"] = json!(self.model_type);
        config["image_token_id"] = json!(files.added_id(decoder, self.placeholder)?);
        config["text_config"] = files.text_config.clone();
        files.put("config.json", &config);
        files.put("preprocessor_config.json", &processor);
        Ok(files.into_files())
    }

    fn canonical_name(&self, file: &Header, name: &str) -> Result<Option<String>, MllmError> {
        match (self.renamed)(file, name)? {
            Some(name) => self.names.unswapped(file, &name),
            None => Ok(None),
        }
    }

    fn gguf_name(&self, canonical: &str) -> Option<String> {
        self.names.in_gguf(canonical)
    }

    fn norms_have_one(&self) -> bool {
        self.changed.norms()
    }

    fn heads_are_tiled(&self) -> bool {
        self.changed.heads()
    }

    fn metadata(&self, _files: &ModelFiles) -> Result<Described, MllmError> {
        Ok(Err(self.lacking))
    }
}
