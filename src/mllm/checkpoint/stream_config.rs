//! Decoders with several hidden states of a token ("streams"), of which a layer works on one.

use super::config::{ConfigObject, MAX_WIDTH, OneOrMany, check_ranges, check_width};
use super::llama_config::LlamaConfig;
use crate::MllmError;
use candle_core::cpu::erf;
use serde_json::json;
use std::f64::consts::SQRT_2;

/// Several hidden states of a token beside one another (`AltUp`), of which a layer works on one and
/// moves the others along. Such layers have a low-rank part beside attention (`LAuReL`), and gates
/// of which few count (`Gemma3nTextConfig`).
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct StreamConfig {
    /// How many there are.
    pub count: usize,
    /// The one that layers work on, from 0.
    pub active: usize,
    /// Whether that one is multiplied by a weight before it reads the layer's own input.
    pub scaled: bool,
    /// Width between the two projections beside attention.
    pub rank: usize,
    /// Of each layer: deviations above the mean below which gates are 0; none where all count.
    pub cutoffs: Vec<Option<f64>>,
    /// Width of the feed-forward network of each layer.
    pub widths: Vec<usize>,
}

const COUNT: &str = "altup_num_inputs";
const ACTIVE: &str = "altup_active_idx";
const RANK: &str = "laurel_rank";
const PARTS: &str = "activation_sparsity_pattern";
const WIDTHS: &str = "intermediate_size";

/// Most streams. Published models have four.
const MAX_STREAMS: usize = 16;
/// The part of gates that are 0 in the first layers, and how many these are, where a file does not
/// say it. Models of no more layers have none.
const DEFAULT_PART: f64 = 0.95;
const DEFAULT_SPARSE: usize = 10;

/// Takes a list of widths out of the keys of a decoder, whose width is then that of the widest.
pub(super) fn split_widths(
    mut text: ConfigObject<'_>,
) -> Result<(ConfigObject<'_>, Option<Vec<usize>>), MllmError> {
    match text.value(WIDTHS)? {
        Some(OneOrMany::Many(widths)) => {
            for width in &widths {
                check_ranges(&text, &[(WIDTHS, *width, MAX_WIDTH)])?;
            }
            let widest = widths.iter().max().copied();
            let widest =
                widest.ok_or_else(|| text.error(WIDTHS, "expected a width, found none"))?;
            text.remove(WIDTHS);
            Ok((text.with_defaults(json!({WIDTHS: widest})), Some(widths)))
        }
        Some(OneOrMany::One(_)) | None => Ok((text, None)),
    }
}

impl StreamConfig {
    /// Reads the keys that Llama does not have.
    pub(super) fn read(
        text: &ConfigObject<'_>,
        config: &LlamaConfig,
        widths: Option<Vec<usize>>,
    ) -> Result<Self, MllmError> {
        let (count, rank) = (
            text.value(COUNT)?.unwrap_or(4),
            text.value(RANK)?.unwrap_or(64),
        );
        check_ranges(
            text,
            &[(COUNT, count, MAX_STREAMS), (RANK, rank, MAX_WIDTH)],
        )?;
        // Key by key, each checked before anything is made of it.
        check_width(text, COUNT, count, config.hidden)?;
        let active = text.value(ACTIVE)?.unwrap_or(0);
        if active >= count {
            return Err(text.error(ACTIVE, format!("{active} is none of {count} streams")));
        }
        let one_each = |key: &str, found: usize| {
            if found == config.layers {
                return Ok(());
            }
            let problem = format!("has {found} entries for {} layers", config.layers);
            Err(text.error(key, problem))
        };
        let parts: Option<Vec<f64>> = text.value(PARTS)?;
        let parts = parts.unwrap_or_else(|| default_parts(config.layers));
        one_each(PARTS, parts.len())?;
        if let Some(part) = parts.iter().find(|part| !(0.0..1.0).contains(*part)) {
            let problem = format!("expected numbers from 0 to below 1, found {part}");
            return Err(text.error(PARTS, problem));
        }
        let widths = widths.unwrap_or_else(|| vec![config.intermediate; config.layers]);
        one_each(WIDTHS, widths.len())?;
        let above = |part: &f64| (*part > 0.0).then(|| deviations_above(*part));
        Ok(Self {
            count,
            active,
            scaled: text.value("altup_correct_scale")?.unwrap_or(true),
            rank,
            cutoffs: parts.iter().map(above).collect(),
            widths,
        })
    }
}

/// The part of gates that are 0 in each layer, where a file does not say it.
fn default_parts(layers: usize) -> Vec<f64> {
    let sparse = if layers > DEFAULT_SPARSE {
        DEFAULT_SPARSE
    } else {
        0
    };
    let part = |layer| if layer < sparse { DEFAULT_PART } else { 0.0 };
    (0..layers).map(part).collect()
}

/// The number of deviations above the mean below which this part of a normal distribution lies.
fn deviations_above(part: f64) -> f64 {
    SQRT_2 * erf::erf_inv(2.0 * part - 1.0)
}

/// The part of a normal distribution that lies below so many deviations above its mean.
pub(crate) fn part_below(deviations: f64) -> f64 {
    f64::midpoint(1.0, erf::erf_f64(deviations / SQRT_2))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checkpoint::{DecoderType, LayerKeys};
    use serde_json::Value;
    use std::path::Path;

    fn read(config: &Value) -> Result<LlamaConfig, MllmError> {
        let root = ConfigObject::root(Path::new("config.json"), config)?;
        LlamaConfig::read_as(root, DecoderType::Gemma3n)
    }

    /// The shapes of the fact sheet: a file that leaves out what the class has.
    #[test]
    fn the_published_e4b_is_the_class_itself() {
        let config = read(&json!({})).unwrap();
        let streams = config.streams.as_ref().unwrap();
        assert_eq!((streams.count, streams.active, streams.rank), (4, 0, 64));
        assert_eq!(streams.widths, [16_384; 35]);
        let sparse: Vec<usize> = (0..35)
            .filter(|layer| streams.cutoffs[*layer].is_some())
            .collect();
        assert_eq!(sparse, (0..10).collect::<Vec<_>>());
        assert!((streams.cutoffs[0].unwrap() - 1.644_853_627).abs() < 1e-8);
        let gemma = config.gemma.as_ref().unwrap();
        assert!(gemma.is_local(3) && !gemma.is_local(4) && !gemma.sees_image_at_once());
        assert_eq!((gemma.window, gemma.query_scalar), (512, 1.0));
        assert_eq!((config.rope.theta, gemma.local_rope.theta), (1e6, 1e4));
        assert_eq!(
            [18, 19, 20, 34].map(|layer| config.shape(layer).keys),
            [
                LayerKeys::Projected,
                LayerKeys::Projected,
                LayerKeys::Of(18),
                LayerKeys::Of(19)
            ]
        );
        assert!(config.value_norms && !config.norms_add_one && !config.layer_scales);
        assert_eq!((config.softcap, config.vocabulary), (Some(30.0), 262_400));
        let inputs = config.layer_inputs.unwrap();
        assert_eq!(
            [Some(5), Some(262_144), None].map(|token| inputs.row(token)),
            [5, 0, 0]
        );
    }

    #[test]
    fn layers_may_differ_in_width_and_sparsity() {
        let config = read(&json!({
            "num_hidden_layers": 3, "num_kv_shared_layers": 1, "intermediate_size": [8, 24, 16],
            "activation_sparsity_pattern": [0.5, 0, 0.25],
            "layer_types": ["sliding_attention", "full_attention", "sliding_attention"],
        }))
        .unwrap();
        assert_eq!(
            [0, 1, 2].map(|layer| config.shape(layer).intermediate),
            [8, 24, 16]
        );
        assert_eq!(config.intermediate, 24);
        let cutoffs = &config.streams.as_ref().unwrap().cutoffs;
        assert_eq!(cutoffs[..2], [Some(0.0), None]);
        assert!((cutoffs[2].unwrap() + 0.674_489_75).abs() < 1e-7);
        // Few layers have no zeros by themselves.
        let few = read(&json!({"num_hidden_layers": 10, "num_kv_shared_layers": 0})).unwrap();
        assert!(few.streams.unwrap().cutoffs.iter().all(Option::is_none));
    }

    #[test]
    fn a_part_and_its_deviations_lead_back() {
        for part in [0.05, 0.5, 0.7, 0.95, 0.999] {
            assert!(
                (part_below(deviations_above(part)) - part).abs() < 1e-12,
                "{part}"
            );
        }
    }

    #[test]
    fn what_contradicts_is_named() {
        for (key, value) in [
            ("altup_num_inputs", json!(0)),
            ("altup_num_inputs", json!(17)),
            ("altup_active_idx", json!(4)),
            ("laurel_rank", json!(0)),
            ("intermediate_size", json!([8, 8])),
            ("intermediate_size", json!([])),
            ("intermediate_size", json!(vec![1 << 22; 35])),
            ("activation_sparsity_pattern", json!([0.95])),
            ("activation_sparsity_pattern", json!(vec![1.0; 35])),
            ("activation_sparsity_pattern", json!(vec![-0.5; 35])),
            ("activation_sparsity_pattern", json!(0.95)),
            ("hidden_size_per_layer_input", json!(0)),
            ("vocab_size_per_layer_input", json!(0)),
            ("num_kv_shared_layers", json!(35)),
            ("num_kv_shared_layers", json!(31)),
            ("num_hidden_layers", json!(1 << 20)),
            ("hidden_activation", json!("silu")),
            ("final_logit_softcapping", json!(-1)),
            ("partial_rotary_factor", json!(0.5)),
        ] {
            let error = read(&json!({key: value})).unwrap_err().to_string();
            assert!(error.contains(key), "{key}: {error}");
        }
    }
}
