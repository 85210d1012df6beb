//! Drafts of an answer: tokens that may come next, guessed from known texts. One pass computes them
//! ahead of the model's choice (prompt lookup: A. Saxena, 2023; verification of drafts: Leviathan
//! et al., arXiv:2211.17192).

use super::draft_model::Drafting;
use crate::{Deadline, MllmError};
use std::ops::RangeInclusive;

/// Longest draft, tokens.
const MAX_DRAFT: usize = 16;
/// Length of the first draft of an answer, tokens.
const FIRST_DRAFT: usize = 8;
/// Last tokens of the answer that must stand in the earlier answer before what is drafted from it.
const ANSWER_MATCH: RangeInclusive<usize> = 1..=4;
/// Last tokens that must stand in the chat before what is drafted from it. One alone says too
/// little.
const CHAT_MATCH: RangeInclusive<usize> = 2..=4;

/// Drafts an answer.
#[derive(Debug)]
pub(super) struct Drafter<'a> {
    /// An earlier answer to the same question; empty for none.
    earlier: &'a [u32],
    /// Drafts where no known text does.
    model: Option<&'a mut Drafting>,
    length: usize,
}

impl<'a> Drafter<'a> {
    pub(super) fn new(earlier: &'a [u32], model: Option<&'a mut Drafting>) -> Self {
        Self {
            earlier,
            model,
            length: FIRST_DRAFT,
        }
    }

    /// At most `limit` tokens that may follow `answer`, the last tokens of `chat`. They are those
    /// after the same words in the earlier answer, else in the chat, else those that the draft
    /// model writes. None of them is `image`.
    pub(super) fn draft(
        &mut self,
        chat: &[u32],
        answer: &[u32],
        image: u32,
        limit: usize,
        deadline: Deadline,
    ) -> Result<Vec<u32>, MllmError> {
        let known = self.known(chat, answer, image, limit);
        match &mut self.model {
            Some(model) if known.is_empty() => {
                model.draft(chat, image, limit.min(self.length), deadline)
            }
            _ => Ok(known),
        }
    }

    /// The part of [`Self::draft`] that needs no model.
    fn known(&self, chat: &[u32], answer: &[u32], image: u32, limit: usize) -> Vec<u32> {
        let from_answer = if answer.is_empty() {
            self.earlier
        } else {
            behind_answer(self.earlier, answer)
        };
        let found = if from_answer.is_empty() {
            behind_last(chat)
        } else {
            from_answer
        };
        found
            .iter()
            .copied()
            .take_while(|token| *token != image)
            .take(limit.min(self.length))
            .collect()
    }

    /// Fits the length of drafts to how many of the drafted tokens were accepted.
    pub(super) fn learn(&mut self, drafted: usize, accepted: usize) {
        if drafted > 0 {
            self.length = if accepted == drafted {
                (2 * self.length).min(MAX_DRAFT)
            } else {
                accepted + 1
            };
        }
    }
}

/// What stands in `earlier` behind the last tokens of `answer`. Of equal matches the nearest to
/// where the answer is now.
fn behind_answer<'a>(earlier: &'a [u32], answer: &[u32]) -> &'a [u32] {
    for count in ANSWER_MATCH.rev() {
        let Some(last) = answer
            .len()
            .checked_sub(count)
            .and_then(|start| answer.get(start..))
        else {
            continue;
        };
        let ends = earlier
            .windows(count)
            .enumerate()
            .filter(|(_, window)| *window == last);
        let ends = ends
            .map(|(start, _)| start + count)
            .filter(|end| *end < earlier.len());
        if let Some(end) = ends.min_by_key(|end| end.abs_diff(answer.len())) {
            return &earlier[end..];
        }
    }
    &[]
}

/// What stands behind the last earlier occurrence of the chat's last tokens.
fn behind_last(chat: &[u32]) -> &[u32] {
    for count in CHAT_MATCH.rev() {
        let Some(start) = chat.len().checked_sub(count) else {
            continue;
        };
        let (before, last) = (&chat[..chat.len() - 1], &chat[start..]);
        if let Some(found) = before.windows(count).rposition(|window| window == last) {
            return &chat[found + count..];
        }
    }
    &[]
}

#[cfg(test)]
mod tests {
    use super::*;

    const IMAGE: u32 = 99;

    fn draft(earlier: &[u32], chat: &[u32], answer: usize) -> Vec<u32> {
        Drafter::new(earlier, None).known(chat, &chat[chat.len() - answer..], IMAGE, 3)
    }

    #[test]
    fn the_earlier_answer_is_continued_where_the_answer_is() {
        let earlier = [1, 2, 3, 7, 2, 3, 8, 9];
        assert_eq!(
            draft(&earlier, &[50], 0),
            [1, 2, 3],
            "an answer begins as the earlier one"
        );
        assert_eq!(draft(&earlier, &[50, 1, 2, 3], 3), [7, 2, 3]);
        assert_eq!(
            draft(&earlier, &[50, 1, 6, 3], 3),
            [7, 2, 3],
            "another word, and the nearest place behind the same"
        );
        assert_eq!(
            draft(&earlier, &[50, 1, 6, 3, 7, 2, 3], 6),
            [8, 9],
            "the longer match"
        );
        assert_eq!(
            draft(&earlier, &[50, 5], 1),
            Vec::<u32>::new(),
            "nothing in common"
        );
        assert_eq!(
            draft(&earlier, &[50, 9], 1),
            Vec::<u32>::new(),
            "behind its end is nothing"
        );
    }

    #[test]
    fn words_of_the_chat_are_continued_as_last_time_up_to_an_image() {
        assert_eq!(draft(&[], &[1, 2, 3, 4, 5, 2, 3], 1), [4, 5, 2]);
        assert_eq!(
            draft(&[], &[1, 2, 3, 4, 2, 3, 5, 2, 3], 1),
            [5, 2, 3],
            "the last of several"
        );
        assert_eq!(
            draft(&[], &[1, 2, 3, 4, 5, 3], 1),
            Vec::<u32>::new(),
            "one word in common is too little"
        );
        assert_eq!(draft(&[], &[2, 3, IMAGE, 4, 2, 3], 0), Vec::<u32>::new());
        assert_eq!(draft(&[], &[2, 3, 4, IMAGE, 2, 3], 0), [4]);
        assert_eq!(draft(&[], &[], 0), Vec::<u32>::new());
    }

    #[test]
    fn drafts_grow_while_they_are_accepted() {
        let earlier: Vec<u32> = (0..40).collect();
        let mut drafter = Drafter::new(&earlier, None);
        let length = |drafter: &Drafter<'_>| drafter.known(&[50], &[], IMAGE, 100).len();
        assert_eq!(length(&drafter), FIRST_DRAFT);
        drafter.learn(8, 8);
        assert_eq!(length(&drafter), 16);
        drafter.learn(16, 16);
        assert_eq!(length(&drafter), MAX_DRAFT);
        drafter.learn(16, 2);
        assert_eq!(length(&drafter), 3);
        drafter.learn(3, 0);
        drafter.learn(0, 0);
        assert_eq!(length(&drafter), 1);
    }
}
