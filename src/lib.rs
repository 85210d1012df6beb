//! A driving agent that plans with a vision-language model, offline on the CPU, and the closed loop
//! to test it in.
//!
//! ```
//! use planagent::{Agent, Challenge, Scenario, simulate};
//!
//! fn main() -> planagent::Result<()> {
//!     let scenario = Scenario::open("generated/changing_lane/2")?;
//!     let mut agent = Agent::builder().model("nano").build()?;
//!     let run = simulate(&scenario, &mut agent, Challenge::NonReactive)?;
//!     println!("{:.2}", run.score());
//!     Ok(())
//! }
//! ```
//!
//! In a simulator of your own, build a [`Scene`] and call [`Agent::plan`] at any step length.
//!
//! # How it works
//! The stages, in the order of the data:
//!
//! 1. `scenario` opens a recording or generates one: map, logged agents, traffic lights, route,
//!    expert.
//! 2. `environment` turns the scene into the two prompts of the paper: the BEV map and the
//!    lane-graph text.
//! 3. `mllm` runs a vision-language model on the CPU, or asks a server.
//! 4. `reasoning` asks the model in three rounds and parses the planner code that it writes.
//! 5. `reflection` rolls the plan out, scores it with the measure of `pdm`, and accepts it or asks
//!    to rethink.
//! 6. `planner` is the trait that the simulator knows; the agent and the baselines implement it.
//! 7. `simulation` closes the loop at 10 Hz.
//! 8. `metrics` scores the simulation with nuPlan's closed-loop metrics.
//! 9. `runs` simulates many scenarios, resumes, and writes tables, pages and films; see [`runs`].
//! 10. `lab` compares planners in studies, builds datasets and measures models.
//!
//! Below them lie `world` (the vocabulary, shapes and motion), `kernels` and `files`; above them
//! the command line. `ARCHITECTURE.md` has the crates and their order.
//!
//! # Where to extend
//! - A planner: implement [`Planner`]; to name it, add it to a [`planning::PlannerRegistry`].
//! - A metric: a [`evaluation::MetricSpec`] in a [`evaluation::MetricRegistry`], used by
//!   [`Simulation::metrics`].
//! - The other agents: implement [`traffic::AgentPolicy`], used by [`Simulation::agents`].
//! - A source of scenarios: implement [`sources::ScenarioReader`] and add it to
//!   [`sources::Readers`].
//! - A model: a folder as Hugging Face writes it, a GGUF file, or a description in `models/`; see
//!   [`AgentBuilder::model`].
//!
//! The folder `examples/` has a program for each.

pub use api::{Agent, AgentBuilder, Error, Result, Run, Simulation, simulate};
pub use planagent_agent::planner::Planner;
pub use planagent_agent::simulation::Challenge;
pub use planagent_scenario::Scenario;
pub use planagent_score::metrics::Score;
pub use planagent_world::{EgoState, Scene, SceneBuilder, Trajectory};

/// Planners: their input and output, their registry, and the settings and records of the agent.
pub mod planning {
    pub use planagent_agent::planner::{
        AfterMaxExec, Attempt, CodeSource, Decision, IdmPlanner, Latency, LogReplay, NoPlan,
        PdmClosed, PlanAgentSettings, PlannerError, PlannerInitialization, PlannerInput,
        PlannerName, PlanningCall, SimplePlanner,
    };
    pub use planagent_agent::planner_registry::{
        PlannerEntry, PlannerNeeds, PlannerParts, PlannerRegistry,
    };
    pub use planagent_agent::reflection::LeadPolicy;
    pub use planagent_planners::all_planners;
    pub use planagent_world::{
        History, HistorySample, SceneError, SceneView, TrajectoryError, TrajectoryState,
    };
}

/// Metrics and scores.
pub mod evaluation {
    pub use planagent_score::metrics::{
        EvaluatedSimulation, Evaluation, METRICS, MetricCategory, MetricError, MetricInput,
        MetricList, MetricRegistry, MetricResult, MetricSpec, Role, ScorePart, ScoreUnit,
        Statistic, StatisticKind, TimeSeries,
    };
}

/// Maps and the geometry that they are made of.
pub mod road {
    pub use planagent_world::geometry::{
        GeometryError, OrientedBox, Point, Polygon, Polyline, Pose, Vector,
    };
    pub use planagent_world::{
        Lane, LaneAreas, LaneId, LaneKind, LaneMap, MapBuilder, MapError, MapParts, Neighbor,
        Roadblock, RoadblockId, Route, StopLine, StopLineId,
    };
}

/// The ego, the objects around it, and who controls them in a simulation.
pub mod traffic {
    pub use planagent_agent::simulation::{
        AGENT_POLICIES, AgentPolicy, AgentPolicyError, AgentPolicyName, AgentPolicySpec,
        SimulationError, SimulationLog,
    };
    pub use planagent_scenario::Frame;
    pub use planagent_world::dynamics::{TrackingError, follow};
    pub use planagent_world::{
        ObjectKind, PACIFICA, SignalStatus, TrackToken, TrackedObject, TrafficLights,
        VehicleParameters,
    };
}

/// Sources of scenarios.
pub mod sources {
    pub use planagent_scenario::{
        Contents, DataRoots, OpenScenario, ReaderError, Readers, ScenarioReader, ScenarioRef, Split,
    };
}

/// Runs of many simulations in a folder, resumed after an interruption, and the studies that
/// compare them.
#[cfg(feature = "report")]
pub mod runs {
    pub use planagent_agent::planner::StopSwitch;
    pub use planagent_lab::study_runs::{Studies, StudiesRequest};
    pub use planagent_runs::runner::{Config, Event, Listener, Request, RunResults, resume, start};
}

mod api;
