//! Chats with several images, against transformers (`tests/fixtures/make_several.py`).

use super::test_prompts::{Prompts, json_of};
use super::test_reference::{LOGIT_TOLERANCE, Reference, difference, fixture};
use super::{LocalModel, Sequence};
use crate::decoder::Logits;
use crate::family::{Chat, ChatImage, ImageFeatures, ImageLayout, PlacedImage};
use crate::{
    Answer, Constraint, Conversation, Deadline, Mark, Mllm, MllmError, PromptPrefix, Request,
    Sampling, Turn,
};
use candle_core::{DType, Device, Tensor};
use image::RgbImage;
use serde_json::Value;
use std::sync::Arc;

/// Of the vocabulary, the reference has the logits of every third token.
const STEP: u32 = 3;

/// The chats with two images of a folder.
struct Several {
    local: LocalModel,
    images: Vec<Arc<RgbImage>>,
    texts: Value,
    reference: Reference,
}

/// A chat of the reference: the turn of each image, and which image it is.
struct Run {
    name: &'static str,
    shown: &'static [(usize, usize)],
    questions: usize,
}

const RUNS: [Run; 3] = [
    Run {
        name: "together_",
        shown: &[(0, 0), (0, 1)],
        questions: 1,
    },
    Run {
        name: "turns_",
        shown: &[(0, 0), (1, 1)],
        questions: 2,
    },
    Run {
        name: "again_",
        shown: &[(1, 1)],
        questions: 2,
    },
];

impl Several {
    fn open(name: &str) -> Self {
        let folder = fixture(name);
        let image = |index: usize| {
            let path = folder.join(format!("image_{index}.png"));
            Arc::new(image::open(path).unwrap().into_rgb8())
        };
        Self {
            local: Prompts::open_at(&folder),
            images: vec![image(0), image(1)],
            texts: json_of(&folder, "prompts.json"),
            reference: Reference::open(&folder.join("several.safetensors")),
        }
    }

    fn text(&self, key: &str) -> &str {
        self.texts[key].as_str().unwrap()
    }

    fn prompt(&self, turn: usize) -> &str {
        self.texts["prompts"][turn].as_str().unwrap()
    }

    /// Whole numbers of the reference.
    fn numbers(&self, run: &Run, key: &str) -> Vec<u32> {
        let stored = self.reference.tensor(&format!("{}{key}", run.name));
        let stored = stored.to_dtype(DType::U32).unwrap();
        stored.flatten_all().unwrap().to_vec1().unwrap()
    }

    /// The layouts and the features of a run's images.
    fn encoded(&self, run: &Run) -> (Vec<ImageLayout>, Option<ImageFeatures>) {
        let model = self.local.model();
        let several = run.shown.len() > 1;
        let parts = run.shown.iter().map(|(_, image)| {
            let image = &self.images[*image];
            let (width, height) = image.dimensions();
            if several {
                let layout = model.layout_of_several(width, height).unwrap();
                (layout, model.encode_of_several(image).unwrap())
            } else {
                let layout = model.image_layout(width, height).unwrap();
                (layout, model.encode_image(image).unwrap())
            }
        });
        let (layouts, parts): (Vec<_>, Vec<_>) = parts.unzip();
        (layouts, ImageFeatures::joined(&parts).unwrap())
    }

    /// The tokens of a run's chat.
    fn ids(&self, run: &Run, layouts: &[ImageLayout]) -> Result<Vec<u32>, MllmError> {
        let first = Turn {
            prompt: self.prompt(0).to_owned(),
            answer: self.text("first_answer").to_owned(),
        };
        let images: Vec<ChatImage> = run
            .shown
            .iter()
            .zip(layouts)
            .map(|((turn, _), layout)| ChatImage {
                turn: *turn,
                layout: *layout,
            })
            .collect();
        self.local.prompt_ids(&Chat {
            system: self.text("system"),
            images: &images,
            turns: &vec![first; run.questions - 1],
            prompt: self.prompt(run.questions - 1),
        })
    }

    /// Checks tokens, positions, logits and greedy tokens of a run; gives the largest difference of
    /// logits.
    fn check(&self, run: &Run) -> f32 {
        let model = self.local.model();
        let (layouts, features) = self.encoded(run);
        let ids = self.ids(run, &layouts).unwrap();
        assert_eq!(ids, self.numbers(run, "input_ids"), "{}", run.name);
        let token = model.info().image_token;
        let placed = PlacedImage::all(ids.iter().copied(), token, &layouts);
        assert_eq!(placed.len(), layouts.len());
        let axes = if self
            .reference
            .contains(&format!("{}position_ids", run.name))
        {
            self.numbers(run, "position_ids")
        } else {
            (0..3).flat_map(|_| 0..ids.len() as u32).collect()
        };
        let expected: Vec<[u32; 3]> = (0..ids.len())
            .map(|at| [0, 1, 2].map(|axis| axes[axis * ids.len() + at]))
            .collect();
        for part in [0..ids.len(), 0..9, 9..31, 31..ids.len()] {
            let found = model.positions(part.clone(), &placed).rotary;
            assert_eq!(found, expected[part], "{}", run.name);
        }
        let expected = self.reference.tensor(&format!("{}logits", run.name));
        let mut worst = 0f32;
        for pieces in [&[][..], &[5, 20, 30, 1]] {
            let found = self.logits(&ids, features.as_ref(), pieces);
            worst = worst.max(difference(&found, expected));
        }
        let greedy = self.numbers(run, "generated");
        let mut sequence = Sequence::new(model);
        sequence.begin(model, &ids, &layouts);
        let mut next = ids;
        for (place, expected) in greedy.iter().enumerate() {
            let logits = sequence.append(model, &next, features.as_ref(), Logits::Last);
            let best = logits.unwrap().unwrap().argmax(1).unwrap();
            next = best.to_vec1::<u32>().unwrap();
            assert_eq!(next, [*expected], "{}: greedy token {place}", run.name);
        }
        worst
    }

    /// The logits of the last positions that the reference has, computed in pieces.
    fn logits(&self, ids: &[u32], features: Option<&ImageFeatures>, pieces: &[usize]) -> Tensor {
        let model = self.local.model();
        let mut sequence = Sequence::new(model);
        let (mut rest, mut last) = (ids, None);
        for piece in pieces.iter().copied().chain([ids.len()]) {
            let (now, later) = rest.split_at(piece.min(rest.len()));
            last = sequence
                .append(model, now, features, Logits::Tail(2))
                .unwrap();
            rest = later;
        }
        let last = last.unwrap();
        let kept: Vec<u32> = (0..last.dims()[1] as u32).step_by(STEP as usize).collect();
        let count = kept.len();
        let kept = Tensor::from_vec(kept, count, &Device::Cpu).unwrap();
        last.index_select(&kept, 1).unwrap()
    }
}

/// Families with what transformers computes of several images.
const FOLDERS: [&str; 10] = [
    "tiny_llava_onevision",
    "tiny_qwen2_vl",
    "tiny_qwen2_5_vl",
    "tiny_qwen3_vl",
    "tiny_qwen3_5",
    "tiny_smolvlm",
    "tiny_internvl3",
    "tiny_gemma3",
    "tiny_gemma4",
    "tiny_lfm2_vl",
];

#[test]
fn several_images_are_read_as_transformers_reads_them() {
    for name in FOLDERS {
        let several = Several::open(name);
        let worst = RUNS.iter().map(|run| several.check(run));
        let worst = worst.fold(0.0, f32::max);
        println!("{name}: worst logits {worst:.1e}");
        assert!(
            worst < LOGIT_TOLERANCE,
            "{name}: the logits differ by {worst}"
        );
    }
}

/// Each mistake lies in what a chat of several images has beside that of one.
#[test]
fn errors_that_are_easily_made_lead_far_away() {
    for name in FOLDERS {
        let several = Several::open(name);
        let run = &RUNS[0];
        let (layouts, features) = several.encoded(run);
        let ids = several.ids(run, &layouts).unwrap();
        let expected = several.reference.tensor("together_logits");
        let features = features.unwrap();
        let deviation = |features: &ImageFeatures| {
            difference(&several.logits(&ids, Some(features), &[]), expected)
        };
        let rows = |first: usize, second: usize| {
            let order: Vec<u32> = (first..features.tokens())
                .chain(0..second)
                .map(|row| row as u32)
                .collect();
            let count = order.len();
            let order = Tensor::from_vec(order, count, &Device::Cpu).unwrap();
            ImageFeatures {
                rows: features.rows.index_select(&order, 0).unwrap(),
                deep: features
                    .deep
                    .iter()
                    .map(|deep| deep.index_select(&order, 0).unwrap())
                    .collect(),
                layouts: features.layouts.clone(),
            }
        };
        let first = layouts[0].tokens;
        let swapped = deviation(&rows(first, first));
        println!("{name}: the images exchanged {swapped:.1e}");
        assert!(swapped > 100.0 * LOGIT_TOLERANCE, "{name}: {swapped}");
        if name == "tiny_llava_onevision" {
            let alone: Vec<usize> = several
                .images
                .iter()
                .map(|image| several.local.model().encode_image(image).unwrap().tokens())
                .collect();
            assert!(
                alone
                    .iter()
                    .zip(&layouts)
                    .all(|(alone, layout)| *alone > layout.tokens)
            );
        }
        let one = ImageLayout {
            tokens: features.tokens(),
            ..layouts[0]
        };
        let joined = ImageFeatures {
            layouts: vec![one],
            ..features.clone()
        };
        let found = deviation(&joined);
        let told = several.local.model().image_at_once()
            || several.reference.contains("together_position_ids");
        println!("{name}: the images as one {found:.1e}");
        assert_eq!(found > 100.0 * LOGIT_TOLERANCE, told, "{name}: {found}");
    }
}

fn ask(conversation: &mut dyn Conversation, prompt: &str) -> Answer {
    let request = Request {
        constraint: Constraint::Free,
        max_new_tokens: 12,
        sampling: Sampling::Greedy,
        deadline: Deadline::NONE,
        draft: None,
    };
    conversation.ask(prompt, &request).unwrap()
}

/// Tokens of a prompt.
fn length(answer: &Answer) -> usize {
    let tokens = answer.tokens;
    tokens.text + tokens.image + tokens.cached
}

/// A chat of a folder, and its answers.
struct Chatting<'a> {
    several: &'a Several,
    conversation: Box<dyn Conversation + 'a>,
}

impl<'a> Chatting<'a> {
    /// Begins a chat with an image of the prompt prefix.
    fn begin(several: &'a Several, image: Option<&Arc<RgbImage>>) -> Self {
        let prefix = PromptPrefix {
            system: several.text("system").into(),
            image: image.cloned(),
        };
        Self {
            several,
            conversation: several.local.converse(&prefix, 0).unwrap(),
        }
    }

    fn show(&mut self, image: &Arc<RgbImage>) {
        self.conversation.show(std::slice::from_ref(image)).unwrap();
    }

    /// Asks the question of a turn.
    fn ask(&mut self, turn: usize) -> Answer {
        ask(&mut *self.conversation, self.several.prompt(turn))
    }

    fn ids(&mut self, turn: usize) -> Vec<u32> {
        self.ask(turn).ids
    }
}

/// Whatever was asked and rewound before, a chat has the answer of one that has just begun.
#[test]
fn images_are_shown_and_rewound() {
    for name in FOLDERS {
        let several = Several::open(name);
        let [first, second] = [&several.images[0], &several.images[1]];
        let fresh = |later: &Arc<RgbImage>| {
            let mut chat = Chatting::begin(&several, Some(first));
            chat.show(later);
            chat.ask(0)
        };
        let both = fresh(second);
        let one = Chatting::begin(&several, Some(first)).ids(0);
        // An answer may end before the reference does.
        let expected = several.numbers(&RUNS[0], "generated");
        assert!(expected.starts_with(&both.ids), "{name}: {:?}", both.ids);
        let mut later = Chatting::begin(&several, None);
        later.show(first);
        later.show(second);
        assert_eq!(later.ids(0), both.ids, "{name}: none in the prefix");

        let mut chat = Chatting::begin(&several, Some(first));
        let start = chat.conversation.mark();
        assert_eq!(chat.ids(0), one, "{name}");
        chat.conversation.rewind(start);
        chat.show(second);
        let shown = chat.conversation.mark();
        let again = chat.ask(0);
        assert_eq!(again.ids, both.ids, "{name}: after a chat of one image");
        assert_eq!(length(&again), length(&both), "{name}");
        chat.conversation.rewind(shown);
        assert_eq!(chat.ids(0), both.ids, "{name}: asked again");
        chat.conversation.rewind(start);
        assert_eq!(chat.ids(0), one, "{name}: without the second");
        chat.conversation.rewind(start);
        // Another image of the same size in the place of one that was rewound.
        chat.show(second);
        chat.ask(0);
        chat.conversation.rewind(start);
        let black = Arc::new(RgbImage::new(second.width(), second.height()));
        chat.show(&black);
        let found = chat.ids(0);
        assert_eq!(found, fresh(&black).ids, "{name}: another image");
    }
}

#[test]
fn a_later_turn_has_an_image_of_its_own() {
    for name in FOLDERS {
        let several = Several::open(name);
        let [first, second] = [&several.images[0], &several.images[1]];
        let mut chat = Chatting::begin(&several, Some(first));
        chat.ask(0);
        let between = chat.conversation.mark();
        chat.show(second);
        let answer = chat.ask(1);
        assert!(answer.tokens.image > 0, "{name}");
        chat.conversation.rewind(between);
        let without = chat.ask(1);
        assert_ne!(length(&without), length(&answer), "{name}");
        chat.conversation.rewind(between);
        chat.show(second);
        assert_eq!(chat.ids(1), answer.ids, "{name}");
        // A mark of a chat that was another: no image is left that belongs to a later turn.
        chat.conversation.rewind(Mark::default());
        chat.show(second);
        chat.show(first);
        let stale = chat.conversation.mark();
        chat.conversation.rewind(Mark::default());
        chat.ask(0);
        chat.show(second);
        chat.conversation.rewind(stale);
        chat.conversation.rewind(Mark::default());
        chat.ask(0);
    }
}

#[test]
fn a_model_of_one_picture_or_none_says_so() {
    let picture = Arc::new(RgbImage::new(32, 32));
    let one = std::slice::from_ref(&picture);
    for (name, expected) in [
        (
            "tiny_cogvlm",
            "chats of this model have one picture, with the first prompt",
        ),
        ("tiny_lfm2", "reads text alone"),
    ] {
        let local = Prompts::open_at(&fixture(name));
        let mut conversation = local.converse(&PromptPrefix::default(), 0).unwrap();
        if name == "tiny_cogvlm" {
            conversation.show(one).unwrap();
        }
        let error = conversation.show(one).unwrap_err().to_string();
        assert!(error.contains(expected), "{name}: {error}");
        // The conversation is as before.
        let image = ask(&mut *conversation, "Which lane?").tokens.image;
        assert_eq!(image > 0, name == "tiny_cogvlm");
        let error = conversation.show(one).unwrap_err().to_string();
        assert!(error.contains(expected), "{name}: {error}");
    }
}
