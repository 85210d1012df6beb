//! A model family from outside of the package.

use super::{Copy, FIRST, free, open, prefix};
use image::RgbImage;
use planagent_mllm::{
    About, Architecture, ChatFormat, ChatTokenizer, Families, Family, HubAccess, ImageFeatures,
    ImageLayout, LanguageModel, Mllm, MllmError, ModelFiles, ModelInfo, ModelRegistry, PlacedImage,
    Positions, Tiles, Trust, VisionLanguageModel,
};
use std::ops::Range;

/// A LLaVA whose tensors have other names and whose images are turned upside down.
static TOY: Family = Family {
    name: "toy",
    config_names: &["toy", "ToyForConditionalGeneration"],
    canonical_name: |stored| (llava().canonical_name)(stored.strip_prefix("toy.")?),
    gguf: Err("a toy"),
    missing_tokenizer: "tokenizer.json",
    decoder_config: |files| (llava().decoder_config)(files),
    open: |files, weights| Ok(Box::new(ToyModel((llava().open)(files, weights)?))),
    about: About {
        models: "toys",
        gguf: &[],
        tested: "this file",
        example: "toy",
    },
};

#[derive(Debug)]
struct ToyModel(Box<dyn VisionLanguageModel>);

fn llava() -> &'static Family {
    Architecture::named("llava").unwrap().family()
}

impl VisionLanguageModel for ToyModel {
    fn info(&self) -> &ModelInfo {
        self.0.info()
    }

    fn image_layout(&self, width: u32, height: u32) -> Result<ImageLayout, MllmError> {
        self.0.image_layout(width, height)
    }

    fn preprocess(&self, image: &RgbImage) -> Result<Tiles, MllmError> {
        self.0.preprocess(&image::imageops::rotate180(image))
    }

    fn encode(&self, tiles: &Tiles) -> candle_core::Result<ImageFeatures> {
        self.0.encode(tiles)
    }

    fn chat_format(
        &self,
        files: &ModelFiles,
        tokenizer: &ChatTokenizer,
    ) -> Result<Box<dyn ChatFormat>, MllmError> {
        self.0.chat_format(files, tokenizer)
    }

    fn positions(&self, tokens: Range<usize>, images: &[PlacedImage]) -> Positions {
        self.0.positions(tokens, images)
    }

    fn decoder(&self) -> &dyn LanguageModel {
        self.0.decoder()
    }
}

/// The answer to the reference chat, its image turned upside down first if `turned`.
fn answer(model: &dyn Mllm, turned: bool) -> String {
    let mut prefix = prefix();
    if turned {
        prefix.image = prefix
            .image
            .map(|image| image::imageops::rotate180(image.as_ref()).into());
    }
    model
        .converse(&prefix, 0)
        .unwrap()
        .ask(FIRST, &free(12))
        .unwrap()
        .text
}

#[test]
fn a_family_from_outside_opens_its_checkpoints() {
    let copy = Copy::new();
    copy.edit("config.json", |config| {
        config["model_type"] = "toy".into();
    });
    copy.edit_tensors(|tensors| {
        *tensors = std::mem::take(tensors)
            .into_iter()
            .map(|(name, tensor)| (format!("toy.{name}"), tensor))
            .collect();
    });
    let registry = ModelRegistry::new(
        "models",
        HubAccess {
            offline: true,
            ..HubAccess::default()
        },
    );
    let registry = registry.with_trust(Trust::Caller);
    let folder = copy.folder().to_str().unwrap();
    let unknown = registry.open(&registry.find(folder).unwrap());
    assert!(matches!(unknown, Err(MllmError::Config { key, .. }) if key == "model_type"));
    assert!(copy.error().to_string().contains("toy"));

    let registry = registry.with_family(&TOY);
    let model = registry.open(&registry.find(folder).unwrap()).unwrap();
    assert_eq!(
        Families::default()
            .with(&TOY)
            .detect(copy.folder())
            .unwrap()
            .name(),
        "toy"
    );
    let plain = open();
    assert_eq!(answer(&*model, true), answer(&plain, false));
    assert_eq!(answer(&*model, false), answer(&plain, true));
}
