//! Models that run in this process on the CPU.

mod ahead;
mod answer_time;
mod check;
mod draft;
mod draft_model;
mod generate;
mod grouped;
mod images;
mod likeliest;
mod loading;
mod memory;
mod outline;
mod picture;
mod sequence;
mod session;
mod thinking;
mod work;

#[cfg(test)]
mod caching_tests;
#[cfg(test)]
mod determinism_tests;
#[cfg(test)]
mod likeliest_tests;
#[cfg(test)]
mod memory_tests;
#[cfg(test)]
mod odd_folder_tests;
#[cfg(test)]
mod outside_tests;
#[cfg(test)]
mod several_tests;
#[cfg(test)]
mod speculation_tests;
#[cfg(test)]
mod state_tests;
#[cfg(test)]
pub(crate) mod test_faults;
#[cfg(test)]
pub(crate) mod test_prompts;
#[cfg(test)]
pub(crate) mod test_reference;
#[cfg(test)]
mod text_only_tests;

pub use check::ModelCheck;
pub use loading::Loading;
pub use memory::{MemoryCheck, MemoryNeed};
pub use outline::{FormatOutline, ModelOutline};
pub(crate) use picture::PictureNeed;
pub(crate) use sequence::Sequence;
pub use work::ModelWork;

use super::checkpoint::{ConfigObject, LoadReport, ModelFiles, OneOrMany};
use super::decoder::Logits;
use super::family::{Chat, ChatFormat, ChatImage, VisionLanguageModel};
use super::source::{Checkpoint, ModelPlace};
use super::text::{ChatTokenizer, GrammarEngine};
use super::{AnswerTime, Conversation, Mllm, MllmError, ModelDescription, PromptPrefix};
use answer_time::AnswerWork;
use draft_model::DraftModel;
use session::LocalConversation;
use std::collections::VecDeque;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use thinking::Thinking;

/// Number of system prompts whose keys and values are cached; a run uses one or two.
const KEPT_PREFIXES: usize = 8;
/// Shortest prefix that is cached, tokens: a lone beginning-of-sequence token is not worth it.
const MIN_PREFIX: usize = 2;

/// A model, with or without a vision tower, with its prompt format, tokenizer and grammars.
#[derive(Debug)]
pub struct LocalModel {
    name: String,
    model: Box<dyn VisionLanguageModel>,
    format: Box<dyn ChatFormat>,
    tokenizer: ChatTokenizer,
    grammars: GrammarEngine,
    end_tokens: Vec<u32>,
    load: LoadReport,
    /// Longest chat that the user allows, tokens; none for that of the model.
    limit: Option<usize>,
    draft_model: Option<Arc<DraftModel>>,
    /// The work of an answer; none for a small model.
    work: Option<AnswerWork>,
    /// How it thinks before it answers; none if it answers at once.
    thinking: Option<Thinking>,
    prefixes: Mutex<VecDeque<Arc<CallPrefix>>>,
}

/// The tokens that all conversations of one system prompt begin with, computed once.
#[derive(Debug)]
struct CallPrefix {
    system: String,
    image: Option<ChatImage>,
    sequence: Sequence,
}

impl LocalModel {
    /// Opens a model folder under the name `name` in results. The folder holds GGUF files, or:
    /// - `config.json`, which names the family,
    /// - safetensors, in one file or in shards,
    /// - `tokenizer.json`,
    /// - `preprocessor_config.json` and a chat template, where the family needs them,
    /// - `tokenizer_config.json` and `generation_config.json` if they exist.
    pub fn open(name: &str, folder: &Path) -> Result<Self, MllmError> {
        Self::load(
            name,
            &ModelPlace::Folder(folder.to_path_buf()),
            &Loading::default(),
        )
    }

    /// Opens a model with settings.
    pub fn load(name: &str, place: &ModelPlace, loading: &Loading) -> Result<Self, MllmError> {
        let mut checkpoint = loading.checkpoint(place)?;
        // Before the weights are read, which takes minutes: a missing tokenizer is found at once.
        let tokenizer = loading.tokenizer(&checkpoint.files, checkpoint.family)?;
        checkpoint.weights.hash()?;
        let work = AnswerWork::from_checkpoint(&checkpoint, loading.image);
        let mut model = checkpoint.open_model()?;
        model.set_images(loading.image)?;
        let Checkpoint { files, weights, .. } = checkpoint;
        let vocabulary = model.info().vocabulary;
        let tokenizer = ChatTokenizer::open(&tokenizer, vocabulary, model.info().image_token)?;
        let mut format = model.chat_format(&files, &tokenizer)?;
        let thinking = loading
            .thinking
            .map(|limit| Thinking::open(limit, &tokenizer))
            .transpose()?;
        if thinking.is_some() {
            format.let_think()?;
        }
        let end_tokens = end_tokens(&files, &tokenizer, vocabulary)?;
        Ok(Self {
            name: name.to_string(),
            grammars: GrammarEngine::new(&tokenizer, &end_tokens)?,
            model,
            format,
            tokenizer,
            end_tokens,
            load: weights.report().clone(),
            limit: loading.context,
            draft_model: None,
            work,
            thinking,
            prefixes: Mutex::new(VecDeque::new()),
        })
    }

    /// Lets another model draft answers, whose vocabulary must be the same. Answers stay as they
    /// are.
    pub(crate) fn with_draft_model(
        mut self,
        place: &ModelPlace,
        loading: &Loading,
    ) -> Result<Self, MllmError> {
        self.draft_model = Some(Arc::new(DraftModel::open(place, loading, &self.tokenizer)?));
        self.load
            .notes
            .push(format!("answers are drafted by {}", place.path().display()));
        Ok(self)
    }

    #[cfg(test)]
    pub(crate) fn model(&self) -> &dyn VisionLanguageModel {
        &*self.model
    }

    /// Longest chat, tokens, whose images become `image_tokens` tokens.
    fn context(&self, image_tokens: usize) -> usize {
        self.limited(self.model.context(image_tokens))
    }

    fn limited(&self, context: usize) -> usize {
        self.limit.map_or(context, |limit| limit.min(context))
    }

    fn prompt_ids(&self, chat: &Chat<'_>) -> Result<Vec<u32>, MllmError> {
        self.format.ids(&self.tokenizer, chat)
    }

    /// The tokens before the image of a prompt prefix and the first prompt. They are always computed in a pass of
    /// their own, so that their keys and values do not depend on the first conversation.
    fn call_prefix(
        &self,
        system: &str,
        image: Option<ChatImage>,
    ) -> Result<Arc<CallPrefix>, MllmError> {
        let same = |prefix: &&Arc<CallPrefix>| prefix.image == image && prefix.system == system;
        let known = {
            let prefixes = self.prefixes.lock().unwrap_or_else(PoisonError::into_inner);
            prefixes.iter().find(same).map(Arc::clone)
        };
        if let Some(prefix) = known {
            return Ok(prefix);
        }
        // Prompts without a common character share the tokens that do not depend on the prompt.
        let with = |prompt| {
            self.prompt_ids(&Chat {
                system,
                images: image.as_slice(),
                turns: &[],
                prompt,
            })
        };
        let (ids, other) = (with("0")?, with("z")?);
        let image_token = self.model.info().image_token;
        let agree = ids
            .iter()
            .zip(&other)
            .take_while(|(a, b)| a == b && **a != image_token)
            .count();
        let len = if agree < MIN_PREFIX { 0 } else { agree };
        let context = self.context(image.map_or(0, |image| image.layout.tokens));
        if len > context {
            return Err(MllmError::PromptTooLong {
                tokens: ids.len(),
                context,
            });
        }
        let mut sequence = Sequence::new(&*self.model);
        sequence.append(&*self.model, &ids[..len], None, Logits::None)?;
        sequence.mark();
        let prefix = Arc::new(CallPrefix {
            system: system.to_string(),
            image,
            sequence,
        });
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
        let info = self.model.info();
        ModelDescription {
            name: self.name.clone(),
            architecture: info.architecture.into(),
            parameters: info.parameters,
            dtype: "f32".into(),
            image_size: info.image_size.map(|side| side as u32),
            image_tokens: info.max_image_tokens,
            vocabulary: info.vocabulary,
            context: self.limited(info.positions),
            weights_blake3: info.blake3.clone(),
            load: self.load.clone(),
            server: None,
        }
    }

    fn answer_time(&self, text: usize, new: usize) -> Option<AnswerTime> {
        self.time_answer(text, new)
    }

    fn converse<'a>(
        &'a self,
        prefix: &PromptPrefix,
        seed: u64,
    ) -> Result<Box<dyn Conversation + 'a>, MllmError> {
        Ok(Box::new(LocalConversation::open(self, prefix, seed)?))
    }

    fn count_tokens(&self, text: &str) -> Option<usize> {
        self.tokenizer.encode_text(text).ok().map(|ids| ids.len())
    }
}

/// The tokens that end an answer: those of `generation_config.json`, else of `config.json`, else of
/// the tokenizer.
pub(crate) fn end_tokens(
    files: &ModelFiles,
    tokenizer: &ChatTokenizer,
    vocabulary: usize,
) -> Result<Vec<u32>, MllmError> {
    // transformers' order: the first file that names any decides.
    for file in ["generation_config.json", "config.json"] {
        let Some(value) = files.json(file)? else {
            continue;
        };
        let path = files.path(file);
        let root = ConfigObject::root(&path, &value)?;
        let text = root.child("text_config")?;
        for object in [Some(root), text].into_iter().flatten() {
            let ids: Option<OneOrMany<u32>> = object.value("eos_token_id")?;
            let ids = ids.as_ref().map_or(&[][..], OneOrMany::as_slice);
            if let Some(id) = ids.iter().find(|id| **id as usize >= vocabulary) {
                return Err(object.error(
                    "eos_token_id",
                    format!("{id} lies outside the vocabulary of {vocabulary}"),
                ));
            }
            if !ids.is_empty() {
                return Ok(ids.to_vec());
            }
        }
    }
    let named = tokenizer
        .special()
        .get("eos_token")
        .and_then(|token| tokenizer.id(token));
    named
        .map(|id| vec![id])
        .ok_or_else(|| MllmError::Tokenizer {
            path: tokenizer.path().to_path_buf(),
            problem:
                "no end-of-sequence token: neither eos_token_id in the configurations nor eos_token"
                    .into(),
        })
}
