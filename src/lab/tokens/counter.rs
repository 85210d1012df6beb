//! Tokenizers that count.

use super::Tokens;
use planagent_mllm::Mllm;
use tiktoken_rs::{CoreBPE, cl100k_base_singleton};

/// Counts the tokens of texts. The ranks of `cl100k_base` are part of the program.
#[derive(Clone, Copy)]
pub struct TokenCounter<'a> {
    cl100k: &'static CoreBPE,
    model: Option<&'a dyn Mllm>,
}

impl<'a> TokenCounter<'a> {
    /// A counter that also counts with the tokenizer of `model`, where it has one here.
    pub fn new(model: Option<&'a dyn Mllm>) -> Self {
        Self {
            cl100k: cl100k_base_singleton(),
            model,
        }
    }

    /// Name of the model whose tokenizer counts beside `cl100k_base`.
    pub fn model_name(&self) -> Option<&'a str> {
        self.model
            .filter(|model| model.count_tokens("").is_some())
            .map(Mllm::name)
    }

    /// The tokens of a text, without special ones.
    pub fn count(&self, text: &str) -> Tokens {
        let model = self.model.and_then(|model| model.count_tokens(text));
        Tokens {
            cl100k: self.cl100k.encode_ordinary(text).len(),
            model,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Counts that OpenAI's tiktoken gives for `cl100k_base`.
    #[test]
    fn counts_as_tiktoken_does() {
        let counter = TokenCounter::new(None);
        for (text, expected) in [
            ("", 0),
            ("tiktoken is great!", 6),
            ("front_left vehicle2 8 m 9 m/s", 11),
            ("(1.20,13.40)", 9),
        ] {
            assert_eq!(counter.count(text).cl100k, expected, "{text}");
        }
    }
}
