//! Looking at a model's files without reading its weights.

use serde::Serialize;

use super::{Architecture, Loading, LocalModel, MemoryCheck, MemoryNeed, end_tokens, memory};
use crate::mllm::MllmError;
use crate::mllm::checkpoint::{Checkpoint, LoadReport, ModelPlace};
use crate::mllm::text::ChatTokenizer;

/// What a look at a model's files found.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ModelCheck {
    /// The family of the model, if its files say.
    pub architecture: Option<Architecture>,
    /// Number of weights in its files.
    pub parameters: u64,
    /// How its weights would be held.
    pub load: LoadReport,
    /// The memory that it would need.
    pub memory: Option<MemoryNeed>,
    /// Everything that is wrong; empty if it can be opened. Whether each weight is finite shows only when it is.
    pub problems: Vec<String>,
}

impl LocalModel {
    /// Opens the small files of a model and the headers of its weights, and says all that is wrong with them.
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

/// Notes what can be gone on from, and ends with the first error that cannot.
fn look(place: &ModelPlace, loading: &Loading, check: &mut ModelCheck) -> Result<(), MllmError> {
    let mut checkpoint = Checkpoint::open(place, loading.quantize)?;
    check.load = checkpoint.weights.forecast(loading.quantize);
    check.parameters = checkpoint.weights.elements() as u64;
    let architecture = loading.architecture(&checkpoint.files)?;
    check.architecture = Some(architecture);
    let decoder = architecture.decoder(&checkpoint.files)?;
    check.memory = Some(MemoryNeed::of(&checkpoint, &decoder, loading.quantize));
    if loading.memory == MemoryCheck::Refuse {
        note(check, memory::check(&checkpoint, &decoder, loading.quantize));
    }
    checkpoint.weights.only_look();
    let model = architecture.open(&mut checkpoint);
    check.problems.extend(checkpoint.weights.problems().iter().map(ToString::to_string));
    let model = match model {
        Ok(model) => model,
        // Beyond a number of tensors that are missing, looking for more is given up.
        Err(_) if !check.problems.is_empty() => return Ok(()),
        Err(error) => return Err(error),
    };
    let files = &checkpoint.files;
    let info = model.info();
    let tokenizer = loading.tokenizer(files, architecture)?;
    let tokenizer = ChatTokenizer::open(&tokenizer, info.vocabulary, info.image_token)?;
    note(check, model.chat_format(files, &tokenizer));
    note(check, end_tokens(files, &tokenizer, info.vocabulary));
    Ok(())
}

fn note<T>(check: &mut ModelCheck, outcome: Result<T, MllmError>) {
    check.problems.extend(outcome.err().map(|error| error.to_string()));
}
