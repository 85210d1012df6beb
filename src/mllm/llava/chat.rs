//! Prompts by the chat template of a model folder.

use crate::mllm::MllmError;
use crate::mllm::checkpoint::ModelFiles;
use crate::mllm::family::{Chat, ChatFormat};
use crate::mllm::text::{ChatTemplate, ChatTokenizer};

/// A chat template. Its one placeholder for the image is repeated for each image token.
#[derive(Debug)]
pub(crate) struct TemplateFormat {
    template: ChatTemplate,
    image_token: u32,
}

impl TemplateFormat {
    /// Opens the template of a model whose placeholder has this id.
    pub(crate) fn open(files: &ModelFiles, tokenizer: &ChatTokenizer, image_token: u32) -> Result<Self, MllmError> {
        let placeholder = placeholder(tokenizer, image_token)?;
        Ok(Self { template: ChatTemplate::open(files, tokenizer.special(), &placeholder)?, image_token })
    }
}

impl ChatFormat for TemplateFormat {
    fn ids(&self, tokenizer: &ChatTokenizer, chat: &Chat<'_>) -> Result<Vec<u32>, MllmError> {
        let rendered = self.template.render(chat.system, chat.image_tokens.is_some(), chat.turns, chat.prompt)?;
        let mut found = 0;
        let mut ids = Vec::new();
        for id in tokenizer.encode_chat(&rendered)? {
            if id == self.image_token {
                found += 1;
                ids.extend(std::iter::repeat_n(id, chat.image_tokens.unwrap_or(0)));
            } else {
                ids.push(id);
            }
        }
        let expected = usize::from(chat.image_tokens.is_some());
        if found == expected { Ok(ids) } else { Err(MllmError::ImagePlaceholder { expected, found }) }
    }
}

/// The placeholder of an image, checked to be one token.
fn placeholder(tokenizer: &ChatTokenizer, id: u32) -> Result<String, MllmError> {
    let broken = |problem: String| MllmError::Tokenizer { path: tokenizer.path().to_path_buf(), problem };
    let token = tokenizer
        .token(id)
        .ok_or_else(|| broken(format!("the image token, id {id} (image_token_index), is missing")))?;
    let ids = tokenizer.encode_chat(&token)?;
    if ids.iter().filter(|found| **found == id).count() == 1 {
        Ok(token)
    } else {
        Err(broken(format!("the image token '{token}', id {id}, is split into the ids {ids:?}: it is no added token")))
    }
}
