//! The measured workloads as lists of steps.

use super::budget::{CallBudget, Layout};
use planagent_mllm::Step;

#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Workload {
    /// A whole planning call.
    Call(CallBudget),
    /// A prompt of this many tokens, then [`DECODED`] sampled tokens.
    Depth(usize),
}

/// Tokens decoded after the prompt of a depth workload.
const DECODED: usize = 64;
/// Compared depths, tokens.
pub(super) const DEPTHS: [usize; 2] = [512, 2048];

impl Workload {
    /// The name in rows.
    pub fn name(&self) -> String {
        match self {
            Self::Call(budget) => match budget.acceptance() {
                Some(acceptance) => format!("call-accepted-{acceptance}"),
                None => "call".to_owned(),
            },
            Self::Depth(tokens) => format!("depth-{tokens}"),
        }
    }

    /// Steps before the first iteration, and again after another workload.
    pub(crate) fn first_steps(&self, layout: Layout) -> Vec<Step> {
        match self {
            Self::Call(budget) => budget.prefix_steps(layout),
            Self::Depth(_) => Vec::new(),
        }
    }

    /// The measured steps for a model whose image has `image` tokens.
    pub fn steps(&self, layout: Layout, image: usize) -> Vec<Step> {
        match self {
            Self::Call(budget) => budget.call_steps(layout, image),
            // The prompt's pass gives the first token.
            Self::Depth(tokens) => vec![
                Step::Keep(0),
                Step::Text(*tokens),
                Step::Sampled(DECODED + 1),
            ],
        }
    }

    /// Maximum length of the sequence, tokens.
    pub fn longest(&self, image: usize) -> usize {
        match self {
            Self::Call(budget) => budget.longest() + image,
            Self::Depth(tokens) => tokens + DECODED + 1,
        }
    }
}
