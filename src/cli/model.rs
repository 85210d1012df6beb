//! Finds and loads the model that the configuration names, with its prompts.

use super::{Config, Printer};
use crate::api::models_folder;
use crate::experiment::run::AgentParts;
use crate::mllm::{
    FetchProgress, HubAccess, MemoryCheck, Mllm, ModelDescription, ModelRegistry, ModelSpec, PromptSet as PromptSetName,
};
use crate::planner::{CodeSource, PlannerRegistry};
use crate::reasoning::PromptSet;
use anyhow::Context;
use indicatif::ProgressBar;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

/// A loaded model, ready to drive.
pub(super) struct Loaded {
    /// What `plan-agent` thinks with.
    pub(super) code_source: CodeSource,
    /// The model in words.
    pub(super) about: ModelDescription,
    /// How long loading took, seconds.
    pub(super) load_s: f64,
}

/// A model in memory, that can be asked in several ways.
pub(super) struct Opened {
    model: Arc<dyn Mllm>,
    spec: ModelSpec,
    load_s: f64,
}

/// Loads the configured model and its prompt set.
///
/// # Errors
/// When there is no such model, its files are broken, or the prompt set cannot be used.
pub(crate) fn load(config: &Config, printer: Printer) -> anyhow::Result<Loaded> {
    open(config, printer)?.asked(config)
}

/// Loads the configured model.
///
/// # Errors
/// When there is no such model, or its files are broken.
pub(super) fn open(config: &Config, printer: Printer) -> anyhow::Result<Opened> {
    let started = Instant::now();
    let registry = registry(config, printer);
    let spec = registry.find(&config.mllm.model)?;
    let model: Arc<dyn Mllm> =
        Arc::from(registry.open(&spec).with_context(|| format!("cannot load the model '{}'", spec.name))?);
    let load_s = started.elapsed().as_secs_f64();
    let about = model.describe();
    about.load.lines().iter().for_each(|line| printer.detail(line));
    printer.note(in_words(&about, load_s));
    Ok(Opened { model, spec, load_s })
}

impl Opened {
    /// The model.
    pub(super) fn model(&self) -> &dyn Mllm {
        self.model.as_ref()
    }

    /// The model, asked as a configuration says.
    ///
    /// # Errors
    /// When the prompt set cannot be used.
    pub(super) fn asked(&self, config: &Config) -> anyhow::Result<Loaded> {
        let set = config.reasoning.prompt_set.as_deref().unwrap_or(match self.spec.prompt_set {
            PromptSetName::Compact => "compact",
            PromptSetName::Paper => "paper",
        });
        let prompts = Arc::new(PromptSet::open(set)?);
        let reasoning = config.reasoning_settings(self.spec.generation);
        let code_source = CodeSource::Model { model: Arc::clone(&self.model), prompts, reasoning };
        Ok(Loaded { code_source, about: self.model.describe(), load_s: self.load_s })
    }
}

/// What agents are made of, with the model where one is loaded.
pub(super) fn parts(config: &Config, loaded: Option<&Loaded>) -> AgentParts {
    AgentParts {
        registry: PlannerRegistry::default(),
        model: loaded.map(|loaded| loaded.code_source.clone()),
        settings: config.agent_settings(),
    }
}

/// The models that the configuration knows, with a bar for downloads.
pub(crate) fn registry(config: &Config, printer: Printer) -> ModelRegistry {
    let hub = HubAccess { offline: config.mllm.offline, ..HubAccess::default() };
    let memory = if config.mllm.ignore_memory { MemoryCheck::Ignore } else { MemoryCheck::Refuse };
    let bar = Mutex::new(None);
    ModelRegistry::new(models_folder(), hub)
        .with_quantize(config.mllm.quantize)
        .with_memory_check(memory)
        .with_listener(Arc::new(move |progress| show(&bar, progress, printer)))
}

/// Shows a download; the bar appears with the first byte that is still to come.
fn show(bar: &Mutex<Option<ProgressBar>>, progress: FetchProgress, printer: Printer) {
    let mut bar = bar.lock().unwrap_or_else(PoisonError::into_inner);
    if progress.bytes >= progress.total {
        if let Some(bar) = bar.take() {
            bar.finish_and_clear();
        }
        return;
    }
    let bar = bar.get_or_insert_with(|| printer.byte_progress(progress.total));
    bar.set_length(progress.total);
    bar.set_position(progress.bytes);
}

/// What a model is, for the reader of stderr.
fn in_words(about: &ModelDescription, load_s: f64) -> String {
    match &about.server {
        Some(server) => format!("model {}: {} at {}", about.name, server.model, server.endpoint),
        None => format!(
            "model {}: {} M parameters, {}, {} image tokens, loaded in {load_s:.2} s",
            about.name,
            about.parameters / 1_000_000,
            about.load.weight_formats.first().map_or(about.dtype.as_str(), |most| most.weight_format.name()),
            about.image_tokens
        ),
    }
}
