//! LLaVA: a Hugging Face `LlavaForConditionalGeneration` folder, opened as it is and run on the CPU.

mod generate;
mod model;
mod session;

#[cfg(test)]
mod determinism_tests;
#[cfg(test)]
mod reference_tests;

use std::collections::VecDeque;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};

use model::{LlavaModel, SequencePrefix};
use session::LlavaConversation;

use super::checkpoint::{Section, read_json};
use super::decoder::Logits;
use super::text::{ChatTemplate, ChatTokenizer, GrammarEngine};
use super::vision::ClipImageProcessor;
use super::{Conversation, Mllm, MllmError, ModelDescription, Opening, Turn};

/// System prompts whose keys and values are kept; a run uses one or two.
const KEPT_PREFIXES: usize = 8;

/// A LLaVA model with all that stands around it: preprocessor, chat template, tokenizer, grammars.
#[derive(Debug)]
pub struct Llava {
    name: String,
    model: LlavaModel,
    processor: ClipImageProcessor,
    tokenizer: ChatTokenizer,
    template: ChatTemplate,
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

impl Llava {
    /// Opens a model folder: `config.json`, safetensors (whole or sharded), `tokenizer.json`, `preprocessor_config.json`, a
    /// chat template, and, if there, `tokenizer_config.json` and `generation_config.json`. `name` is what results call it.
    ///
    /// # Errors
    /// When a file is missing or broken, or the files contradict each other; the error names file, key or tensor.
    pub fn open(name: &str, folder: &Path) -> Result<Self, MllmError> {
        if !folder.is_dir() {
            return Err(MllmError::MissingFile {
                folder: folder.to_path_buf(),
                file: "such folder, and so no config.json".into(),
            });
        }
        let model = LlavaModel::open(folder)?;
        let config = model.config();
        let processor = ClipImageProcessor::open(folder)?;
        processor.check_side(config.vision.image_size)?;
        let tokenizer = ChatTokenizer::open(folder, config.text.vocabulary)?;
        let image_token = image_token(&tokenizer, config.image_token)?;
        let template = ChatTemplate::open(folder, tokenizer.special(), &image_token)?;
        let end_tokens = end_tokens(folder, &tokenizer, config.text.vocabulary)?;
        Ok(Self {
            name: name.to_string(),
            grammars: GrammarEngine::new(&tokenizer, &end_tokens)?,
            model,
            processor,
            tokenizer,
            template,
            end_tokens,
            prefixes: Mutex::new(VecDeque::new()),
        })
    }

    /// Token ids of a chat that ends with `prompt`, each image as its image tokens.
    fn prompt_ids(&self, system: &str, image: bool, turns: &[Turn], prompt: &str) -> Result<Vec<u32>, MllmError> {
        let rendered = self.template.render(system, image, turns, prompt)?;
        let config = self.model.config();
        let mut found = 0;
        let mut ids = Vec::new();
        for id in self.tokenizer.encode_chat(&rendered)? {
            if id == config.image_token {
                found += 1;
                ids.extend(std::iter::repeat_n(id, config.image_tokens()));
            } else {
                ids.push(id);
            }
        }
        let expected = usize::from(image);
        if found == expected { Ok(ids) } else { Err(MllmError::ImagePlaceholder { expected, found }) }
    }

    /// What stands before the image and the first prompt. It is always computed on its own, so that it is the same
    /// whichever conversation comes first.
    fn call_prefix(&self, system: &str, image: bool) -> Result<Arc<CallPrefix>, MllmError> {
        let same = |prefix: &&Arc<CallPrefix>| prefix.image == image && prefix.system == system;
        let known = {
            let prefixes = self.prefixes.lock().unwrap_or_else(PoisonError::into_inner);
            prefixes.iter().find(same).map(Arc::clone)
        };
        if let Some(prefix) = known {
            return Ok(prefix);
        }
        // Two prompts that share no character agree in what does not depend on the prompt.
        let ids = self.prompt_ids(system, image, &[], "0")?;
        let other = self.prompt_ids(system, image, &[], "z")?;
        let image_token = self.model.config().image_token;
        let len = ids.iter().zip(&other).take_while(|(a, b)| a == b && **a != image_token).count();
        let mut sequence = self.model.new_sequence();
        if len > self.model.config().text.context {
            return Err(MllmError::PromptTooLong { tokens: ids.len(), context: self.model.config().text.context });
        }
        self.model.append(&mut sequence, &ids[..len], None, Logits::None)?;
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

impl Mllm for Llava {
    fn name(&self) -> &str {
        &self.name
    }

    fn describe(&self) -> ModelDescription {
        let config = self.model.config();
        ModelDescription {
            name: self.name.clone(),
            architecture: "llava".into(),
            parameters: self.model.parameters(),
            dtype: "f32".into(),
            image_size: Some(config.vision.image_size as u32),
            image_tokens: config.image_tokens(),
            vocabulary: config.text.vocabulary,
            context: config.text.context,
            weights_blake3: self.model.blake3().to_string(),
        }
    }

    fn converse<'a>(&'a self, opening: &Opening, seed: u64) -> Result<Box<dyn Conversation + 'a>, MllmError> {
        Ok(Box::new(LlavaConversation::open(self, opening, seed)?))
    }
}

/// The placeholder of an image, checked to be one token.
fn image_token(tokenizer: &ChatTokenizer, id: u32) -> Result<String, MllmError> {
    let broken = |problem: String| MllmError::Tokenizer { path: tokenizer.path().to_path_buf(), problem };
    let token = tokenizer
        .token(id)
        .ok_or_else(|| broken(format!("the image token, id {id} (image_token_index), is missing")))?;
    let ids = tokenizer.encode_chat(&token)?;
    if ids.iter().filter(|found| **found == id).count() == 1 {
        Ok(token)
    } else {
        Err(broken(format!("the image token {token:?}, id {id}, is split into the ids {ids:?}: it is no added token")))
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
