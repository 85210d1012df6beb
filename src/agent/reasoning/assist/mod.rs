//! The question of LLM-ASSIST (Sharan et al. 2024). The answer is one line: a plan or parameters of
//! PDM-Closed. Its prompts are not public; these are ours (`prompts/llm_assist_*`).

mod answer;
mod engine;
mod prompts;

pub use answer::{
    AssistParameters, Assistance, WAYPOINT_SECONDS, Waypoint, Waypoints, parse_assistance,
};
pub use engine::{AssistQuestion, AssistReasoning};

use crate::environment::choice::choice;

choice! {
    /// The two variants of LLM-ASSIST.
    pub enum AssistVariant {
        /// Unconstrained: the model gives the plan itself.
        Unconstrained = "unc",
        /// The model gives parameters of PDM-Closed.
        Parameters = "par",
    }
}
