//! The work of a conversation, counted in passes of the decoder and images of the tower.

use super::LocalModel;
use super::test_reference::{fixture, open_checkpoint};
use crate::checkpoint::ModelFiles;
use crate::decoder::{DecoderCache, DecoderInput, LanguageModel, Logits};
use crate::family::{
    ChatFormat, ImageFeatures, ImageLayout, ModelInfo, PlacedImage, Positions, Tiles,
    VisionLanguageModel,
};
use crate::text::ChatTokenizer;
use crate::{Constraint, Deadline, Mllm, MllmError, PromptPrefix, Request, Sampling};
use candle_core::Tensor;
use image::RgbImage;
use std::ops::Range;
use std::path::Path;
use std::sync::{Arc, Mutex};

/// Rows of each pass, and number of images.
#[derive(Debug, Default, Clone, PartialEq, Eq)]
struct Computed {
    passes: Vec<usize>,
    images: usize,
}

/// A model that counts its passes and images.
#[derive(Debug)]
struct Counting {
    model: Box<dyn VisionLanguageModel>,
    computed: Arc<Mutex<Computed>>,
}

impl VisionLanguageModel for Counting {
    fn info(&self) -> &ModelInfo {
        self.model.info()
    }

    fn context(&self, image_tokens: usize) -> usize {
        self.model.context(image_tokens)
    }

    fn image_layout(&self, width: u32, height: u32) -> Result<ImageLayout, MllmError> {
        self.model.image_layout(width, height)
    }

    fn preprocess(&self, image: &RgbImage) -> Result<Tiles, MllmError> {
        self.computed.lock().unwrap().images += 1;
        self.model.preprocess(image)
    }

    fn encode(&self, tiles: &Tiles) -> candle_core::Result<ImageFeatures> {
        self.model.encode(tiles)
    }

    fn positions(&self, tokens: Range<usize>, images: &[PlacedImage]) -> Positions {
        self.model.positions(tokens, images)
    }

    fn chat_format(
        &self,
        files: &ModelFiles,
        tokenizer: &ChatTokenizer,
    ) -> Result<Box<dyn ChatFormat>, MllmError> {
        self.model.chat_format(files, tokenizer)
    }

    fn decoder(&self) -> &dyn LanguageModel {
        self
    }
}

impl LanguageModel for Counting {
    fn embed(&self, ids: &[u32]) -> candle_core::Result<Tensor> {
        self.model.decoder().embed(ids)
    }

    fn exact_pass(&self) -> usize {
        self.model.decoder().exact_pass()
    }

    fn new_cache(&self, limit: usize) -> DecoderCache {
        self.model.decoder().new_cache(limit)
    }

    fn forward(
        &self,
        input: &DecoderInput,
        cache: &mut DecoderCache,
        wanted: Logits,
    ) -> candle_core::Result<Option<Tensor>> {
        self.computed
            .lock()
            .unwrap()
            .passes
            .push(input.rows.dim(0)?);
        self.model.decoder().forward(input, cache, wanted)
    }
}

/// The checkpoint in a folder and its counts.
fn counted(folder: &Path) -> (LocalModel, Arc<Mutex<Computed>>) {
    let mut local = LocalModel::open("tiny", folder).unwrap();
    let computed = Arc::new(Mutex::new(Computed::default()));
    let model = open_checkpoint(folder).open_model().unwrap();
    local.model = Box::new(Counting {
        model,
        computed: Arc::clone(&computed),
    });
    (local, computed)
}

/// The system prompt and image of a checkpoint's reference.
fn prefix(folder: &Path) -> PromptPrefix {
    let image = ["image.png", "image_0.png"]
        .map(|name| folder.join(name))
        .into_iter()
        .find(|path| path.exists());
    let image = image::open(image.unwrap()).unwrap().into_rgb8();
    PromptPrefix {
        system: "Drive safely.".into(),
        image: Some(image.into()),
    }
}

fn request(constraint: Constraint, max_new_tokens: usize) -> Request {
    Request {
        constraint,
        max_new_tokens,
        sampling: Sampling::Greedy,
        deadline: Deadline::NONE,
        draft: None,
    }
}

#[test]
fn a_planning_call_encodes_its_image_once_and_computes_forced_tokens_in_one_pass() {
    for (name, shared) in [
        ("tiny_llava", true),
        ("tiny_llava_next", true),
        ("tiny_cogvlm", false),
    ] {
        check_planning_calls(name, &fixture(name), shared);
    }
}

#[test]
fn families_of_today_compute_as_little() {
    for name in [
        "tiny_smolvlm",
        "tiny_internvl3",
        "tiny_qwen3_vl",
        "tiny_qwen2_5_vl",
        "tiny_qwen2_vl",
        "tiny_llava_onevision",
        "tiny_gemma3",
        "tiny_gemma3n_vision",
        "tiny_gemma4",
        "tiny_lfm2_vl",
        "tiny_qwen3_5",
    ] {
        check_planning_calls(name, &fixture(name), true);
    }
}

/// Counts the work of two planning calls; `shared` says whether they share the system prompt.
fn check_planning_calls(name: &str, folder: &Path, shared: bool) {
    let (local, computed) = counted(folder);
    let take = || std::mem::take(&mut *computed.lock().unwrap());
    let prefix = prefix(folder);
    for call in 0..2 {
        let mut conversation = local.converse(&prefix, 0).unwrap();
        // Only the first call computes the system prompt before the image; a CogVLM has none there.
        let before = take().passes;
        assert_eq!(
            before.len(),
            usize::from(shared && call == 0),
            "{name}: {before:?}"
        );
        let start = conversation.mark();
        let first = conversation
            .ask("Look.", &request(Constraint::Regex("[a-f]{4}".into()), 8))
            .unwrap();
        let Computed { passes, images } = take();
        assert_eq!(images, 1, "{name}");
        assert_eq!(
            passes[0],
            first.tokens.text + first.tokens.image,
            "{name}: {passes:?}"
        );
        assert!(
            passes[1..].iter().all(|rows| *rows == 1) && passes.len() <= first.tokens.sampled,
            "{name}: {passes:?}"
        );
        assert_eq!(first.tokens.cached > 0, shared);
        let second = conversation
            .ask(
                "Now?",
                &request(Constraint::Choice(vec!["keep left".into()]), 16),
            )
            .unwrap();
        assert_eq!(
            take(),
            Computed::default(),
            "{name}: nothing of {:?} is the model's choice",
            second.text
        );
        let third = conversation
            .ask(
                "Code?",
                &request(Constraint::Regex("x = [0-9]; end".into()), 32),
            )
            .unwrap();
        let Computed { passes, images } = take();
        assert_eq!(
            (passes.len(), images),
            (third.tokens.sampled, 0),
            "{name}: a pass for each free token: {passes:?}"
        );
        assert!(
            third.tokens.fast_forwarded > third.tokens.sampled,
            "{:?}",
            third.tokens
        );
        // What the first two rounds left uncomputed, and the fast-forwarded tokens before the
        // number.
        assert!(
            passes[0] > third.tokens.text + third.tokens.image,
            "{passes:?} {:?}",
            third.tokens
        );
        conversation.rewind(start);
        let again = conversation
            .ask(
                "Look again.",
                &request(Constraint::Regex("[a-f]{4}".into()), 8),
            )
            .unwrap();
        let Computed { passes, images } = take();
        assert_eq!(
            (images, again.tokens.image),
            (0, 0),
            "{name}: the features are kept"
        );
        assert_eq!(passes[0], again.tokens.text, "{name}: {passes:?}");
        assert!(
            again.tokens.cached >= first.tokens.cached + first.tokens.image,
            "{name}: {:?}",
            again.tokens
        );
    }
}

#[test]
fn a_prompt_that_leaves_no_choice_is_computed_and_counted_by_the_next_round() {
    for name in ["tiny_llava", "tiny_cogvlm"] {
        let (local, computed) = counted(&fixture(name));
        let take = || std::mem::take(&mut *computed.lock().unwrap());
        let prefix = prefix(&fixture(name));
        let mut conversation = local.converse(&prefix, 0).unwrap();
        let known: usize = take().passes.iter().sum();
        let first = conversation
            .ask(
                "Look.",
                &request(Constraint::Choice(vec!["keep".into()]), 8),
            )
            .unwrap();
        assert_eq!(
            (first.tokens.text, first.tokens.image, first.tokens.cached),
            (0, 0, known),
            "{name}"
        );
        assert_eq!(
            take(),
            Computed {
                passes: Vec::new(),
                images: 1
            },
            "{name}"
        );
        let second = conversation
            .ask("Now?", &request(Constraint::Regex("[a-f]{4}".into()), 8))
            .unwrap();
        let Computed { passes, images } = take();
        assert_eq!(
            (passes[0], images),
            (second.tokens.text + second.tokens.image, 0),
            "{name}"
        );
        assert_eq!(
            (second.tokens.image, second.tokens.cached),
            (local.describe().image_tokens, known),
            "{name}"
        );
    }
}
