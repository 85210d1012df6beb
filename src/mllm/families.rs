//! The families of models. To add one, add its folder and a line to [`BUILT_IN`].

use super::checkpoint::{ConfigObject, ModelFiles};
use super::family::Family;
use super::{
    MllmError, cogvlm, gemma3, gemma3n, gemma4, internvl, lfm2_vl, llava, llava_next,
    llava_onevision, qwen2_5_vl, qwen2_vl, qwen3_5, qwen3_vl, smolvlm, text_only,
};
use serde::de::Error;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::path::Path;

const BUILT_IN: &[&Family] = &[
    &llava::FAMILY,
    &llava_next::FAMILY,
    &cogvlm::FAMILY,
    &smolvlm::FAMILY,
    &internvl::FAMILY,
    &qwen3_vl::FAMILY,
    &qwen2_5_vl::FAMILY,
    &qwen2_vl::FAMILY,
    &llava_onevision::FAMILY,
    &gemma3::FAMILY,
    &gemma3n::FAMILY,
    &gemma4::FAMILY,
    &lfm2_vl::FAMILY,
    &qwen3_5::FAMILY,
    &text_only::LLAMA,
    &text_only::QWEN2,
    &text_only::QWEN3,
    &text_only::GEMMA3,
    &text_only::GEMMA3N,
    &text_only::GEMMA4,
    &text_only::LFM2,
    &text_only::QWEN35,
];

/// The families that models are looked for in: those that are built in, and those of a program that
/// uses this one.
#[derive(Debug, Clone)]
pub struct Families(Vec<Architecture>);

/// A known family, by its name in model descriptions and results.
#[derive(Debug, Clone, Copy)]
pub struct Architecture(&'static Family);

impl Default for Families {
    fn default() -> Self {
        Self(BUILT_IN.iter().map(|family| Architecture(family)).collect())
    }
}

impl Families {
    pub fn with(mut self, family: &'static Family) -> Self {
        self.0.push(Architecture(family));
        self
    }

    pub fn iter(&self) -> impl Iterator<Item = Architecture> {
        self.0.iter().copied()
    }

    /// The family that the `config.json` of a folder names: by its `model_type`, else by the first
    /// of its `architectures`.
    pub fn detect(&self, folder: &Path) -> Result<Architecture, MllmError> {
        self.detect_in(&ModelFiles::folder(folder)?)
    }

    /// The family that the `config.json` of a model names.
    pub(crate) fn detect_in(&self, files: &ModelFiles) -> Result<Architecture, MllmError> {
        let json = files.required_json("config.json")?;
        let path = files.path("config.json");
        let root = ConfigObject::root(&path, &json)?;
        // `model_type` first, because a class in `architectures` may serve several families.
        let (key, found) = if let Some(name) = root.value("model_type")? {
            ("model_type", Some(name))
        } else {
            let names: Option<Vec<String>> = root.value("architectures")?;
            (
                "architectures",
                names.and_then(|names| names.into_iter().next()),
            )
        };
        let Some(found) = found else {
            return Err(root.error(
                "model_type",
                "is missing, and architectures names no model either",
            ));
        };
        self.iter()
            .find(|family| family.0.config_names.contains(&found.as_str()))
            .ok_or_else(|| {
                let known: Vec<&str> = self
                    .iter()
                    .filter_map(|family| family.0.config_names.first().copied())
                    .collect();
                root.error(
                    key,
                    format!(
                        "'{found}' is not supported; supported are {}",
                        known.join(", ")
                    ),
                )
            })
    }
}

impl Architecture {
    /// The built-in family of this name.
    pub fn named(name: &str) -> Option<Self> {
        Families::default()
            .iter()
            .find(|family| family.name() == name)
    }

    pub fn name(self) -> &'static str {
        self.0.name
    }

    pub fn family(self) -> &'static Family {
        self.0
    }
}

impl PartialEq for Architecture {
    fn eq(&self, other: &Self) -> bool {
        self.name() == other.name()
    }
}

impl Eq for Architecture {}

impl Serialize for Architecture {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name())
    }
}

impl<'de> Deserialize<'de> for Architecture {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let name = String::deserialize(deserializer)?;
        Self::named(&name).ok_or_else(|| {
            let known: Vec<&str> = Families::default().iter().map(Self::name).collect();
            D::Error::custom(format!(
                "unknown architecture '{name}'; known are {}",
                known.join(", ")
            ))
        })
    }
}
