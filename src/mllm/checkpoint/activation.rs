//! Activation functions by their names in configurations.

use super::section::Section;
use crate::mllm::MllmError;

/// Activation functions by their names in Hugging Face configurations.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Activation {
    /// `gelu`: with the error function.
    Gelu,
    /// `gelu_new`, `gelu_pytorch_tanh`: with tanh.
    GeluTanh,
    /// `quick_gelu`: x·σ(1.702 x).
    QuickGelu,
    /// `relu`.
    Relu,
    /// `silu`, `swish`.
    Silu,
}

impl Activation {
    /// Reads an activation by its name.
    ///
    /// # Errors
    /// When the name is not known.
    pub(crate) fn from_section(section: &Section<'_>, key: &str, default: Self) -> Result<Self, MllmError> {
        match section.text(key)? {
            None => Ok(default),
            Some("gelu") => Ok(Self::Gelu),
            Some("gelu_new" | "gelu_pytorch_tanh") => Ok(Self::GeluTanh),
            Some("quick_gelu") => Ok(Self::QuickGelu),
            Some("relu") => Ok(Self::Relu),
            Some("silu" | "swish") => Ok(Self::Silu),
            Some(other) => Err(section.error(key, format!("activation {other:?} is not supported"))),
        }
    }
}
