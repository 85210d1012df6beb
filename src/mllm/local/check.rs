//! Checks of a model's files that do not read its weights.

use serde::Serialize;

use super::{Loading, LocalModel, MemoryCheck, MemoryNeed, end_tokens, memory};
use crate::mllm::MllmError;
use crate::mllm::checkpoint::LoadReport;
use crate::mllm::families::Architecture;
use crate::mllm::source::{Checkpoint, ModelPlace};
use crate::mllm::text::ChatTokenizer;

#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ModelCheck {
    /// The family of the model, if its files name one.
    pub architecture: Option<Architecture>,
    /// Number of weights in its files.
    pub parameters: u64,
    /// The formats of its weights in memory.
    pub load: LoadReport,
    pub memory: Option<MemoryNeed>,
    /// All errors; empty if the model can be opened. Weights that are not finite show only when it is opened.
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
        if let Err(error) = look(place, loading, &mut check) {
            check.problems.push(error.to_string());
        }
        check
    }
}

/// Collects errors that do not hinder further checks, and ends with the first one that does.
fn look(place: &ModelPlace, loading: &Loading, check: &mut ModelCheck) -> Result<(), MllmError> {
    let mut checkpoint = Checkpoint::open(place, loading.quantize, &loading.families)?;
    check.load = checkpoint.weights.forecast(loading.quantize);
    check.parameters = checkpoint.weights.elements() as u64;
    loading.check_family(&checkpoint)?;
    check.architecture = Some(checkpoint.family);
    let decoder = (checkpoint.family.family().decoder_config)(&checkpoint.files)?;
    check.memory = Some(MemoryNeed::of(&checkpoint, &decoder, loading.quantize));
    if loading.memory == MemoryCheck::Refuse {
        note(check, memory::check(&checkpoint, &decoder, loading.quantize));
    }
    checkpoint.weights.only_look();
    let model = checkpoint.open_model();
    check.problems.extend(checkpoint.weights.problems().iter().map(ToString::to_string));
    let model = match model {
        Ok(mut model) => {
            note(check, model.set_images(loading.image));
            model
        }
        // The collected errors say more than the one that ended the check.
        Err(_) if !check.problems.is_empty() => return Ok(()),
        Err(error) => return Err(error),
    };
    let files = &checkpoint.files;
    let info = model.info();
    let tokenizer = loading.tokenizer(&checkpoint)?;
    let tokenizer = ChatTokenizer::open(&tokenizer, info.vocabulary, info.image_token)?;
    note(check, model.chat_format(files, &tokenizer));
    note(check, end_tokens(files, &tokenizer, info.vocabulary));
    Ok(())
}

fn note<T>(check: &mut ModelCheck, outcome: Result<T, MllmError>) {
    check.problems.extend(outcome.err().map(|error| error.to_string()));
}
