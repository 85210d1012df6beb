//! What is measured, as lists of steps.

use super::budget::{CallBudget, Layout};
use crate::mllm::Step;

/// One kind of thing that is measured again and again.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Workload {
    /// A whole planning call.
    Call(CallBudget),
    /// A prompt of so many tokens, then [`DECODED`] more one by one.
    Depth(usize),
}

/// Tokens that are decoded behind a prompt whose depth is measured.
const DECODED: usize = 64;
/// Depths that engines are compared at, tokens.
pub(super) const DEPTHS: [usize; 2] = [512, 2048];

impl Workload {
    /// Its name in rows.
    pub fn name(&self) -> String {
        match self {
            Self::Call(_) => "call".to_owned(),
            Self::Depth(tokens) => format!("depth-{tokens}"),
        }
    }

    /// What must be done once, before the first time and whenever another workload came between.
    pub fn first_steps(&self, layout: Layout) -> Vec<Step> {
        match self {
            Self::Call(budget) => budget.prefix_steps(layout),
            Self::Depth(_) => Vec::new(),
        }
    }

    /// What is measured, for a model whose image becomes `image` tokens.
    pub fn steps(&self, layout: Layout, image: usize) -> Vec<Step> {
        match self {
            Self::Call(budget) => budget.call_steps(layout, image),
            // The first token comes with the prompt.
            Self::Depth(tokens) => vec![Step::Keep(0), Step::Text(*tokens), Step::Sampled(DECODED + 1)],
        }
    }

    /// Most tokens that the sequence holds at once.
    pub fn longest(&self, image: usize) -> usize {
        match self {
            Self::Call(budget) => budget.longest() + image,
            Self::Depth(tokens) => tokens + DECODED + 1,
        }
    }
}
