//! A small model that drafts answers of a larger one.

use super::loading::Loading;
use super::sequence::Sequence;
use crate::decoder::Logits;
use crate::family::VisionLanguageModel;
use crate::sampling::most_likely;
use crate::source::ModelPlace;
use crate::text::ChatTokenizer;
use crate::{Deadline, MllmError};
use std::sync::Arc;

/// Longest draft of a model, tokens: each costs a pass of it.
const MAX_DRAFT: usize = 8;

/// A small model with the vocabulary of the model that it drafts for. It reads the text of chats
/// alone.
#[derive(Debug)]
pub(super) struct DraftModel(Box<dyn VisionLanguageModel>);

impl DraftModel {
    /// Opens a model that drafts for one with this tokenizer.
    ///
    /// # Errors
    /// When its vocabulary is another, among others.
    pub(super) fn open(
        place: &ModelPlace,
        loading: &Loading,
        drafts_for: &ChatTokenizer,
    ) -> Result<Self, MllmError> {
        let mut checkpoint = loading.checkpoint(place)?;
        let files = loading.tokenizer(&checkpoint.files, checkpoint.family)?;
        let model = checkpoint.open_model()?;
        let tokenizer =
            ChatTokenizer::open(&files, model.info().vocabulary, model.info().image_token)?;
        match tokenizer.vocabulary_difference(drafts_for) {
            None => Ok(Self(model)),
            Some(problem) => Err(MllmError::DraftModel {
                place: place.path().to_path_buf(),
                problem,
            }),
        }
    }
}

/// What a draft model has computed of a chat.
#[derive(Debug)]
pub(super) struct Drafting {
    model: Arc<DraftModel>,
    sequence: Sequence,
}

impl Drafting {
    pub(super) fn new(model: &Arc<DraftModel>) -> Self {
        Self {
            sequence: Sequence::new(&*model.0),
            model: Arc::clone(model),
        }
    }

    /// At most `limit` tokens that the model would write behind a chat, whose placeholder of an
    /// image is `image`.
    pub(super) fn draft(
        &mut self,
        chat: &[u32],
        image: u32,
        limit: usize,
        deadline: Deadline,
    ) -> Result<Vec<u32>, MllmError> {
        let model = &*self.model.0;
        let is_image = |id: u32| id == image || id == model.info().image_token;
        let text: Vec<u32> = chat.iter().copied().filter(|id| !is_image(*id)).collect();
        // Tokens that the small model does not know: it cannot draft here, and the larger one
        // answers alone.
        if text
            .iter()
            .any(|id| *id as usize >= model.info().vocabulary)
        {
            return Ok(Vec::new());
        }
        let limit = limit
            .min(MAX_DRAFT)
            .min(model.context(0).saturating_sub(text.len()));
        let kept = self.sequence.begin(model, &text, &[]);
        let mut next = text[kept..].to_vec();
        let mut draft = Vec::new();
        while draft.len() < limit {
            let logits =
                self.sequence
                    .append_in_passes(model, &next, None, Logits::Last, deadline)?;
            let Some(logits) = logits else { break };
            let best = most_likely(&logits.flatten_all()?.to_vec1::<f32>()?)
                .filter(|token| !is_image(*token));
            let Some(token) = best else { break };
            draft.push(token);
            next = vec![token];
        }
        Ok(draft)
    }
}
