//! Text processing for models: tokenizer, chat template, grammars.

mod grammar;
mod template;
mod template_bounds;
mod token_bytes;
mod tokenizer;

pub(crate) use grammar::{GrammarEngine, GrammarState};
pub(crate) use template::ChatTemplate;
pub use tokenizer::ChatTokenizer;
pub(crate) use tokenizer::special_tokens;
