//! Token counts, under the names of several servers. A count that is absent or odd is zero: it must
//! never cost the answer.

use crate::TokenCounts;
use serde_json::Value;

/// The counts of a completion or an event; `None` where it has none.
pub(super) fn counts(part: &Value) -> Option<TokenCounts> {
    let of_choice = || part.pointer("/choices/0/usage");
    let places = [
        part.get("usage"),
        of_choice(),
        part.pointer("/x_groq/usage"),
    ];
    let usage = places
        .into_iter()
        .flatten()
        .find(|usage| usage.as_object().is_some_and(|fields| !fields.is_empty()));
    match usage {
        Some(usage) => Some(named(usage)),
        None => part
            .get("timings")
            .filter(|timings| timings.is_object())
            .map(timed),
    }
}

fn named(usage: &Value) -> TokenCounts {
    let prompt = first(usage, &["/prompt_tokens", "/input_tokens"]);
    let cached = first(
        usage,
        &[
            "/prompt_tokens_details/cached_tokens",
            "/input_tokens_details/cached_tokens",
            "/prompt_cache_hit_tokens",
        ],
    );
    let sampled = first(usage, &["/completion_tokens", "/output_tokens"]);
    TokenCounts {
        text: prompt.saturating_sub(cached),
        cached: cached.min(prompt),
        sampled,
        ..TokenCounts::default()
    }
}

/// The counts of llama.cpp's server beside an answer without `usage`. Its prompt has no cached
/// tokens in it.
fn timed(timings: &Value) -> TokenCounts {
    TokenCounts {
        text: first(timings, &["/prompt_n"]),
        cached: first(timings, &["/cache_n"]),
        sampled: first(timings, &["/predicted_n"]),
        ..TokenCounts::default()
    }
}

/// The first of these counts that is there and above zero.
fn first(fields: &Value, places: &[&str]) -> usize {
    places
        .iter()
        .filter_map(|place| fields.pointer(place))
        .map(count)
        .find(|count| *count > 0)
        .unwrap_or(0)
}

#[allow(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a count beyond 2^53 is no count"
)]
fn count(value: &Value) -> usize {
    let whole = value.as_u64().and_then(|count| usize::try_from(count).ok());
    whole
        .or_else(|| {
            value
                .as_f64()
                .filter(|count| (0.0..9e15).contains(count))
                .map(|count| count as usize)
        })
        .unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn counts_are_read_under_the_names_of_all_servers() {
        let full = Some((4, 8, 3));
        for (what, part, expected) in [
            (
                "OpenAI, vLLM",
                json!({"usage": {"prompt_tokens": 12, "completion_tokens": 3, "prompt_tokens_details": {"cached_tokens": 8}}}),
                full,
            ),
            (
                "DeepSeek",
                json!({"usage": {"prompt_tokens": 12, "completion_tokens": 3, "prompt_cache_hit_tokens": 8}}),
                full,
            ),
            (
                "gateways in front of Anthropic",
                json!({"usage": {"input_tokens": 12, "output_tokens": 3, "input_tokens_details": {"cached_tokens": 8}}}),
                full,
            ),
            (
                "Moonshot: in the choice",
                json!({"choices": [{"usage": {"prompt_tokens": 4, "completion_tokens": 3}}]}),
                Some((4, 0, 3)),
            ),
            (
                "Groq: beside the stream",
                json!({"x_groq": {"usage": {"prompt_tokens": 4, "completion_tokens": 3}}}),
                Some((4, 0, 3)),
            ),
            (
                "llama-server without usage",
                json!({"timings": {"prompt_n": 4, "cache_n": 8, "predicted_n": 3}}),
                full,
            ),
            (
                "vLLM: details are null",
                json!({"usage": {"prompt_tokens": 4, "completion_tokens": null, "prompt_tokens_details": null}}),
                Some((4, 0, 0)),
            ),
            (
                "numbers with a point",
                json!({"usage": {"prompt_tokens": 4.0, "completion_tokens": 3.0}}),
                Some((4, 0, 3)),
            ),
            (
                "more cached than asked",
                json!({"usage": {"prompt_tokens": 4, "prompt_cache_hit_tokens": 9}}),
                Some((0, 4, 0)),
            ),
            (
                "nonsense",
                json!({"usage": {"prompt_tokens": "many", "completion_tokens": -3}}),
                Some((0, 0, 0)),
            ),
            ("empty", json!({"usage": {}}), None),
            ("null", json!({"usage": null}), None),
            ("no object", json!({"usage": 3}), None),
            ("absent", json!({}), None),
        ] {
            let counts = counts(&part).map(|counts| (counts.text, counts.cached, counts.sampled));
            assert_eq!(counts, expected, "{what}");
        }
    }
}
