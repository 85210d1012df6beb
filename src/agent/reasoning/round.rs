//! The three rounds of an attempt, and the names that questions have in records.

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

choice! {
    /// What a question to a language agent's model asks for, in records.
    pub enum RoundName {
        /// The paper's first round.
        Understanding = "understanding",
        /// The paper's second round.
        Instruction = "instruction",
        /// One line of code.
        Code = "code",
        /// A list of waypoints.
        Waypoints = "waypoints",
        /// One of a few actions.
        Action = "action",
        /// The action that an earlier answer meant.
        Extraction = "extraction",
        /// Whether a kind of information is needed.
        Need = "need",
        /// A call of a tool.
        Tool = "tool",
        /// Which experience of a memory fits.
        Experience = "experience",
        /// Reasons without a plan.
        Reasoning = "reasoning",
        /// What is to be learned from an accident.
        Lesson = "lesson",
    }
}

impl From<Round> for RoundName {
    fn from(round: Round) -> Self {
        match round {
            Round::Understanding => Self::Understanding,
            Round::Instruction => Self::Instruction,
            Round::Code => Self::Code,
        }
    }
}
