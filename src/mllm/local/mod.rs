//! Models that are computed in this process: a folder as Hugging Face writes it, opened as it is and run on the CPU.

mod architecture;
mod check;
mod generate;
mod memory;
mod sequence;
mod session;
mod vlm;

#[cfg(test)]
mod caching_tests;
#[cfg(test)]
mod determinism_tests;
#[cfg(test)]
pub(crate) mod test_faults;
#[cfg(test)]
pub(crate) mod test_reference;

use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

pub use architecture::Architecture;
pub use check::ModelCheck;
pub use memory::{MemoryCheck, MemoryNeed};
pub(crate) use sequence::Sequence;
use sequence::SequencePrefix;
use session::LocalConversation;
pub(crate) use vlm::{Chat, ChatFormat, InputEmbeddings, ModelInfo, VisionLanguageModel};

use super::checkpoint::{Checkpoint, LoadReport, ModelFiles, ModelPlace, Section};
use super::decoder::Logits;
use super::gguf::{self, CreateFile};
use super::matrix::WeightFormat;
use super::text::{ChatTokenizer, GrammarEngine};
use super::{Conversation, Mllm, MllmError, ModelDescription, PromptPrefix};

/// System prompts whose keys and values are kept; a run uses one or two.
const KEPT_PREFIXES: usize = 8;
/// Fewest tokens that are worth keeping: a lone beginning-of-sequence token is not.
const MIN_PREFIX: usize = 2;

/// A vision-language model with all that stands around it: prompt format, tokenizer, grammars.
#[derive(Debug)]
pub struct LocalModel {
    name: String,
    model: Box<dyn VisionLanguageModel>,
    format: Box<dyn ChatFormat>,
    tokenizer: ChatTokenizer,
    grammars: GrammarEngine,
    end_tokens: Vec<u32>,
    load: LoadReport,
    prefixes: Mutex<VecDeque<Arc<CallPrefix>>>,
}

/// What all conversations of one system prompt begin with, computed once.
#[derive(Debug)]
struct CallPrefix {
    system: String,
    image: bool,
    sequence: SequencePrefix,
}

/// How a model is loaded.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Loading {
    /// In which storage weights are held; none for that of the files (f32 where these are safetensors).
    pub quantize: Option<WeightFormat>,
    /// The folder of its tokenizer, for models whose files hold none (`CogVLM`'s).
    pub tokenizer: Option<PathBuf>,
    /// What to do when there seems to be too little memory.
    pub memory: MemoryCheck,
    /// The family that the model must be of, and who says so; none for any.
    pub expected: Option<(Architecture, String)>,
}

impl Loading {
    /// Opens a model's small files and the headers of its weights, if it is of the expected family and there is memory.
    ///
    /// # Errors
    /// When a file is missing or broken, the family is another, or there is too little memory.
    pub(crate) fn checkpoint(&self, place: &ModelPlace) -> Result<Checkpoint, MllmError> {
        let checkpoint = Checkpoint::open(place, self.quantize)?;
        let architecture = self.architecture(&checkpoint.files)?;
        if self.memory == MemoryCheck::Refuse {
            let decoder = architecture.decoder(&checkpoint.files)?;
            memory::check(&checkpoint, &decoder, self.quantize)?;
        }
        Ok(checkpoint)
    }

    /// The family of a model.
    ///
    /// # Errors
    /// When its configuration does not say, or it is not the one that is expected.
    fn architecture(&self, files: &ModelFiles) -> Result<Architecture, MllmError> {
        let found = Architecture::of(files)?;
        match &self.expected {
            Some((expected, by)) if *expected != found => Err(MllmError::Config {
                path: files.path("config.json"),
                key: "model_type".into(),
                problem: format!(
                    "this is a {} model, the description of {by:?} says {}",
                    found.name(),
                    expected.name()
                ),
            }),
            _ => Ok(found),
        }
    }

    /// The files of a model's tokenizer.
    ///
    /// # Errors
    /// When there are none.
    fn tokenizer(&self, files: &ModelFiles, architecture: Architecture) -> Result<ModelFiles, MllmError> {
        let tokenizer = match &self.tokenizer {
            Some(folder) => ModelFiles::folder(folder)?,
            None => files.clone(),
        };
        if tokenizer.text("tokenizer.json")?.is_some() {
            return Ok(tokenizer);
        }
        Err(tokenizer.missing(match architecture {
            Architecture::Llava | Architecture::LlavaNext => "tokenizer.json",
            Architecture::CogVlm => {
                "tokenizer.json (CogVLM's repositories have none; that of a LLaMA fits: copy it here, or name it under \
                 tokenizer in the model's description)"
            }
        }))
    }
}

impl LocalModel {
    /// Opens a model folder: `config.json`, safetensors (whole or sharded), `tokenizer.json`, for the LLaVA families
    /// `preprocessor_config.json` and a chat template, and, if there, `tokenizer_config.json` and
    /// `generation_config.json`; or GGUF files. The configuration says which [`Architecture`] it is. `name` is what results
    /// call it.
    ///
    /// # Errors
    /// When a file is missing or broken, or the files contradict each other; the error names file, key or tensor.
    pub fn open(name: &str, folder: &Path) -> Result<Self, MllmError> {
        Self::load(name, &ModelPlace::Folder(folder.to_path_buf()), &Loading::default())
    }

    /// Opens a model in a given way.
    ///
    /// # Errors
    /// As [`Self::open`], and when there is too little memory.
    pub fn load(name: &str, place: &ModelPlace, loading: &Loading) -> Result<Self, MllmError> {
        let mut checkpoint = loading.checkpoint(place)?;
        let architecture = loading.architecture(&checkpoint.files)?;
        // Missed before the weights are read, which takes minutes.
        let tokenizer = loading.tokenizer(&checkpoint.files, architecture)?;
        checkpoint.weights.hash()?;
        let model = architecture.open(&mut checkpoint)?;
        let Checkpoint { files, weights } = checkpoint;
        let vocabulary = model.info().vocabulary;
        let tokenizer = ChatTokenizer::open(&tokenizer, vocabulary, model.info().image_token)?;
        let format = model.chat_format(&files, &tokenizer)?;
        let end_tokens = end_tokens(&files, &tokenizer, vocabulary)?;
        Ok(Self {
            name: name.to_string(),
            grammars: GrammarEngine::new(&tokenizer, &end_tokens)?,
            model,
            format,
            tokenizer,
            end_tokens,
            load: weights.report().clone(),
            prefixes: Mutex::new(VecDeque::new()),
        })
    }

    /// Writes a model as GGUF; see [`GgufPart`](crate::mllm::GgufPart) for the files. `progress` is told the bytes that are
    /// written and their sum.
    ///
    /// # Errors
    /// When the model is broken, or a file cannot be written.
    pub fn export(
        name: &str,
        place: &ModelPlace,
        loading: &Loading,
        create: &mut CreateFile<'_>,
        progress: &mut dyn FnMut(u64, u64),
    ) -> Result<LoadReport, MllmError> {
        let checkpoint = Checkpoint::open(place, loading.quantize)?;
        let architecture = loading.architecture(&checkpoint.files)?;
        let tokenizer = loading.tokenizer(&checkpoint.files, architecture)?;
        gguf::export(checkpoint, &tokenizer, name, create, progress)
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
        let image_token = self.model.info().image_token;
        let agree = ids.iter().zip(&other).take_while(|(a, b)| a == b && **a != image_token).count();
        let len = if agree < MIN_PREFIX { 0 } else { agree };
        let context = self.model.context(image_tokens.unwrap_or(0));
        if len > context {
            return Err(MllmError::PromptTooLong { tokens: ids.len(), context });
        }
        let mut sequence = Sequence::new(&*self.model);
        sequence.append(&*self.model, &ids[..len], None, Logits::None)?;
        let prefix = Arc::new(CallPrefix { system: system.to_string(), image, sequence: sequence.to_prefix() });
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
            image_size: Some(info.image_size as u32),
            image_tokens: info.max_image_tokens,
            vocabulary: info.vocabulary,
            context: info.positions,
            weights_blake3: info.blake3.clone(),
            load: self.load.clone(),
            server: None,
        }
    }

    fn converse<'a>(&'a self, prefix: &PromptPrefix, seed: u64) -> Result<Box<dyn Conversation + 'a>, MllmError> {
        Ok(Box::new(LocalConversation::open(self, prefix, seed)?))
    }

    fn count_tokens(&self, text: &str) -> Option<usize> {
        self.tokenizer.encode_text(text).ok().map(|ids| ids.len())
    }
}

/// The tokens that end an answer: of `generation_config.json`, else of the decoder's configuration, else of the tokenizer.
fn end_tokens(files: &ModelFiles, tokenizer: &ChatTokenizer, vocabulary: usize) -> Result<Vec<u32>, MllmError> {
    const KEY: &str = "eos_token_id";
    for file in ["generation_config.json", "config.json"] {
        let Some(value) = files.json(file)? else { continue };
        let path = files.path(file);
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
