//! Checks of a model's files that do not read its weights.

use super::grouped::grouped;
use super::{Loading, LocalModel, MemoryCheck, MemoryNeed, PictureNeed, end_tokens, memory};
use crate::checkpoint::{LoadReport, ModelFiles, WeightFormatPlan, Weights};
use crate::families::Architecture;
use crate::family::{Chat, ChatFormat, ChatImage, ImageLayout, VisionLanguageModel};
use crate::source::{Checkpoint, ModelPlace};
use crate::text::{ChatTokenizer, GrammarEngine};
use crate::{MllmError, Turn};
use image::RgbImage;
use serde::Serialize;

/// System prompt, prompt and answer of the chats that a check writes.
const WORDS: [&str; 3] = ["You drive a car.", "Which lane?", "The lane of the ego."];
/// Earlier rounds of the longest of them: a planning call has three rounds.
const EARLIER_ROUNDS: usize = 2;

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ModelCheck {
    /// The family of the model, if its files name one.
    pub architecture: Option<Architecture>,
    /// What the files call the model, where that is no known family.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub kind: Option<String>,
    /// Number of weights in its files.
    pub parameters: u64,
    /// The formats of its weights in memory.
    pub load: LoadReport,
    pub memory: Option<MemoryNeed>,
    /// All errors; empty if the model can be opened. Weights that are not finite show only when it
    /// is opened.
    pub problems: Vec<String>,
}

impl ModelCheck {
    /// The check of a model that is not opened because of an error.
    pub(crate) fn refused(place: &ModelPlace, error: &MllmError) -> Self {
        let mut check = Self::empty();
        check.add_facts(place);
        check.problems.push(error.to_string());
        check
    }

    fn empty() -> Self {
        Self {
            architecture: None,
            kind: None,
            parameters: 0,
            load: LoadReport::default(),
            memory: None,
            problems: Vec::new(),
        }
    }

    /// What a refused model says of itself: nobody can tell two refused files apart without it.
    fn add_facts(&mut self, place: &ModelPlace) {
        if let Some((kind, parameters)) = place.facts() {
            (self.kind, self.parameters) = (Some(kind), parameters);
        }
    }
}

impl LocalModel {
    /// Opens the small files of a model and the headers of its weights, and collects the errors.
    pub fn check(place: &ModelPlace, loading: &Loading) -> ModelCheck {
        let mut check = ModelCheck::empty();
        look(place, loading, &mut check);
        check
    }

    /// Why a model cannot draft for another, where each can be opened alone.
    pub(crate) fn check_draft(
        [place, draft_place]: [&ModelPlace; 2],
        [loading, draft_loading]: [&Loading; 2],
    ) -> Result<(), MllmError> {
        let own = tokenizer_of(place, loading)?;
        match tokenizer_of(draft_place, draft_loading)?.vocabulary_difference(&own) {
            None => Ok(()),
            Some(problem) => Err(MllmError::DraftModel {
                place: draft_place.path().to_path_buf(),
                problem,
            }),
        }
    }
}

fn tokenizer_of(place: &ModelPlace, loading: &Loading) -> Result<ChatTokenizer, MllmError> {
    let mut checkpoint = loading.open(place)?;
    let files = loading.tokenizer(&checkpoint.files, checkpoint.family)?;
    checkpoint.weights.only_look();
    let model = checkpoint.open_model()?;
    let info = model.info();
    ChatTokenizer::open(&files, info.vocabulary, info.image_token)
}

/// Collects the errors of a model.
fn look(place: &ModelPlace, loading: &Loading, check: &mut ModelCheck) {
    let checkpoint = match loading.open(place) {
        Ok(checkpoint) => checkpoint,
        Err(error) => {
            check.problems.push(error.to_string());
            check.add_facts(place);
            // The small files may have errors of their own.
            if let ModelPlace::Folder(folder) = place
                && let Ok(files) = ModelFiles::folder(folder)
                && let Ok(family) = loading.families.detect_in(&files)
            {
                check.architecture = Some(family);
                look_at_files(&files, family, loading, check);
            }
            return;
        }
    };
    check.load = checkpoint.weights.forecast(loading.quantize);
    check.parameters = checkpoint.weights.elements() as u64;
    let family = checkpoint.family;
    note(check, loading.check_family(&checkpoint));
    check.architecture = Some(family);
    look_at_weights(checkpoint, loading, check);
}

/// Checks the weights, then the files that chats need.
fn look_at_weights(mut checkpoint: Checkpoint, loading: &Loading, check: &mut ModelCheck) {
    let family = checkpoint.family;
    match checkpoint.decoder_config() {
        Ok(decoder) => {
            let picture = PictureNeed::estimate(&checkpoint, loading.image);
            check.memory = Some(MemoryNeed::estimate(
                &checkpoint,
                &decoder,
                picture,
                loading.quantize,
                loading.context,
            ));
            if loading.memory == MemoryCheck::Refuse {
                note(
                    check,
                    memory::check(
                        &checkpoint,
                        &decoder,
                        picture,
                        loading.quantize,
                        loading.context,
                    ),
                );
            }
        }
        Err(error) => check.problems.push(error.to_string()),
    }
    checkpoint.weights.only_look();
    let model = checkpoint.open_model();
    check
        .load
        .notes
        .clone_from(&checkpoint.weights.report().notes);
    let problems = checkpoint.weights.take_problems().into_iter();
    let problems: Vec<_> = problems
        .map(|error| checkpoint.by_own_name(error))
        .collect();
    check.problems.extend(grouped(&problems));
    match model {
        Ok(model) => look_at_chats(model, &checkpoint.files, family, loading, check),
        Err(error) => {
            // The collected errors say more than the one that ended the check.
            if check.problems.is_empty() {
                check.problems.push(error.to_string());
            }
            look_at_files(&checkpoint.files, family, loading, check);
        }
    }
}

/// Checks the small files of a model whose weights are not checked.
fn look_at_files(
    files: &ModelFiles,
    family: Architecture,
    loading: &Loading,
    check: &mut ModelCheck,
) {
    let mut weights = Weights::empty(files.place(), WeightFormatPlan::default());
    weights.only_list();
    match (family.family().open)(files, &mut weights) {
        Ok(model) => look_at_chats(model, files, family, loading, check),
        Err(error) => {
            note::<()>(check, Err(files.by_own_key(error)));
            let tokenizer = loading
                .tokenizer(files, family)
                .and_then(|files| files.required_json("tokenizer.json"));
            note(check, tokenizer);
        }
    }
}

/// Checks what writes a chat and what ends it.
fn look_at_chats(
    mut model: Box<dyn VisionLanguageModel>,
    files: &ModelFiles,
    family: Architecture,
    loading: &Loading,
    check: &mut ModelCheck,
) {
    note(check, model.set_images(loading.image));
    let layout = look_at_image(&*model, loading);
    let image = layout.as_ref().ok().copied().flatten();
    note(check, layout);
    let info = model.info();
    let open = |files: ModelFiles| ChatTokenizer::open(&files, info.vocabulary, info.image_token);
    match loading.tokenizer(files, family).and_then(open) {
        Ok(tokenizer) => {
            match model.chat_format(files, &tokenizer) {
                Ok(format) => look_at_rounds(&*format, &tokenizer, image, check),
                Err(error) => note::<()>(check, Err(error)),
            }
            let ends = end_tokens(files, &tokenizer, info.vocabulary);
            let grammars = ends.and_then(|ends| GrammarEngine::new(&tokenizer, &ends));
            note(check, grammars);
        }
        Err(error) => note::<()>(check, Err(error)),
    }
}

/// Prepares a picture of the side that is drawn for the model, if it takes one, and checks that its
/// tokens leave room for a chat.
fn look_at_image(
    model: &dyn VisionLanguageModel,
    loading: &Loading,
) -> Result<Option<ImageLayout>, MllmError> {
    let Some((side, layout)) = model.info().image_size.zip(model.drawn_layout()?) else {
        return Ok(None);
    };
    let side = side as u32;
    let context = model.context(layout.tokens);
    let context = loading.context.map_or(context, |limit| limit.min(context));
    if layout.tokens >= context {
        let tokens = layout.tokens;
        let problem = format!(
            "a picture of {side} x {side} pixels becomes {tokens} tokens, and the context has {context}"
        );
        return Err(MllmError::Image { problem });
    }
    model.preprocess(&RgbImage::new(side, side))?;
    Ok(Some(layout))
}

/// Writes the chats of all rounds: a template may refuse a system prompt, or a second question.
fn look_at_rounds(
    format: &dyn ChatFormat,
    tokenizer: &ChatTokenizer,
    image: Option<ImageLayout>,
    check: &mut ModelCheck,
) {
    let [system, prompt, answer] = WORDS;
    let turn = Turn {
        prompt: prompt.to_owned(),
        answer: answer.to_owned(),
    };
    let turns = vec![turn; EARLIER_ROUNDS];
    let images: Vec<ChatImage> = image.map(ChatImage::first).into_iter().collect();
    for earlier in 0..=turns.len() {
        let chat = Chat {
            system,
            images: &images,
            turns: turns
                .get(..earlier)
                .expect("no more rounds are earlier than there are"),
            prompt,
        };
        let written = format.ids(tokenizer, &chat);
        let failed = written.is_err();
        note(check, written);
        if failed {
            // Later rounds fail for the same reason, in words that differ by numbers.
            break;
        }
    }
}

/// Notes an error once.
fn note<T>(check: &mut ModelCheck, outcome: Result<T, MllmError>) {
    let problem = outcome.err().map(|error| error.to_string());
    check
        .problems
        .extend(problem.filter(|problem| !check.problems.contains(problem)));
}
