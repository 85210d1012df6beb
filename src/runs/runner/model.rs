//! Loads the model that the configuration names, with its prompts.

use super::config::Config;
use super::error::RunnerError;
use super::event::{Event, Listener};
use super::probe;
use crate::report::{Inputs, PromptList};
use crate::worker::run::AgentParts;
use planagent_agent::planner::CodeSource;
use planagent_agent::planner_registry::PlannerRegistry;
use planagent_agent::reasoning::{PromptPlace, PromptSet, ReasoningSettings};
use planagent_mllm::{
    Asking, HubAccess, MemoryCheck, Mllm, ModelDescription, ModelInputs, ModelRegistry,
    models_folder, parameter_count,
};
use planagent_planners::all_planners;
use std::sync::Arc;
use std::time::Instant;

/// A loaded model with its prompts.
pub struct LoadedModel {
    pub(super) code_source: CodeSource,
    /// The model in words.
    pub about: ModelDescription,
    /// How long loading took, seconds.
    pub load_s: f64,
    /// What names its prompt set.
    named_by: String,
    /// Digests of its prompts, small files and description.
    pub(super) inputs: Inputs,
}

/// A model in memory, which can be asked in several ways.
pub struct OpenModel {
    model: Arc<dyn Mllm>,
    asking: Asking,
    inputs: ModelInputs,
    load_s: f64,
}

/// Loads the configured model and its prompt set.
pub fn load_model(config: &Config, listener: &Listener) -> Result<LoadedModel, RunnerError> {
    let loaded = OpenModel::open(config, listener)?.with_prompts(config)?;
    if let Some(prompts) = loaded.prompt_list() {
        let text = format!(
            "prompts {} ({}): {}",
            prompts.set, prompts.named_by, prompts.place
        );
        // Prompts of one's own are worth a line, the usual ones are not.
        listener(if prompts.built_in {
            Event::Detail(text)
        } else {
            Event::Note(text)
        });
    }
    Ok(loaded)
}

impl LoadedModel {
    /// Asks a server what it must be able to do. A model in this process needs no such question.
    ///
    /// # Errors
    /// When the server cannot be asked as the configuration says.
    pub fn probe(&self, config: &Config, listener: &Listener) -> Result<(), RunnerError> {
        probe::probe(&self.code_source, config.environment.bev, listener)
    }

    /// The parts of an agent with this model, which is asked before an agent depends on it.
    ///
    /// # Errors
    /// When its server cannot be asked as the configuration says.
    pub fn agent_parts(
        &self,
        config: &Config,
        listener: &Listener,
    ) -> Result<AgentParts, RunnerError> {
        self.probe(config, listener)?;
        Ok(agent_parts(config, all_planners(), Some(self)))
    }

    /// The model with its prompts and the way in which it samples.
    pub fn parts(&self) -> Option<(&dyn Mllm, &PromptSet, &ReasoningSettings)> {
        match &self.code_source {
            CodeSource::Model {
                model,
                prompts,
                reasoning,
            } => Some((model.as_ref(), prompts.as_ref(), reasoning)),
            _ => None,
        }
    }

    /// Where its prompts come from, for records.
    pub(crate) fn prompt_list(&self) -> Option<PromptList> {
        let (_, prompts, _) = self.parts()?;
        let place = match prompts.place() {
            PromptPlace::Folder(folder) => std::path::absolute(folder)
                .unwrap_or_else(|_| folder.clone())
                .display()
                .to_string(),
            PromptPlace::BuiltIn => PromptPlace::BuiltIn.to_string(),
        };
        Some(PromptList {
            set: prompts.name().to_owned(),
            named_by: self.named_by.clone(),
            place,
            built_in: prompts.is_built_in(),
            blake3: prompts.blake3().to_owned(),
        })
    }
}

impl OpenModel {
    pub fn open(config: &Config, listener: &Listener) -> Result<Self, RunnerError> {
        let started = Instant::now();
        let registry = model_registry(config, listener);
        config.of_run.check_model(&config.mllm.model, &registry)?;
        let spec = registry
            .find(&config.mllm.model)
            .map_err(|error| RunnerError::FindModel(Box::new(error)))?;
        let failed = |source| RunnerError::LoadModel {
            name: spec.name.clone(),
            source: Box::new(source),
        };
        let asking = registry.asking(&spec).map_err(failed)?;
        // Loading a model takes long: what is wrong with its prompts is said before.
        config.reasoning.prompts(&asking.prompt_set)?;
        let model = registry.open(&spec).map_err(failed)?;
        let load_s = started.elapsed().as_secs_f64();
        let about = model.describe();
        about
            .load
            .lines()
            .into_iter()
            .for_each(|line| listener(Event::Detail(line)));
        listener(Event::Note(in_words(&about, load_s)));
        let inputs = registry
            .inputs(&spec)
            .map_err(|error| RunnerError::FindModel(Box::new(error)))?;
        Ok(Self {
            model: Arc::from(model),
            asking,
            inputs,
            load_s,
        })
    }

    pub fn model(&self) -> &dyn Mllm {
        self.model.as_ref()
    }

    /// The model with the prompts and the decoding of a configuration.
    pub fn with_prompts(&self, config: &Config) -> Result<LoadedModel, RunnerError> {
        let prompts = Arc::new(config.reasoning.prompts(&self.asking.prompt_set)?);
        let reasoning = config.reasoning.settings(self.asking.generation);
        let named_by = match &config.reasoning.prompt_set {
            Some(_) => "reasoning.prompt_set".to_owned(),
            None => self.asking.named_by.to_string(),
        };
        let inputs = of_model(self.inputs.clone(), &prompts);
        let code_source = CodeSource::Model {
            model: Arc::clone(&self.model),
            prompts,
            reasoning,
        };
        Ok(LoadedModel {
            code_source,
            about: self.model.describe(),
            load_s: self.load_s,
            named_by,
            inputs,
        })
    }
}

/// Digests of the configured model and its prompts, without loading it.
///
/// # Errors
/// When its files are not on this machine yet, among others.
pub(super) fn inputs_here(config: &Config, listener: &Listener) -> Result<Inputs, RunnerError> {
    let registry = model_registry(config, listener);
    config.of_run.check_model(&config.mllm.model, &registry)?;
    let find = |error| RunnerError::FindModel(Box::new(error));
    let spec = registry.find(&config.mllm.model).map_err(find)?;
    let inputs = registry.inputs(&spec).map_err(find)?;
    let asking = registry.asking(&spec).map_err(find)?;
    Ok(of_model(
        inputs,
        &config.reasoning.prompts(&asking.prompt_set)?,
    ))
}

fn of_model(ModelInputs { files, description }: ModelInputs, prompts: &PromptSet) -> Inputs {
    Inputs {
        prompts: prompts.digests().clone(),
        model: files,
        description,
        ..Inputs::default()
    }
}

/// The parts of an agent, with the model where one is loaded.
pub fn agent_parts(
    config: &Config,
    registry: PlannerRegistry,
    loaded: Option<&LoadedModel>,
) -> AgentParts {
    AgentParts {
        registry,
        model: loaded.map(|loaded| loaded.code_source.clone()),
        settings: config.agent_settings(),
        agents: None,
        stop: None,
        on_failed_call: None,
    }
}

/// The models that the configuration can name.
pub fn model_registry(config: &Config, listener: &Listener) -> ModelRegistry {
    let hub = HubAccess {
        offline: config.mllm.offline,
        ..HubAccess::default()
    };
    let memory = if config.mllm.ignore_memory {
        MemoryCheck::Ignore
    } else {
        MemoryCheck::Refuse
    };
    let listener = Arc::clone(listener);
    ModelRegistry::new(models_folder(), hub)
        .with_adapter(config.mllm.adapter.clone())
        .with_quantize(config.mllm.quantize)
        .with_context(config.mllm.context)
        .with_memory_check(memory)
        .with_trust(config.mllm.trust.clone())
        .with_listener(Arc::new(move |progress| listener(Event::Fetched(progress))))
}

fn in_words(about: &ModelDescription, load_s: f64) -> String {
    match &about.server {
        Some(server) => format!(
            "model {}: {} at {}",
            about.name, server.model, server.endpoint
        ),
        None => format!(
            "model {}: {} parameters, {}, {}, loaded in {load_s:.2} s",
            about.name,
            parameter_count(about.parameters),
            about
                .load
                .weight_formats
                .first()
                .map_or(about.dtype.as_str(), |most| most.weight_format.name()),
            match about.image_size {
                Some(_) => format!("{} image tokens", about.image_tokens),
                None => "reads text alone: no BEV map is shown to it".to_owned(),
            }
        ),
    }
}
