//! Positions on three axes (M-RoPE: Wang et al., arXiv:2409.12191).

use crate::family::{PlacedImage, Positions};
use std::ops::Range;

/// Where tokens of a chat with this image stand. An image takes one moment; its tokens stand at
/// their rows and columns. The text behind it goes on after the longer side, not after the number
/// of tokens (`get_rope_index` in transformers).
pub(crate) fn positions(tokens: Range<usize>, image: Option<PlacedImage>) -> Positions {
    let Some(image) = image else {
        return Positions::plain(tokens.start as u32..tokens.end as u32);
    };
    let span = image.tokens();
    let columns = image.layout.columns.max(1);
    let taken = image.layout.rows.max(columns);
    let position = |index: usize| {
        if span.contains(&index) {
            let place = index - span.start;
            [0, place / columns, place % columns].map(|offset| (span.start + offset) as u32)
        } else {
            let plain = if index < span.start {
                index
            } else {
                (index + taken).saturating_sub(span.len())
            };
            [plain as u32; 3]
        }
    };
    Positions {
        rotary: tokens.map(position).collect(),
        vision: 0..0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::family::ImageLayout;

    #[test]
    fn text_goes_on_behind_the_longer_side() {
        let image = PlacedImage {
            first: 2,
            layout: ImageLayout {
                tokens: 6,
                rows: 2,
                columns: 3,
            },
        };
        let expected = [
            [0, 0, 0],
            [1, 1, 1],
            [2, 2, 2],
            [2, 2, 3],
            [2, 2, 4],
            [2, 3, 2],
            [2, 3, 3],
            [2, 3, 4],
            [5, 5, 5],
            [6, 6, 6],
        ];
        assert_eq!(positions(0..10, Some(image)).rotary, expected);
        assert_eq!(positions(4..9, Some(image)).rotary, expected[4..9]);
        assert_eq!(positions(1..3, None).rotary, [[1; 3], [2; 3]]);
    }
}
