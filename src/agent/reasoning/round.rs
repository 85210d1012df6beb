//! The three rounds of an attempt.

use crate::environment::choice::choice;

choice! {
    /// One of the paper's three rounds.
    pub enum Round {
        /// Scene understanding: global and local questions.
        Understanding = "understanding",
        /// Motion instruction: longitudinal and lateral, with reasons.
        Instruction = "instruction",
        /// Planner code.
        Code = "code",
    }
}
