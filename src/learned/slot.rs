//! Learned planners in the registry: one network in memory for all simulations of a run.

use super::blocks::Weights;
use super::checkpoint::{Checkpoint, CheckpointError};
use planagent_agent::planner::{
    LearnedSettings, PlanAgentSettings, Planner, PlannerError, PlannerName,
};
use planagent_agent::planner_registry::{PlannerEntry, PlannerNeeds};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// Makes a network of tensors.
type Take<M> = fn(&mut Weights) -> candle_core::Result<M>;

/// The network of a learned planner, kept with the checkpoint that it comes from.
#[derive(Debug)]
pub(super) struct Slot<M> {
    model: &'static str,
    take: Take<M>,
    loaded: Mutex<Option<(PathBuf, Arc<M>)>>,
}

impl<M> Slot<M> {
    /// An empty slot for a model of this name.
    pub(super) fn new(model: &'static str, take: Take<M>) -> Self {
        Self {
            model,
            take,
            loaded: Mutex::new(None),
        }
    }

    fn network(&self, checkpoint: &Path) -> Result<Arc<M>, CheckpointError> {
        // A network is put here only when it is complete.
        let mut loaded = self.loaded.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((path, network)) = loaded.as_ref()
            && path == checkpoint
        {
            return Ok(Arc::clone(network));
        }
        let network = Arc::new(Checkpoint::open(checkpoint)?.load(self.model, self.take)?);
        *loaded = Some((checkpoint.to_owned(), Arc::clone(&network)));
        Ok(network)
    }
}

/// The entry of a learned planner that `plan` makes of its network.
pub(super) fn learned_entry<M: Send + Sync + 'static>(
    name: &'static str,
    summary: &'static str,
    slot: Slot<M>,
    plan: impl Fn(Arc<M>) -> Box<dyn Planner> + Send + Sync + 'static,
) -> PlannerEntry {
    let name = PlannerName::new(name);
    let slot = Arc::new(slot);
    let network =
        {
            let slot = Arc::clone(&slot);
            move |settings: &PlanAgentSettings| {
                let checkpoint = settings.learned.checkpoint(name.as_str()).ok_or(
                    PlannerError::NoCheckpoint {
                        planner: name,
                        key: format!("learned.{}", LearnedSettings::key(name.as_str())),
                    },
                )?;
                Ok::<_, PlannerError>(slot.network(&planagent_files::path_of(checkpoint))?)
            }
        };
    let network = Arc::new(network);
    let prepare = Arc::clone(&network);
    let entry = PlannerEntry::new(name, summary, PlannerNeeds::Checkpoint, move |parts| {
        Ok(plan(network(parts.settings)?))
    });
    entry.prepared_by(move |settings| prepare(settings).map(|_| ()))
}
