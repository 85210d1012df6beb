//! Stage 6: the planners. The simulator knows an agent only through [`Planner`], whose shape is nuPlan's.

mod active_plan;
mod code_source;
mod idm;
mod latency;
mod llm_assist;
mod log_replay;
mod monitored;
mod pdm_closed;
mod plan_agent;
mod record;
mod registry;
mod settings;
mod shuffled_bev;
mod simple;

pub use code_source::{CodeSource, DEFAULT_ACCELERATIONS, planner_code};
pub use idm::IdmPlanner;
pub use latency::Latency;
pub use llm_assist::LlmAssist;
pub use log_replay::LogReplay;
pub use monitored::{MonitoredStep, monitored_step};
pub use pdm_closed::PdmClosed;
pub use plan_agent::{PlanAgent, build_idm_plan, names};
pub use record::{Attempt, Decision, NoPlan, PlanningCall, feedback};
pub use registry::{PlannerEntry, PlannerName, PlannerNeeds, PlannerParts, PlannerRegistry, UnknownPlanner};
pub use settings::{AfterMaxExec, PlanAgentSettings};
pub use simple::SimplePlanner;

use crate::pdm::DrivableLayers;
use crate::world::{LaneMap, Route, SceneView, Trajectory, TrajectoryError};
use std::sync::Arc;

/// What a planner learns once, before the first iteration.
#[derive(Debug, Clone, Copy)]
pub struct PlannerInitialization<'a> {
    /// The map, to be kept if the planner needs it.
    pub map: &'a Arc<LaneMap>,
    /// Where to go.
    pub route: &'a Route,
}

/// What a planner learns at every iteration.
///
/// There is the present and the recent past in it and nothing else: by construction a planner never sees the logged future.
/// (Log replay, the reference that does, is handed the recorded drive when it is made.)
#[derive(Debug, Clone, Copy)]
pub struct PlannerInput<'a> {
    /// Which iteration, from 0.
    pub iteration: usize,
    /// What is known now.
    pub scene: SceneView<'a>,
}

/// Why a planner gives no trajectory.
#[derive(Debug, thiserror::Error)]
pub enum PlannerError {
    /// Asked for a trajectory before it was initialised.
    #[error("the planner has not been initialised")]
    NotInitialized,
    /// The route holds no lane to drive on.
    #[error("the route has no lanes")]
    EmptyRoute,
    /// Log replay has nothing recorded from this iteration on, and no earlier trajectory.
    #[error("the recording holds {samples} samples; iteration {iteration} has no future to replay")]
    NoRecordedFuture {
        /// The iteration.
        iteration: usize,
        /// Length of the recording.
        samples: usize,
    },
    /// The planner cannot be built.
    #[error("{planner} needs {part}")]
    MissingPart {
        /// Its name.
        planner: PlannerName,
        /// What is missing.
        part: &'static str,
    },
    /// What it computed is no trajectory.
    #[error("the planned states make no trajectory")]
    Trajectory(#[from] TrajectoryError),
    /// Something that the planner builds on failed.
    #[error("{doing} failed")]
    Failed {
        /// What it was doing.
        doing: &'static str,
        /// What went wrong.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
}

/// An agent that drives: once initialised, it gives a trajectory at every iteration.
pub trait Planner: Send {
    /// Name for tables and files, for example `log-replay`.
    fn name(&self) -> &str;

    /// Prepares for one scenario. Called once before the first iteration; a second call starts afresh.
    ///
    /// # Errors
    /// When the planner cannot drive on this map or route.
    fn initialize(&mut self, initialization: &PlannerInitialization<'_>) -> Result<(), PlannerError>;

    /// The trajectory to follow from now on: it starts at the present or before and reaches over the next step at least.
    ///
    /// # Errors
    /// When no trajectory can be given.
    fn compute_trajectory(&mut self, input: &PlannerInput<'_>) -> Result<Trajectory, PlannerError>;

    /// The planning calls since the last initialization; none for a planner that makes none.
    fn calls(&self) -> &[PlanningCall] {
        &[]
    }

    /// The drivable areas that the planner scores its plans with, if it has one answer for the whole simulation.
    fn drivable_layers(&self) -> Option<DrivableLayers> {
        None
    }
}
