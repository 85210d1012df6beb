//! A SentencePiece tokenizer in GGUF metadata, converted to an equivalent `tokenizer.json`.
//!
//! GGUF has pieces with scores (`tokenizer.ggml.model = llama`): the neighbors whose joint piece has the highest score are
//! joined first. A byte-pair model with its merges in the order of the scores does the same.

use std::collections::HashMap;

use serde_json::{Value as Json, json};

use super::header::Header;
use crate::mllm::MllmError;

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
/// Longest piece, bytes. SentencePiece's pieces have 16 characters; a longer one means a broken file.
const MAX_PIECE: usize = 1024;

/// A tokenizer as Hugging Face's files.
pub(crate) struct TokenizerFiles {
    /// `tokenizer.json`.
    pub tokenizer: Json,
    /// `tokenizer_config.json`.
    pub config: Json,
    /// The token that ends an answer.
    pub eos: Option<i64>,
}

/// The id of the image's placeholder in a `tokenizer.json`. A file without one gets it after all other tokens.
pub(crate) fn image_token(tokenizer: &mut Json) -> Result<u64, &'static str> {
    let tokens = tokenizer["added_tokens"].as_array().into_iter().flatten();
    if let Some(known) = tokens.clone().find(|token| token["content"] == IMAGE) {
        return known["id"].as_u64().ok_or("the token <image> has no id");
    }
    let vocabulary = tokenizer["model"]["vocab"].as_object().ok_or("it has no vocabulary")?;
    let ids = vocabulary.values().chain(tokens.map(|token| &token["id"])).filter_map(Json::as_u64);
    let next = ids.max().map_or(0, |last| last + 1);
    match tokenizer["added_tokens"].as_array_mut() {
        Some(tokens) => tokens.push(added_token(next, IMAGE, true)),
        None => tokenizer["added_tokens"] = json!([added_token(next, IMAGE, true)]),
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
    const MODEL: &str = "tokenizer.ggml.model";
    match header.text(MODEL)? {
        Some("llama") => {}
        Some(other) => {
            return Err(header.error(
                MODEL,
                format!("'{other}' is not supported in GGUF (llama, SentencePiece, is); put the model's tokenizer.json beside it"),
            ));
        }
        None => {
            return Err(header.error(MODEL, "the file has no tokenizer; put the model's tokenizer.json beside it"));
        }
    }
    let pieces = Pieces::read(header, vocabulary)?;
    let special = |role: &str| -> Result<Option<(i64, &str)>, MllmError> {
        let key = format!("tokenizer.ggml.{role}_token_id");
        let Some(id) = header.metadata.get(&key).and_then(Json::as_u64) else { return Ok(None) };
        let token = pieces.tokens.get(id as usize);
        let token =
            token.ok_or_else(|| header.error(&key, format!("{id} is none of {} tokens", pieces.tokens.len())))?;
        Ok(Some((id as i64, *token)))
    };
    let (bos, eos, unknown) = (special("bos")?, special("eos")?, special("unknown")?);
    let mut config = json!({});
    for (key, token) in [("bos_token", bos), ("eos_token", eos), ("unk_token", unknown)] {
        if let Some((_, token)) = token {
            config[key] = json!(token);
        }
    }
    let flag = |key: &str| header.flag(&format!("tokenizer.ggml.{key}"));
    let bos = if flag("add_bos_token")?.unwrap_or(true) { bos } else { None };
    let prefix = flag("add_space_prefix")?.unwrap_or(true);
    let unknown = unknown.map(|(_, token)| token);
    Ok(TokenizerFiles { tokenizer: pieces.to_json(bos, unknown, prefix), config, eos: eos.map(|(id, _)| id) })
}

/// The pieces of a vocabulary, by id.
struct Pieces<'a> {
    tokens: Vec<&'a str>,
    scores: Vec<f64>,
    kinds: Vec<i64>,
}

impl<'a> Pieces<'a> {
    fn read(header: &'a Header, vocabulary: usize) -> Result<Self, MllmError> {
        const TOKENS: &str = "tokenizer.ggml.tokens";
        let Some(Json::Array(list)) = header.metadata.get(TOKENS) else {
            return Err(header.error(TOKENS, "expected a list of texts"));
        };
        let tokens: Option<Vec<&str>> = list.iter().map(Json::as_str).collect();
        let tokens = tokens.ok_or_else(|| header.error(TOKENS, "expected a list of texts"))?;
        if tokens.len() > vocabulary {
            return Err(
                header.error(TOKENS, format!("{} tokens, but the embedding has {vocabulary} rows", tokens.len()))
            );
        }
        if let Some((id, long)) = tokens.iter().enumerate().find(|(_, token)| token.len() > MAX_PIECE) {
            return Err(header.error(TOKENS, format!("token {id} has {} bytes", long.len())));
        }
        let scores: Vec<f64> = header.list("tokenizer.ggml.scores", "a list of numbers")?.unwrap_or_default();
        if scores.len() != tokens.len() {
            return Err(header.error("tokenizer.ggml.scores", format!("expected {} scores", tokens.len())));
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
            if let Some(other) = ids.insert(token, id) {
                return Err(
                    header.error(TOKENS, format!("'{}' occurs twice, as {other} and {id}", token.escape_debug()))
                );
            }
        }
        Ok(Self { tokens, scores, kinds })
    }

    /// Every way to join two pieces to a third, by falling score; equal scores in the order of transformers.
    fn merges(&self) -> Vec<[&'a str; 2]> {
        let ids: HashMap<&str, usize> = self.tokens.iter().enumerate().map(|(id, token)| (*token, id)).collect();
        let mut merges = Vec::new();
        for (id, token) in self.tokens.iter().enumerate().filter(|(id, _)| self.kinds[*id] == piece::NORMAL) {
            let halves = token.char_indices().skip(1).map(|(at, _)| token.split_at(at));
            let mut pairs: Vec<(usize, usize, [&str; 2])> =
                halves.filter_map(|(left, right)| Some((*ids.get(left)?, *ids.get(right)?, [left, right]))).collect();
            pairs.sort_unstable_by_key(|(left, right, _)| (*left, *right));
            merges.extend(pairs.into_iter().map(|(_, _, pair)| (self.scores[id], pair)));
        }
        let lengths = |[left, right]: [&str; 2]| (left.chars().count(), right.chars().count());
        merges.sort_by(|(score, pair), (other, rival)| {
            other.total_cmp(score).then_with(|| lengths(*rival).cmp(&lengths(*pair)))
        });
        merges.into_iter().map(|(_, pair)| pair).collect()
    }

    /// `tokenizer.json`.
    fn to_json(&self, bos: Option<(i64, &str)>, unknown: Option<&str>, prefix: bool) -> Json {
        let all = || self.tokens.iter().enumerate();
        let vocabulary: serde_json::Map<String, Json> =
            all().map(|(id, token)| ((*token).to_string(), json!(id))).collect();
        let tokens: Vec<Json> = all()
            .filter(|(id, _)| [piece::UNKNOWN, piece::CONTROL, piece::USER_DEFINED].contains(&self.kinds[*id]))
            .map(|(id, token)| added_token(id as u64, token, self.kinds[id] != piece::USER_DEFINED || *token == IMAGE))
            .collect();
        let space = json!({"type": "Replace", "pattern": {"String": " "}, "content": "\u{2581}"});
        let normalizers =
            if prefix { vec![json!({"type": "Prepend", "prepend": "\u{2581}"}), space] } else { vec![space] };
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
                "vocab": vocabulary, "merges": self.merges(),
            },
        })
    }
}

/// The post-processor that puts a token before every text.
fn beginning(id: i64, token: &str) -> Json {
    let text = |part: &str, kind: u8| json!({"Sequence": {"id": part, "type_id": kind}});
    let special = |kind: u8| json!({"SpecialToken": {"id": token, "type_id": kind}});
    json!({
        "type": "TemplateProcessing",
        "single": [special(0), text("A", 0)],
        "pair": [special(0), text("A", 0), special(1), text("B", 1)],
        "special_tokens": {token: {"id": token, "ids": [id], "tokens": [token]}},
    })
}
