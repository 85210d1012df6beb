//! The order of the rows of queries and keys, in Hugging Face's and in llama.cpp's files.

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum RowOrder {
    /// Hugging Face's.
    Plain,
    /// llama.cpp's: within each head, a row of the first half and then its partner of the second
    /// half, as its rotary embedding rotates them.
    Paired { heads: usize },
}

/// Puts paired rows ([`RowOrder::Paired`]) back in order.
pub(super) fn unpaired(bytes: &[u8], rows: usize, heads: usize) -> Vec<u8> {
    reordered(bytes, rows, heads, |row, half| {
        if row < half {
            2 * row
        } else {
            2 * (row - half) + 1
        }
    })
}

/// The reverse of [`unpaired`].
pub(crate) fn paired(bytes: &[u8], rows: usize, heads: usize) -> Vec<u8> {
    reordered(bytes, rows, heads, |row, half| row / 2 + row % 2 * half)
}

/// Reorders the rows of each head. `source` maps a row of the result, within its head, and half the
/// head's height to the row that it is copied from.
fn reordered(
    bytes: &[u8],
    rows: usize,
    heads: usize,
    source: impl Fn(usize, usize) -> usize,
) -> Vec<u8> {
    let (width, head) = (bytes.len() / rows.max(1), rows / heads.max(1));
    let mut out = Vec::with_capacity(bytes.len());
    for first in (0..rows).step_by(head.max(1)) {
        for row in 0..head {
            let begin = (first + source(row, head / 2)) * width;
            out.extend_from_slice(&bytes[begin..begin + width]);
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn pairs_are_put_in_order_and_back(heads in 1_usize..4, half in 1_usize..5, width in 1_usize..4) {
            let rows = heads * 2 * half;
            let bytes: Vec<u8> = (0..rows * width).map(|byte| byte as u8).collect();
            let pairs = paired(&bytes, rows, heads);
            prop_assert_eq!(&pairs[..width], &bytes[..width]);
            prop_assert_eq!(&pairs[width..2 * width], &bytes[half * width..(half + 1) * width], "the partner follows");
            prop_assert_eq!(unpaired(&pairs, rows, heads), bytes);
        }
    }
}
