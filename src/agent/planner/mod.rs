//! Stage 6: the planners. The simulator knows an agent only through [`Planner`], whose shape is
//! nuPlan's.

mod agent_state;
mod attempts;
mod clock;
mod code_question;
mod code_source;
mod codes;
mod delayed;
mod error;
mod exec;
mod gated;
mod idm;
mod language_agent;
mod language_settings;
mod latency;
mod layer;
mod layered;
mod llm_assist;
mod log_replay;
mod model_input;
mod monitored;
mod name;
mod pdm_closed;
mod pdm_closed_plus;
mod plan_agent;
mod plan_bounds;
mod record;
mod settings;
mod simple;
mod stop;
mod stop_switch;
mod unreadable;
mod waypoint_path;

pub use agent_state::{ActivePlan, AgentState};
pub use attempts::{AttemptLimits, Attempts, Question, Trial};
pub use clock::Clock;
pub use code_source::{CodeCall, CodeList, CodeSource};
pub use codes::{DEFAULT_ACCELERATIONS, fixed_code, grid_codes, plain_codes, planner_code};
pub use delayed::Delayed;
pub use error::PlannerError;
pub use exec::{
    AnswerError, DEFAULT_EXEC_TIMEOUT, ExecAgent, ExecAgentsStep, ExecCommand, ExecError,
    ExecReply, ExecRequest, ExecSession, interned, is_exec, moved, read_reply, trajectory_of,
};
pub use gated::Gated;
pub use idm::IdmPlanner;
pub use language_agent::{CallTerms, LanguageAgent, Shown, planning_call};
#[doc(hidden)]
pub use language_settings::AgentKeys;
pub use language_settings::{AgentSettings, LanguageAgentSettings};
pub use latency::Latency;
pub use layer::AgentLayer;
pub use llm_assist::{AskedModel, LlmAssist};
#[doc(hidden)]
pub use llm_assist::{AssistDrive, HandedAnswers};
pub use log_replay::LogReplay;
pub use monitored::Monitored;
pub use name::PlannerName;
pub use pdm_closed::PdmClosed;
pub use pdm_closed_plus::PdmClosedPlus;
pub use plan_agent::PlanAgent;
pub use plan_bounds::{PlanJump, check_plan};
pub use record::{Attempt, Decision, DecisionKind, NoPlan, PlanningCall, Proposal, feedback};
pub use settings::{
    AfterMaxExec, CallSettings, EnvironmentSettings, LearnedSettings, PlanAgentSettings,
    ReflectionSettings,
};
pub use simple::SimplePlanner;
pub use stop::comfortable_stop;
pub use stop_switch::StopSwitch;
pub use unreadable::Unreadable;
pub use waypoint_path::{Onward, prolonged, through_waypoints};

use crate::environment::BevView;
use image::RgbImage;
use planagent_score::pdm::DrivableLayers;
use planagent_world::{LaneMap, Route, SceneView, Trajectory};
use std::sync::Arc;

/// Renders the BEV image of another scene, the same one for the same draw.
pub type BevSource = Arc<
    dyn Fn(u64, &BevView) -> Result<RgbImage, Box<dyn std::error::Error + Send + Sync>>
        + Send
        + Sync,
>;

/// A planner's input before the first iteration.
#[derive(Debug, Clone, Copy)]
pub struct PlannerInitialization<'a> {
    /// The map; a planner may keep it.
    pub map: &'a Arc<LaneMap>,
    /// The route.
    pub route: &'a Route,
}

/// A planner's input at every iteration: the present and the recent past. By construction a planner
/// never sees the logged future; log replay, which does, is built with the recording.
#[derive(Debug, Clone, Copy)]
pub struct PlannerInput<'a> {
    /// The iteration, from 0.
    pub iteration: usize,
    /// The present scene with its history.
    pub scene: SceneView<'a>,
}

/// A planner: once initialized, it gives a trajectory at every iteration.
pub trait Planner: Send {
    /// Name for tables and files, for example `log-replay`.
    fn name(&self) -> &str;

    /// Prepares for one scenario. Called once before the first iteration; a second call discards
    /// all state.
    ///
    /// # Errors
    /// When the planner cannot plan on this map or route.
    fn initialize(
        &mut self,
        initialization: &PlannerInitialization<'_>,
    ) -> Result<(), PlannerError>;

    /// The trajectory to follow from now on. It starts at the present or before and reaches over
    /// the next step at least.
    ///
    /// # Errors
    /// When no trajectory can be given.
    fn compute_trajectory(&mut self, input: &PlannerInput<'_>) -> Result<Trajectory, PlannerError>;

    /// Called once after the last iteration of a simulation.
    ///
    /// # Errors
    /// When the planner finds only now that its trajectories were wrong; the simulation fails with
    /// it.
    fn finish(&mut self) -> Result<(), PlannerError> {
        Ok(())
    }

    /// The planning calls since the last initialization; none for a planner that makes none.
    fn calls(&self) -> &[PlanningCall] {
        &[]
    }

    /// The planning calls, which the planner may give away.
    fn take_calls(&mut self) -> Vec<PlanningCall> {
        self.calls().to_vec()
    }

    /// The drivable areas that the planner scores its plans with, if they are the same in the whole
    /// simulation.
    fn drivable_layers(&self) -> Option<DrivableLayers> {
        None
    }
}
