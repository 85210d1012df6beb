//! The images of a conversation: where they lie in its chat, and their features.

use super::sequence::Sequence;
use crate::MllmError;
use crate::family::{ChatImage, ImageFeatures, ImageLayout, VisionLanguageModel, one_picture};
use image::RgbImage;
use std::sync::Arc;

/// The images of a conversation, in the order of its turns.
#[derive(Debug, Default)]
pub(super) struct Images {
    shown: Vec<Shown>,
    /// Those of the prompt prefix, which stay whatever is rewound.
    of_prefix: usize,
    /// How those that the last prompt had lie in its chat.
    laid_out: Vec<(Arc<RgbImage>, ChatImage)>,
    /// Of the first of them, each alone.
    encoded: Vec<ImageFeatures>,
    /// Of the same, behind one another.
    features: Option<ImageFeatures>,
}

/// An image and the turn whose prompt begins with it, from 0.
#[derive(Debug, Clone)]
struct Shown {
    image: Arc<RgbImage>,
    turn: usize,
}

impl Images {
    /// The image of the prompt prefix, if it has one, with its place in the chat.
    pub(super) fn of_prefix(
        model: &dyn VisionLanguageModel,
        image: Option<&Arc<RgbImage>>,
    ) -> Result<(Self, Option<ChatImage>), MllmError> {
        let mut images = Self::default();
        if let Some(image) = image {
            images.show(model, std::slice::from_ref(image), 0)?;
        }
        images.of_prefix = images.shown.len();
        let first = places(model, &images.shown)?.first().copied();
        Ok((images, first))
    }

    /// Adds images that the prompt of a turn begins with.
    ///
    /// # Errors
    /// When the model takes no such image, or not so many. Then none is added.
    pub(super) fn show(
        &mut self,
        model: &dyn VisionLanguageModel,
        images: &[Arc<RgbImage>],
        turn: usize,
    ) -> Result<(), MllmError> {
        let before = self.shown.len();
        let new = images.iter().map(|image| Shown {
            image: Arc::clone(image),
            turn,
        });
        self.shown.extend(new);
        let placed = places(model, &self.shown);
        if placed.is_err() {
            self.shown.truncate(before);
        }
        placed.map(|_| ())
    }

    /// Number of images that were shown after those of the prefix.
    pub(super) fn later(&self) -> usize {
        self.shown.len() - self.of_prefix
    }

    /// Drops those that were shown later than the first `later` behind the prefix, or for a turn
    /// behind the next, which is `turn`.
    pub(super) fn rewind(&mut self, later: usize, turn: usize) {
        self.shown.truncate(self.of_prefix.saturating_add(later));
        self.shown.retain(|shown| shown.turn <= turn);
    }

    /// Lays the images out for the next prompt. Features and computed tokens of an image that is
    /// another than before, or lies otherwise, are dropped with all behind it.
    pub(super) fn lay_out(
        &mut self,
        model: &dyn VisionLanguageModel,
        sequence: &mut Sequence,
    ) -> Result<Vec<ChatImage>, MllmError> {
        let places = places(model, &self.shown)?;
        let images = self.shown.iter().map(|shown| &shown.image);
        let known = self.laid_out.iter().zip(images.clone().zip(&places));
        let same = known
            .take_while(|((before, was), (now, place))| {
                Arc::ptr_eq(before, now) && was.layout == place.layout
            })
            .count();
        if same < self.laid_out.len() {
            let before = self.laid_out.iter().take(same);
            let tokens = before.map(|(_, image)| image.layout.tokens).sum();
            sequence.forget_image_from(model.info().image_token, tokens);
        }
        if same < self.encoded.len() {
            self.encoded.truncate(same);
            self.features = ImageFeatures::joined(&self.encoded)?;
        }
        self.laid_out = images.cloned().zip(places.iter().copied()).collect();
        Ok(places)
    }

    /// Encodes images that are not encoded yet, if one of the tokens stands for an image. Says
    /// whether there were such images.
    pub(super) fn encode(
        &mut self,
        model: &dyn VisionLanguageModel,
        ids: &[u32],
    ) -> Result<bool, MllmError> {
        let before = self.encoded.len();
        if before == self.shown.len() || !ids.contains(&model.info().image_token) {
            return Ok(false);
        }
        let several = self.shown.len() > 1;
        for shown in self.shown.iter().skip(before) {
            self.encoded.push(if several {
                model.encode_of_several(&shown.image)?
            } else {
                model.encode_image(&shown.image)?
            });
        }
        self.features = ImageFeatures::joined(&self.encoded)?;
        Ok(true)
    }

    /// The features of all that are encoded; none before the first.
    pub(super) fn features(&self) -> Option<&ImageFeatures> {
        self.features.as_ref()
    }
}

/// How images lie in their chat.
fn places(model: &dyn VisionLanguageModel, shown: &[Shown]) -> Result<Vec<ChatImage>, MllmError> {
    let several = shown.len() > 1;
    let place = |Shown { image, turn }: &Shown| {
        let (width, height) = image.dimensions();
        let layout: ImageLayout = if several {
            model.layout_of_several(width, height)?
        } else {
            model.image_layout(width, height)?
        };
        if model.info().image_first && *turn > 0 {
            return Err(one_picture());
        }
        Ok(ChatImage {
            turn: *turn,
            layout,
        })
    };
    shown.iter().map(place).collect()
}
