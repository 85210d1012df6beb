//! The agent of the paper as a library type.

use super::Result;
use planagent_agent::planner::{
    CodeSource, PlanAgentSettings, Planner, PlannerError, PlannerInitialization, PlannerInput,
    PlannerName, PlanningCall,
};
use planagent_agent::planner_registry::PlannerParts;
use planagent_agent::reasoning::ReasoningConfig;
use planagent_mllm::{HubAccess, Mllm, ModelRegistry, Trust, models_folder};
use planagent_planners::all_planners;
use planagent_world::{EgoState, LaneMap, MICROS_PER_SECOND, STEP_S, Scene, SceneView, Trajectory};
use std::fmt;
use std::path::PathBuf;
use std::sync::Arc;

/// The model that ships with the library.
const DEFAULT_MODEL: &str = "nano";

/// A driving agent that plans with a vision-language model. It is a [`Planner`], so
/// [`simulate`](crate::simulate) runs it; in a loop of your own, call [`Agent::plan`].
pub struct Agent {
    planner: Box<dyn Planner>,
    /// What was odd when its server was tried.
    remarks: Vec<String>,
    /// The map that the planner was initialized with.
    initialized: Option<Arc<LaneMap>>,
    /// Time of the first plan since then, seconds.
    start_s: f64,
}

impl fmt::Debug for Agent {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Agent")
            .field("planner", &self.planner.name())
            .finish_non_exhaustive()
    }
}

impl Agent {
    /// An agent with the model "nano" and default settings; every setting can be changed.
    pub fn builder() -> AgentBuilder {
        AgentBuilder::default()
    }

    /// The trajectory from now on. `time_s` is the agent's clock and the time of the trajectory's
    /// first state: call with growing times at any step length, and the agent asks its model when
    /// its interval has passed. A scene with another map starts the agent again.
    ///
    /// # Errors
    /// When the model fails or the scene has no lane near the ego.
    pub fn plan(&mut self, scene: &Scene, time_s: f64) -> Result<Trajectory> {
        if !self
            .initialized
            .as_ref()
            .is_some_and(|map| Arc::ptr_eq(map, &scene.map))
        {
            let initialization = PlannerInitialization {
                map: &scene.map,
                route: &scene.route,
            };
            self.initialize(&initialization)?;
            self.start_s = time_s;
        }
        let iteration = ((time_s - self.start_s) / STEP_S).round().max(0.0) as usize;
        let ego = EgoState {
            time_us: (time_s * MICROS_PER_SECOND).round() as i64,
            ..scene.ego
        };
        let scene = SceneView {
            ego: &ego,
            ..scene.view()
        };
        Ok(self
            .planner
            .compute_trajectory(&PlannerInput { iteration, scene })?)
    }

    /// What was odd in the answers of a server to the two short questions that
    /// [`AgentBuilder::build`] asks it, in sentences: for example that the model may not look at
    /// pictures. Empty for a model in this process.
    pub fn remarks(&self) -> &[String] {
        &self.remarks
    }

    /// The planning calls since the agent started on this map.
    pub fn calls(&self) -> &[PlanningCall] {
        self.planner.calls()
    }
}

impl Planner for Agent {
    fn name(&self) -> &str {
        self.planner.name()
    }

    fn initialize(
        &mut self,
        initialization: &PlannerInitialization<'_>,
    ) -> Result<(), PlannerError> {
        self.planner.initialize(initialization)?;
        self.initialized = Some(Arc::clone(initialization.map));
        Ok(())
    }

    fn compute_trajectory(&mut self, input: &PlannerInput<'_>) -> Result<Trajectory, PlannerError> {
        self.planner.compute_trajectory(input)
    }

    fn finish(&mut self) -> Result<(), PlannerError> {
        self.planner.finish()
    }

    fn calls(&self) -> &[PlanningCall] {
        self.planner.calls()
    }

    fn take_calls(&mut self) -> Vec<PlanningCall> {
        self.planner.take_calls()
    }

    fn drivable_layers(&self) -> Option<planagent_score::pdm::DrivableLayers> {
        self.planner.drivable_layers()
    }
}

/// Settings of an [`Agent`], each with a default.
#[derive(Debug, Clone)]
pub struct AgentBuilder {
    planner: String,
    model: String,
    models: Option<PathBuf>,
    prompts: Option<String>,
    offline: bool,
    trusted: bool,
    settings: PlanAgentSettings,
}

impl Default for AgentBuilder {
    fn default() -> Self {
        Self {
            planner: PlannerName::PLAN_AGENT.as_str().to_owned(),
            model: DEFAULT_MODEL.to_owned(),
            models: None,
            prompts: None,
            offline: false,
            trusted: false,
            settings: PlanAgentSettings::default(),
        }
    }
}

impl AgentBuilder {
    /// The model: a name ("nano", the default), a folder as Hugging Face writes it, a GGUF file, a
    /// hub id (`llava-hf/llava-1.5-7b-hf`; `org/name:Q4_K_M` for a GGUF file), or a `.toml` file that
    /// describes one.
    #[must_use]
    pub fn model(self, model: impl Into<String>) -> Self {
        Self {
            model: model.into(),
            ..self
        }
    }

    /// Looks for the descriptions of models by name in this folder, instead of `$PLANAGENT_MODELS`
    /// or `models`.
    #[must_use]
    pub fn models_folder(self, folder: impl Into<PathBuf>) -> Self {
        Self {
            models: Some(folder.into()),
            ..self
        }
    }

    /// Another planner of the registry, for example a baseline without a model (`fixed-code`,
    /// `random-code`, `grid-code`).
    #[must_use]
    pub fn planner(self, name: impl Into<String>) -> Self {
        Self {
            planner: name.into(),
            ..self
        }
    }

    /// A prompt set: `paper`, `compact` or a folder. By default the model's description decides.
    #[must_use]
    pub fn prompts(self, name_or_folder: impl Into<String>) -> Self {
        Self {
            prompts: Some(name_or_folder.into()),
            ..self
        }
    }

    /// Never uses the network. `HF_HUB_OFFLINE=1` does the same.
    #[must_use]
    pub fn offline(self) -> Self {
        Self {
            offline: true,
            ..self
        }
    }

    /// Vouches for the chat template and the tokenizer of the model. Both are programs by nature,
    /// and a downloaded folder is hostile until shown otherwise: they may take all memory and time,
    /// or end the process. Without this, only models in the library, servers, and models whose
    /// description says `trusted = true` are opened. `planagent models check` tries a folder in a
    /// process with limits.
    #[must_use]
    pub fn trust_model(self) -> Self {
        Self {
            trusted: true,
            ..self
        }
    }

    /// Seed of the model's samples.
    #[must_use]
    pub fn seed(mut self, seed: u64) -> Self {
        self.settings.seed = seed;
        self
    }

    /// All other settings: reflection, gate, latency, monitoring and so on.
    #[must_use]
    pub fn settings(self, settings: PlanAgentSettings) -> Self {
        Self { settings, ..self }
    }

    /// Loads the model. A server gets two short questions, as before a run; one that still loads
    /// its model is waited for.
    ///
    /// # Errors
    /// When there is no such model, planner or prompt set, the files of the model are broken, or
    /// nobody vouches for them. When a server cannot be asked.
    pub fn build(self) -> Result<Agent> {
        let registry = all_planners();
        let entry = registry.find(&self.planner)?;
        let model = if entry.needs_model() {
            Some(self.code_source()?)
        } else {
            None
        };
        let (settings, model) = (&self.settings, model.as_ref());
        let remarks = match model {
            Some(model) => model.probe(settings.environment.bev, &|_| ())?,
            None => Vec::new(),
        };
        let parts = PlannerParts {
            name: entry.name,
            settings,
            model,
            recording: &[],
            simulation: None,
            shuffled_bev: None,
        };
        Ok(Agent {
            planner: entry.build(&parts)?,
            remarks,
            initialized: None,
            start_s: 0.0,
        })
    }

    fn code_source(&self) -> Result<CodeSource> {
        let environment = HubAccess::of_environment();
        let hub = HubAccess {
            offline: self.offline || environment.offline,
            ..environment
        };
        let trust = if self.trusted {
            Trust::Caller
        } else {
            Trust::Nobody
        };
        let registry = ModelRegistry::new(self.models.clone().unwrap_or_else(models_folder), hub)
            .with_trust(trust);
        let spec = registry.find(&self.model)?;
        let model: Arc<dyn Mllm> = Arc::from(registry.open(&spec)?);
        let asking = registry.asking(&spec)?;
        let config = ReasoningConfig {
            prompt_set: self.prompts.clone(),
            ..ReasoningConfig::default()
        };
        let (prompts, reasoning) = (
            Arc::new(config.prompts(&asking.prompt_set)?),
            config.settings(asking.generation),
        );
        Ok(CodeSource::Model {
            model,
            prompts,
            reasoning,
        })
    }
}
