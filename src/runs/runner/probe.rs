//! Asks a server two short questions before a run depends on it.

use super::error::RunnerError;
use super::event::{Event, Listener};
use planagent_agent::planner::CodeSource;

/// Asks the model of an agent what planning calls will ask, and tells what is odd in its answers.
/// `bev` says whether the calls show a picture.
pub(super) fn probe(
    source: &CodeSource,
    bev: bool,
    listener: &Listener,
) -> Result<(), RunnerError> {
    let Some(name) = source.model_name() else {
        return Ok(());
    };
    let tell = |remark: &str| listener(Event::Note(format!("model {name}: {remark}")));
    let remarks = source
        .probe(bev, &tell)
        .map_err(|source| RunnerError::AskModel {
            name: name.to_owned(),
            source: Box::new(source),
        })?;
    for remark in remarks {
        tell(&remark);
    }
    Ok(())
}
