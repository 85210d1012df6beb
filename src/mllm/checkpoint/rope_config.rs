//! The rotary embedding in a decoder's configuration.

use super::config::ConfigObject;
use super::decoder_type::DecoderType;
use super::neutral::Neutral;
use crate::MllmError;
use planagent_kernels::attention::{Rope, RopeScaling, RotarySections};
use serde::Deserialize;

#[derive(Deserialize)]
#[serde(rename_all = "snake_case")]
enum RopeType {
    Default,
    Linear,
    Llama3,
    /// Longer contexts than in training change the base; within it, this is the default.
    Dynamic,
    /// The default with sections.
    Mrope,
}

/// Reads `rope_scaling` (before transformers 5) or `rope_parameters`, with `rope_theta` in it or
/// beside it. Of two, transformers takes the first unless it is empty. `context` is the number of
/// positions of the training.
pub(super) fn read_rope(
    text: &ConfigObject<'_>,
    kind: DecoderType,
    context: usize,
) -> Result<Rope, MllmError> {
    let by_layer = (kind == DecoderType::Gemma3)
        .then(|| layer_rope(text, "full_attention"))
        .transpose()?
        .flatten();
    let section = match text
        .child("rope_scaling")?
        .filter(|section| !section.is_empty())
    {
        Some(section) => section,
        None if kind == DecoderType::Gemma3 => {
            by_layer.map_or_else(|| text.child_or_empty("rope_scaling"), Ok)?
        }
        None => text.child_or_empty("rope_parameters")?,
    };
    section.only_neutral(&[("partial_rotary_factor", Neutral::Number(1.0))])?;
    let required = |key: &str| {
        section
            .positive(key)?
            .ok_or_else(|| section.error(key, "is missing for this rope_type"))
    };
    let rope_type = if section.contains("rope_type") {
        "rope_type"
    } else {
        "type"
    };
    let scaling = match section.value(rope_type)?.unwrap_or(RopeType::Default) {
        RopeType::Default | RopeType::Dynamic | RopeType::Mrope => RopeScaling::None,
        RopeType::Linear => RopeScaling::Linear {
            factor: required("factor")?,
        },
        RopeType::Llama3 => RopeScaling::Llama3 {
            factor: required("factor")?,
            low_freq_factor: required("low_freq_factor")?,
            high_freq_factor: required("high_freq_factor")?,
            original_context: original_context(text, &section)?.unwrap_or(context as f64),
        },
    };
    let beside = text.positive("rope_theta")?.unwrap_or_else(|| kind.theta());
    let theta = section.positive("rope_theta")?.unwrap_or(beside);
    let lengths: Option<[usize; 3]> = section.value("mrope_section")?;
    let sections = lengths
        .or_else(|| kind.sections())
        .map(|lengths| RotarySections {
            lengths,
            interleaved: kind.interleaved(),
        });
    Ok(Rope {
        theta,
        scaling,
        sections,
    })
}

/// The rotary embedding of the local layers of a Gemma 3.
pub(super) fn read_local_rope(text: &ConfigObject<'_>) -> Result<Rope, MllmError> {
    const THETA: f64 = 10_000.0;
    let section = layer_rope(text, "sliding_attention")?;
    let own = match &section {
        Some(section) => {
            section.only_neutral(&[
                ("rope_type", Neutral::Text(&["default"])),
                ("partial_rotary_factor", Neutral::Number(1.0)),
            ])?;
            section.positive("rope_theta")?
        }
        None => None,
    };
    let beside = text.positive("rope_local_base_freq")?;
    Ok(Rope {
        theta: own.or(beside).unwrap_or(THETA),
        scaling: RopeScaling::None,
        sections: None,
    })
}

/// The part of `rope_parameters` for layers of a kind.
fn layer_rope<'a>(
    text: &ConfigObject<'a>,
    kind: &str,
) -> Result<Option<ConfigObject<'a>>, MllmError> {
    text.child("rope_parameters")?
        .map_or(Ok(None), |all| all.child(kind))
}

/// Positions before a context was lengthened: beside the section comes before in it.
fn original_context(
    text: &ConfigObject<'_>,
    section: &ConfigObject<'_>,
) -> Result<Option<f64>, MllmError> {
    const KEY: &str = "original_max_position_embeddings";
    Ok(text.positive(KEY)?.or(section.positive(KEY)?))
}
