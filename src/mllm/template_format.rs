//! Prompts by the chat template of a model folder.

use crate::MllmError;
use crate::checkpoint::ModelFiles;
use crate::family::{Chat, ChatFormat, ChatImage, ImageLayout};
use crate::text::{ChatTemplate, ChatTokenizer};

/// A chat template, which writes one placeholder for an image.
#[derive(Debug)]
pub(crate) struct TemplateFormat {
    template: ChatTemplate,
    /// What the template writes for an image.
    mark: String,
    /// The text of a token of the image.
    placeholder: String,
    image_token: u32,
    image: ImageText,
}

/// What stands in a chat where the template writes the placeholder.
#[derive(Debug, Clone, Copy)]
pub(crate) enum ImageText {
    /// A placeholder for each token of the image.
    Repeated,
    /// A text with separators around and between the image's parts, made from the placeholder.
    Written(fn(placeholder: &str, layout: ImageLayout) -> String),
    /// The same for views of different sizes, where a tile becomes `tile` tokens.
    Tiled {
        write: fn(placeholder: &str, layout: ImageLayout, tile: usize) -> String,
        tile: usize,
    },
}

impl TemplateFormat {
    /// Opens the template of a model whose placeholder has this id.
    pub(crate) fn open(
        files: &ModelFiles,
        tokenizer: &ChatTokenizer,
        image_token: u32,
        image: ImageText,
    ) -> Result<Self, MllmError> {
        let placeholder = placeholder(tokenizer, image_token)?;
        let template = ChatTemplate::open(files, tokenizer.special(), Some(&placeholder))?;
        Ok(Self {
            template,
            mark: placeholder.clone(),
            placeholder,
            image_token,
            image,
        })
    }

    /// Opens the template of a model that writes `mark` for an image, or its placeholder.
    pub(crate) fn open_marked(
        files: &ModelFiles,
        tokenizer: &ChatTokenizer,
        image_token: u32,
        mark: &str,
        write: fn(placeholder: &str, layout: ImageLayout) -> String,
    ) -> Result<Self, MllmError> {
        let image = ImageText::Written(write);
        match ChatTemplate::open(files, tokenizer.special(), Some(mark)) {
            Ok(template) => Ok(Self {
                template,
                mark: mark.to_owned(),
                placeholder: placeholder(tokenizer, image_token)?,
                image_token,
                image,
            }),
            Err(error) => Self::open(files, tokenizer, image_token, image).map_err(|_| error),
        }
    }

    /// The ids of a rendered chat whose placeholders are one token for each token of their image.
    fn repeated(
        &self,
        tokenizer: &ChatTokenizer,
        rendered: &str,
        images: &[ChatImage],
    ) -> Result<Vec<u32>, MllmError> {
        let mut found = 0;
        let mut ids = Vec::new();
        for id in tokenizer.encode_chat(rendered)? {
            if id == self.image_token {
                let tokens = images.get(found).map_or(0, |image| image.layout.tokens);
                found += 1;
                ids.extend(std::iter::repeat_n(id, tokens));
            } else {
                ids.push(id);
            }
        }
        let expected = images.len();
        if found == expected {
            Ok(ids)
        } else {
            Err(MllmError::ImagePlaceholder { expected, found })
        }
    }

    /// The ids of a rendered chat whose placeholders become texts. Separators may form one token
    /// with the text around them, so the whole text is split at once.
    fn written(
        &self,
        tokenizer: &ChatTokenizer,
        rendered: &str,
        images: &[ChatImage],
        text_of: impl Fn(ImageLayout) -> String,
    ) -> Result<Vec<u32>, MllmError> {
        let found = rendered.matches(&self.mark).count();
        let expected = images.len();
        if found != expected {
            return Err(MllmError::ImagePlaceholder { expected, found });
        }
        // Behind the last mark there is text alone.
        let texts = images
            .iter()
            .map(|image| text_of(image.layout))
            .chain([String::new()]);
        let whole: String = rendered
            .split(&self.mark)
            .zip(texts)
            .flat_map(|(part, text)| [part.to_owned(), text])
            .collect();
        let ids = tokenizer.encode_chat(&whole)?;
        let tokens = images.iter().map(|image| image.layout.tokens).sum();
        let found = ids.iter().filter(|id| **id == self.image_token).count();
        if found == tokens {
            Ok(ids)
        } else {
            Err(MllmError::ImagePlaceholder {
                expected: tokens,
                found,
            })
        }
    }
}

impl ChatFormat for TemplateFormat {
    fn let_think(&mut self) -> Result<(), MllmError> {
        self.template.let_think()
    }

    fn ids(&self, tokenizer: &ChatTokenizer, chat: &Chat<'_>) -> Result<Vec<u32>, MllmError> {
        let turns: Vec<usize> = chat.images.iter().map(|image| image.turn).collect();
        let rendered = self
            .template
            .render(chat.system, &turns, chat.turns, chat.prompt)?;
        match self.image {
            ImageText::Repeated => self.repeated(tokenizer, &rendered, chat.images),
            ImageText::Written(write) => {
                let text_of = |layout| write(&self.placeholder, layout);
                self.written(tokenizer, &rendered, chat.images, text_of)
            }
            ImageText::Tiled { write, tile } => {
                let text_of = |layout| write(&self.placeholder, layout, tile);
                self.written(tokenizer, &rendered, chat.images, text_of)
            }
        }
    }
}

/// The placeholder of an image, checked to be one token.
fn placeholder(tokenizer: &ChatTokenizer, id: u32) -> Result<String, MllmError> {
    let broken = |problem: String| MllmError::Tokenizer {
        path: tokenizer.path().to_path_buf(),
        problem,
    };
    let token = tokenizer.token(id).ok_or_else(|| {
        broken(format!(
            "the image token, id {id} (image_token_index), is missing"
        ))
    })?;
    let ids = tokenizer.encode_chat(&token)?;
    if ids.iter().filter(|found| **found == id).count() == 1 {
        Ok(token)
    } else {
        Err(broken(format!(
            "the image token '{token}', id {id}, is split into the ids {ids:?}: it is no added token"
        )))
    }
}
