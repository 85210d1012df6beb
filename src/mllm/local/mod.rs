//! Models that are computed in this process: a folder as Hugging Face writes it, opened as it is and run on the CPU.

mod architecture;
mod generate;
mod sequence;
mod session;
mod vlm;

#[cfg(test)]
mod determinism_tests;
#[cfg(test)]
pub(crate) mod test_reference;

use std::collections::VecDeque;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

pub use architecture::Architecture;
pub(crate) use sequence::Sequence;
use sequence::SequencePrefix;
use session::LocalConversation;
pub(crate) use vlm::{Chat, ChatFormat, ModelFacts, PlacedRows, VisionLanguageModel};

use super::checkpoint::{Section, read_json};
use super::decoder::Logits;
use super::text::{ChatTokenizer, GrammarEngine};
use super::{Conversation, Mllm, MllmError, ModelDescription, Opening};

/// System prompts whose keys and values are kept; a run uses one or two.
const KEPT_PREFIXES: usize = 8;
/// Fewest tokens that are worth keeping: a lone beginning-of-sequence token is not.
const LEAST_PREFIX: usize = 2;

/// A vision-language model with all that stands around it: prompt format, tokenizer, grammars.
#[derive(Debug)]
pub struct LocalModel {
    name: String,
    model: Box<dyn VisionLanguageModel>,
    format: Box<dyn ChatFormat>,
    tokenizer: ChatTokenizer,
    grammars: GrammarEngine,
    end_tokens: Vec<u32>,
    prefixes: Mutex<VecDeque<Arc<CallPrefix>>>,
}

/// What all conversations of one system prompt begin with, computed once.
#[derive(Debug)]
struct CallPrefix {
    system: String,
    image: bool,
    sequence: SequencePrefix,
}

impl LocalModel {
    /// Opens a model folder: `config.json`, safetensors (whole or sharded), `tokenizer.json`, for the LLaVA families
    /// `preprocessor_config.json` and a chat template, and, if there, `tokenizer_config.json` and
    /// `generation_config.json`. The configuration says which [`Architecture`] it is. `name` is what results call it.
    ///
    /// # Errors
    /// When a file is missing or broken, or the files contradict each other; the error names file, key or tensor.
    pub fn open(name: &str, folder: &Path) -> Result<Self, MllmError> {
        Self::open_with_tokenizer(name, folder, folder)
    }

    /// Opens a model folder without a tokenizer (`CogVLM`'s repositories have none) with that of another folder.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn open_with_tokenizer(name: &str, folder: &Path, tokenizer: &Path) -> Result<Self, MllmError> {
        for folder in [folder, tokenizer] {
            if !folder.is_dir() {
                return Err(MllmError::MissingFile {
                    folder: folder.to_path_buf(),
                    file: "such folder, and so no config.json".into(),
                });
            }
        }
        let architecture = Architecture::detect(folder)?;
        let model = architecture.open(folder)?;
        let vocabulary = model.facts().vocabulary;
        if architecture == Architecture::CogVlm && !tokenizer.join("tokenizer.json").is_file() {
            return Err(MllmError::MissingFile {
                folder: tokenizer.to_path_buf(),
                file:
                    "tokenizer.json (CogVLM's repositories have none; that of a LLaMA fits: copy it here, or name it \
                       under tokenizer in the model's description)"
                        .into(),
            });
        }
        let tokenizer = ChatTokenizer::open(tokenizer, vocabulary)?;
        let format = model.chat_format(folder, &tokenizer)?;
        let end_tokens = end_tokens(folder, &tokenizer, vocabulary)?;
        Ok(Self {
            name: name.to_string(),
            grammars: GrammarEngine::new(&tokenizer, &end_tokens)?,
            model,
            format,
            tokenizer,
            end_tokens,
            prefixes: Mutex::new(VecDeque::new()),
        })
    }

    /// Token ids of a chat.
    fn prompt_ids(&self, chat: &Chat<'_>) -> Result<Vec<u32>, MllmError> {
        self.format.ids(&self.tokenizer, chat)
    }

    /// What stands before the image and the first prompt. It is always computed on its own, so that it is the same
    /// whichever conversation comes first.
    fn call_prefix(&self, system: &str, image_tokens: Option<usize>) -> Result<Arc<CallPrefix>, MllmError> {
        let image = image_tokens.is_some();
        let same = |prefix: &&Arc<CallPrefix>| prefix.image == image && prefix.system == system;
        let known = {
            let prefixes = self.prefixes.lock().unwrap_or_else(PoisonError::into_inner);
            prefixes.iter().find(same).map(Arc::clone)
        };
        if let Some(prefix) = known {
            return Ok(prefix);
        }
        // Two prompts that share no character agree in what does not depend on the prompt.
        let ids = self.prompt_ids(&Chat { system, image_tokens, turns: &[], prompt: "0" })?;
        let other = self.prompt_ids(&Chat { system, image_tokens, turns: &[], prompt: "z" })?;
        let image_token = self.model.facts().image_token;
        let agree = ids.iter().zip(&other).take_while(|(a, b)| a == b && **a != image_token).count();
        let len = if agree < LEAST_PREFIX { 0 } else { agree };
        let context = self.model.context(image_tokens.unwrap_or(0));
        if len > context {
            return Err(MllmError::PromptTooLong { tokens: ids.len(), context });
        }
        let mut sequence = Sequence::new(&*self.model);
        sequence.append(&*self.model, &ids[..len], None, Logits::None)?;
        let prefix = Arc::new(CallPrefix { system: system.to_string(), image, sequence: sequence.to_prefix()? });
        let mut prefixes = self.prefixes.lock().unwrap_or_else(PoisonError::into_inner);
        if !prefixes.iter().any(|known| same(&known)) {
            if prefixes.len() >= KEPT_PREFIXES {
                prefixes.pop_front();
            }
            prefixes.push_back(Arc::clone(&prefix));
        }
        Ok(prefix)
    }
}

impl Mllm for LocalModel {
    fn name(&self) -> &str {
        &self.name
    }

    fn describe(&self) -> ModelDescription {
        let facts = self.model.facts();
        ModelDescription {
            name: self.name.clone(),
            architecture: facts.architecture.into(),
            parameters: facts.parameters,
            dtype: "f32".into(),
            image_size: Some(facts.image_size as u32),
            image_tokens: facts.most_image_tokens,
            vocabulary: facts.vocabulary,
            context: facts.positions,
            weights_blake3: facts.blake3.clone(),
            server: None,
        }
    }

    fn converse<'a>(&'a self, opening: &Opening, seed: u64) -> Result<Box<dyn Conversation + 'a>, MllmError> {
        Ok(Box::new(LocalConversation::open(self, opening, seed)?))
    }
}

/// The tokens that end an answer: of `generation_config.json`, else of the decoder's configuration, else of the tokenizer.
fn end_tokens(folder: &Path, tokenizer: &ChatTokenizer, vocabulary: usize) -> Result<Vec<u32>, MllmError> {
    const KEY: &str = "eos_token_id";
    for file in ["generation_config.json", "config.json"] {
        let path = folder.join(file);
        if !path.is_file() {
            continue;
        }
        let value = read_json(&path)?;
        let root = Section::root(&path, &value)?;
        let nested = root.section("text_config", "text_config.")?;
        for section in [Some(root), nested].into_iter().flatten() {
            let ids = section.token_ids(KEY)?;
            if let Some(id) = ids.iter().find(|id| **id as usize >= vocabulary) {
                return Err(section.error(KEY, format!("{id} lies outside the vocabulary of {vocabulary}")));
            }
            if !ids.is_empty() {
                return Ok(ids);
            }
        }
    }
    let named = tokenizer.special().get("eos_token").and_then(|token| tokenizer.id(token));
    named.map(|id| vec![id]).ok_or_else(|| MllmError::Tokenizer {
        path: tokenizer.path().to_path_buf(),
        problem: "no end-of-sequence token: neither eos_token_id in the configurations nor eos_token".into(),
    })
}
