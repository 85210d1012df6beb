//! The positions that a token may attend to.

use std::ops::Range;

/// Which positions the tokens of a pass may attend to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum AttentionMask {
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
}

impl AttentionMask {
    /// The positions that a token of the pass attends to.
    pub(super) fn seen_by(self, token: usize) -> Range<usize> {
        match self {
            Self::All { positions } => 0..positions,
            Self::Causal { start, window } => {
                let end = start + token + 1;
                end.saturating_sub(window.unwrap_or(end))..end
            }
        }
    }
}
