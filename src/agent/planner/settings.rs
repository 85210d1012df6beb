//! Settings of the agent, in the sections of the configuration file. The defaults are those of the
//! published results; where they differ from the paper, `docs/decisions` says why.

use super::language_settings::LanguageAgentSettings;
use super::latency::Latency;
use crate::environment::{DEFAULT_NODE_LENGTH, LaneGraph};
use crate::reflection::{
    Judge, LeadPolicy, PlanBuilder, PlanMonitor, ReflectionError, Ride, steps_of,
};
use planagent_score::pdm::{PdmMemory, TRAJECTORY_STEPS};
use planagent_world::{STEP_S, SceneView};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::time::Duration;

/// Which plan becomes active when all attempts were refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum AfterMaxExec {
    /// The last one (the paper).
    Last,
    /// The one with the best score; the active plan is kept where it scores more.
    #[default]
    Best,
}

/// Section `agent`: a planning call as a whole.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CallSettings {
    /// Time between planning calls, seconds (the paper: 2).
    /// Why: docs/decisions/130-two-seconds-between-calls.md.
    pub interval_s: f64,
    /// Time between planning calls while something blocks the ego's lane or its lead agent stands,
    /// seconds (the paper: 2).
    /// Why: docs/decisions/122-before-what-stands.md.
    pub blocked_interval_s: f64,
    /// Wall time after which a planning call is interrupted and the active plan is kept,
    /// milliseconds; `None` for no limit. The image and a running reflection are completed all the
    /// same.
    pub deadline_ms: Option<u64>,
    /// Predicted score of PDM-Closed from which on the model is not asked and PDM-Closed is
    /// executed; `None` always asks.
    /// Why: docs/decisions/107-gate.md.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gate: Option<f64>,
    /// How long a planning call lasts in simulated time.
    /// Why: docs/decisions/108-latency.md.
    pub latency: Latency,
}

impl Default for CallSettings {
    fn default() -> Self {
        Self {
            interval_s: 2.0,
            blocked_interval_s: 0.5,
            deadline_ms: None,
            gate: None,
            latency: Latency::default(),
        }
    }
}

/// Section `environment`: the input of the model.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EnvironmentSettings {
    /// Whether the model gets the BEV image.
    pub bev: bool,
    /// Whether that image is of an unrelated scene, a new one at each planning call (an ablation).
    pub shuffled_bev: bool,
    /// Whether the model gets the lane-graph text.
    pub lane_graph: bool,
    /// Side of the square that the BEV image shows, meters; its pixels are those of the model's
    /// vision tower.
    pub view_m: f64,
    /// Length of a lane-graph node, meters.
    pub node_length_m: f64,
    /// Whether codes may name the oncoming lane to pass what blocks the ego's. `None`: those of a
    /// model as its prompt set says, those of no model always.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub oncoming_lane: Option<bool>,
}

impl Default for EnvironmentSettings {
    fn default() -> Self {
        let (view_m, node_length_m) = (64.0, DEFAULT_NODE_LENGTH);
        Self {
            bev: true,
            shuffled_bev: false,
            lane_graph: true,
            view_m,
            node_length_m,
            oncoming_lane: None,
        }
    }
}

/// Section `reflection`: how plans are scored and executed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[allow(
    clippy::struct_excessive_bools,
    reason = "switches of a file, each for itself"
)]
pub struct ReflectionSettings {
    /// Whether plans are scored; without, the first plan that can be read becomes active.
    pub enabled: bool,
    /// λ: a plan that scores this becomes active (the paper: 0.75).
    pub threshold: f64,
    /// λ of a plan that begins a lane change, where it is higher. In 350 validation scenes, most
    /// lane changes that scored less than 0.98 lowered the score of the simulation. A change
    /// towards the goal's lane needs λ alone. A plan that stays in a blocked lane which the ego can
    /// leave needs this too, so that other lanes are tried.
    /// Why: docs/decisions/102-lane-change-threshold.md.
    pub lane_change_threshold: f64,
    /// Maximum number of attempts of a planning call (the paper: 3).
    pub max_exec: usize,
    /// Length of the roll-outs, seconds. 4 s are PDM-Closed's.
    pub horizon_s: f64,
    /// Which plan becomes active when all attempts were refused.
    /// Why: docs/decisions/109-paper-settings.md.
    pub after_max_exec: AfterMaxExec,
    /// Whether further codes are tried out when all attempts were refused: the ego's lane more
    /// slowly and, where something blocks it, other lanes. Where no accepted plan begins the way to
    /// the goal's lane, or past an obstacle over the oncoming lane, that is tried too.
    /// Why: docs/decisions/129-judged-handover.md, docs/decisions/136-to-the-goals-lane.md,
    /// docs/decisions/144-wait-where-the-way-begins.md.
    pub further_codes: bool,
    /// Which objects a plan follows.
    /// Why: docs/decisions/103-lead-policy.md.
    pub lead_policy: LeadPolicy,
    /// How plans drive.
    /// Why: docs/decisions/128-comfortable-plans.md.
    pub ride: Ride,
    /// Whether the active plan is monitored between planning calls. At every step it is scored with
    /// its slower and lateral versions and a stop, and one of them is executed. A lane change whose
    /// score falls is aborted. Without monitoring the plan is executed as the model wrote it (the
    /// paper).
    /// Why: docs/decisions/101-monitoring.md.
    pub monitoring: bool,
    /// Whether the ego may brake hard against the active plan: by PDM-Closed's emergency brake, and
    /// under monitoring by the stop.
    /// Why: docs/decisions/104-emergency-brake.md.
    pub emergency_brake: bool,
    /// Whether the best of PDM-Closed's proposals drives at a step where the monitored plan scores
    /// less than λ and the proposal scores more.
    /// Why: docs/decisions/129-judged-handover.md.
    pub handover: bool,
    /// Whether the ego swerves into a lane beside at a step where people or bicycles are near, the
    /// monitored plan scores less than λ, and the same code scores the λ of lane changes there.
    /// Why: docs/decisions/154-evade-at-once.md.
    pub evasion: bool,
}

impl Default for ReflectionSettings {
    fn default() -> Self {
        Self {
            enabled: true,
            threshold: 0.75,
            lane_change_threshold: 0.98,
            max_exec: 3,
            horizon_s: 4.0,
            after_max_exec: AfterMaxExec::Best,
            further_codes: true,
            lead_policy: LeadPolicy::Nearest,
            ride: Ride::Comfortable,
            monitoring: true,
            emergency_brake: true,
            handover: true,
            evasion: true,
        }
    }
}

impl ReflectionSettings {
    /// What builds plans that drive as these settings say.
    pub fn plan_builder(&self) -> PlanBuilder {
        PlanBuilder {
            lead_policy: self.lead_policy,
            ride: self.ride,
            horizon_s: self.horizon_s.max(TRAJECTORY_STEPS as f64 * STEP_S),
        }
    }

    /// How an active plan is monitored.
    pub fn plan_monitor(&self) -> PlanMonitor {
        PlanMonitor {
            steps: steps_of(self.horizon_s),
            threshold: self.threshold,
            emergency_brake: self.emergency_brake,
            handover: self.handover,
            evasion: self
                .evasion
                .then(|| self.threshold.max(self.lane_change_threshold)),
        }
    }

    /// Reflection's view of a scene, which scores plans that drive as these settings say. The
    /// reference path that PDM-Closed chooses now is kept in `memory`.
    ///
    /// # Errors
    /// When the horizon is too short to be scored, or the ego's pose is not finite.
    pub fn judge<'a>(
        &self,
        scene: &'a SceneView<'a>,
        graph: &LaneGraph,
        memory: &mut PdmMemory,
    ) -> Result<Judge<'a>, ReflectionError> {
        Judge::of_plans(scene, graph, (self.ride, self.horizon_s), memory)
    }
}

/// Section `learned`: the checkpoint of each learned planner, a file. A key is the planner's name
/// with `_` for `-`. Which planners there are, the registry knows.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(transparent)]
pub struct LearnedSettings(BTreeMap<String, String>);

impl LearnedSettings {
    /// The key of a planner, by the planner's name.
    pub fn key(planner: &str) -> String {
        planner.replace('-', "_")
    }

    /// The checkpoint of a planner, by the planner's name; `None` where none is set.
    pub fn checkpoint(&self, planner: &str) -> Option<&str> {
        self.0.get(&Self::key(planner)).map(String::as_str)
    }

    /// Sets the checkpoint of a planner, by the planner's name.
    pub fn set(&mut self, planner: &str, file: String) {
        self.0.insert(Self::key(planner), file);
    }

    /// The checkpoint of one planner alone.
    pub fn only(mut self, planner: &str) -> Self {
        let own = Self::key(planner);
        self.0.retain(|key, _| *key == own);
        self
    }

    /// The keys that are set.
    pub fn keys(&self) -> impl Iterator<Item = &str> {
        self.0.keys().map(String::as_str)
    }

    /// All checkpoints.
    pub fn all_mut(&mut self) -> impl Iterator<Item = &mut String> {
        self.0.values_mut()
    }

    /// Whether no checkpoint is set.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }
}

/// Settings of the agent.
#[derive(Debug, Clone, PartialEq)]
pub struct PlanAgentSettings {
    /// Section `agent`.
    pub agent: CallSettings,
    /// Section `environment`.
    pub environment: EnvironmentSettings,
    /// Section `reflection`.
    pub reflection: ReflectionSettings,
    /// Section `learned`.
    pub learned: LearnedSettings,
    /// Section `language_agents`.
    pub language_agents: LanguageAgentSettings,
    /// Seed of the simulation; each planning call draws from a stream of its own.
    pub seed: u64,
}

impl Default for PlanAgentSettings {
    fn default() -> Self {
        let (agent, environment) = (CallSettings::default(), EnvironmentSettings::default());
        let (reflection, learned, language_agents) = Default::default();
        Self {
            agent,
            environment,
            reflection,
            learned,
            language_agents,
            seed: 0,
        }
    }
}

impl PlanAgentSettings {
    /// The same with plans in the paper's form: the plan of a code drives as its IDM says, and
    /// nothing but codes is tried.
    #[doc(hidden)]
    pub fn in_form_of_paper(mut self) -> Self {
        self.reflection.ride = Ride::Idm;
        self.reflection.further_codes = false;
        self.reflection.handover = false;
        self.reflection.evasion = false;
        self
    }

    /// The deadline of a planning call, if there is one.
    #[doc(hidden)]
    pub fn deadline(&self) -> Option<Duration> {
        self.agent.deadline_ms.map(Duration::from_millis)
    }

    /// How the active plan is monitored; `None` where it is not.
    pub(super) fn monitor(&self) -> Option<PlanMonitor> {
        let reflection = &self.reflection;
        (reflection.enabled && reflection.monitoring).then(|| reflection.plan_monitor())
    }

    /// The seed of the planning call at an iteration.
    pub(super) fn call_seed(&self, iteration: usize) -> u64 {
        self.seed
            .wrapping_mul(0x9E37_79B9_7F4A_7C15)
            .wrapping_add(iteration as u64)
    }
}
