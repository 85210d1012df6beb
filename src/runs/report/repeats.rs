//! Attempts that repeat an earlier one of the same planning call: models do, although the prompt
//! says that it was refused.

use planagent_agent::planner::Attempt;

/// What an attempt repeats.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Repeat {
    /// All answers of this attempt (from 0), and with them its planner code.
    Answers(usize),
    /// Only its planner code.
    Code(usize),
}

impl Repeat {
    /// The first attempt that the attempt with this index repeats.
    pub(super) fn find(attempts: &[Attempt], index: usize) -> Option<Self> {
        let (attempt, before) = (attempts.get(index)?, attempts.get(..index)?);
        let code = attempt.line()?;
        let answers = |attempt: &Attempt| {
            attempt
                .rounds
                .iter()
                .map(|round| round.answer.clone())
                .collect::<Vec<_>>()
        };
        let own = answers(attempt);
        let has_code = |other: &Attempt| other.line().as_deref() == Some(&code);
        let whole = before
            .iter()
            .position(|other| has_code(other) && answers(other) == own);
        let whole = whole.filter(|_| !own.is_empty()).map(Self::Answers);
        whole.or_else(|| before.iter().position(has_code).map(Self::Code))
    }
}
