//! The names of tensors in llama.cpp's GGUF files and in Hugging Face's checkpoints.

/// Tensors outside of layers: name in GGUF, canonical name.
const SINGLE: [(&str, &str); 13] = [
    ("token_embd.weight", "language_model.embed_tokens.weight"),
    ("output_norm.weight", "language_model.norm.weight"),
    ("output.weight", "lm_head.weight"),
    ("v.class_embd", "vision_tower.embeddings.class_embedding"),
    ("v.patch_embd.weight", "vision_tower.embeddings.patch_embedding.weight"),
    ("v.position_embd.weight", "vision_tower.embeddings.position_embedding.weight"),
    ("v.pre_ln.weight", "vision_tower.pre_layrnorm.weight"),
    ("v.pre_ln.bias", "vision_tower.pre_layrnorm.bias"),
    ("mm.0.weight", "multi_modal_projector.linear_1.weight"),
    ("mm.0.bias", "multi_modal_projector.linear_1.bias"),
    ("mm.2.weight", "multi_modal_projector.linear_2.weight"),
    ("mm.2.bias", "multi_modal_projector.linear_2.bias"),
    ("model.image_newline", "image_newline"),
];

/// Parts of layers, before `.weight` or `.bias`.
const DECODER_PARTS: [(&str, &str); 9] = [
    ("attn_norm", "input_layernorm"),
    ("attn_q", "self_attn.q_proj"),
    ("attn_k", "self_attn.k_proj"),
    ("attn_v", "self_attn.v_proj"),
    ("attn_output", "self_attn.o_proj"),
    ("ffn_norm", "post_attention_layernorm"),
    ("ffn_gate", "mlp.gate_proj"),
    ("ffn_up", "mlp.up_proj"),
    ("ffn_down", "mlp.down_proj"),
];
const VISION_PARTS: [(&str, &str); 8] = [
    ("ln1", "layer_norm1"),
    ("ln2", "layer_norm2"),
    ("attn_q", "self_attn.q_proj"),
    ("attn_k", "self_attn.k_proj"),
    ("attn_v", "self_attn.v_proj"),
    ("attn_out", "self_attn.out_proj"),
    ("ffn_up", "mlp.fc1"),
    ("ffn_down", "mlp.fc2"),
];

/// A part of a layer: name in GGUF, canonical name.
type Part = (&'static str, &'static str);

/// Layers: prefix in GGUF, canonical prefix, parts.
const LAYERS: [(&str, &str, &[Part]); 2] =
    [("blk.", "language_model.layers.", &DECODER_PARTS), ("v.blk.", "vision_tower.encoder.layers.", &VISION_PARTS)];

/// The canonical name of a tensor in GGUF; none if a LLaVA has no such tensor.
pub(super) fn to_canonical(name: &str) -> Option<String> {
    if let Some((_, canonical)) = SINGLE.iter().find(|(known, _)| *known == name) {
        return Some((*canonical).to_string());
    }
    LAYERS.iter().find_map(|(prefix, canonical, parts)| {
        let (number, part, kind) = layer(name.strip_prefix(prefix)?)?;
        let (_, renamed) = parts.iter().find(|(known, _)| *known == part)?;
        Some(format!("{canonical}{number}.{renamed}.{kind}"))
    })
}

/// The name in GGUF of a canonical tensor; none if the format has no such tensor.
pub(super) fn from_canonical(name: &str) -> Option<String> {
    if let Some((known, _)) = SINGLE.iter().find(|(_, canonical)| *canonical == name) {
        return Some((*known).to_string());
    }
    LAYERS.iter().find_map(|(prefix, canonical, parts)| {
        let (number, part, kind) = layer(name.strip_prefix(canonical)?)?;
        let (renamed, _) = parts.iter().find(|(_, known)| *known == part)?;
        Some(format!("{prefix}{number}.{renamed}.{kind}"))
    })
}

/// Splits `3.attn_q.weight` into its three parts.
fn layer(rest: &str) -> Option<(&str, &str, &str)> {
    let (number, rest) = rest.split_once('.')?;
    let (part, kind) = rest.rsplit_once('.')?;
    let digits = !number.is_empty() && number.len() < 8 && number.bytes().all(|byte| byte.is_ascii_digit());
    (digits && ["weight", "bias"].contains(&kind)).then_some((number, part, kind))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_translated_both_ways() {
        for (name, canonical) in [
            ("token_embd.weight", "language_model.embed_tokens.weight"),
            ("blk.31.attn_output.weight", "language_model.layers.31.self_attn.o_proj.weight"),
            ("blk.0.attn_k.bias", "language_model.layers.0.self_attn.k_proj.bias"),
            ("v.blk.2.ffn_up.bias", "vision_tower.encoder.layers.2.mlp.fc1.bias"),
            ("v.blk.2.ln1.weight", "vision_tower.encoder.layers.2.layer_norm1.weight"),
            ("mm.2.bias", "multi_modal_projector.linear_2.bias"),
        ] {
            assert_eq!(to_canonical(name).as_deref(), Some(canonical));
            assert_eq!(from_canonical(canonical).as_deref(), Some(name));
        }
        for name in
            ["", "blk.", "blk.x.attn_q.weight", "blk.1.attn_q", "blk.1.ffn_gate_exps.weight", "v.post_ln.weight"]
        {
            assert_eq!(to_canonical(name), None, "{name}");
        }
    }
}
