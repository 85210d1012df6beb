//! The names of an LFM2's tensors.

/// Names of LFM2, and those of Llama for the same parts.
const RENAMED: [(&str, &str); 9] = [
    (".embedding_norm.", ".norm."),
    (".operator_norm.", ".input_layernorm."),
    (".ffn_norm.", ".post_attention_layernorm."),
    (".feed_forward.w1.", ".mlp.gate_proj."),
    (".feed_forward.w2.", ".mlp.down_proj."),
    (".feed_forward.w3.", ".mlp.up_proj."),
    (".self_attn.out_proj.", ".self_attn.o_proj."),
    (".self_attn.q_layernorm.", ".self_attn.q_norm."),
    (".self_attn.k_layernorm.", ".self_attn.k_norm."),
];

/// The canonical name of a tensor of the decoder, from its name behind `language_model.`.
pub(crate) fn canonical_name(name: &str) -> String {
    let renamed = RENAMED
        .iter()
        .find(|(own, _)| name.starts_with("language_model.") && name.contains(own));
    renamed.map_or_else(
        || name.to_owned(),
        |(own, canonical)| name.replacen(own, canonical, 1),
    )
}

#[cfg(test)]
mod tests {
    use super::canonical_name;

    #[test]
    fn parts_have_the_names_of_llama() {
        for (name, canonical) in [
            (
                "language_model.embedding_norm.weight",
                "language_model.norm.weight",
            ),
            (
                "language_model.layers.3.feed_forward.w3.weight",
                "language_model.layers.3.mlp.up_proj.weight",
            ),
            (
                "language_model.layers.3.self_attn.q_layernorm.weight",
                "language_model.layers.3.self_attn.q_norm.weight",
            ),
            (
                "language_model.layers.3.conv.conv.weight",
                "language_model.layers.3.conv.conv.weight",
            ),
            (
                "vision_tower.ffn_norm.weight",
                "vision_tower.ffn_norm.weight",
            ),
        ] {
            assert_eq!(canonical_name(name), canonical);
        }
    }
}
