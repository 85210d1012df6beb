//! Stage 4: the Reasoning Engine of the paper. It asks the model three rounds, scene understanding, motion instruction and
//! planner code, and reads the answers.

mod code;
mod code_lexer;
mod code_parser;

pub use code::{ACCEL_MAX, DECEL_MAX, FUNCTION, Names, PlannerCode, Range, TARGET_SPEED};
pub use code_parser::{ParseError, Parsed, parse};
