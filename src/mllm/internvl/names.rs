//! The names of tensors in both layouts.

/// Beginnings of names: stored, canonical.
const BEGINNINGS: [(&str, &str); 11] = [
    ("language_model.model.", "language_model."),
    ("language_model.lm_head.", "lm_head."),
    (
        "vision_tower.embeddings.cls_token",
        "vision_tower.embeddings.class_embedding",
    ),
    (
        "vision_tower.embeddings.position_embeddings",
        "vision_tower.embeddings.position_embedding.weight",
    ),
    (
        "vision_tower.embeddings.patch_embeddings.projection.",
        "vision_tower.embeddings.patch_embedding.",
    ),
    (
        "vision_model.embeddings.position_embedding",
        "vision_tower.embeddings.position_embedding.weight",
    ),
    ("vision_model.embeddings.", "vision_tower.embeddings."),
    ("vision_model.", "vision_tower."),
    ("mlp1.0.", "multi_modal_projector.layer_norm."),
    ("mlp1.1.", "multi_modal_projector.linear_1."),
    ("mlp1.3.", "multi_modal_projector.linear_2."),
];

/// Beginnings of the layers of the tower.
const LAYERS: [&str; 2] = [
    "vision_tower.encoder.layer.",
    "vision_model.encoder.layers.",
];

/// Beginnings of the parts of these layers: stored, canonical.
const PARTS: [(&str, &str); 10] = [
    ("attention.projection_layer.", "self_attn.out_proj."),
    ("attention.", "self_attn."),
    ("attn.proj.", "self_attn.out_proj."),
    ("attn.", "self_attn."),
    ("layernorm_before.", "layer_norm1."),
    ("layernorm_after.", "layer_norm2."),
    ("norm1.", "layer_norm1."),
    ("norm2.", "layer_norm2."),
    ("lambda_", "layer_scale"),
    ("ls", "layer_scale"),
];

/// The canonical name of a tensor: CLIP's for the tower, LLaVA's for the projector.
pub(super) fn canonical_name(stored: &str) -> String {
    let name = stored.strip_prefix("model.").unwrap_or(stored);
    if let Some(layer) = LAYERS.iter().find_map(|prefix| name.strip_prefix(prefix))
        && let Some((number, part)) = layer.split_once('.')
    {
        let renamed = PARTS
            .iter()
            .find_map(|(from, to)| Some(format!("{to}{}", part.strip_prefix(from)?)));
        let part = renamed.unwrap_or_else(|| part.to_string());
        let kind = if part.starts_with("layer_scale") {
            ".weight"
        } else {
            ""
        };
        return format!("vision_tower.encoder.layers.{number}.{part}{kind}");
    }
    let renamed = BEGINNINGS
        .iter()
        .find_map(|(from, to)| Some(format!("{to}{}", name.strip_prefix(from)?)));
    renamed.unwrap_or_else(|| name.to_string())
}

#[cfg(test)]
mod tests {
    use super::canonical_name;

    #[test]
    fn both_layouts_have_the_same_canonical_names() {
        for (hf, original, canonical) in [
            (
                "vision_tower.embeddings.cls_token",
                "vision_model.embeddings.class_embedding",
                "vision_tower.embeddings.class_embedding",
            ),
            (
                "model.vision_tower.embeddings.position_embeddings",
                "vision_model.embeddings.position_embedding",
                "vision_tower.embeddings.position_embedding.weight",
            ),
            (
                "vision_tower.embeddings.patch_embeddings.projection.bias",
                "vision_model.embeddings.patch_embedding.bias",
                "vision_tower.embeddings.patch_embedding.bias",
            ),
            (
                "vision_tower.encoder.layer.3.attention.projection_layer.bias",
                "vision_model.encoder.layers.3.attn.proj.bias",
                "vision_tower.encoder.layers.3.self_attn.out_proj.bias",
            ),
            (
                "vision_tower.encoder.layer.3.layernorm_after.bias",
                "vision_model.encoder.layers.3.norm2.bias",
                "vision_tower.encoder.layers.3.layer_norm2.bias",
            ),
            (
                "vision_tower.encoder.layer.3.lambda_1",
                "vision_model.encoder.layers.3.ls1",
                "vision_tower.encoder.layers.3.layer_scale1.weight",
            ),
            (
                "multi_modal_projector.linear_2.weight",
                "mlp1.3.weight",
                "multi_modal_projector.linear_2.weight",
            ),
            (
                "model.language_model.norm.weight",
                "language_model.model.norm.weight",
                "language_model.norm.weight",
            ),
            (
                "lm_head.weight",
                "language_model.lm_head.weight",
                "lm_head.weight",
            ),
        ] {
            assert_eq!(
                (
                    canonical_name(hf).as_str(),
                    canonical_name(original).as_str()
                ),
                (canonical, canonical)
            );
        }
        assert_eq!(
            canonical_name("vision_model.encoder.layers.0.attn.qkv.weight"),
            "vision_tower.encoder.layers.0.self_attn.qkv.weight"
        );
        assert_eq!(
            canonical_name("vision_tower.encoder.layer.0.attention.q_proj.weight"),
            "vision_tower.encoder.layers.0.self_attn.q_proj.weight"
        );
    }
}
