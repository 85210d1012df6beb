//! Families with a table of names: how the tower's metadata becomes the small files, and these the
//! metadata.

use super::names::Names;
use super::{Described, Entries, GgufLayout, Header, TextFiles, is_pair, no_tower};
use crate::MllmError;
use crate::checkpoint::{ModelFiles, VisionConfig};
use planagent_kernels::Activation;
use serde_json::{Value, json};
use std::collections::BTreeMap;

/// How llama.cpp's files hold a family: a decoder, and a tower beside it.
pub(crate) struct PairLayout {
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
    pub written: Written,
}

/// Whether this program writes a pair of files of a family.
#[derive(Clone, Copy)]
pub(crate) enum Written {
    /// It does not, because of this part.
    Not(&'static str),
    /// With this metadata.
    With(fn(&ModelFiles) -> Result<Described, MllmError>),
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

impl GgufLayout for PairLayout {
    fn opens(&self, decoder: &Header, tower: Option<&Header>) -> bool {
        is_pair(decoder, tower, self.decoders, self.projector)
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

    fn metadata(&self, files: &ModelFiles) -> Result<Described, MllmError> {
        match self.written {
            Written::Not(lacking) => Ok(Err(lacking)),
            Written::With(describe) => describe(files),
        }
    }
}

/// Mean and deviation of a tower's pixel values; none where they are not normalized.
type NormalizedBy = [[f32; 3]; 2];

/// The metadata that all towers have, with `projector` as the kind of the projector to a decoder of
/// `width` numbers.
///
/// # Errors
/// The part that llama.cpp has no key for.
pub(crate) fn tower_metadata(
    projector: &str,
    vision: &VisionConfig,
    width: usize,
    scale: Option<NormalizedBy>,
) -> Result<Entries, &'static str> {
    let Some([mean, deviation]) = scale else {
        return Err("pixels that are not normalized");
    };
    let entries = [
        ("has_vision_encoder", json!(true)),
        ("projector_type", json!(projector)),
        ("vision.projection_dim", json!(width)),
        ("vision.image_size", json!(vision.image_size)),
        ("vision.patch_size", json!(vision.patch_size)),
        ("vision.embedding_length", json!(vision.hidden)),
        ("vision.feed_forward_length", json!(vision.intermediate)),
        ("vision.block_count", json!(vision.layers)),
        ("vision.attention.head_count", json!(vision.heads)),
        (
            "vision.attention.layer_norm_epsilon",
            json!(vision.layer_norm_eps),
        ),
        ("vision.image_mean", json!(mean)),
        ("vision.image_std", json!(deviation)),
    ];
    Ok(entries
        .map(|(key, value)| (format!("clip.{key}"), value))
        .into())
}

/// As [`tower_metadata`], for a family whose towers have the activation `expected`.
pub(crate) fn tower_with_activation(
    expected: Activation,
    projector: &str,
    vision: &VisionConfig,
    width: usize,
    scale: Option<NormalizedBy>,
) -> Result<Entries, &'static str> {
    if vision.act != expected {
        return Err("another activation of the vision tower");
    }
    let mut metadata = tower_metadata(projector, vision, width, scale)?;
    // llama.cpp has one word for both forms of GELU, and takes CLIP's without a word.
    match expected {
        Activation::Gelu | Activation::GeluTanh => {
            metadata.push(("clip.use_gelu".to_owned(), json!(true)));
        }
        Activation::Silu => metadata.push(("clip.use_silu".to_owned(), json!(true))),
        Activation::QuickGelu | Activation::Relu => {}
    }
    Ok(metadata)
}
