//! Text processing for models: tokenizer, chat template, grammars.

mod grammar;
mod prompt_rules;
mod template;
mod template_bounds;
mod template_engine;
mod token_bytes;
mod tokenizer;

pub(crate) use grammar::{GrammarEngine, GrammarState};
pub(crate) use template::{ChatTemplate, template_source};
pub use template_engine::TemplateEngine;
pub use tokenizer::ChatTokenizer;
pub(crate) use tokenizer::special_tokens;
