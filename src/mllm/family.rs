//! The contract of a model family: what differs between LLaVA, `CogVLM` and their like.
//!
//! A family answers five questions, and nothing else knows it by name. One without a vision tower
//! answers the first two with an error, and its models read text alone:
//! 1. How does an image become tiles ([`VisionLanguageModel::preprocess`])?
//! 2. How do tiles become input rows of the decoder ([`VisionLanguageModel::encode`])?
//! 3. How does a chat become tokens, with placeholders for the image
//!    ([`VisionLanguageModel::chat_format`])?
//! 4. Where do the tokens stand ([`VisionLanguageModel::positions`])?
//! 5. What are its tensors called in safetensors and GGUF files (`canonical_name` and `gguf` of
//!    [`Family`])?
//!
//! An image has one [`ImageLayout`], which its width and height decide, and whether its chat has
//! others. The layout says how many tokens stand for the image, and which grid it is cut into. The
//! chat format writes it, with separators between its parts. The positions follow from it.

use super::checkpoint::{LlamaConfig, ModelFiles, Weights};
use super::decoder::{LanguageModel, Position};
use super::endpoint_settings::DRAWN_SIDES;
use super::gguf::GgufLayout;
use super::text::ChatTokenizer;
use super::{MllmError, Turn};
use candle_core::Tensor;
use image::RgbImage;
use planagent_kernels::Awake;
use serde::de::Error as _;
use serde::{Deserialize, Deserializer, Serialize};
use std::fmt::{self, Debug, Formatter};
use std::ops::Range;

/// A model, or why it cannot be opened.
pub type OpenedModel = Result<Box<dyn VisionLanguageModel>, MllmError>;

/// A family of models. `families.rs` lists those that are built in.
#[derive(Clone, Copy)]
pub struct Family {
    /// The name in model descriptions and results.
    pub name: &'static str,
    /// The `model_type` of `config.json`, then the entries of `architectures`, that this family
    /// opens.
    pub config_names: &'static [&'static str],
    /// The canonical name of a tensor in safetensors; none for a tensor that is no weight.
    pub canonical_name: fn(stored: &str) -> Option<String>,
    /// How llama.cpp's GGUF files hold the family, or the part that its format has no place for.
    pub gguf: Result<&'static dyn GgufLayout, &'static str>,
    /// The error where a model has no tokenizer: the missing file, and what to do.
    pub missing_tokenizer: &'static str,
    /// Reads the configuration of the decoder.
    pub decoder_config: fn(&ModelFiles) -> Result<LlamaConfig, MllmError>,
    /// Opens the configuration and the preprocessor, and takes the weights.
    pub open: fn(&ModelFiles, &mut Weights) -> OpenedModel,
    /// What its users read (`docs/supported-models.md`).
    pub about: About,
}

/// What users of a family read.
#[derive(Debug, Clone, Copy)]
pub struct About {
    /// The published models that it opens, in words.
    pub models: &'static str,
    /// The decoders of llama.cpp's files that it opens (`general.architecture`), and the projector
    /// beside each (`clip.projector_type`).
    pub gguf: &'static [(&'static str, Option<&'static str>)],
    /// What its outputs are compared with, and where.
    pub tested: &'static str,
    /// A published model, as `--model` takes it.
    pub example: &'static str,
}

impl Debug for Family {
    fn fmt(&self, out: &mut Formatter<'_>) -> fmt::Result {
        out.debug_tuple("Family").field(&self.name).finish()
    }
}

/// An opened model.
pub trait VisionLanguageModel: Debug + Send + Sync {
    /// Sizes and names that users of the model need.
    fn info(&self) -> &ModelInfo;

    /// Changes how images are shown to the model.
    ///
    /// # Errors
    /// When the family cannot show them so.
    fn set_images(&mut self, settings: ImageSettings) -> Result<(), MllmError> {
        if let Some(tiles) = settings.tiles {
            let problem = format!(
                "image.tiles = {tiles}: images of this family are not cut as a setting says"
            );
            return Err(MllmError::Image { problem });
        }
        match self.info().image_size {
            Some(side) => settings.check_size(side),
            None if settings.is_default() => Ok(()),
            None => Err(no_picture()),
        }
    }

    /// How an image of this width and height, pixels, lies in a chat.
    ///
    /// # Errors
    /// When the model takes no such image, or none at all.
    fn image_layout(&self, width: u32, height: u32) -> Result<ImageLayout, MllmError>;

    /// How one of several images of a chat lies in it. An image with another layout than alone is
    /// prepared by [`Self::preprocess_of_several`].
    ///
    /// # Errors
    /// As [`Self::image_layout`], and when a chat of the model has one image at most.
    fn layout_of_several(&self, width: u32, height: u32) -> Result<ImageLayout, MllmError> {
        self.image_layout(width, height)
    }

    /// How the image that is drawn for the model lies in a chat; none for a model that reads text
    /// alone.
    fn drawn_layout(&self) -> Result<Option<ImageLayout>, MllmError> {
        self.info()
            .image_size
            .map(|side| self.image_layout(side as u32, side as u32))
            .transpose()
    }

    /// Pixels of all tiles that an image of this width and height becomes.
    fn tower_pixels(&self, width: u32, height: u32) -> Result<usize, MllmError> {
        let ImageLayout { rows, columns, .. } = self.image_layout(width, height)?;
        let side = self.info().image_size.ok_or_else(no_picture)?;
        // Beside its tiles stands the image in one piece.
        let views = match rows.saturating_mul(columns) {
            0 | 1 => 1,
            tiles => tiles.saturating_add(1),
        };
        Ok(side.saturating_mul(side).saturating_mul(views))
    }

    /// What the tower costs for an image of this width and height, pixels, where its layers read
    /// maps of several sizes; none for a tower of patches, whose tensors say it.
    fn tower_cost(&self, width: u32, height: u32) -> Option<TowerCost> {
        let _ = (width, height);
        None
    }

    /// Cuts and scales an image to the tiles that the vision tower takes.
    fn preprocess(&self, image: &RgbImage) -> Result<Tiles, MllmError>;

    /// As [`Self::preprocess`], for one of several images of a chat.
    ///
    /// # Errors
    /// When the image cannot be used.
    fn preprocess_of_several(&self, image: &RgbImage) -> Result<Tiles, MllmError> {
        self.preprocess(image)
    }

    /// Encodes the tiles of an image to input rows of the decoder.
    fn encode(&self, tiles: &Tiles) -> candle_core::Result<ImageFeatures>;

    /// How chats are written, from the model's files.
    fn chat_format(
        &self,
        files: &ModelFiles,
        tokenizer: &ChatTokenizer,
    ) -> Result<Box<dyn ChatFormat>, MllmError>;

    /// Where the tokens `tokens` of a chat with these images stand, which are in their order.
    fn positions(&self, tokens: Range<usize>, images: &[PlacedImage]) -> Positions {
        let _ = images;
        Positions::plain(tokens.start as u32..tokens.end as u32)
    }

    /// Whether the tokens of an image see one another, so that one pass must compute all of them.
    fn image_at_once(&self) -> bool {
        false
    }

    /// Longest chat, tokens, whose images become `image_tokens` tokens.
    fn context(&self, image_tokens: usize) -> usize {
        let _ = image_tokens;
        self.info().positions
    }

    /// The language model.
    fn decoder(&self) -> &dyn LanguageModel;

    /// Encodes the image of a chat to input rows of the decoder.
    fn encode_image(&self, image: &RgbImage) -> Result<ImageFeatures, MllmError> {
        let pixels = self.preprocess(image)?;
        let _threads = Awake::begin();
        Ok(self.encode(&pixels)?)
    }

    /// As [`Self::encode_image`], for one of several images of a chat.
    ///
    /// # Errors
    /// As [`Self::preprocess_of_several`], and when the tower fails.
    fn encode_of_several(&self, image: &RgbImage) -> Result<ImageFeatures, MllmError> {
        let pixels = self.preprocess_of_several(image)?;
        let _threads = Awake::begin();
        Ok(self.encode(&pixels)?)
    }
}

/// The cost of an image in a vision tower.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct TowerCost {
    /// Bytes of the activations that are alive at once, beside the pixels.
    pub bytes: u64,
    /// Multiplications and additions.
    pub operations: u64,
}

/// The error of a model without a vision tower that is shown a picture.
pub(crate) fn no_picture() -> MllmError {
    MllmError::Image {
        problem: "this model reads text alone, and takes no picture".into(),
    }
}

/// The error of a model whose chats have one picture, with the first prompt.
pub(crate) fn one_picture() -> MllmError {
    MllmError::Image {
        problem: "chats of this model have one picture, with the first prompt".into(),
    }
}

/// An image as the vision tower takes it.
#[derive(Debug, Clone)]
pub struct Tiles {
    /// Pixel values of each tile, (3, height, width).
    pub pixels: Vec<Tensor>,
    /// Width of the image before it was cut, pixels.
    pub width: u32,
    /// Height of the image before it was cut, pixels.
    pub height: u32,
}

impl Tiles {
    /// An image in one view with these pixel values.
    pub(crate) fn one_view(image: &RgbImage, pixels: Tensor) -> Self {
        Self {
            pixels: vec![pixels],
            width: image.width(),
            height: image.height(),
        }
    }

    /// The pixel values of an image in one view.
    ///
    /// # Errors
    /// When there is no image.
    pub(crate) fn view(&self) -> candle_core::Result<&Tensor> {
        let view = self.pixels.first();
        view.ok_or_else(|| candle_core::Error::Msg("there is no image".to_owned()))
    }
}

/// Reads a side within [`DRAWN_SIDES`].
fn drawn_side<'de, D: Deserializer<'de>>(source: D) -> Result<Option<u32>, D::Error> {
    let side = u32::deserialize(source)?;
    if DRAWN_SIDES.contains(&side) {
        return Ok(Some(side));
    }
    let (min, max) = (DRAWN_SIDES.start(), DRAWN_SIDES.end());
    Err(D::Error::custom(format!(
        "size is {side}; it must be from {min} to {max}"
    )))
}

/// How images are shown to a model, in its description; what is not set is as the model's files
/// say.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ImageSettings {
    /// Side of the square image that is drawn for the model, pixels. Only towers that take any size
    /// have a choice.
    #[serde(
        deserialize_with = "drawn_side",
        skip_serializing_if = "Option::is_none"
    )]
    pub size: Option<u32>,
    /// Most tiles that an image is cut into.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tiles: Option<usize>,
}

impl ImageSettings {
    pub(crate) fn is_default(&self) -> bool {
        *self == Self::default()
    }

    /// Checks that the size is the one that a tower takes, if one is set.
    pub(crate) fn check_size(self, side: usize) -> Result<(), MllmError> {
        match self.size {
            Some(size) if size as usize != side => Err(MllmError::Image {
                problem: format!("image.size = {size}: the vision tower takes {side}"),
            }),
            _ => Ok(()),
        }
    }
}

/// How an image lies in a chat.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ImageLayout {
    /// Tokens that stand for the image, one for each row of its features. Separators between its
    /// parts are text.
    pub tokens: usize,
    /// Rows of the grid that it is cut into: tiles, or tokens of a tower that takes any size. 1 for
    /// an image in one piece.
    pub rows: usize,
    /// Columns of that grid.
    pub columns: usize,
}

impl ImageLayout {
    /// An image in one piece, whose tokens follow one another.
    pub fn whole(tokens: usize) -> Self {
        Self {
            tokens,
            rows: 1,
            columns: 1,
        }
    }
}

/// An image in a chat.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PlacedImage {
    /// Index of its first token.
    pub first: usize,
    pub layout: ImageLayout,
}

impl PlacedImage {
    /// The images of a chat with these layouts. Their tokens follow one another in `ids`, where
    /// `image_token` stands for each; those that are not in `ids` yet are left out.
    pub fn all(
        ids: impl IntoIterator<Item = u32>,
        image_token: u32,
        layouts: &[ImageLayout],
    ) -> Vec<Self> {
        let mut layouts = layouts.iter().filter(|layout| layout.tokens > 0);
        let (mut placed, mut left) = (Vec::new(), 0);
        for (first, _) in (0..).zip(ids).filter(|(_, id)| *id == image_token) {
            if left == 0 {
                let Some(layout) = layouts.next().copied() else {
                    break;
                };
                placed.push(Self { first, layout });
                left = layout.tokens;
            }
            left -= 1;
        }
        placed
    }

    /// The tokens of an image whose tokens follow one another.
    pub fn tokens(&self) -> Range<usize> {
        self.first..self.first + self.layout.tokens
    }
}

/// Images as the decoder takes them.
#[derive(Debug, Clone)]
pub struct ImageFeatures {
    /// Input rows: (tokens of the images, hidden).
    pub rows: Tensor,
    /// Added to the hidden states of the images' tokens after the first layers, one for each:
    /// (tokens of the images, hidden). Most families have none (`DeepStack`: Meng et al.,
    /// arXiv:2406.04334).
    pub deep: Vec<Tensor>,
    /// The layout of each image, in the order of their rows.
    pub layouts: Vec<ImageLayout>,
}

impl ImageFeatures {
    /// The features of an image in one piece.
    pub fn whole(rows: Tensor) -> candle_core::Result<Self> {
        Ok(Self {
            layouts: vec![ImageLayout::whole(rows.dim(0)?)],
            deep: Vec::new(),
            rows,
        })
    }

    /// The features of images behind one another; none without one.
    pub(crate) fn joined(parts: &[Self]) -> candle_core::Result<Option<Self>> {
        let [first, others @ ..] = parts else {
            return Ok(None);
        };
        if others.is_empty() {
            return Ok(Some(first.clone()));
        }
        let rows: Vec<&Tensor> = parts.iter().map(|part| &part.rows).collect();
        let deep = (0..first.deep.len())
            .map(|layer| {
                let layer: Vec<&Tensor> = parts
                    .iter()
                    .filter_map(|part| part.deep.get(layer))
                    .collect();
                Tensor::cat(&layer, 0)
            })
            .collect::<candle_core::Result<_>>()?;
        Ok(Some(Self {
            rows: Tensor::cat(&rows, 0)?,
            deep,
            layouts: parts.iter().flat_map(|part| part.layouts.clone()).collect(),
        }))
    }

    /// Number of tokens that stand for the images.
    pub fn tokens(&self) -> usize {
        self.layouts.iter().map(|layout| layout.tokens).sum()
    }
}

/// Where tokens of a chat stand.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Positions {
    /// The position of each token for its rotary embedding.
    pub rotary: Vec<Position>,
    /// Which of the tokens, by index, layers treat as parts of an image: a range for each image that
    /// has such tokens, in their order.
    pub vision: Vec<Range<usize>>,
}

impl Positions {
    /// Tokens with one position each, and without layers that tell an image from text.
    pub fn plain(positions: impl IntoIterator<Item = u32>) -> Self {
        Self {
            rotary: positions
                .into_iter()
                .map(|position| [position; 3])
                .collect(),
            vision: Vec::new(),
        }
    }

    /// As [`Self::plain`], of the tokens `tokens`, where layers tell those of images from text.
    pub(crate) fn with_images(tokens: Range<usize>, images: &[PlacedImage]) -> Self {
        let within = |index: usize| index.clamp(tokens.start, tokens.end) - tokens.start;
        let seen = images.iter().map(PlacedImage::tokens);
        let seen = seen.map(|image| within(image.start)..within(image.end));
        Self {
            vision: seen.filter(|image| !image.is_empty()).collect(),
            ..Self::plain(tokens.start as u32..tokens.end as u32)
        }
    }
}

/// How a family writes a chat as tokens.
pub trait ChatFormat: Debug + Send + Sync {
    /// Token ids of a chat, each token of an image as the model's placeholder
    /// ([`ModelInfo::image_token`]).
    fn ids(&self, tokenizer: &ChatTokenizer, chat: &Chat<'_>) -> Result<Vec<u32>, MllmError>;

    /// From now on, chats end where the model begins to think.
    ///
    /// # Errors
    /// When the family's chats know no thinking.
    fn let_think(&mut self) -> Result<(), MllmError> {
        Err(MllmError::Request {
            problem: "generation.thinking: chats of this family know no thinking".into(),
        })
    }
}

/// A chat that ends with a user's prompt.
#[derive(Debug, Clone, Copy)]
pub struct Chat<'a> {
    /// The system prompt; empty for none.
    pub system: &'a str,
    /// The images that prompts begin with, in the order of the turns.
    pub images: &'a [ChatImage],
    pub turns: &'a [Turn],
    pub prompt: &'a str,
}

/// An image that a prompt of a chat begins with.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ChatImage {
    /// The turn of the prompt, from 0.
    pub turn: usize,
    pub layout: ImageLayout,
}

impl ChatImage {
    /// An image that the first prompt begins with.
    pub(crate) fn first(layout: ImageLayout) -> Self {
        Self { turn: 0, layout }
    }
}

/// Sizes and names of a model.
#[derive(Debug, Clone)]
pub struct ModelInfo {
    /// Name of its family.
    pub architecture: &'static str,
    /// The id that stands for a token of the image. It need not be a token of the vocabulary; in
    /// a model without a vision tower it is none.
    pub image_token: u32,
    /// Whether the image stands before the system prompt, so that no chat shares a prefix with
    /// another. Such a chat has one image at most, which comes with the first prompt.
    pub image_first: bool,
    /// Side of the square that the vision tower takes, or that a tower for any size is shown by
    /// default, pixels; none for a model that reads text alone.
    pub image_size: Option<usize>,
    /// Tokens of the image that becomes the most.
    pub max_image_tokens: usize,
    /// How many tokens an image may become; none where its tower decides.
    pub image_range: Option<ImageRange>,
    /// Number of token ids.
    pub vocabulary: usize,
    /// Positions that the decoder was trained for.
    pub positions: usize,
    /// Number of weights.
    pub parameters: u64,
    /// BLAKE3 of the weight files.
    pub blake3: String,
}

/// How many tokens an image may become in a tower that takes any size.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct ImageRange {
    pub least: usize,
    pub most: usize,
    /// The least that the model's makers, and llama.cpp, advise where places in the image matter.
    pub advised: usize,
}

/// An id that no vocabulary has.
const NO_TOKEN: u32 = u32::MAX;

/// How a model takes images.
#[derive(Debug, Clone, Copy)]
pub(crate) struct ImageInfo {
    /// The id that stands for a token of the image.
    pub token: u32,
    /// Side of the square that the vision tower takes, or is shown by default, pixels.
    pub side: usize,
    /// Tokens of the image that becomes the most.
    pub max_tokens: usize,
}

impl ModelInfo {
    /// The facts of a model of the family `architecture` whose weights were just taken; before,
    /// `weights` had `before` numbers. `image` is none for a model without a vision tower.
    pub(crate) fn new(
        architecture: &'static str,
        text: &LlamaConfig,
        image: Option<ImageInfo>,
        weights: &Weights,
        before: usize,
    ) -> Self {
        Self {
            architecture,
            image_token: image.map_or(NO_TOKEN, |image| image.token),
            image_first: false,
            image_size: image.map(|image| image.side),
            max_image_tokens: image.map_or(0, |image| image.max_tokens),
            image_range: None,
            vocabulary: text.vocabulary,
            positions: text.context,
            parameters: (before - weights.elements()) as u64,
            blake3: weights.blake3().to_string(),
        }
    }
}
