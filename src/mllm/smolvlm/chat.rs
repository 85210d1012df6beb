//! The text of an image in a chat: separators around and between its tiles.

use crate::family::ImageLayout;
use std::fmt::Write as _;

const FRAME: &str = "<fake_token_around_image>";
const WHOLE: &str = "<global-img>";

/// Tiles row by row, each behind its place, then the whole view (`get_image_prompt_string` in
/// transformers).
pub(super) fn image_text(placeholder: &str, layout: ImageLayout) -> String {
    let ImageLayout {
        tokens,
        rows,
        columns,
    } = layout;
    let mut text = String::new();
    let tiles = rows * columns;
    let views = if tiles > 1 { tiles + 1 } else { 1 };
    let tokens = placeholder.repeat(tokens / views);
    if tiles > 1 {
        for row in 1..=rows {
            for column in 1..=columns {
                // Writing to a text cannot fail.
                let _ = write!(text, "{FRAME}<row_{row}_col_{column}>{tokens}");
            }
            text.push('\n');
        }
        text.push('\n');
    }
    text + FRAME + WHOLE + &tokens + FRAME
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_and_the_whole_view_are_written_out() {
        assert_eq!(
            image_text("*", ImageLayout::whole(2)),
            "<fake_token_around_image><global-img>**<fake_token_around_image>"
        );
        assert_eq!(
            image_text(
                "*",
                ImageLayout {
                    tokens: 3,
                    rows: 2,
                    columns: 1
                }
            ),
            "<fake_token_around_image><row_1_col_1>*\n<fake_token_around_image><row_2_col_1>*\n\n\
             <fake_token_around_image><global-img>*<fake_token_around_image>"
        );
    }
}
