//! The text of an image in a chat: marks around it, and before each of its tiles.

use crate::family::ImageLayout;
use std::fmt::Write as _;

const START: &str = "<|image_start|>";
const END: &str = "<|image_end|>";
const THUMBNAIL: &str = "<|img_thumbnail|>";

/// An image in one piece, or its tiles of `tile` tokens row by row, each behind its place, then the
/// thumbnail, if tokens are left for it (`Lfm2VlProcessor` in transformers).
pub(super) fn marked(placeholder: &str, layout: ImageLayout, tile: usize) -> String {
    let ImageLayout {
        tokens,
        rows,
        columns,
    } = layout;
    if rows * columns <= 1 {
        return format!("{START}{}{END}", placeholder.repeat(tokens));
    }
    let mut text = START.to_owned();
    for row in 1..=rows {
        for column in 1..=columns {
            // Writing to a text cannot fail.
            let _ = write!(
                text,
                "<|img_row_{row}_col_{column}|>{}",
                placeholder.repeat(tile)
            );
        }
    }
    let thumbnail = tokens.saturating_sub(rows * columns * tile);
    if thumbnail > 0 {
        text += THUMBNAIL;
        text += &placeholder.repeat(thumbnail);
    }
    text + END
}

/// The tokens alone (`use_image_special_tokens: false`).
pub(super) fn bare(placeholder: &str, layout: ImageLayout, _tile: usize) -> String {
    placeholder.repeat(layout.tokens)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_and_the_thumbnail_are_written_out() {
        let whole = ImageLayout::whole(2);
        assert_eq!(marked("*", whole, 9), "<|image_start|>**<|image_end|>");
        let tiles = |tokens| ImageLayout {
            tokens,
            rows: 2,
            columns: 1,
        };
        assert_eq!(
            marked("*", tiles(7), 2),
            "<|image_start|><|img_row_1_col_1|>**<|img_row_2_col_1|>**<|img_thumbnail|>***<|image_end|>"
        );
        assert_eq!(
            marked("*", tiles(4), 2),
            "<|image_start|><|img_row_1_col_1|>**<|img_row_2_col_1|>**<|image_end|>"
        );
        assert_eq!(bare("*", tiles(4), 2), "****");
    }
}
