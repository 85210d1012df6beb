//! Stage 4: the Reasoning Engine of the paper. It asks the model three rounds, scene understanding,
//! motion instruction and planner code, and reads the answers.

mod answer;
mod assist;
mod call_parser;
mod code;
mod code_lexer;
mod code_parser;
mod config;
mod engine;
mod error;
mod fitting;
mod grammar;
mod history;
mod instruction;
mod known_variables;
mod outputs;
mod prompt_set;
mod prompt_source;
mod proposals;
mod question;
mod question_prompts;
mod round;
mod templates;
mod tool;
mod variables;

pub use answer::PlannerAnswer;
pub use assist::{
    AssistParameters, AssistQuestion, AssistReasoning, AssistVariant, Assistance, WAYPOINT_SECONDS,
    Waypoint, Waypoints, parse_assistance,
};
pub use call_parser::ParseError;
pub use code::{FUNCTION, Names, PlannerCode, Range};
pub use code_parser::{Parsed, parse};
pub use config::ReasoningConfig;
pub use engine::{
    Feedback, Interruption, Reasoning, ReasoningSettings, ReasoningTrace, RoundRecord,
    ScenarioPrompt, feedback_text, round_prompt, round_record, system_prompt,
};
pub use error::{PromptError, ReasoningError};
pub use grammar::{ACCELERATIONS, DECELERATIONS, target_speeds};
pub use history::{AnswerHistory, Speculation};
pub use instruction::{
    Lateral, LateralReason, Longitudinal, LongitudinalReason, MotionInstruction,
};
pub use outputs::{DrivingAction, LISTED_WAYPOINTS, SeenPlace, WaypointList};
pub use prompt_set::{InstructionForm, PromptForms, PromptSet, UnderstandingForm};
pub use prompt_source::{PromptPlace, built_in_prompts};
pub use proposals::Proposals;
pub use question::{FreeQuestion, question_prompt};
pub use question_prompts::QuestionPrompts;
pub use round::{Round, RoundName};
pub use tool::ToolUse;
