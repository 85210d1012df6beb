//! Positions on three axes (M-RoPE: Wang et al., arXiv:2409.12191).

use crate::family::{PlacedImage, Positions};
use std::ops::Range;

/// Where tokens of a chat with these images stand. An image takes one moment; its tokens stand at
/// their rows and columns. The text behind it goes on after the longer side, not after the number
/// of tokens (`get_rope_index` in transformers).
pub(crate) fn positions(tokens: Range<usize>, images: &[PlacedImage]) -> Positions {
    let position = |index: usize| {
        // Tokens and positions that the images before it take.
        let (mut passed, mut taken) = (0, 0);
        for image in images {
            let span = image.tokens();
            if index < span.start {
                break;
            }
            let columns = image.layout.columns.max(1);
            if span.contains(&index) {
                let place = index - span.start;
                let start = (span.start + taken).saturating_sub(passed);
                return [0, place / columns, place % columns].map(|offset| (start + offset) as u32);
            }
            passed += span.len();
            taken += image.layout.rows.max(columns);
        }
        [(index + taken).saturating_sub(passed) as u32; 3]
    };
    Positions {
        rotary: tokens.map(position).collect(),
        vision: Vec::new(),
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
        assert_eq!(positions(0..10, &[image]).rotary, expected);
        assert_eq!(positions(4..9, &[image]).rotary, expected[4..9]);
        assert_eq!(positions(1..3, &[]).rotary, [[1; 3], [2; 3]]);
        // The second image begins where the first one leads to.
        let second = PlacedImage { first: 9, ..image };
        let behind = [
            [6, 6, 6],
            [6, 6, 7],
            [6, 6, 8],
            [6, 7, 6],
            [6, 7, 7],
            [6, 7, 8],
            [9, 9, 9],
        ];
        let found = positions(0..16, &[image, second]).rotary;
        assert_eq!(found, [&expected[..9], &behind].concat());
    }
}
