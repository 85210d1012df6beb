//! The names of tensors in llama.cpp's GGUF files and the canonical names of a family.

use super::Header;
use crate::MllmError;

/// The names of a family's tensors: name in GGUF, canonical name.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Names {
    /// Tensors outside of layers.
    pub single: &'static [Pair],
    /// Layers: prefix in GGUF, canonical prefix, parts before `.weight` or `.bias`.
    pub layers: &'static [(&'static str, &'static str, &'static [Pair])],
}

/// Name in GGUF, canonical name.
pub(crate) type Pair = (&'static str, &'static str);

/// The decoder's tensors outside of layers.
pub(crate) const EMBEDDING: Pair = ("token_embd.weight", "language_model.embed_tokens.weight");
pub(crate) const FINAL_NORM: Pair = ("output_norm.weight", "language_model.norm.weight");
pub(crate) const OUTPUT: Pair = ("output.weight", "lm_head.weight");
/// The divisors of the rotary embedding's frequencies (Llama 3.1).
pub(crate) const ROTARY: Pair = ("rope_freqs.weight", "language_model.rope_freqs.weight");

/// The layers of a decoder.
pub(crate) const DECODER_LAYERS: (&str, &str, &[Pair]) =
    ("blk.", "language_model.layers.", &DECODER_PARTS);

const DECODER_PARTS: [Pair; 11] = [
    ("attn_norm", "input_layernorm"),
    ("attn_q", "self_attn.q_proj"),
    ("attn_k", "self_attn.k_proj"),
    ("attn_v", "self_attn.v_proj"),
    ("attn_q_norm", "self_attn.q_norm"),
    ("attn_k_norm", "self_attn.k_norm"),
    ("attn_output", "self_attn.o_proj"),
    ("ffn_norm", "post_attention_layernorm"),
    ("ffn_gate", "mlp.gate_proj"),
    ("ffn_up", "mlp.up_proj"),
    ("ffn_down", "mlp.down_proj"),
];

/// The layers of a Gemma 3, whose norm before the feed-forward network is not Llama's second one.
pub(crate) const GEMMA_LAYERS: (&str, &str, &[Pair]) = (
    "blk.",
    "language_model.layers.",
    OF_GEMMA4.split_at(OF_GEMMA3).0,
);

/// The layers of a Gemma 4: those of Gemma 3, and what reads the token once more.
pub(crate) const GEMMA4_LAYERS: (&str, &str, &[Pair]) =
    ("blk.", "language_model.layers.", OF_GEMMA4);

/// The layers of a Gemma 3n: those of a Gemma 4 but for the factor, and what moves its streams.
const GEMMA3N_LAYERS: (&str, &str, &[Pair]) = (
    "blk.",
    "language_model.layers.",
    GEMMA_PARTS.split_at(GEMMA_PARTS.len() - 1).0,
);

/// Parts that Gemma 3n alone has, which come first, and those of Gemma 3 behind them.
const OF_GEMMA3N: usize = 8;
const OF_GEMMA3: usize = 13;
const OF_GEMMA4: &[Pair] = GEMMA_PARTS.split_at(OF_GEMMA3N).1;

/// The parts of all three, in an order in which those of each follow one another.
const GEMMA_PARTS: [Pair; 25] = [
    ("altup_router", "altup.modality_router"),
    ("altup_router_norm", "altup.router_norm"),
    ("altup_predict_coef", "altup.prediction_coefs"),
    ("altup_correct_coef", "altup.correction_coefs"),
    ("altup_correct_scale", "altup.correct_output_scale"),
    ("laurel_l", "laurel.linear_left"),
    ("laurel_r", "laurel.linear_right"),
    ("laurel_post_norm", "laurel.post_laurel_norm"),
    ("attn_norm", "input_layernorm"),
    ("attn_q", "self_attn.q_proj"),
    ("attn_k", "self_attn.k_proj"),
    ("attn_v", "self_attn.v_proj"),
    ("attn_q_norm", "self_attn.q_norm"),
    ("attn_k_norm", "self_attn.k_norm"),
    ("attn_output", "self_attn.o_proj"),
    ("post_attention_norm", "post_attention_layernorm"),
    ("ffn_norm", "pre_feedforward_layernorm"),
    ("ffn_gate", "mlp.gate_proj"),
    ("ffn_up", "mlp.up_proj"),
    ("ffn_down", "mlp.down_proj"),
    ("post_ffw_norm", "post_feedforward_layernorm"),
    ("inp_gate", "per_layer_input_gate"),
    ("proj", "per_layer_projection"),
    ("post_norm", "post_per_layer_input_norm"),
    ("layer_output_scale", "layer_scalar"),
];

/// The decoder's tensors of a Gemma 4 for the inputs of layers.
pub(crate) const GEMMA4_SINGLE: [Pair; 3] = [
    (
        "per_layer_token_embd.weight",
        "language_model.embed_tokens_per_layer.weight",
    ),
    (
        "per_layer_model_proj.weight",
        "language_model.per_layer_model_projection.weight",
    ),
    (
        "per_layer_proj_norm.weight",
        "language_model.per_layer_projection_norm.weight",
    ),
];

/// The decoder of a Gemma 3n; its streams are all but the first in one tensor.
pub(crate) const GEMMA3N_NAMES: Names = Names {
    single: &[
        EMBEDDING,
        FINAL_NORM,
        OUTPUT,
        GEMMA4_SINGLE[0],
        GEMMA4_SINGLE[1],
        GEMMA4_SINGLE[2],
        (
            "altup_proj.weight",
            "language_model.altup_projections.weight",
        ),
        (
            "altup_unembd_proj.weight",
            "language_model.altup_unembed_projections.weight",
        ),
    ],
    layers: &[GEMMA3N_LAYERS],
};

/// The final norm of an LFM2.
pub(crate) const LFM2_NORM: Pair = ("token_embd_norm.weight", "language_model.norm.weight");

/// The layers of an LFM2.
pub(crate) const LFM2_LAYERS: (&str, &str, &[Pair]) =
    ("blk.", "language_model.layers.", &LFM2_PARTS);

const LFM2_PARTS: [Pair; 14] = [
    ("attn_norm", "input_layernorm"),
    ("attn_q", "self_attn.q_proj"),
    ("attn_k", "self_attn.k_proj"),
    ("attn_v", "self_attn.v_proj"),
    ("attn_q_norm", "self_attn.q_norm"),
    ("attn_k_norm", "self_attn.k_norm"),
    ("attn_output", "self_attn.o_proj"),
    ("shortconv.conv", "conv.conv"),
    ("shortconv.in_proj", "conv.in_proj"),
    ("shortconv.out_proj", "conv.out_proj"),
    ("ffn_norm", "post_attention_layernorm"),
    ("ffn_gate", "mlp.gate_proj"),
    ("ffn_up", "mlp.up_proj"),
    ("ffn_down", "mlp.down_proj"),
];

/// The layers of a Qwen 3.5. `ssm_a` gets its ending when it is read ([`super::qwen35::renamed`]).
pub(crate) const QWEN35_LAYERS: (&str, &str, &[Pair]) =
    ("blk.", "language_model.layers.", &QWEN35_PARTS);

const QWEN35_PARTS: [Pair; 20] = [
    ("attn_norm", "input_layernorm"),
    ("attn_q", "self_attn.q_proj"),
    ("attn_k", "self_attn.k_proj"),
    ("attn_v", "self_attn.v_proj"),
    ("attn_q_norm", "self_attn.q_norm"),
    ("attn_k_norm", "self_attn.k_norm"),
    ("attn_output", "self_attn.o_proj"),
    ("attn_qkv", "linear_attn.in_proj_qkv"),
    ("attn_gate", "linear_attn.in_proj_z"),
    ("ssm_alpha", "linear_attn.in_proj_a"),
    ("ssm_beta", "linear_attn.in_proj_b"),
    ("ssm_a", "linear_attn.decay"),
    ("ssm_dt", "linear_attn.dt"),
    ("ssm_conv1d", "linear_attn.conv1d"),
    ("ssm_norm", "linear_attn.norm"),
    ("ssm_out", "linear_attn.out_proj"),
    ("post_attention_norm", "post_attention_layernorm"),
    ("ffn_gate", "mlp.gate_proj"),
    ("ffn_up", "mlp.up_proj"),
    ("ffn_down", "mlp.down_proj"),
];

/// The layers of a tower with CLIP's names.
pub(crate) const VISION_LAYERS: (&str, &str, &[Pair]) = ("v.blk.", VISION_PREFIX, &VISION_PARTS);

const VISION_PREFIX: &str = "vision_tower.encoder.layers.";

const VISION_PARTS: [Pair; 11] = [
    ("ln1", "layer_norm1"),
    ("ln2", "layer_norm2"),
    ("attn_q", "self_attn.q_proj"),
    ("attn_k", "self_attn.k_proj"),
    ("attn_v", "self_attn.v_proj"),
    ("attn_qkv", "self_attn.qkv"),
    ("attn_out", "self_attn.out_proj"),
    ("ls1", "layer_scale1"),
    ("ls2", "layer_scale2"),
    ("ffn_up", "mlp.fc1"),
    ("ffn_down", "mlp.fc2"),
];

impl Names {
    /// The canonical name of a tensor in GGUF; none if the family has no such tensor.
    pub(crate) fn to_canonical(self, name: &str) -> Option<String> {
        if let Some((_, canonical)) = self.single.iter().find(|(known, _)| *known == name) {
            return Some((*canonical).to_string());
        }
        self.layers.iter().find_map(|(prefix, canonical, parts)| {
            let (number, part, kind) = layer(name.strip_prefix(prefix)?)?;
            let (_, renamed) = parts.iter().find(|(known, _)| *known == part)?;
            Some(format!("{canonical}{number}.{renamed}.{kind}"))
        })
    }

    /// As [`Self::to_canonical`], also of a tower whose feed-forward layers have each other's names.
    pub(crate) fn unswapped(self, file: &Header, name: &str) -> Result<Option<String>, MllmError> {
        let hidden = file.count("clip.vision.embedding_length")?;
        let canonical = self.to_canonical(name);
        Ok(canonical.map(|canonical| unswapped(file, canonical, hidden)))
    }

    /// The name in GGUF of a canonical tensor; none if the format has no such tensor.
    pub(crate) fn in_gguf(self, name: &str) -> Option<String> {
        if let Some((known, _)) = self.single.iter().find(|(_, canonical)| *canonical == name) {
            return Some((*known).to_string());
        }
        self.layers.iter().find_map(|(prefix, canonical, parts)| {
            let (number, part, kind) = layer(name.strip_prefix(canonical)?)?;
            let (renamed, _) = parts.iter().find(|(_, known)| *known == part)?;
            Some(format!("{prefix}{number}.{renamed}.{kind}"))
        })
    }
}

/// What a layer's tensor may be: numbers, or the bounds of what goes into a matrix and comes out.
const KINDS: [&str; 6] = [
    "weight",
    "bias",
    "input_min",
    "input_max",
    "output_min",
    "output_max",
];

/// Splits `3.attn_q.weight` into its three parts.
fn layer(rest: &str) -> Option<(&str, &str, &str)> {
    let (number, rest) = rest.split_once('.')?;
    let (part, kind) = rest.rsplit_once('.')?;
    let digits =
        !number.is_empty() && number.len() < 8 && number.bytes().all(|byte| byte.is_ascii_digit());
    (digits && KINDS.contains(&kind)).then_some((number, part, kind))
}

/// Undoes a swap of llama.cpp's older converter, which calls the first layer of the tower's
/// feed-forward part `ffn_down` and the last `ffn_up`. The first is the one whose input is the
/// hidden states of `hidden` numbers.
pub(crate) fn unswapped(header: &Header, canonical: String, hidden: Option<usize>) -> String {
    const SWAPS: [[&str; 2]; 2] = [["mlp.fc1", "mlp.fc2"], ["mlp.up_proj", "mlp.down_proj"]];
    let Some((layer, part)) = canonical
        .strip_prefix(VISION_PREFIX)
        .and_then(|rest| rest.split_once('.'))
    else {
        return canonical;
    };
    let down = header
        .tensors
        .get(&format!("v.blk.{layer}.ffn_down.weight"));
    if down.is_none_or(|place| place.shape.get(1).copied() != hidden) {
        return canonical;
    }
    let swap = |[one, other]: [&str; 2]| {
        part.strip_prefix(one)
            .map(|kind| format!("{VISION_PREFIX}{layer}.{other}{kind}"))
    };
    let swapped = SWAPS
        .into_iter()
        .flat_map(|[up, down]| [[up, down], [down, up]])
        .find_map(swap);
    swapped.unwrap_or(canonical)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_translated_both_ways() {
        let names = Names {
            single: &[EMBEDDING, OUTPUT],
            layers: &[DECODER_LAYERS, VISION_LAYERS],
        };
        for (name, canonical) in [
            ("token_embd.weight", "language_model.embed_tokens.weight"),
            (
                "blk.31.attn_output.weight",
                "language_model.layers.31.self_attn.o_proj.weight",
            ),
            (
                "blk.0.attn_k.bias",
                "language_model.layers.0.self_attn.k_proj.bias",
            ),
            (
                "v.blk.2.ffn_up.bias",
                "vision_tower.encoder.layers.2.mlp.fc1.bias",
            ),
            (
                "v.blk.2.ln1.weight",
                "vision_tower.encoder.layers.2.layer_norm1.weight",
            ),
            ("output.weight", "lm_head.weight"),
        ] {
            assert_eq!(names.to_canonical(name).as_deref(), Some(canonical));
            assert_eq!(names.in_gguf(canonical).as_deref(), Some(name));
        }
        for name in [
            "",
            "blk.",
            "blk.x.attn_q.weight",
            "blk.1.attn_q",
            "blk.1.ffn_gate_exps.weight",
            "v.post_ln.weight",
        ] {
            assert_eq!(names.to_canonical(name), None, "{name}");
        }
    }
}
