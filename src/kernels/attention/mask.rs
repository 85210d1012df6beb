//! The positions that a token may attend to.

use std::ops::Range;

/// Which positions the tokens of a pass may attend to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AttentionMask<'a> {
    /// Every token attends to the first `positions`.
    All {
        /// Number of positions.
        positions: usize,
    },
    /// A token attends to its own position and to those before it.
    Causal {
        /// Position of the first token.
        start: usize,
        /// Maximum positions that a token attends to, its own included; `None` for no limit.
        window: Option<usize>,
    },
    /// As [`Self::Causal`], and the positions of each block see one another within the window, as
    /// far back as it reaches.
    CausalWithBlocks {
        /// Position of the first token.
        start: usize,
        /// Maximum positions up to its own that a token attends to; `None` for no limit.
        window: Option<usize>,
        /// First position of each block, and the one behind its last. No two share a position.
        blocks: &'a [[usize; 2]],
    },
}

impl AttentionMask<'_> {
    /// The positions that a token of the pass attends to.
    pub(super) fn seen_by(self, token: usize) -> Range<usize> {
        match self {
            Self::All { positions } => 0..positions,
            Self::Causal { start, window } => {
                let end = start + token + 1;
                end.saturating_sub(window.unwrap_or(end))..end
            }
            Self::CausalWithBlocks {
                start,
                window,
                blocks,
            } => {
                let Range { start: from, end } = Self::Causal { start, window }.seen_by(token);
                // The token's own position is the one before `end`.
                let mut blocks = blocks.iter();
                let own = blocks.find(|[first, behind]| (first + 1..=*behind).contains(&end));
                from..own.map_or(end, |[_, behind]| *behind)
            }
        }
    }
}
