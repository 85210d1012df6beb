//! Keys of a GGUF file that no code read. One that changes the result is an error that names it;
//! one that is not known is noted.

use super::header::Header;
use super::metadata::shown;
use crate::MllmError;
use serde_json::Value;

/// How a key is treated that no code of the model's family read.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Unread {
    /// It says nothing about the result, or nothing where it is not read.
    NoEffect,
    /// It changes the result, unless it has one of these values.
    Changes(&'static [f64]),
    /// As [`Self::Changes`], unless it is true.
    ChangesUnlessTrue,
}

use Unread::{Changes, ChangesUnlessTrue, NoEffect};

/// No value, or a list of such.
const ZERO: Unread = Changes(&[0.0]);
/// A factor that multiplies by 1, or that is not used.
const FACTOR: Unread = Changes(&[0.0, 1.0]);

/// Keys of decoders behind the name of the architecture; one that ends in a point stands for all
/// keys that begin with it.
const DECODER: &[(&str, Unread)] = &[
    ("vocab_size", NoEffect),
    ("tensor_data_layout", NoEffect),
    ("decoder_start_token_id", NoEffect),
    ("pooling_type", NoEffect),
    // The flags of the tower say which layers they are.
    ("n_deepstack_layers", NoEffect),
    // Without experts, which are refused.
    ("expert_", NoEffect),
    ("experts_per_group", NoEffect),
    ("moe_", ZERO),
    ("interleave_moe_layer_step", ZERO),
    ("leading_dense_block_count", ZERO),
    ("nextn_predict_layers", ZERO),
    ("features_length", ZERO),
    ("embedding_length_out", ZERO),
    ("embedding_length_per_layer_input", ZERO),
    ("use_parallel_residual", ZERO),
    ("logit_scale", FACTOR),
    ("residual_scale", FACTOR),
    ("embedding_scale", FACTOR),
    ("attn_logit_softcapping", ZERO),
    ("final_logit_softcapping", ZERO),
    ("router_logit_softcapping", ZERO),
    ("swin_norm", ZERO),
    ("rescale_every_n_layers", ZERO),
    ("token_shift_count", FACTOR),
    ("time_mix_extra_dim", ZERO),
    ("time_decay_extra_dim", ZERO),
    ("full_attention_interval", FACTOR),
    ("activation_sparsity_scale", ZERO),
    ("swiglu_clamp_exp", ZERO),
    ("swiglu_clamp_shexp", ZERO),
    ("decoder_block_count", ZERO),
    ("altup.", ZERO),
    ("ssm.", ZERO),
    ("kda.", ZERO),
    ("wkv.", ZERO),
    ("posnet.", ZERO),
    ("convnext.", ZERO),
    ("shortconv.", ZERO),
    ("classifier.", ZERO),
    // Decoders of Llama's kind have RMS norms.
    ("attention.layer_norm_epsilon", NoEffect),
    ("attention.group_norm_", NoEffect),
    ("attention.relative_buckets_count", ZERO),
    ("attention.causal", ChangesUnlessTrue),
    ("attention.max_alibi_bias", ZERO),
    ("attention.clamp_kqv", ZERO),
    ("attention.scale", ZERO),
    ("attention.output_scale", FACTOR),
    ("attention.temperature_length", ZERO),
    ("attention.temperature_scale", ZERO),
    ("attention.q_lora_rank", ZERO),
    ("attention.kv_lora_rank", ZERO),
    ("attention.decay_lora_rank", ZERO),
    ("attention.iclr_lora_rank", ZERO),
    ("attention.value_residual_mix_lora_rank", ZERO),
    ("attention.gate_lora_rank", ZERO),
    ("attention.key_length_mla", ZERO),
    ("attention.value_length_mla", ZERO),
    ("attention.key_length_swa", ZERO),
    ("attention.value_length_swa", ZERO),
    ("attention.shared_kv_layers", ZERO),
    ("attention.sliding_window_pattern", ZERO),
    ("attention.indexer.", ZERO),
    ("rope.dimension_count_swa", ZERO),
    ("rope.freq_base_swa", ZERO),
    ("rope.scaling.alpha", FACTOR),
    ("rope.scaling.attn_factor", FACTOR),
    // Only YaRN uses these, and then they are read.
    ("rope.scaling.original_context_length", NoEffect),
    ("rope.scaling.finetuned", NoEffect),
    ("rope.scaling.yarn_log_multiplier", ZERO),
    ("rope.scaling.yarn_", NoEffect),
    // With the type `none`, or where the newer key stands beside it.
    ("rope.scaling.factor", NoEffect),
    ("rope.scale_linear", NoEffect),
];

/// Keys of vision towers behind `clip.`.
const TOWER: &[(&str, Unread)] = &[
    ("has_vision_encoder", NoEffect),
    ("has_text_encoder", NoEffect),
    ("has_audio_encoder", NoEffect),
    ("has_llava_projector", NoEffect),
    ("projector_type", NoEffect),
    ("text.", NoEffect),
    ("audio.", NoEffect),
    // The projector's tensors say it.
    ("vision.projection_dim", NoEffect),
    ("vision.mm_", NoEffect),
    // Remarks of llama.cpp's older converter; the resolutions of the grid decide.
    ("vision.image_aspect_ratio", NoEffect),
    ("vision.image_crop_resolution", NoEffect),
    ("vision.image_split_resolution", NoEffect),
    ("vision.image_min_pixels", ZERO),
    ("vision.image_max_pixels", ZERO),
    ("vision.preproc_min_tiles", ZERO),
    ("vision.preproc_max_tiles", ZERO),
    ("vision.preproc_image_size", ZERO),
    ("vision.spatial_merge_size", FACTOR),
    ("vision.image_grid_pinpoints", ZERO),
    ("vision.feature_layer", ZERO),
    ("vision.n_wa_pattern", ZERO),
    ("vision.wa_layer_indexes", ZERO),
    ("vision.window_size", ZERO),
    ("vision.is_deepstack_layers", ZERO),
    ("vision.projector.scale_factor", FACTOR),
    ("vision.sam.", ZERO),
    ("minicpmv_version", ZERO),
    ("minicpmv_query_num", ZERO),
];

/// Checks the keys of a header behind `prefix` that no code read, and notes those that are in no
/// table.
pub(crate) fn check(header: &Header, notes: &mut Vec<String>) -> Result<(), MllmError> {
    let architecture = header.architecture()?;
    let (prefix, table) = if architecture == super::TOWER {
        ("clip.".to_owned(), TOWER)
    } else {
        (format!("{architecture}."), DECODER)
    };
    for (key, value) in header.unread() {
        let Some(name) = key.strip_prefix(&prefix) else {
            continue;
        };
        match treatment(table, name) {
            Some(unread) if unread.is_neutral(value) => {}
            Some(_) => {
                let problem = format!(
                    "{} changes the result, and it is not read for this model",
                    shown(value)
                );
                return Err(header.error(key, problem));
            }
            None => notes.push(format!(
                "{}: the key {key} is not known and not read",
                header.path.display()
            )),
        }
    }
    Ok(())
}

/// How an unread key is treated, by its own name or by the beginning of its name.
fn treatment(table: &[(&str, Unread)], name: &str) -> Option<Unread> {
    let is_of =
        |known: &str| known == name || known.ends_with(['.', '_']) && name.starts_with(known);
    table
        .iter()
        .find(|(known, _)| is_of(known))
        .map(|(_, unread)| *unread)
}

impl Unread {
    fn is_neutral(self, value: &Value) -> bool {
        match self {
            NoEffect => true,
            ChangesUnlessTrue => *value == Value::Bool(true),
            Changes(neutral) => match value {
                Value::Array(values) => values.iter().all(|value| self.is_neutral(value)),
                Value::Bool(flag) => !flag,
                Value::Number(number) => number
                    .as_f64()
                    .is_some_and(|number| neutral.contains(&number)),
                _ => false,
            },
        }
    }
}
