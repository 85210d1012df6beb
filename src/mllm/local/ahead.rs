//! Drafted tokens that are computed before the model has chosen them.

/// Drafted tokens behind the tokens of a sequence that are certain, and the logits after each.
#[derive(Debug, Default)]
pub(super) struct Ahead {
    /// Number of tokens before them.
    start: usize,
    tokens: Vec<u32>,
    /// One row a token; empty when it was used.
    logits: Vec<Vec<f32>>,
}

impl Ahead {
    pub(super) fn new(start: usize, tokens: Vec<u32>, logits: Vec<Vec<f32>>) -> Self {
        Self {
            start,
            tokens,
            logits,
        }
    }

    /// Number of tokens before them.
    pub(super) fn start(&self) -> usize {
        self.start
    }

    pub(super) fn len(&self) -> usize {
        self.tokens.len()
    }

    /// How many of them were chosen.
    pub(super) fn accepted(&self, chosen: &[u32]) -> usize {
        self.tokens
            .iter()
            .zip(chosen)
            .take_while(|(drafted, chosen)| drafted == chosen)
            .count()
    }

    /// The logits after `chosen`, if these are the first drafted tokens. They are given once.
    pub(super) fn take_logits(&mut self, chosen: &[u32]) -> Option<Vec<f32>> {
        if chosen.is_empty() || self.accepted(chosen) < chosen.len() {
            return None;
        }
        let row = self.logits.get_mut(chosen.len() - 1)?;
        Some(std::mem::take(row)).filter(|row| !row.is_empty())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn logits_are_given_for_chosen_drafts_alone_and_once() {
        let mut ahead = Ahead::new(10, vec![5, 6, 7], vec![vec![0.5], vec![0.6], vec![0.7]]);
        assert_eq!(
            (ahead.start(), ahead.len(), ahead.accepted(&[5, 6, 1])),
            (10, 3, 2)
        );
        assert_eq!(ahead.take_logits(&[]), None);
        assert_eq!(ahead.take_logits(&[5, 6]), Some(vec![0.6]));
        assert_eq!(ahead.take_logits(&[5, 6]), None);
        assert_eq!(ahead.take_logits(&[5, 1]), None);
        assert_eq!(ahead.take_logits(&[5, 6, 7, 8]), None);
    }
}
