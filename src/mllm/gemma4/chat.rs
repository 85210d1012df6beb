//! The text of an image in a chat of Gemma 4.

use crate::family::ImageLayout;

/// The image's tokens between their marks (`replace_image_token` in transformers).
pub(super) fn image_text(placeholder: &str, layout: ImageLayout) -> String {
    format!("<|image>{}<image|>", placeholder.repeat(layout.tokens))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_image_stands_between_marks() {
        let layout = ImageLayout {
            tokens: 6,
            rows: 2,
            columns: 3,
        };
        assert_eq!(image_text("*", layout), "<|image>******<image|>");
    }
}
