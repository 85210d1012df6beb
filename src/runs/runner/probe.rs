//! Asks a server two short questions before a run depends on it.

use super::error::RunnerError;
use super::event::{Event, Listener};
use planagent_agent::planner::CodeSource;
use planagent_mllm::ProbeQuestion;

/// Asks the model of an agent what planning calls will ask. `bev` says whether they show a picture.
/// A model that was asked before is not asked again, and one in this process never.
pub(super) fn probe(
    source: &CodeSource,
    bev: bool,
    listener: &Listener,
) -> Result<(), RunnerError> {
    let CodeSource::Model {
        model, reasoning, ..
    } = source
    else {
        return Ok(());
    };
    let generation = reasoning.generation;
    let question = ProbeQuestion {
        picture: bev,
        constrained: reasoning.grammar,
        max_new_tokens: generation.max_new_tokens.understanding,
        sampling: generation.sampling,
    };
    let name = model.name();
    let remarks = model
        .probe(&question, &|wait| {
            listener(Event::Note(format!("model {name}: {wait}")));
        })
        .map_err(|source| RunnerError::AskModel {
            name: name.to_owned(),
            source: Box::new(source),
        })?;
    for remark in remarks {
        listener(Event::Note(format!("model {name}: {remark}")));
    }
    Ok(())
}
