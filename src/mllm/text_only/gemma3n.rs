//! The tensors of a Gemma 3n.

use super::canonical_name as of_decoder;

/// The canonical name of a tensor of the decoder.
pub(crate) fn canonical_name(stored: &str) -> Option<String> {
    let name = stored.strip_prefix("model.").unwrap_or(stored);
    let name = match name.strip_prefix("language_model.model.") {
        Some(rest) => format!("language_model.{rest}"),
        None => match name.strip_prefix("language_model.lm_head.") {
            Some(rest) => format!("lm_head.{rest}"),
            None => of_decoder(name)?,
        },
    };
    // No weight of a layer in folders, and one in llama.cpp's files.
    if name.ends_with(".correct_output_scale") {
        return Some(name + ".weight");
    }
    Some(name)
}

#[cfg(test)]
mod tests {
    use super::canonical_name;

    #[test]
    fn every_layout_has_one_canonical_name() {
        let scale = "language_model.layers.1.altup.correct_output_scale.weight";
        let split = "language_model.altup_projections.2.weight";
        for (name, canonical) in [
            ("model.layers.1.altup.correct_output_scale", scale),
            (
                "model.language_model.layers.1.altup.correct_output_scale",
                scale,
            ),
            (
                "language_model.model.layers.1.altup.correct_output_scale",
                scale,
            ),
            ("model.altup_projections.2.weight", split),
            ("model.language_model.altup_projections.2.weight", split),
            ("language_model.lm_head.weight", "lm_head.weight"),
            ("lm_head.weight", "lm_head.weight"),
        ] {
            assert_eq!(canonical_name(name).as_deref(), Some(canonical), "{name}");
        }
    }
}
