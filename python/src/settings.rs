//! Settings of Python as configurations, and loaded models, kept once a process.

use crate::errors::{Failure, Outcome};
use crate::work::lock;
use planagent::runs::{Config, Listener};
use planagent_mllm::offline_variable;
use planagent_runs::runner::{LoadedModel, RunnerError, load_model, silent};
use std::collections::HashMap;
use std::sync::{Arc, Mutex};

/// The configuration of settings as JSON, over the defaults and what `HF_HUB_OFFLINE` says.
pub(crate) fn config(settings: &str) -> Outcome<Config> {
    let invalid = |text: String| Failure::argument(text);
    let table: toml::Table = serde_json::from_str(settings)
        .map_err(|error| invalid(format!("the settings: {error}")))?;
    let mut config = Config::default();
    config.mllm.offline = offline_variable().is_some();
    config
        .overlaid(&table)
        .map_err(|error| invalid(planagent_runs::worker::run::with_causes(&error)))
}

type Slot = Arc<Mutex<Option<Arc<LoadedModel>>>>;

/// The configured model with its prompts. It is loaded at its first use in a process.
pub(crate) fn model(config: &Config) -> Outcome<Arc<LoadedModel>> {
    Ok(shared_model(config, &silent())?)
}

/// As [`model`], for runs; a listener hears of the loading.
pub(crate) fn shared_model(
    config: &Config,
    listener: &Listener,
) -> Result<Arc<LoadedModel>, RunnerError> {
    static LOADED: Mutex<Option<HashMap<String, Slot>>> = Mutex::new(None);
    let key = format!("{:?}", (&config.mllm, &config.reasoning));
    let slot = Arc::clone(
        lock(&LOADED)
            .get_or_insert_default()
            .entry(key)
            .or_default(),
    );
    // Threads that want the same model wait here.
    let mut slot = lock(&slot);
    if let Some(loaded) = &*slot {
        return Ok(Arc::clone(loaded));
    }
    let loaded = Arc::new(load_model(config, listener)?);
    *slot = Some(Arc::clone(&loaded));
    Ok(loaded)
}
