//! The names of tensors in all layouts that Qwen's vision-language models were saved in.

/// Beginnings of the names of a tower's tensors: stored, canonical.
const VISION: [(&str, &str); 8] = [
    (
        "patch_embed.proj.",
        "vision_tower.embeddings.patch_embedding.",
    ),
    ("pos_embed.", "vision_tower.embeddings.position_embedding."),
    ("deepstack_merger_list.", "multi_modal_projector.deepstack."),
    ("merger.ln_q.", "multi_modal_projector.norm."),
    ("merger.mlp.0.", "multi_modal_projector.linear_fc1."),
    ("merger.mlp.2.", "multi_modal_projector.linear_fc2."),
    ("merger.", "multi_modal_projector."),
    ("blocks.", "vision_tower.encoder.layers."),
];

/// Parts of the tower's layers: stored, canonical.
const PARTS: [(&str, &str); 6] = [
    (".norm1.", ".layer_norm1."),
    (".norm2.", ".layer_norm2."),
    (".attn.proj.", ".self_attn.out_proj."),
    (".attn.", ".self_attn."),
    (".mlp.linear_fc", ".mlp.fc"),
    (".mlp.", ".mlp."),
];

/// The canonical name of a tensor: CLIP's for the tower, Llama's for the decoder.
pub(crate) fn canonical_name(stored: &str) -> String {
    let name = stored.strip_prefix("model.").unwrap_or(stored);
    if let Some(vision) = name.strip_prefix("visual.") {
        let begun = VISION
            .iter()
            .find_map(|(from, to)| Some(format!("{to}{}", vision.strip_prefix(from)?)));
        let begun = begun.unwrap_or_else(|| stored.to_string());
        if !begun.starts_with("vision_tower.encoder.") {
            return begun;
        }
        let part = PARTS.iter().find(|(from, _)| begun.contains(from));
        return part.map_or_else(|| begun.clone(), |(from, to)| begun.replacen(from, to, 1));
    }
    if name.starts_with("lm_head.") || name.starts_with("language_model.") {
        return name.to_string();
    }
    format!("language_model.{name}")
}

#[cfg(test)]
mod tests {
    use super::canonical_name;

    #[test]
    fn every_layout_has_one_canonical_name() {
        for (name, canonical) in [
            (
                "model.visual.patch_embed.proj.weight",
                "vision_tower.embeddings.patch_embedding.weight",
            ),
            (
                "visual.blocks.3.norm1.weight",
                "vision_tower.encoder.layers.3.layer_norm1.weight",
            ),
            (
                "model.visual.blocks.3.attn.qkv.bias",
                "vision_tower.encoder.layers.3.self_attn.qkv.bias",
            ),
            (
                "model.visual.blocks.3.attn.proj.bias",
                "vision_tower.encoder.layers.3.self_attn.out_proj.bias",
            ),
            (
                "model.visual.blocks.3.mlp.linear_fc2.bias",
                "vision_tower.encoder.layers.3.mlp.fc2.bias",
            ),
            (
                "visual.blocks.3.mlp.gate_proj.bias",
                "vision_tower.encoder.layers.3.mlp.gate_proj.bias",
            ),
            (
                "visual.merger.mlp.2.bias",
                "multi_modal_projector.linear_fc2.bias",
            ),
            (
                "model.visual.merger.norm.bias",
                "multi_modal_projector.norm.bias",
            ),
            (
                "model.visual.deepstack_merger_list.1.linear_fc1.bias",
                "multi_modal_projector.deepstack.1.linear_fc1.bias",
            ),
            (
                "model.layers.0.mlp.up_proj.weight",
                "language_model.layers.0.mlp.up_proj.weight",
            ),
            (
                "model.language_model.norm.weight",
                "language_model.norm.weight",
            ),
            ("lm_head.weight", "lm_head.weight"),
        ] {
            assert_eq!(canonical_name(name), canonical);
        }
    }
}
