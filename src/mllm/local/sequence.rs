//! The computed tokens of a chat.

use crate::decoder::{DecoderCache, DecoderInput, Logits};
use crate::family::{ImageFeatures, ImageLayout, PlacedImage, Positions, VisionLanguageModel};
use crate::{Deadline, MllmError};
use candle_core::Tensor;
use planagent_kernels::attention::position_end;

/// Tokens of one pass: bounds the activations, and the time between two looks at the deadline.
pub(super) const MAX_TOKENS_IN_PASS: usize = 512;

/// Tokens at the end of a prompt that open the answer, at most: a chat's history may hold them
/// otherwise (Qwen 3 and 3.5 write no empty thinking there), so that later prompts part before it.
const ANSWER_OPENING: usize = 8;

/// Computed tokens with what the decoder keeps of them. A clone is a branch: it costs one copy of
/// the layers' states at most, once one of both is appended to.
#[derive(Debug, Clone)]
pub(crate) struct Sequence {
    ids: Vec<u32>,
    /// For each token, the length that its keys were computed for
    /// ([`LanguageModel::rotary_length`](crate::decoder::LanguageModel::rotary_length)).
    lengths: Vec<usize>,
    /// The position behind the prompt; 0 before the first.
    prompt_end: usize,
    cache: DecoderCache,
}

/// Tokens of the next pass. An image whose token is `whole` is not cut.
fn pass_length(ids: &[u32], whole: Option<u32>) -> usize {
    let length = ids.len().min(MAX_TOKENS_IN_PASS);
    let (pass, later) = ids.split_at(length);
    let cut = pass.last().copied().filter(|id| Some(*id) == whole);
    let more = later.iter().take_while(|id| Some(**id) == cut);
    length + if cut.is_some() { more.count() } else { 0 }
}

/// An empty cache for the longest chat of a model.
pub(super) fn new_cache(model: &dyn VisionLanguageModel) -> DecoderCache {
    model
        .decoder()
        .new_cache(model.context(model.info().max_image_tokens))
}

impl Sequence {
    pub(crate) fn new(model: &dyn VisionLanguageModel) -> Self {
        Self {
            ids: Vec::new(),
            lengths: Vec::new(),
            prompt_end: 0,
            cache: new_cache(model),
        }
    }

    /// Begins a prompt, whose images lie so in the chat. Keeps computed tokens that it begins with,
    /// without its last one, whose logits are needed, and gives their number.
    pub(crate) fn begin(
        &mut self,
        model: &dyn VisionLanguageModel,
        prompt: &[u32],
        images: &[ImageLayout],
    ) -> usize {
        let image_token = model.info().image_token;
        let images = PlacedImage::all(prompt.iter().copied(), image_token, images);
        let positions = model.positions(0..prompt.len(), &images).rotary;
        self.prompt_end = positions.iter().map(position_end).max().unwrap_or(0);
        let length = model.decoder().rotary_length(self.prompt_end);
        let known = self.ids.iter().zip(&self.lengths);
        let agree = known
            .zip(prompt)
            .take_while(|((known, computed_for), id)| known == id && **computed_for == length)
            .count();
        self.cut(agree.min(prompt.len().saturating_sub(1)));
        self.cache.drop_planned_marks();
        self.mark_prompt(image_token, &prompt[self.ids.len()..]);
        self.ids.len()
    }

    /// Marks, in tokens that are to be appended, where later prompts part from this one: behind the
    /// last image, before the opening of the answer, and before the last token, whose logits are needed
    /// again.
    pub(crate) fn mark_prompt(&mut self, image_token: u32, next: &[u32]) {
        let image_end = next.iter().rposition(|id| *id == image_token);
        let image_end = image_end.map(|last| last + 1);
        let last = next.len().checked_sub(1);
        let opening = last.and_then(|last| last.checked_sub(ANSWER_OPENING));
        for end in [image_end, opening, last].into_iter().flatten() {
            self.cache.mark_at(self.ids.len() + end);
        }
    }

    /// Marks the sequence as it is: [`Self::cut`] goes back to it, whatever layers keep.
    pub(crate) fn mark(&mut self) {
        self.cache.mark_at(self.ids.len());
    }

    pub(crate) fn ids(&self) -> &[u32] {
        &self.ids
    }

    /// Appends tokens and gives the wanted logits (wanted positions, vocabulary). The n-th image
    /// token of the sequence takes the n-th row of `features`, wherever it stands. Tokens of an
    /// image whose tokens see one another are computed once more with those that follow them. After
    /// an error the sequence is unchanged.
    pub(crate) fn append(
        &mut self,
        model: &dyn VisionLanguageModel,
        ids: &[u32],
        features: Option<&ImageFeatures>,
        wanted: Logits,
    ) -> Result<Option<Tensor>, MllmError> {
        if ids.is_empty() {
            return Ok(None);
        }
        let begun = self.begun_image(model, ids);
        if begun > 0 {
            return self.append_again(model, begun, ids, features, wanted);
        }
        let input = self.decoder_input(model, ids, features)?;
        let logits = model.decoder().forward(&input, &mut self.cache, wanted)?;
        self.ids.extend_from_slice(ids);
        let length = |end: usize| model.decoder().rotary_length(end.max(input.prompt_end));
        self.lengths
            .extend(input.positions.iter().map(position_end).map(length));
        Ok(logits)
    }

    /// Computed tokens of an image that sees more of itself with `ids`.
    fn begun_image(&self, model: &dyn VisionLanguageModel, ids: &[u32]) -> usize {
        let image_token = model.info().image_token;
        if !model.image_at_once() || ids.first() != Some(&image_token) {
            return 0;
        }
        let last = self.ids.iter().rev();
        last.take_while(|id| **id == image_token).count()
    }

    /// Computes the last `begun` tokens once more, with `ids` behind them.
    fn append_again(
        &mut self,
        model: &dyn VisionLanguageModel,
        begun: usize,
        ids: &[u32],
        features: Option<&ImageFeatures>,
        wanted: Logits,
    ) -> Result<Option<Tensor>, MllmError> {
        let before = self.clone();
        let kept = self.ids.len().saturating_sub(begun);
        let image: Vec<u32> = self.ids.iter().skip(kept).copied().collect();
        let whole = [self.cut(kept).as_slice(), &image, ids].concat();
        let wanted = match wanted {
            Logits::All => Logits::Tail(ids.len()),
            other => other,
        };
        let appended = self.append(model, &whole, features, wanted);
        if appended.is_err() {
            *self = before;
        }
        appended
    }

    /// Appends tokens in as many passes as they need, checks the deadline before each, and gives
    /// the wanted logits of the last. After an error the earlier passes stay appended.
    pub(crate) fn append_in_passes(
        &mut self,
        model: &dyn VisionLanguageModel,
        ids: &[u32],
        features: Option<&ImageFeatures>,
        wanted: Logits,
        deadline: Deadline,
    ) -> Result<Option<Tensor>, MllmError> {
        let mut logits = None;
        let whole = model.image_at_once().then_some(model.info().image_token);
        let mut rest = ids;
        while !rest.is_empty() {
            deadline.check()?;
            let (pass, later) = rest.split_at(pass_length(rest, whole));
            let wanted = if later.is_empty() {
                wanted
            } else {
                Logits::None
            };
            logits = self.append(model, pass, features, wanted)?;
            rest = later;
        }
        Ok(logits)
    }

    /// The decoder's input for tokens that follow the sequence.
    pub(crate) fn decoder_input(
        &self,
        model: &dyn VisionLanguageModel,
        ids: &[u32],
        features: Option<&ImageFeatures>,
    ) -> Result<DecoderInput, MllmError> {
        let image_token = model.info().image_token;
        let is_image = |id: &u32| *id == image_token;
        // A pass may end inside the placeholders, so it goes on behind those that are computed.
        let mut used = self.ids.iter().filter(|id| is_image(id)).count();
        let known = features.map_or(0, ImageFeatures::tokens);
        let mut rows = Vec::new();
        let layers = features
            .filter(|_| ids.iter().any(is_image))
            .map_or(0, |features| features.deep.len());
        let mut deep = vec![Vec::new(); layers];
        for run in ids.chunk_by(|a, b| is_image(a) == is_image(b)) {
            if run.first().is_some_and(is_image) {
                let Some(features) = features.filter(|_| used + run.len() <= known) else {
                    return Err(MllmError::ImagePlaceholder {
                        expected: known,
                        found: used + run.len(),
                    });
                };
                rows.push(features.rows.narrow(0, used, run.len())?);
                for (deep, features) in deep.iter_mut().zip(&features.deep) {
                    deep.push(features.narrow(0, used, run.len())?);
                }
                used += run.len();
            } else {
                let embedded = model.decoder().embed(run)?;
                for deep in &mut deep {
                    deep.push(embedded.zeros_like()?);
                }
                rows.push(embedded);
            }
        }
        if used > known {
            return Err(MllmError::ImagePlaceholder {
                expected: known,
                found: used,
            });
        }
        let layouts = features.map_or(&[][..], |features| &features.layouts);
        let all = self.ids.iter().chain(ids).copied();
        let images = PlacedImage::all(all, image_token, layouts);
        let Positions { rotary, vision } =
            model.positions(self.ids.len()..self.ids.len() + ids.len(), &images);
        let context = model.info().positions;
        if let Some(position) = rotary
            .iter()
            .flatten()
            .max()
            .filter(|position| **position as usize >= context)
        {
            let problem = format!("position {position} lies outside the context of {context}");
            return Err(candle_core::Error::msg(problem).into());
        }
        let deep = deep
            .iter()
            .map(|rows| Tensor::cat(rows, 0))
            .collect::<candle_core::Result<_>>()?;
        Ok(DecoderInput {
            rows: Tensor::cat(&rows, 0)?,
            tokens: ids
                .iter()
                .map(|id| (!is_image(id)).then_some(*id))
                .collect(),
            positions: rotary,
            prompt_end: self.prompt_end,
            vision,
            deep,
        })
    }

    /// Drops the tokens from an image on before which other images have `tokens` tokens.
    pub(super) fn forget_image_from(&mut self, image_token: u32, tokens: usize) {
        let images = (0..).zip(&self.ids).filter(|(_, id)| **id == image_token);
        if let Some((first, _)) = images.skip(tokens).map(|(at, id)| (at, *id)).next() {
            self.cut(first);
        }
    }

    /// How many of the first tokens are those of `ids`.
    pub(super) fn agree(&self, ids: &[u32]) -> usize {
        self.ids
            .iter()
            .zip(ids)
            .take_while(|(own, other)| own == other)
            .count()
    }

    /// Drops the tokens from `len` on. Where layers keep a state that cannot be cut back so far, more
    /// are dropped, to the last mark before; those before `len` are given, to be appended again.
    pub(crate) fn cut(&mut self, len: usize) -> Vec<u32> {
        let reached = self.cache.cut(len.min(self.ids.len()));
        self.ids.truncate(len);
        self.lengths.truncate(reached);
        self.ids.split_off(reached)
    }
}

#[cfg(test)]
mod tests {
    use super::{MAX_TOKENS_IN_PASS, pass_length};

    #[test]
    fn a_pass_does_not_cut_an_image_that_is_seen_at_once() {
        let mut ids = vec![1; MAX_TOKENS_IN_PASS - 2];
        ids.extend([7; 5]);
        ids.extend([1; 3]);
        assert_eq!(pass_length(&ids, None), MAX_TOKENS_IN_PASS);
        assert_eq!(pass_length(&ids, Some(1)), MAX_TOKENS_IN_PASS);
        assert_eq!(pass_length(&ids, Some(7)), MAX_TOKENS_IN_PASS + 3);
        assert_eq!(pass_length(&ids[..9], Some(7)), 9);
        assert_eq!(pass_length(&[], Some(7)), 0);
    }
}
