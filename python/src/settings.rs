//! Settings of Python as configurations, and loaded models, kept once a process.

use crate::command::trial;
use crate::errors::{Failure, Outcome};
use crate::work::{computed, lock};
use planagent::runs::{Config, Event, Listener};
use planagent_mllm::offline_variable;
use planagent_runs::runner::{LoadedModel, RunnerError, load_model, silent};
use pyo3::exceptions::PyUserWarning;
use pyo3::prelude::*;
use std::collections::HashMap;
use std::ffi::CString;
use std::process;
use std::sync::{Arc, Mutex, MutexGuard};

/// The configuration of settings as JSON, over the defaults and what `HF_HUB_OFFLINE` says.
pub(crate) fn config(settings: &str) -> Outcome<Config> {
    let invalid = |text: String| Failure::argument(text);
    let table: toml::Table = serde_json::from_str(settings)
        .map_err(|error| invalid(format!("the settings: {error}")))?;
    let mut config = Config::default();
    config.mllm.offline = offline_variable().is_some();
    config.mllm.trust = trial();
    config.overlaid_at(&table, PLACE).map_err(|error| {
        let said = planagent_runs::worker::run::with_causes(&error);
        let said = said.strip_prefix("in the configuration ").unwrap_or(&said);
        // The key of a value stands in a line of its own.
        let lines: Vec<&str> = said.lines().map(str::trim).collect();
        invalid(lines.join(", "))
    })
}

/// The argument that errors name.
const PLACE: &str = "settings";

type Slot = Arc<Mutex<Option<Arc<LoadedModel>>>>;
type Slots = HashMap<(u32, String), Slot>;

static LOADED: Mutex<Option<Slots>> = Mutex::new(None);

/// The lock of the models, held through a fork.
pub(crate) type HeldModels = MutexGuard<'static, Option<Slots>>;

pub(crate) fn held_models() -> HeldModels {
    lock(&LOADED)
}

/// The slot of a model. A forked process shares what its parent had loaded; what another thread of
/// the parent was loading, it loads itself.
fn slot(key: String) -> Slot {
    let pid = process::id();
    let mut loaded = lock(&LOADED);
    let slots = loaded.get_or_insert_default();
    if let Some(own) = slots.get(&(pid, key.clone())) {
        return Arc::clone(own);
    }
    let inherited = slots.iter().find_map(|((owner, name), slot)| {
        let model = slot.try_lock().ok()?.clone()?;
        (*owner != pid && *name == key).then_some(model)
    });
    let slot = Slot::new(Mutex::new(inherited));
    slots.insert((pid, key), Arc::clone(&slot));
    slot
}

/// The configured model with its prompts. It is loaded at its first use in a process. What is odd
/// in the answers of a server is a warning.
pub(crate) fn model(config: &Config) -> Outcome<Arc<LoadedModel>> {
    let loaded = load(config, &silent(), |load| computed(|| Ok(load()?)))?;
    loaded.probe(config, &warnings())?;
    Ok(loaded)
}

/// Raises notes as warnings of Python.
fn warnings() -> Listener {
    Arc::new(|event| {
        let Event::Note(text) = event else { return };
        let Ok(text) = CString::new(text) else { return };
        // Where warnings are exceptions, the model is of use all the same.
        let _ = Python::attach(|py| PyErr::warn(py, &py.get_type::<PyUserWarning>(), &text, 1));
    })
}

/// As [`model`], for runs; a listener hears of the loading. Not for threads of the common pool:
/// who loads a model computes while others wait for it.
pub(crate) fn shared_model(
    config: &Config,
    listener: &Listener,
) -> Result<Arc<LoadedModel>, RunnerError> {
    load(config, listener, |load| load())
}

/// The loaded model; `how` calls what loads it.
fn load<E>(
    config: &Config,
    listener: &Listener,
    how: impl FnOnce(&(dyn Fn() -> Result<LoadedModel, RunnerError> + Sync)) -> Result<LoadedModel, E>,
) -> Result<Arc<LoadedModel>, E> {
    let slot = slot(format!("{:?}", (&config.mllm, &config.reasoning)));
    // Threads that want the same model wait here.
    let mut slot = lock(&slot);
    if let Some(loaded) = &*slot {
        return Ok(Arc::clone(loaded));
    }
    let loaded = Arc::new(how(&|| load_model(config, listener))?);
    *slot = Some(Arc::clone(&loaded));
    Ok(loaded)
}
