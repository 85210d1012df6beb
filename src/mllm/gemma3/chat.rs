//! The text of an image in a chat of Gemma 3.

use crate::family::ImageLayout;

/// What the chat template writes for an image.
pub(super) const BEGIN: &str = "<start_of_image>";
const END: &str = "<end_of_image>";

/// The image's tokens between their marks and empty lines (`full_image_sequence` in transformers).
pub(crate) fn image_text(placeholder: &str, layout: ImageLayout) -> String {
    format!("\n\n{BEGIN}{}{END}\n\n", placeholder.repeat(layout.tokens))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_image_stands_between_marks_and_empty_lines() {
        assert_eq!(
            image_text("*", ImageLayout::whole(3)),
            "\n\n<start_of_image>***<end_of_image>\n\n"
        );
    }
}
