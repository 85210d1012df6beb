//! Constrained decoding: the tokens that a grammar allows or determines next.

use super::tokenizer::ChatTokenizer;
use crate::{Constraint, MllmError};
use llguidance::api::TopLevelGrammar;
use llguidance::panic_utils::catch_unwind;
use llguidance::{Matcher, ParserFactory, regex_to_lark};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use tokenizers::Tokenizer;
use toktrie::{
    InferenceCapabilities, SimpleVob, TokEnv, TokRxInfo, TokTrie, TokenId, TokenizerEnv,
};

/// Maximum compiled grammars in the cache. A run uses fewer than ten.
const MAX_GRAMMARS: usize = 64;
/// Maximum characters of a constraint in an error message.
const MAX_SHOWN: usize = 200;
/// A control character that no tokenizer merges with text; see [`Vocabulary::tokenize`].
const SENTINEL: &str = "\u{2}";

/// Compiles constraints for a vocabulary.
pub(crate) struct GrammarEngine {
    factory: ParserFactory,
    compiled: Mutex<BTreeMap<Constraint, Matcher>>,
}

/// Progress of an answer under a constraint.
pub(crate) struct GrammarState {
    matcher: Matcher,
    shown: String,
}

/// The tokenizer as the grammar library needs it.
struct Vocabulary {
    trie: TokTrie,
    tokenizer: Tokenizer,
    /// Whether the tokenizer adds a space before a text.
    prepends_space: bool,
}

impl std::fmt::Debug for GrammarEngine {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter
            .debug_struct("GrammarEngine")
            .finish_non_exhaustive()
    }
}

impl GrammarEngine {
    /// `end` are the ids that end an answer; at least one.
    pub(crate) fn new(tokenizer: &ChatTokenizer, end: &[u32]) -> Result<Self, MllmError> {
        let broken = |problem: String| MllmError::Tokenizer {
            path: tokenizer.path().to_path_buf(),
            problem,
        };
        let words = tokenizer.bytes();
        let first_end = *end
            .first()
            .ok_or_else(|| broken("the model has no end-of-sequence token".into()))?;
        // The library panics on some vocabularies, and a file of a stranger must not end the
        // program.
        let factory = catch_unwind(std::panic::AssertUnwindSafe(|| {
            let trie = TokTrie::from(&TokRxInfo::new(words.len() as u32, first_end), words)
                .with_eos_tokens(end);
            let plain = tokenizer.for_plain_text();
            let prepends_space = plain
                .encode_fast("a", false)
                .is_ok_and(|encoding| trie.decode(encoding.get_ids()) != b"a");
            let vocabulary: TokEnv = Arc::new(Vocabulary {
                trie,
                tokenizer: plain,
                prepends_space,
            });
            let capabilities = InferenceCapabilities {
                ff_tokens: true,
                ..InferenceCapabilities::default()
            };
            let mut factory = ParserFactory::new(&vocabulary, capabilities, &[])?;
            factory.quiet();
            factory.limits_mut().verbose_errors = false;
            Ok(factory)
        }))
        .map_err(|error| broken(first_line(&error.to_string())))?;
        Ok(Self {
            factory,
            compiled: Mutex::new(BTreeMap::new()),
        })
    }

    /// Starts an answer under a constraint; `None` for [`Constraint::Free`].
    pub(crate) fn begin(&self, constraint: &Constraint) -> Result<Option<GrammarState>, MllmError> {
        let shown = shown(constraint);
        let fail = |problem: String| MllmError::Grammar {
            constraint: shown.clone(),
            problem,
        };
        let grammar = match constraint {
            Constraint::Free => return Ok(None),
            Constraint::Lark(grammar) => TopLevelGrammar::from_lark(grammar.clone()),
            other => TopLevelGrammar::from_lark(format!("start: {}", lark(other).map_err(fail)?)),
        };
        let known = {
            let compiled = self.compiled.lock().unwrap_or_else(PoisonError::into_inner);
            compiled.get(constraint).map(Matcher::deep_clone)
        };
        if let Some(matcher) = known {
            return Ok(Some(GrammarState { matcher, shown }));
        }
        let create = std::panic::AssertUnwindSafe(|| self.factory.create_parser(grammar));
        let matcher = Matcher::new(catch_unwind(create));
        if let Some(problem) = matcher.get_error() {
            return Err(fail(problem));
        }
        let mut compiled = self.compiled.lock().unwrap_or_else(PoisonError::into_inner);
        if compiled.len() >= MAX_GRAMMARS {
            compiled.clear();
        }
        compiled.insert(constraint.clone(), matcher.deep_clone());
        Ok(Some(GrammarState { matcher, shown }))
    }
}

impl GrammarState {
    /// Whether the answer is complete and no further token is allowed.
    pub(crate) fn is_complete(&self) -> bool {
        self.matcher.is_stopped() && !self.matcher.is_error()
    }

    /// The tokens that the grammar determines next, in the tokenizer's spelling. They count as
    /// generated.
    pub(crate) fn take_fast_forwarded(&mut self) -> Result<Vec<TokenId>, MllmError> {
        if self.matcher.is_stopped() {
            self.check()?;
            return Ok(Vec::new());
        }
        let fast_forwarded = self.matcher.compute_ff_tokens();
        self.check()?;
        if !fast_forwarded.is_empty() {
            self.consume(&fast_forwarded)?;
        }
        Ok(fast_forwarded)
    }

    /// The tokens that the grammar allows next. End tokens are among them where the text may end.
    pub(crate) fn allowed(&mut self) -> Result<SimpleVob, MllmError> {
        self.matcher
            .compute_mask()
            .map_err(|error| self.error(&error.to_string()))
    }

    /// How many of these tokens the grammar allows next, one after the other.
    pub(crate) fn allowed_prefix(&mut self, tokens: &[TokenId]) -> Result<usize, MllmError> {
        if tokens.is_empty() || self.matcher.is_stopped() {
            return self.check().map(|()| 0);
        }
        self.matcher
            .validate_tokens(tokens)
            .map_err(|error| self.error(&error.to_string()))
    }

    /// Adds generated tokens.
    pub(crate) fn consume(&mut self, tokens: &[TokenId]) -> Result<(), MllmError> {
        self.matcher
            .consume_tokens(tokens)
            .map_err(|error| self.error(&error.to_string()))
    }

    fn check(&self) -> Result<(), MllmError> {
        match self.matcher.get_error() {
            None => Ok(()),
            Some(problem) => Err(self.error(&problem)),
        }
    }

    fn error(&self, problem: &str) -> MllmError {
        MllmError::Grammar {
            constraint: self.shown.clone(),
            problem: first_line(problem),
        }
    }
}

impl Vocabulary {
    /// Ids of a text in the middle of an answer. A tokenizer that adds a space before every text
    /// gets a sentinel before it, whose tokens are removed again.
    fn tokenize(&self, text: &str) -> Vec<TokenId> {
        let encode = |text: &str| {
            self.tokenizer
                .encode_fast(text, false)
                .map(|encoding| encoding.get_ids().to_vec())
        };
        let ids = if self.prepends_space {
            match (encode(SENTINEL), encode(&format!("{SENTINEL}{text}"))) {
                (Ok(sentinel), Ok(mut ids)) if ids.starts_with(&sentinel) => {
                    Ok(ids.split_off(sentinel.len()))
                }
                (_, other) => other,
            }
        } else {
            encode(text)
        };
        // Fast-forwarded tokens must give exactly these bytes, so other spellings are not used.
        match ids {
            Ok(ids) if self.trie.decode_raw(&ids) == text.as_bytes() => ids,
            _ => self.trie.greedy_tokenize(text.as_bytes()),
        }
    }
}

impl TokenizerEnv for Vocabulary {
    fn tok_trie(&self) -> &TokTrie {
        &self.trie
    }

    fn tokenize_bytes(&self, bytes: &[u8]) -> Vec<TokenId> {
        self.trie
            .tokenize_with_greedy_fallback(bytes, |text| self.tokenize(text))
    }
}

/// A constraint as an expression of Lark.
fn lark(constraint: &Constraint) -> Result<String, String> {
    match constraint {
        Constraint::Choice(texts) => choice(texts),
        Constraint::Regex(pattern) => regex(pattern),
        Constraint::Sequence(parts) if parts.is_empty() => Err("the sequence is empty".into()),
        Constraint::Sequence(parts) => {
            let parts = parts.iter().map(|part| Ok(format!("({})", lark(part)?)));
            Ok(parts.collect::<Result<Vec<String>, String>>()?.join(" "))
        }
        Constraint::OneOf(parts) if parts.is_empty() => Err("the choice is empty".into()),
        Constraint::OneOf(parts) => {
            let parts = parts.iter().map(|part| Ok(format!("({})", lark(part)?)));
            Ok(parts.collect::<Result<Vec<String>, String>>()?.join(" | "))
        }
        Constraint::Free | Constraint::Lark(_) => {
            Err("a sequence cannot contain free text or Lark".into())
        }
    }
}

fn choice(texts: &[String]) -> Result<String, String> {
    if texts.is_empty() {
        return Err("the choice is empty".into());
    }
    if texts.iter().any(String::is_empty) {
        return Err("a choice has an empty text".into());
    }
    let alternatives: Vec<String> = texts
        .iter()
        .map(|text| serde_json::Value::from(text.as_str()).to_string())
        .collect();
    Ok(alternatives.join(" | "))
}

fn regex(pattern: &str) -> Result<String, String> {
    let escapes = pattern.len() - pattern.trim_end_matches('\\').len();
    if pattern.is_empty() || escapes % 2 == 1 {
        return Err("the regular expression is empty or ends in a backslash".into());
    }
    Ok(format!("/{}/", regex_to_lark(pattern, "")))
}

fn shown(constraint: &Constraint) -> String {
    let text = format!("{constraint:?}");
    match text.char_indices().nth(MAX_SHOWN) {
        None => text,
        Some((end, _)) => format!("{}...", &text[..end]),
    }
}

fn first_line(text: &str) -> String {
    text.lines().next().unwrap_or_default().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::checkpoint::ModelFiles;
    use serde_json::json;

    /// A tokenizer like that of Llama 2: adds a space before every text, writes `▁` for spaces, and
    /// unknown characters as bytes.
    fn sentence_piece() -> (tempfile::TempDir, ChatTokenizer) {
        let mut vocabulary = serde_json::Map::new();
        let bytes = (0..256).map(|byte| format!("<0x{byte:02X}>"));
        let words = [
            "\u{2581}",
            "k",
            "e",
            "p",
            "l",
            "a",
            "n",
            "ke",
            "ep",
            "keep",
            "\u{2581}l",
            "\u{2581}la",
            "ne",
        ];
        let tokens = ["<unk>", "<s>", "</s>"]
            .map(String::from)
            .into_iter()
            .chain(bytes)
            .chain(words.map(String::from));
        for (id, token) in tokens.enumerate() {
            vocabulary.insert(token, json!(id));
        }
        let special = |id: u32, content: &str| {
            json!({"id": id, "content": content, "single_word": false, "lstrip": false, "rstrip": false,
                "normalized": false, "special": true})
        };
        let file = json!({
            "version": "1.0", "truncation": null, "padding": null,
            "added_tokens": [special(0, "<unk>"), special(1, "<s>"), special(2, "</s>")],
            "normalizer": {"type": "Sequence", "normalizers": [
                {"type": "Prepend", "prepend": "\u{2581}"},
                {"type": "Replace", "pattern": {"String": " "}, "content": "\u{2581}"}]},
            "pre_tokenizer": null, "post_processor": null,
            "decoder": {"type": "Sequence", "decoders": [
                {"type": "Replace", "pattern": {"String": "\u{2581}"}, "content": " "},
                {"type": "ByteFallback"}, {"type": "Fuse"}, {"type": "Strip", "content": " ", "start": 1, "stop": 0}]},
            "model": {"type": "BPE", "dropout": null, "unk_token": "<unk>", "continuing_subword_prefix": null,
                "end_of_word_suffix": null, "fuse_unk": true, "byte_fallback": true, "ignore_merges": false,
                "vocab": vocabulary,
                "merges": [["k", "e"], ["e", "p"], ["ke", "ep"], ["\u{2581}", "l"], ["\u{2581}l", "a"], ["n", "e"]]},
        });
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("tokenizer.json"), file.to_string()).unwrap();
        let tokenizer =
            ChatTokenizer::open(&ModelFiles::folder(folder.path()).unwrap(), 280, 0).unwrap();
        (folder, tokenizer)
    }

    #[test]
    fn sentence_piece_answers_are_fast_forwarded_without_the_added_space() {
        let (_folder, tokenizer) = sentence_piece();
        let engine = GrammarEngine::new(&tokenizer, &[2]).unwrap();
        let mut state = engine
            .begin(&Constraint::Choice(vec!["keep lane\n".into()]))
            .unwrap()
            .unwrap();
        let fast_forwarded = state.take_fast_forwarded().unwrap();
        let spelled: Vec<String> = fast_forwarded
            .iter()
            .filter_map(|id| tokenizer.token(*id))
            .collect();
        assert_eq!(spelled, ["keep", "\u{2581}la", "ne", "<0x0A>"]);
        assert_eq!(tokenizer.decode_verbatim(&fast_forwarded), "keep lane\n");
        assert!(state.is_complete());
    }

    #[test]
    fn a_grammar_is_followed_byte_by_byte() {
        let (_folder, tokenizer) = sentence_piece();
        let engine = GrammarEngine::new(&tokenizer, &[2]).unwrap();
        let mut state = engine
            .begin(&Constraint::Regex("(keep| lane)?".into()))
            .unwrap()
            .unwrap();
        assert!(state.take_fast_forwarded().unwrap().is_empty());
        let allowed = state.allowed().unwrap();
        let allows = |token: &str| allowed.is_allowed(tokenizer.id(token).unwrap());
        for token in [
            "keep",
            "k",
            "ke",
            "\u{2581}",
            "\u{2581}la",
            "<0x20>",
            "</s>",
        ] {
            assert!(allows(token), "{token}");
        }
        for token in ["ep", "l", "<s>", "<unk>", "<0x0A>"] {
            assert!(!allows(token), "{token}");
        }
        let ids = |tokens: &[&str]| {
            tokens
                .iter()
                .map(|token| tokenizer.id(token).unwrap())
                .collect::<Vec<_>>()
        };
        assert_eq!(state.allowed_prefix(&ids(&["ke", "ep", "ne"])).unwrap(), 2);
        assert_eq!(state.allowed_prefix(&ids(&["ne"])).unwrap(), 0);
        assert_eq!(state.allowed().unwrap(), allowed, "asking changes nothing");
        assert!(state.consume(&[tokenizer.id("ep").unwrap()]).is_err());
    }

    #[test]
    fn an_open_end_meets_what_follows_only_in_one_expression() {
        let (_folder, tokenizer) = sentence_piece();
        let engine = GrammarEngine::new(&tokenizer, &[2]).unwrap();
        let answer = ["k", "e", "<0x0A>", "<0x23>", "<0x31>"];
        let ids: Vec<TokenId> = answer
            .iter()
            .map(|token| tokenizer.id(token).unwrap())
            .collect();
        let allowed = |constraint: Constraint| -> usize {
            let mut state = engine.begin(&constraint).unwrap().unwrap();
            // The first letter is forced.
            let forced = state.take_fast_forwarded().unwrap().len();
            forced + state.allowed_prefix(&ids[forced..]).unwrap()
        };
        let whole = Constraint::Regex(r"k[^#]{1,40}\n#1".into());
        assert_eq!(allowed(whole), answer.len());
        let parts = Constraint::Sequence(vec![
            Constraint::Regex("k[^#]{1,40}".into()),
            Constraint::Choice(vec!["\n#1".into()]),
        ]);
        assert_eq!(allowed(parts), 3, "the first part took the line break");
    }
}
