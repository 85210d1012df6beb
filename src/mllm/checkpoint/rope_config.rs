//! The rotary embedding in a decoder's configuration.

use super::config::{ConfigObject, MAX_CONTEXT};
use super::decoder_type::DecoderType;
use super::neutral::Neutral;
use crate::MllmError;
use planagent_kernels::attention::{Rope, RopeScaling, RotarySections, Yarn};
use serde::Deserialize;
use serde_json::json;

#[derive(Deserialize)]
#[serde(rename_all = "snake_case")]
enum RopeType {
    Default,
    Linear,
    Llama3,
    Yarn,
    /// Longer contexts than in training change the base; within it, this is the default.
    Dynamic,
    /// The default with sections.
    Mrope,
    /// The first pairs are turned by the frequencies of the whole head.
    Proportional,
}

/// A rotary embedding, and the positions that it is meant for.
pub(super) struct ReadRope {
    pub rope: Rope,
    /// Positions that a chat may have.
    pub context: usize,
    /// The part of a head that is rotated.
    pub part: f64,
}

/// Reads `rope_scaling` (before transformers 5) or `rope_parameters`, with `rope_theta` in it or
/// beside it. Of two, transformers takes the first unless it is empty. `context` is the number of
/// positions in the configuration.
pub(super) fn read_rope(
    text: &ConfigObject<'_>,
    kind: DecoderType,
    context: usize,
) -> Result<ReadRope, MllmError> {
    if kind == DecoderType::Gemma4 {
        return read_global_rope(text, context);
    }
    let is_gemma = matches!(kind, DecoderType::Gemma3 | DecoderType::Gemma3n);
    let by_layer = is_gemma
        .then(|| layer_rope(text, "full_attention"))
        .transpose()?
        .flatten();
    let section = match text
        .child("rope_scaling")?
        .filter(|section| !section.is_empty())
    {
        Some(section) => section,
        None if is_gemma => by_layer.map_or_else(|| text.child_or_empty("rope_scaling"), Ok)?,
        None => text.child_or_empty("rope_parameters")?,
    };
    let part = rotated_part(text, &section, kind)?;
    let required = |key: &str| {
        section
            .positive(key)?
            .ok_or_else(|| section.error(key, "is missing for this rope_type"))
    };
    // Configurations of before transformers 4.43 say `type`.
    let rope_type = if section.contains("rope_type") {
        "rope_type"
    } else {
        "type"
    };
    let scaling = match section.value(rope_type)?.unwrap_or(RopeType::Default) {
        RopeType::Default | RopeType::Mrope => RopeScaling::None,
        RopeType::Dynamic => RopeScaling::Dynamic {
            factor: required("factor")?,
            original_context: context as f64,
        },
        RopeType::Yarn => RopeScaling::Yarn(read_yarn(text, &section, context as f64)?),
        RopeType::Linear => RopeScaling::Linear {
            factor: required("factor")?,
        },
        RopeType::Proportional => {
            return Err(section.error(rope_type, "'proportional' is not supported here"));
        }
        RopeType::Llama3 => RopeScaling::Llama3 {
            factor: required("factor")?,
            low_freq_factor: required("low_freq_factor")?,
            high_freq_factor: required("high_freq_factor")?,
            original_context: original_context(text, &section)?.unwrap_or(context as f64),
        },
    };
    let beside = text.positive("rope_theta")?.unwrap_or_else(|| kind.theta());
    let theta = section.positive("rope_theta")?.unwrap_or(beside);
    if matches!(scaling, RopeScaling::Yarn(_)) && theta <= 1.0 {
        let problem = format!("{theta} is too small for yarn; it must be above 1");
        return Err(section.error("rope_theta", problem));
    }
    let lengths: Option<[usize; 3]> = section.value("mrope_section")?;
    let sections = lengths
        .or_else(|| kind.sections())
        .map(|lengths| RotarySections {
            lengths,
            interleaved: kind.interleaved(),
        });
    let rope = Rope {
        theta,
        scaling,
        sections,
    };
    Ok(ReadRope {
        context: lengthened(scaling, context),
        rope,
        part,
    })
}

/// The rotary embedding of the global layers of a Gemma 4.
fn read_global_rope(text: &ConfigObject<'_>, context: usize) -> Result<ReadRope, MllmError> {
    const PART: &str = "partial_rotary_factor";
    let section = layer_rope(text, "full_attention")?;
    // Without any parameters, those of the class.
    let class = json!({"rope_type": "proportional", PART: 0.25, "rope_theta": 1e6});
    let section = match section {
        Some(section) => section,
        None => text
            .child_or_empty("rope_parameters")?
            .child_or_empty("full_attention")?
            .with_defaults(class),
    };
    let scaling = match section.value("rope_type")?.unwrap_or(RopeType::Default) {
        RopeType::Default => {
            section.only_neutral(&[(PART, Neutral::Number(1.0))])?;
            RopeScaling::None
        }
        RopeType::Proportional => {
            let part = section.positive(PART)?.unwrap_or(1.0);
            if part > 1.0 {
                let problem = format!("expected a number of at most 1, found {part}");
                return Err(section.error(PART, problem));
            }
            RopeScaling::Proportional {
                part,
                factor: section.positive("factor")?.unwrap_or(1.0),
            }
        }
        _ => {
            let problem = "is not supported in these layers; default and proportional are";
            return Err(section.error("rope_type", problem));
        }
    };
    let rope = Rope {
        theta: section.positive("rope_theta")?.unwrap_or(GEMMA4_THETA),
        scaling,
        sections: None,
    };
    Ok(ReadRope {
        rope,
        context,
        part: 1.0,
    })
}

/// Base where a section of Gemma 4 has none (`default_theta` of transformers).
const GEMMA4_THETA: f64 = 10_000.0;

/// The part of a head that is rotated: that of the section, beside it, or of the class.
fn rotated_part(
    text: &ConfigObject<'_>,
    section: &ConfigObject<'_>,
    kind: DecoderType,
) -> Result<f64, MllmError> {
    const KEY: &str = "partial_rotary_factor";
    let Some(default) = kind.rotated_part() else {
        // A key that this code would pass over changes every answer, so it is refused.
        section.only_neutral(&[(KEY, Neutral::Number(1.0))])?;
        return Ok(1.0);
    };
    let place = if section.contains(KEY) { section } else { text };
    let part = place.positive(KEY)?.unwrap_or(default);
    if part > 1.0 {
        return Err(place.error(KEY, format!("expected a number of at most 1, found {part}")));
    }
    Ok(part)
}

/// Largest factor by which a context is lengthened. Published ones are at most 64.
const MAX_FACTOR: f64 = 65_536.0;

/// Reads the keys of `YaRN`.
fn read_yarn(
    text: &ConfigObject<'_>,
    section: &ConfigObject<'_>,
    context: f64,
) -> Result<Yarn, MllmError> {
    let original = original_context(text, section)?;
    let original_context = original.unwrap_or(context);
    // Without a factor it is the ratio of the contexts, as in files of DeepSeek.
    let factor = match (section.positive("factor")?, original) {
        (Some(factor), _) => factor,
        (None, Some(original)) => context / original,
        (None, None) => return Err(section.error("factor", "is missing for this rope_type")),
    };
    let attention = match section.positive("attention_factor")? {
        Some(attention) => attention,
        None => match (
            section.positive("mscale")?,
            section.positive("mscale_all_dim")?,
        ) {
            (Some(above), Some(below)) => {
                Yarn::advised_attention(factor, above) / Yarn::advised_attention(factor, below)
            }
            _ => Yarn::advised_attention(factor, 1.0),
        },
    };
    let yarn = Yarn {
        factor,
        original_context,
        beta_fast: section.positive("beta_fast")?.unwrap_or(32.0),
        beta_slow: section.positive("beta_slow")?.unwrap_or(1.0),
        truncate: section.value("truncate")?.unwrap_or(true),
        attention,
    };
    for (key, number) in [
        ("factor", factor),
        ("attention_factor", attention),
        ("beta_fast", yarn.beta_fast),
    ] {
        if number > MAX_FACTOR {
            let problem = format!("expected a number of at most {MAX_FACTOR}, found {number}");
            return Err(section.error(key, problem));
        }
    }
    if yarn.beta_slow > yarn.beta_fast {
        let problem = format!(
            "{} is larger than beta_fast, {}",
            yarn.beta_slow, yarn.beta_fast
        );
        return Err(section.error("beta_slow", problem));
    }
    Ok(yarn)
}

/// The rotary embedding of the local layers of a Gemma 3.
pub(super) fn read_local_rope(text: &ConfigObject<'_>) -> Result<Rope, MllmError> {
    /// Base where the file has none (`rope_local_base_freq` of `Gemma3TextConfig`).
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

/// Positions that a chat may have: `YaRN` and a dynamic base are meant for more than those of the
/// training, and published configurations name these (Qwen2.5's card, `InternVL3`).
fn lengthened(scaling: RopeScaling, context: usize) -> usize {
    let meant = match scaling {
        RopeScaling::Yarn(yarn) => yarn.factor * yarn.original_context,
        RopeScaling::Dynamic {
            factor,
            original_context,
        } => factor * original_context,
        RopeScaling::None
        | RopeScaling::Linear { .. }
        | RopeScaling::Llama3 { .. }
        | RopeScaling::Proportional { .. } => 0.0,
    };
    // A cast of a float keeps to the range of the target.
    context.max((meant as usize).min(MAX_CONTEXT))
}
