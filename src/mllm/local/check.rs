//! Checks of a model's files that do not read its weights.

use super::{Loading, LocalModel, MemoryCheck, MemoryNeed, end_tokens, memory};
use crate::MllmError;
use crate::checkpoint::{LoadReport, ModelFiles, WeightFormatPlan, Weights};
use crate::families::Architecture;
use crate::family::VisionLanguageModel;
use crate::source::{Checkpoint, ModelPlace};
use crate::text::ChatTokenizer;
use serde::Serialize;

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ModelCheck {
    /// The family of the model, if its files name one.
    pub architecture: Option<Architecture>,
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
    pub(crate) fn refused(error: &MllmError) -> Self {
        Self {
            architecture: None,
            parameters: 0,
            load: LoadReport::default(),
            memory: None,
            problems: vec![error.to_string()],
        }
    }
}

impl LocalModel {
    /// Opens the small files of a model and the headers of its weights, and collects the errors.
    pub fn check(place: &ModelPlace, loading: &Loading) -> ModelCheck {
        let mut check = ModelCheck {
            architecture: None,
            parameters: 0,
            load: LoadReport::default(),
            memory: None,
            problems: Vec::new(),
        };
        look(place, loading, &mut check);
        check
    }
}

/// Collects the errors of a model.
fn look(place: &ModelPlace, loading: &Loading, check: &mut ModelCheck) {
    let checkpoint = match Checkpoint::open(place, loading.quantize, &loading.families) {
        Ok(checkpoint) => checkpoint,
        Err(error) => {
            check.problems.push(error.to_string());
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
    match (family.family().decoder_config)(&checkpoint.files) {
        Ok(decoder) => {
            check.memory = Some(MemoryNeed::estimate(
                &checkpoint,
                &decoder,
                loading.quantize,
                loading.context,
            ));
            if loading.memory == MemoryCheck::Refuse {
                note(
                    check,
                    memory::check(&checkpoint, &decoder, loading.quantize, loading.context),
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
    check.problems.extend(
        checkpoint
            .weights
            .problems()
            .iter()
            .map(ToString::to_string),
    );
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
            note::<()>(check, Err(error));
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
    let info = model.info();
    let open = |files: ModelFiles| ChatTokenizer::open(&files, info.vocabulary, info.image_token);
    match loading.tokenizer(files, family).and_then(open) {
        Ok(tokenizer) => {
            note(check, model.chat_format(files, &tokenizer));
            note(check, end_tokens(files, &tokenizer, info.vocabulary));
        }
        Err(error) => note::<()>(check, Err(error)),
    }
}

/// Notes an error once.
fn note<T>(check: &mut ModelCheck, outcome: Result<T, MllmError>) {
    let problem = outcome.err().map(|error| error.to_string());
    check
        .problems
        .extend(problem.filter(|problem| !check.problems.contains(problem)));
}
