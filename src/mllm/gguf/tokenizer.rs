//! A tokenizer in GGUF metadata, converted to an equivalent `tokenizer.json`.
//!
//! SentencePiece: GGUF has pieces with scores (`tokenizer.ggml.model = llama`): the neighbors whose
//! joint piece has the highest score are joined first. A byte-pair model with its merges in the
//! order of the scores does the same. Gemma 4's files name the merges themselves
//! (`tokenizer.ggml.model = gemma4`). Byte-level tokenizers are in `byte_level`.

use super::header::Header;
use super::{TOKENIZER, byte_level};
use crate::MllmError;
use crate::checkpoint::read_json;
use serde_json::{Value as Json, json};
use std::collections::{BTreeMap, HashMap, HashSet};
use std::path::PathBuf;

/// Kinds of pieces (`llama_token_type`).
pub(crate) mod piece {
    /// Text.
    pub(crate) const NORMAL: i64 = 1;
    /// The piece for text without a piece.
    pub(crate) const UNKNOWN: i64 = 2;
    /// A special token.
    pub(crate) const CONTROL: i64 = 3;
    /// A token added by a user.
    pub(crate) const USER_DEFINED: i64 = 4;
    /// A row of the embedding without a token.
    pub(crate) const UNUSED: i64 = 5;
    /// A byte, `<0x0A>`.
    pub(crate) const BYTE: i64 = 6;
}

/// The placeholder of an image.
const IMAGE: &str = "<image>";
/// The key of the kind of a tokenizer.
const MODEL: &str = "tokenizer.ggml.model";
/// Longest piece, bytes. SentencePiece's pieces have 16 characters; a longer one means a broken
/// file.
const MAX_PIECE: usize = 1024;

/// Special tokens that end a turn of a chat.
const TURN_ENDS: [&str; 5] = [
    "<|im_end|>",
    "<|eot_id|>",
    "<end_of_turn>",
    "<turn|>",
    "<|end|>",
];

/// A tokenizer as Hugging Face's files.
pub(crate) struct TokenizerFiles {
    /// `tokenizer.json`.
    pub tokenizer: Json,
    /// `tokenizer_config.json`.
    pub config: Json,
    /// The tokens that end an answer.
    pub ends: Vec<i64>,
}

/// The id of the image's placeholder in a `tokenizer.json`. A file without one gets it after all
/// other tokens.
pub(crate) fn image_token(tokenizer: &mut Json) -> Result<u64, &'static str> {
    placeholder(tokenizer, IMAGE)
}

/// As [`image_token`], of a placeholder with another name.
pub(crate) fn placeholder(tokenizer: &mut Json, name: &str) -> Result<u64, &'static str> {
    let tokens = tokenizer["added_tokens"].as_array().into_iter().flatten();
    if let Some(known) = tokens.clone().find(|token| token["content"] == name) {
        return known["id"]
            .as_u64()
            .ok_or("the token of an image has no id");
    }
    let vocabulary = tokenizer["model"]["vocab"]
        .as_object()
        .ok_or("it has no vocabulary")?;
    let ids = vocabulary
        .values()
        .chain(tokens.map(|token| &token["id"]))
        .filter_map(Json::as_u64);
    let next = ids.max().map_or(0, |last| last + 1);
    match tokenizer["added_tokens"].as_array_mut() {
        Some(tokens) => tokens.push(added_token(next, name, true)),
        None => tokenizer["added_tokens"] = json!([added_token(next, name, true)]),
    }
    Ok(next)
}

/// A token that is matched before the text is split.
pub(crate) fn added_token(id: u64, token: &str, special: bool) -> Json {
    json!({
        "id": id, "content": token, "special": special,
        "single_word": false, "lstrip": false, "rstrip": false, "normalized": false,
    })
}

/// Reads the tokenizer of a model whose embedding has `vocabulary` rows.
pub(crate) fn read(header: &Header, vocabulary: usize) -> Result<TokenizerFiles, MllmError> {
    let is_listed = match header.text(MODEL)? {
        Some("llama") => false,
        Some("gemma4") => true,
        Some("gpt2") => return byte_level::read(header, vocabulary),
        Some(other) => {
            return Err(header.error(
                MODEL,
                format!(
                    "'{other}' is not supported in GGUF (llama, SentencePiece, gemma4, the same with its merges, and gpt2, \
                     byte-level, are); put the model's tokenizer.json beside it"
                ),
            ));
        }
        None => {
            return Err(header.error(
                MODEL,
                "the file has no tokenizer; put the model's tokenizer.json beside it",
            ));
        }
    };
    let pieces = Pieces::read(header, vocabulary)?;
    let merges = if is_listed {
        json!(pieces.listed_merges(header)?)
    } else {
        json!(pieces.merges(&scores(header, pieces.tokens.len())?))
    };
    let Special {
        bos,
        unknown,
        ends,
        config,
    } = Special::read(header, &pieces)?;
    let flag = |key: &str| header.flag(&format!("tokenizer.ggml.{key}"));
    // llama.cpp's default where the key is absent.
    let bos = if flag("add_bos_token")?.unwrap_or(true) {
        bos
    } else {
        None
    };
    let prefix = flag("add_space_prefix")?.unwrap_or(!is_listed);
    let unknown = unknown.map(|(_, token)| token);
    let tokenizer = pieces.to_json(&merges, bos, unknown, prefix);
    Ok(TokenizerFiles {
        tokenizer,
        config,
        ends,
    })
}

/// The scores of so many pieces.
fn scores(header: &Header, pieces: usize) -> Result<Vec<f64>, MllmError> {
    const SCORES: &str = "tokenizer.ggml.scores";
    let scores: Vec<f64> = header
        .list(SCORES, "a list of numbers")?
        .unwrap_or_default();
    if scores.len() == pieces {
        return Ok(scores);
    }
    Err(header.error(SCORES, format!("expected {pieces} scores")))
}

/// A note where a decoder's file leaves its tokenizer open, and no file beside it decides.
pub(crate) fn note(header: &Header) -> Result<Option<String>, MllmError> {
    if header.text(MODEL)? != Some("gpt2") || header.path.with_file_name(TOKENIZER).is_file() {
        return Ok(None);
    }
    byte_level::note(header)
}

/// What errors about a decoder's tokenizer call it: the file beside it, or its own.
pub(crate) fn place(header: &Header) -> PathBuf {
    let beside = header.path.with_file_name(TOKENIZER);
    if beside.is_file() {
        beside
    } else {
        header.path.clone()
    }
}

/// The tokenizer of a decoder: the file beside it, else that of the metadata, whose other small
/// files go to `files`.
pub(crate) fn files(
    header: &Header,
    vocabulary: usize,
    files: &mut BTreeMap<String, String>,
) -> Result<Json, MllmError> {
    let beside = header.path.with_file_name(TOKENIZER);
    if beside.is_file() {
        return read_json(&beside);
    }
    let read = read(header, vocabulary)?;
    files.insert("tokenizer_config.json".into(), read.config.to_string());
    if !read.ends.is_empty() {
        files.insert(
            "generation_config.json".into(),
            json!({"eos_token_id": read.ends}).to_string(),
        );
    }
    Ok(read.tokenizer)
}

/// The id of an added token in a `tokenizer.json`.
pub(crate) fn added_id(tokenizer: &Json, token: &str) -> Option<u64> {
    let mut tokens = tokenizer["added_tokens"].as_array()?.iter();
    tokens.find(|added| added["content"] == token)?["id"].as_u64()
}

/// The tokens with a role.
pub(super) struct Special<'a> {
    pub(super) bos: Option<(i64, &'a str)>,
    /// The tokens that end an answer.
    pub(super) ends: Vec<i64>,
    pub(super) unknown: Option<(i64, &'a str)>,
    /// `tokenizer_config.json`.
    pub(super) config: Json,
}

impl<'a> Special<'a> {
    pub(super) fn read(header: &Header, pieces: &Pieces<'a>) -> Result<Self, MllmError> {
        let special = |role: &str| -> Result<Option<(i64, &'a str)>, MllmError> {
            let key = format!("tokenizer.ggml.{role}_token_id");
            let Some(id) = header.metadata.get(&key).and_then(Json::as_u64) else {
                return Ok(None);
            };
            let token = pieces.tokens.get(id as usize);
            let token = token.ok_or_else(|| {
                header.error(
                    &key,
                    format!("{id} is none of {} tokens", pieces.tokens.len()),
                )
            })?;
            Ok(Some((id as i64, *token)))
        };
        let (bos, eos, unknown) = (special("bos")?, special("eos")?, special("unknown")?);
        let mut config = json!({});
        for (key, token) in [
            ("bos_token", bos),
            ("eos_token", eos),
            ("unk_token", unknown),
        ] {
            if let Some((_, token)) = token {
                config[key] = json!(token);
            }
        }
        // The file's own comes first.
        let mut ends: Vec<i64> = eos.map(|(id, _)| id).into_iter().collect();
        let turn = special("eot")?.map(|(id, _)| id);
        for id in turn.into_iter().chain(pieces.ends_of_turns()) {
            if !ends.contains(&id) {
                ends.push(id);
            }
        }
        Ok(Self {
            bos,
            ends,
            unknown,
            config,
        })
    }
}

/// The pieces of a vocabulary, by id.
pub(super) struct Pieces<'a> {
    pub(super) tokens: Vec<&'a str>,
    /// Kinds of the pieces ([`piece`]).
    pub(super) kinds: Vec<i64>,
}

impl<'a> Pieces<'a> {
    pub(super) fn read(header: &'a Header, vocabulary: usize) -> Result<Self, MllmError> {
        const TOKENS: &str = "tokenizer.ggml.tokens";
        let Some(Json::Array(list)) = header.metadata.get(TOKENS) else {
            return Err(header.error(TOKENS, "expected a list of texts"));
        };
        let tokens: Option<Vec<&str>> = list.iter().map(Json::as_str).collect();
        let tokens = tokens.ok_or_else(|| header.error(TOKENS, "expected a list of texts"))?;
        if tokens.len() > vocabulary {
            return Err(header.error(
                TOKENS,
                format!(
                    "{} tokens, but the embedding has {vocabulary} rows",
                    tokens.len()
                ),
            ));
        }
        if let Some((id, long)) = tokens
            .iter()
            .enumerate()
            .find(|(_, token)| token.len() > MAX_PIECE)
        {
            return Err(header.error(TOKENS, format!("token {id} has {} bytes", long.len())));
        }
        let kinds = match header.list("tokenizer.ggml.token_type", "a list of integers")? {
            Some(kinds) if kinds.len() == tokens.len() => kinds,
            Some(kinds) => {
                let problem = format!("{} types of {} tokens", kinds.len(), tokens.len());
                return Err(header.error("tokenizer.ggml.token_type", problem));
            }
            None => vec![piece::NORMAL; tokens.len()],
        };
        let mut ids = HashMap::new();
        for (id, token) in tokens.iter().enumerate() {
            // A text with two ids would have one of them when the tokenizer reads it back.
            if let Some(other) = ids.insert(token, id) {
                return Err(header.error(
                    TOKENS,
                    format!(
                        "'{}' occurs twice, as {other} and {id}",
                        token.escape_debug()
                    ),
                ));
            }
        }
        Ok(Self { tokens, kinds })
    }

    /// The special tokens that end a turn by their names: files may name another as the end of a
    /// text alone (as llama.cpp treats them).
    fn ends_of_turns(&self) -> impl Iterator<Item = i64> {
        let all = self.tokens.iter().zip(&self.kinds).enumerate();
        all.filter(|(_, (token, kind))| **kind == piece::CONTROL && TURN_ENDS.contains(*token))
            .map(|(id, _)| id as i64)
    }

    /// Every way to join two pieces to a third, by falling score; equal scores in the order of
    /// transformers.
    fn merges(&self, scores: &[f64]) -> Vec<[&'a str; 2]> {
        let ids: HashMap<&str, usize> = self
            .tokens
            .iter()
            .enumerate()
            .map(|(id, token)| (*token, id))
            .collect();
        let mut merges = Vec::new();
        for (id, token) in self
            .tokens
            .iter()
            .enumerate()
            .filter(|(id, _)| self.kinds[*id] == piece::NORMAL)
        {
            let halves = token
                .char_indices()
                .skip(1)
                .map(|(at, _)| token.split_at(at));
            let mut pairs: Vec<(usize, usize, [&str; 2])> = halves
                .filter_map(|(left, right)| {
                    Some((*ids.get(left)?, *ids.get(right)?, [left, right]))
                })
                .collect();
            // transformers sorts the pairs of a piece by their ids, and its sort by score is
            // stable.
            pairs.sort_unstable_by_key(|(left, right, _)| (*left, *right));
            merges.extend(pairs.into_iter().map(|(_, _, pair)| (scores[id], pair)));
        }
        let lengths = |[left, right]: [&str; 2]| (left.chars().count(), right.chars().count());
        merges.sort_by(|(score, pair), (other, rival)| {
            other
                .total_cmp(score)
                .then_with(|| lengths(*rival).cmp(&lengths(*pair)))
        });
        merges.into_iter().map(|(_, pair)| pair).collect()
    }

    /// The merges that a file names, in its order.
    fn listed_merges(&self, header: &Header) -> Result<Vec<[String; 2]>, MllmError> {
        const MERGES: &str = "tokenizer.ggml.merges";
        let known: HashSet<&str> = self.tokens.iter().copied().collect();
        let stored: Vec<String> = header
            .list(MERGES, "a list of texts")?
            .ok_or_else(|| header.missing(MERGES))?;
        let pair = |merge: &String| {
            let (left, right) = merge.split_once(' ')?;
            let is_token = |part: &str| known.contains(part);
            let makes_token = is_token(left) && is_token(right);
            (makes_token && is_token(&format!("{left}{right}")))
                .then(|| [left.to_owned(), right.to_owned()])
        };
        let named = |merge: &String| {
            pair(merge).ok_or_else(|| {
                let problem = format!("'{}' joins no two tokens to a third", merge.escape_debug());
                header.error(MERGES, problem)
            })
        };
        stored.iter().map(named).collect()
    }

    /// The tokens that are matched before a text is split.
    pub(super) fn added(&self) -> Vec<Json> {
        let all = self.tokens.iter().zip(&self.kinds).enumerate();
        all.filter(|(_, (_, kind))| {
            [piece::UNKNOWN, piece::CONTROL, piece::USER_DEFINED].contains(*kind)
        })
        .map(|(id, (token, kind))| {
            added_token(
                id as u64,
                token,
                *kind != piece::USER_DEFINED || *token == IMAGE,
            )
        })
        .collect()
    }

    /// `tokenizer.json`.
    fn to_json(
        &self,
        merges: &Json,
        bos: Option<(i64, &str)>,
        unknown: Option<&str>,
        prefix: bool,
    ) -> Json {
        let all = || self.tokens.iter().enumerate();
        let vocabulary: serde_json::Map<String, Json> = all()
            .map(|(id, token)| ((*token).to_string(), json!(id)))
            .collect();
        let tokens = self.added();
        let space = json!({"type": "Replace", "pattern": {"String": " "}, "content": "\u{2581}"});
        // The same parts, in the same order, as in `tokenizer.json` of transformers' Llama.
        let normalizers = if prefix {
            vec![json!({"type": "Prepend", "prepend": "\u{2581}"}), space]
        } else {
            vec![space]
        };
        let mut decoders = vec![
            json!({"type": "Replace", "pattern": {"String": "\u{2581}"}, "content": " "}),
            json!({"type": "ByteFallback"}),
            json!({"type": "Fuse"}),
        ];
        if prefix {
            decoders.push(json!({"type": "Strip", "content": " ", "start": 1, "stop": 0}));
        }
        json!({
            "version": "1.0",
            "added_tokens": tokens,
            "normalizer": {"type": "Sequence", "normalizers": normalizers},
            "pre_tokenizer": null,
            "post_processor": bos.map(|(id, token)| beginning(id, token)),
            "decoder": {"type": "Sequence", "decoders": decoders},
            "model": {
                "type": "BPE", "dropout": null, "unk_token": unknown, "continuing_subword_prefix": null,
                "end_of_word_suffix": null, "fuse_unk": true, "byte_fallback": true, "ignore_merges": false,
                "vocab": vocabulary, "merges": merges,
            },
        })
    }
}

/// The post-processor that puts a token before every text.
pub(super) fn beginning(id: i64, token: &str) -> Json {
    let text = |part: &str, kind: u8| json!({"Sequence": {"id": part, "type_id": kind}});
    let special = |kind: u8| json!({"SpecialToken": {"id": token, "type_id": kind}});
    json!({
        "type": "TemplateProcessing",
        "single": [special(0), text("A", 0)],
        "pair": [special(0), text("A", 0), special(1), text("B", 1)],
        "special_tokens": {token: {"id": token, "ids": [id], "tokens": [token]}},
    })
}
