//! Stage 1: scenarios from any source: map, recorded ego and agents, traffic lights, route.

use planagent_world::{
    EgoState, History, Interaction, LaneMap, Route, SceneView, TrackedObject, TrafficLights,
};
use std::sync::Arc;

#[cfg(feature = "argoverse2")]
#[allow(missing_docs, reason = "the root names none of it")]
pub mod argoverse2;
#[cfg(any(feature = "womd", feature = "argoverse2", feature = "nuplan"))]
mod folders;
#[allow(missing_docs, reason = "the root names none of it")]
pub mod generator;
mod held;
mod interplan;
mod later_start;
#[allow(missing_docs, reason = "the root names none of it")]
pub mod modified;
#[cfg(feature = "nuplan")]
#[allow(missing_docs, reason = "the root names none of it")]
pub mod nuplan;
mod open;
mod reader;
#[cfg(any(feature = "womd", feature = "argoverse2"))]
#[allow(missing_docs, reason = "the messages say all")]
mod recording;
mod registry;
mod split;
#[cfg(feature = "womd")]
#[allow(missing_docs, reason = "the root names none of it")]
pub mod womd;

pub use held::HeldScenario;
pub use later_start::without_start;
pub use open::OpenError;
pub use reader::{
    DataRoots, OnProgress, OpenScenario, ReaderError, ScenarioReader, ScenarioRef, absolute_path,
};
#[cfg(any(feature = "womd", feature = "argoverse2"))]
pub use recording::error::{FileError, FilePlace, RecordingFault};
pub use registry::{RECORDINGS, Readers};
pub use split::{ExcludedToken, MissingTokens, Split};

/// The scenario that commands take where none is named: a person steps out, and the agent has to
/// leave the lane in time. Planner codes decide the score, so a model that reads the scene is clearly
/// better than one that does not (docs/decisions/127-default-scene.md).
pub const DEFAULT_SCENARIO: &str = "generated/traversing_pickup_dropoff/15~jaywalking_pedestrian";

/// nuPlan's type of a scenario without a tag (devkit `DEFAULT_SCENARIO_NAME`).
pub const UNKNOWN_TYPE: &str = "unknown";

/// Maximum number of frames of [`Scenario::future`]: eight seconds at 10 Hz, nuPlan's longest
/// horizon.
pub const FUTURE_FRAMES: usize = 80;

/// One time step of the log.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// The recorded ego; its time is that of the frame.
    pub ego: EgoState,
    /// Agents and static objects.
    pub objects: Arc<[TrackedObject]>,
    /// State of the traffic lights.
    pub lights: Arc<TrafficLights>,
}

/// A recorded or generated scenario.
#[derive(Debug, Clone)]
pub struct Scenario {
    /// Unique within its source: a Waymo scenario id, a nuPlan token, the name of a generated
    /// scenario.
    pub id: String,
    /// nuPlan's scenario type; `unknown` if the source has none.
    pub scenario_type: String,
    /// Name of the source log.
    pub log_name: String,
    /// Lanes and areas around the scenario.
    pub map: Arc<LaneMap>,
    /// Route of the ego.
    pub route: Route,
    /// All frames at 10 Hz, with the history before the start.
    pub frames: Vec<Frame>,
    /// Index of the frame of iteration 0.
    pub start: usize,
    /// The recorded ego after the last frame at 10 Hz, up to eight seconds. The simulation ends
    /// before it. Log replay and the open-loop metrics use it, as in nuPlan.
    pub future: Vec<EgoState>,
    /// What a modification added; `None` for a scenario as its source has it.
    pub interaction: Option<Arc<Interaction>>,
}

impl Scenario {
    /// Number N of iterations: the frames from the start on. A simulation records N−1 samples.
    pub fn iterations(&self) -> usize {
        self.frames.len() - self.start
    }

    /// The frame of an iteration.
    pub fn frame(&self, iteration: usize) -> Option<&Frame> {
        self.frames.get(self.start + iteration)
    }

    /// The recorded ego from iteration 0 on: nuPlan's expert trajectory, N states.
    pub fn expert(&self) -> impl Iterator<Item = &EgoState> {
        self.frames[self.start..].iter().map(|frame| &frame.ego)
    }

    /// The recorded ego from iteration 0 on, beyond the end of the scenario.
    pub fn recorded(&self) -> impl Iterator<Item = &EgoState> {
        self.expert().chain(&self.future)
    }

    /// The recorded scene of a frame.
    pub fn scene<'a>(&'a self, frame: &'a Frame, history: &'a History) -> SceneView<'a> {
        SceneView {
            map: &self.map,
            route: &self.route,
            ego: &frame.ego,
            objects: &frame.objects,
            lights: &frame.lights,
            history,
        }
    }

    /// The frames before iteration 0, oldest first.
    pub fn past(&self) -> &[Frame] {
        &self.frames[..self.start]
    }
}

/// What a recording holds, counted without building the scenario.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Contents {
    /// Place in a file of several recordings, from 0.
    pub record: Option<usize>,
    /// Recorded steps at 10 Hz.
    pub steps: usize,
    /// Iterations of a simulation.
    pub iterations: usize,
    /// Recorded objects.
    pub tracks: usize,
    /// Lanes for motor vehicles, lane connectors included: as many as the map of the opened
    /// scenario has.
    pub lanes: usize,
}
