//! Why an answer ended, in the words of several servers.

use crate::{EndpointFailure, FinishReason};
use serde_json::Value;

/// Words for the limit of tokens that the request set.
const LENGTH: [&str; 6] = [
    "length",
    "max_tokens",
    "max_length",
    "max_new_tokens",
    "max_output_tokens",
    "token_limit",
];
/// Words for the model's own limit: Mistral, gateways in front of Anthropic.
const CONTEXT: [&str; 2] = ["model_length", "model_context_window_exceeded"];
/// Words for an answer that a filter holds back: `OpenAI` and Azure, Gemini, Zhipu, Cohere,
/// Anthropic.
const FILTERED: [&str; 9] = [
    "content_filter",
    "safety",
    "sensitive",
    "blocklist",
    "prohibited_content",
    "recitation",
    "error_toxic",
    "refusal",
    "refused",
];
/// Words for a call of a tool in place of an answer.
const TOOLS: [&str; 4] = ["tool_calls", "tool_call", "tool_use", "function_call"];
/// Words for an answer that the server did not complete: `OpenRouter`, `SGLang` and vLLM, Zhipu,
/// `DeepSeek`.
const BROKEN: [&str; 7] = [
    "error",
    "abort",
    "aborted",
    "cancelled",
    "canceled",
    "network_error",
    "insufficient_system_resource",
];

/// How an answer ended.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Ending {
    /// The answer is complete.
    Answer(FinishReason),
    /// There is no answer, and the word says why.
    Withheld(String),
    Tools(String),
    Broken(String),
}

impl Ending {
    /// The ending that a choice names; `None` before the end.
    ///
    /// A word that is not known means the end: servers invent words for it (`eos`, `eos_token`,
    /// `stop_sequence`, `end_turn`).
    pub(super) fn from_choice(choice: &Value) -> Option<Self> {
        // The first GPT-4V had an object; others name only the reason to stop.
        let named = [
            choice.get("finish_reason"),
            choice.pointer("/finish_details/type"),
            choice.get("stop_reason"),
            choice.get("done_reason"),
            choice.get("finishReason"),
        ];
        named
            .into_iter()
            .flatten()
            .find_map(word)
            .map(|word| Self::named(&word))
    }

    fn named(word: &str) -> Self {
        let plain = word.to_ascii_lowercase();
        let is_in = |words: &[&str]| words.contains(&plain.as_str());
        if is_in(&LENGTH) {
            Self::Answer(FinishReason::Length)
        } else if is_in(&CONTEXT) {
            Self::Answer(FinishReason::ContextFull)
        } else if is_in(&FILTERED) {
            Self::Withheld(word.to_owned())
        } else if is_in(&TOOLS) {
            Self::Tools(word.to_owned())
        } else if is_in(&BROKEN) {
            Self::Broken(word.to_owned())
        } else {
            Self::Answer(FinishReason::EndOfSequence)
        }
    }

    /// The reason of a complete answer, or the failure in a sentence of its own. `shown` shortens
    /// words of the server.
    pub(super) fn reason(
        &self,
        shown: &dyn Fn(&str) -> String,
    ) -> Result<FinishReason, EndpointFailure> {
        let named = |word: &str| format!("finish_reason '{}'", shown(word));
        match self {
            Self::Answer(reason) => Ok(*reason),
            Self::Withheld(word) => {
                let sentence = format!(
                    "a filter of the server held the answer back ({})",
                    named(word)
                );
                Err(EndpointFailure::Withheld(sentence))
            }
            Self::Tools(word) => Err(EndpointFailure::NoAnswer(format!(
                "the model called a tool ({}), though the request offers none; switch tools off in the server",
                named(word)
            ))),
            Self::Broken(word) => Err(EndpointFailure::Closed(format!(
                "the server broke the answer off ({})",
                named(word)
            ))),
        }
    }
}

/// A reason as a word. Some servers write an empty text or "null" in every event before the last.
fn word(reason: &Value) -> Option<String> {
    match reason {
        Value::String(word) if word.is_empty() || word == "null" => None,
        Value::String(word) => Some(word.clone()),
        Value::Number(number) => Some(number.to_string()),
        Value::Object(fields) => fields
            .get("type")
            .and_then(Value::as_str)
            .map(ToOwned::to_owned),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn every_word_for_the_end_is_understood() {
        use FinishReason::{ContextFull, EndOfSequence, Length};
        for (word, reason) in [
            (json!("stop"), EndOfSequence),
            (json!("eos"), EndOfSequence),
            (json!("eos_token"), EndOfSequence),
            (json!("stop_sequence"), EndOfSequence),
            (json!("end_turn"), EndOfSequence),
            (json!("COMPLETE"), EndOfSequence),
            (json!("a word of next year"), EndOfSequence),
            (json!(1), EndOfSequence),
            (json!({"type": "stop", "matched": 2}), EndOfSequence),
            (json!({"type": "length", "length": 5}), Length),
            (json!("length"), Length),
            (json!("MAX_TOKENS"), Length),
            (json!("model_length"), ContextFull),
        ] {
            let ending = Ending::from_choice(&json!({"finish_reason": word}));
            assert_eq!(ending, Some(Ending::Answer(reason)), "{word}");
        }
    }

    #[test]
    fn an_end_is_found_under_other_names_and_not_before_it() {
        for (choice, expected) in [
            (
                json!({"finish_details": {"type": "max_tokens"}}),
                Some(FinishReason::Length),
            ),
            (
                json!({"finish_reason": null, "finish_details": {"type": "stop"}}),
                Some(FinishReason::EndOfSequence),
            ),
            (
                json!({"stop_reason": "end_turn"}),
                Some(FinishReason::EndOfSequence),
            ),
            (
                json!({"finish_reason": "length", "stop_reason": "</s>"}),
                Some(FinishReason::Length),
            ),
            (json!({"finish_reason": null, "stop_reason": null}), None),
            (json!({"finish_reason": ""}), None),
            (json!({"finish_reason": "null"}), None),
            (json!({"finish_reason": false}), None),
            (json!({}), None),
        ] {
            assert_eq!(
                Ending::from_choice(&choice),
                expected.map(Ending::Answer),
                "{choice}"
            );
        }
    }

    #[test]
    fn an_end_without_an_answer_has_its_own_sentence() {
        let failure = |word: &str| {
            let ending = Ending::from_choice(&json!({"finish_reason": word})).unwrap();
            ending.reason(&str::to_owned).unwrap_err()
        };
        for word in ["content_filter", "SAFETY", "sensitive", "refusal"] {
            assert!(
                matches!(failure(word), EndpointFailure::Withheld(text) if text.contains(word)),
                "{word}"
            );
        }
        for word in ["tool_calls", "function_call", "tool_use"] {
            assert!(
                matches!(failure(word), EndpointFailure::NoAnswer(text) if text.contains(word)),
                "{word}"
            );
        }
        for word in [
            "error",
            "abort",
            "network_error",
            "insufficient_system_resource",
        ] {
            assert!(
                matches!(failure(word), EndpointFailure::Closed(text) if text.contains(word)),
                "{word}"
            );
        }
    }
}
