//! The planners that a run can name. A new planner is its file and one line of
//! [`PlannerRegistry::default`]; crates above and programs add theirs with
//! [`PlannerRegistry::with`].

mod commands;

use crate::planner::{
    AgentKeys, AgentLayer, AskedModel, BevSource, CodeSource, IdmPlanner, Latency, LlmAssist,
    LogReplay, PdmClosed, PdmClosedPlus, PlanAgent, PlanAgentSettings, Planner, PlannerError,
    PlannerName, SimplePlanner,
};
use crate::reasoning::AssistVariant;
use crate::simulation::ClosedLoop;
use planagent_world::EgoState;
use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;

/// What a planner is built from. Runs load a model only for a planner that needs one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum PlannerNeeds {
    /// Nothing but the scenario's map and route.
    Nothing,
    /// The recorded ego states.
    Recording,
    /// The agent's settings.
    Settings,
    /// The agent's settings and a model.
    Model,
    /// A file with the weights of a network.
    Checkpoint,
    /// The agent's settings and the simulation itself, in which it looks ahead
    /// ([`PlannerParts::simulation`]).
    Simulation,
}

/// The settings that a planner depends on.
#[doc(hidden)]
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs, reason = "a part of `PlannerNeeds`")]
pub enum UsedSettings {
    None,
    Checkpoint,
    Agent,
    AgentAndModel,
}

impl PlannerNeeds {
    /// The settings that a planner with these needs depends on.
    #[doc(hidden)]
    pub fn settings(self) -> UsedSettings {
        match self {
            Self::Nothing | Self::Recording => UsedSettings::None,
            Self::Checkpoint => UsedSettings::Checkpoint,
            Self::Settings | Self::Simulation => UsedSettings::Agent,
            Self::Model => UsedSettings::AgentAndModel,
        }
    }
}

/// What a planner of one simulation is built from.
#[derive(Clone, Copy)]
pub struct PlannerParts<'a> {
    /// Name under which the planner is registered.
    pub name: PlannerName,
    /// Settings of agents; the seed is that of the simulation.
    pub settings: &'a PlanAgentSettings,
    /// The model of a planner that needs one.
    pub model: Option<&'a CodeSource>,
    /// The recorded ego states from iteration 0 on, for a planner that needs them.
    pub recording: &'a [EgoState],
    /// The simulation at iteration 0, for a planner that looks ahead in a copy of it.
    pub simulation: Option<&'a ClosedLoop<'static>>,
    /// Images of other scenes, for the ablation that shows them to the model.
    pub shuffled_bev: Option<&'a BevSource>,
}

type Built = Result<Box<dyn Planner>, PlannerError>;
type Prepare = dyn Fn(&PlanAgentSettings) -> Result<(), PlannerError> + Send + Sync;
/// BLAKE3 of the texts that a planner reads beside its settings, by name.
type Digests = dyn Fn(&PlanAgentSettings) -> BTreeMap<String, String> + Send + Sync;

/// A planner in the registry.
#[derive(Clone)]
pub struct PlannerEntry {
    /// Its name.
    pub name: PlannerName,
    /// One line about it.
    pub summary: &'static str,
    /// What it is built from.
    pub needs: PlannerNeeds,
    build: Arc<dyn Fn(&PlannerParts<'_>) -> Built + Send + Sync>,
    unsupported: fn(&PlanAgentSettings) -> Option<&'static str>,
    prepare: Arc<Prepare>,
    digests: Arc<Digests>,
    least_context: usize,
    agent: Option<AgentKeys>,
}

impl PlannerEntry {
    /// A planner that `build` makes for each simulation.
    pub fn new(
        name: PlannerName,
        summary: &'static str,
        needs: PlannerNeeds,
        build: impl Fn(&PlannerParts<'_>) -> Built + Send + Sync + 'static,
    ) -> Self {
        let prepare = Arc::new(|_: &PlanAgentSettings| Ok(()));
        Self {
            name,
            summary,
            needs,
            build: Arc::new(build),
            unsupported: |_| None,
            prepare,
            digests: Arc::new(|_: &PlanAgentSettings| BTreeMap::new()),
            least_context: 0,
            agent: None,
        }
    }

    /// The same, with settings of its own in section `language_agents`.
    #[doc(hidden)]
    #[must_use]
    pub fn with_keys(self, keys: AgentKeys) -> Self {
        Self {
            agent: Some(keys),
            ..self
        }
    }

    /// The same, with what a run does once before its first simulation.
    #[doc(hidden)]
    #[must_use]
    pub fn prepared_by(
        self,
        prepare: impl Fn(&PlanAgentSettings) -> Result<(), PlannerError> + Send + Sync + 'static,
    ) -> Self {
        Self {
            prepare: Arc::new(prepare),
            ..self
        }
    }

    /// The same, which does not support the key that `unsupported` names.
    #[doc(hidden)]
    #[must_use]
    pub fn refusing(self, unsupported: fn(&PlanAgentSettings) -> Option<&'static str>) -> Self {
        Self {
            unsupported,
            ..self
        }
    }

    /// The same, which reads texts of its own: prompts, or a memory.
    #[doc(hidden)]
    #[must_use]
    pub fn reading(
        self,
        digests: impl Fn(&PlanAgentSettings) -> BTreeMap<String, String> + Send + Sync + 'static,
    ) -> Self {
        Self {
            digests: Arc::new(digests),
            ..self
        }
    }

    /// The same, whose prompts and answers need a context of this many tokens.
    #[doc(hidden)]
    #[must_use]
    pub fn needing_context(self, tokens: usize) -> Self {
        Self {
            least_context: tokens,
            ..self
        }
    }

    /// Tokens that the context of its model has at least.
    #[doc(hidden)]
    pub fn least_context(&self) -> usize {
        self.least_context
    }

    /// BLAKE3 of the texts of its own that it reads, by name, hexadecimal: part of a run's inputs.
    #[doc(hidden)]
    pub fn digests(&self, settings: &PlanAgentSettings) -> BTreeMap<String, String> {
        (self.digests)(settings)
    }

    /// Prepares for the simulations of a run: loads the checkpoint of a planner that needs one.
    ///
    /// # Errors
    /// When it has none, or one that cannot be used.
    pub fn prepare(&self, settings: &PlanAgentSettings) -> Result<(), PlannerError> {
        (self.prepare)(settings)
    }

    /// Whether it asks the configured model.
    pub fn needs_model(&self) -> bool {
        self.needs == PlannerNeeds::Model
    }

    /// The configuration key that is set and that this planner does not support.
    pub fn unsupported(&self, settings: &PlanAgentSettings) -> Option<&'static str> {
        (self.unsupported)(settings)
    }

    /// The planner of one simulation.
    ///
    /// # Errors
    /// When a part is missing.
    pub fn build(&self, parts: &PlannerParts<'_>) -> Result<Box<dyn Planner>, PlannerError> {
        let missing = match self.needs {
            PlannerNeeds::Model if parts.model.is_none() => "a model",
            PlannerNeeds::Simulation if parts.simulation.is_none() => {
                "a simulation to look ahead in"
            }
            _ => return (self.build)(parts),
        };
        Err(PlannerError::MissingPart {
            planner: self.name,
            part: missing,
        })
    }
}

impl fmt::Debug for PlannerEntry {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("PlannerEntry")
            .field("name", &self.name)
            .field("needs", &self.needs)
            .finish_non_exhaustive()
    }
}

/// A name that no planner has.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("unknown planner '{name}'; known planners are {}", known.join(", "))]
pub struct UnknownPlanner {
    /// The name.
    pub name: String,
    /// The names of all planners.
    pub known: Vec<String>,
}

/// The planners by name. The default has those of this crate.
#[derive(Debug, Clone)]
pub struct PlannerRegistry {
    entries: Vec<PlannerEntry>,
}

impl Default for PlannerRegistry {
    fn default() -> Self {
        use PlannerNeeds::{Model, Nothing, Recording};
        let assist = |name, summary, variant| PlannerEntry {
            unsupported: |settings| {
                (settings.agent.latency != Latency::None).then_some("agent.latency")
            },
            ..PlannerEntry::new(name, summary, Model, move |parts| {
                llm_assist(parts, variant)
            })
        };
        let name = PlannerName::new;
        // One list, a row a planner, in the order in which the program shows them.
        Self {
            entries: vec![
                PlannerEntry::new(
                    PlannerName::PLAN_AGENT,
                    "the agent of the paper",
                    Model,
                    plan_agent,
                ),
                PlannerEntry::new(
                    name("plan-agent-paper"),
                    "the agent with the paper's form of a plan",
                    Model,
                    plan_agent_of_paper,
                ),
                PlannerEntry::new(
                    name("log-replay"),
                    "the recorded driver",
                    Recording,
                    |parts| boxed(LogReplay::new(parts.recording.to_vec())),
                ),
                PlannerEntry::new(name("idm"), "nuPlan's IDM planner", Nothing, |_| {
                    boxed(IdmPlanner::default())
                }),
                PlannerEntry::new(
                    name("simple"),
                    "nuPlan's planner that drives straight ahead",
                    Nothing,
                    |_| boxed(SimplePlanner::default()),
                ),
                PlannerEntry::new(PlannerName::PDM_CLOSED, "PDM-Closed", Nothing, |_| {
                    boxed(PdmClosed::new())
                }),
                PlannerEntry::new(
                    name("pdm-closed-plus"),
                    "PDM-Closed with proposals on every centerline (a control)",
                    Nothing,
                    |_| boxed(PdmClosedPlus::new()),
                ),
                assist(
                    name("llm-assist-unc"),
                    "LLM-ASSIST; the model gives waypoints",
                    AssistVariant::Unconstrained,
                ),
                assist(
                    name("llm-assist-par"),
                    "LLM-ASSIST; the model tunes PDM-Closed",
                    AssistVariant::Parameters,
                ),
            ],
        }
    }
}

impl PlannerRegistry {
    /// The same with one more planner, in place of an earlier one of the same name.
    #[must_use]
    pub fn with(mut self, entry: PlannerEntry) -> Self {
        self.entries.retain(|earlier| earlier.name != entry.name);
        self.entries.push(entry);
        self
    }

    /// All planners.
    pub fn entries(&self) -> &[PlannerEntry] {
        &self.entries
    }

    /// The planners that need a checkpoint.
    pub fn learned(&self) -> impl Iterator<Item = PlannerName> {
        self.entries
            .iter()
            .filter(|entry| entry.needs == PlannerNeeds::Checkpoint)
            .map(|entry| entry.name)
    }

    /// The planners with settings of their own in section `language_agents`.
    #[doc(hidden)]
    pub fn language_agents(&self) -> impl Iterator<Item = AgentKeys> {
        self.entries.iter().filter_map(|entry| entry.agent)
    }

    /// The planner of a name.
    ///
    /// # Errors
    /// When no planner has it.
    pub fn find(&self, name: &str) -> Result<&PlannerEntry, UnknownPlanner> {
        self.entries
            .iter()
            .find(|entry| entry.name.as_str() == name)
            .ok_or_else(|| {
                let known = self
                    .entries
                    .iter()
                    .map(|entry| entry.name.to_string())
                    .collect();
                UnknownPlanner {
                    name: name.to_owned(),
                    known,
                }
            })
    }
}

#[allow(clippy::unnecessary_wraps, reason = "the shape of a build function")]
fn boxed(planner: impl Planner + 'static) -> Built {
    Ok(Box::new(planner))
}

impl PlannerParts<'_> {
    /// PlanAgent with these parts, whose codes come from `source`.
    #[doc(hidden)]
    pub fn agent(&self, source: CodeSource) -> Box<dyn AgentLayer> {
        PlanAgent::new(self.name, source, self.settings.clone())
            .with_shuffled_bev(self.shuffled_bev.cloned())
            .layered()
    }
}

fn plan_agent(parts: &PlannerParts<'_>) -> Built {
    let missing = PlannerError::MissingPart {
        planner: parts.name,
        part: "a model",
    };
    Ok(Box::new(parts.agent(parts.model.cloned().ok_or(missing)?)))
}

/// PlanAgent with the paper's form of a plan, whatever the settings say of that.
/// Why: docs/decisions/128-comfortable-plans.md.
fn plan_agent_of_paper(parts: &PlannerParts<'_>) -> Built {
    let settings = parts.settings.clone().in_form_of_paper();
    plan_agent(&PlannerParts {
        settings: &settings,
        ..*parts
    })
}

fn llm_assist(parts: &PlannerParts<'_>, variant: AssistVariant) -> Built {
    let Some(CodeSource::Model {
        model,
        prompts,
        reasoning,
    }) = parts.model.cloned()
    else {
        return Err(PlannerError::MissingPart {
            planner: parts.name,
            part: "a language model",
        });
    };
    Ok(Box::new(LlmAssist::new(
        parts.name,
        variant,
        AskedModel {
            model,
            prompts,
            reasoning,
        },
        parts.settings.clone(),
    )))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_later_entry_replaces_an_earlier_one_of_its_name() {
        let own = PlannerEntry::new(
            PlannerName::new("idm"),
            "mine",
            PlannerNeeds::Settings,
            |_| Ok(Box::new(SimplePlanner::default())),
        );
        let registry = PlannerRegistry::default().with(own);
        assert_eq!(registry.find("idm").unwrap().summary, "mine");
        assert_eq!(
            registry.entries().len(),
            PlannerRegistry::default().entries().len()
        );
        let error = registry.find("imd").unwrap_err().to_string();
        assert!(
            error.starts_with(
                "unknown planner 'imd'; known planners are plan-agent, plan-agent-paper, log-replay"
            ),
            "{error}"
        );
    }
}
