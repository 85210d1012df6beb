//! Stage 1: opening a drive. Whatever its source, it becomes a [`Scenario`]: map, logged ego and agents, lights, route.

use crate::world::{EgoState, History, LaneMap, Route, SceneView, TrackedObject, TrafficLights};
use std::sync::Arc;

pub mod argoverse2;
pub mod generator;
pub mod nuplan;
mod reader;
mod recording;
pub mod womd;

pub use reader::{
    Contents, DataRoots, ExcludedToken, MissingTokens, OnProgress, OpenScenario, ReaderError, Readers, Recognition,
    ScenarioReader, ScenarioRef, Split, absolute_path,
};
pub use recording::trace::LineFault;
pub use recording::window::TimeFault;

/// nuPlan's type of a scenario without a tag (devkit `DEFAULT_SCENARIO_NAME`).
pub const UNKNOWN_TYPE: &str = "unknown";

/// Most frames of [`Scenario::future`]: eight seconds at 10 Hz, the farthest that nuPlan looks ahead.
pub const FUTURE_FRAMES: usize = 80;

/// One instant of the log.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    /// The recorded ego; its time is the time of the frame.
    pub ego: EgoState,
    /// Everything else that was seen.
    pub objects: Arc<[TrackedObject]>,
    /// The lights.
    pub lights: Arc<TrafficLights>,
}

/// A recorded or generated drive, cut to nuPlan's window.
#[derive(Debug, Clone)]
pub struct Scenario {
    /// Name that is unique within its source: a Waymo scenario id, a nuPlan token, a generator name with its seed.
    pub id: String,
    /// nuPlan's scenario type; `unknown` where the source does not tag it.
    pub scenario_type: String,
    /// Name of the log that it was cut from.
    pub log_name: String,
    /// The map around it.
    pub map: Arc<LaneMap>,
    /// Where the ego is meant to go.
    pub route: Route,
    /// All frames at 10 Hz, those of the history before the start included.
    pub frames: Vec<Frame>,
    /// Which frame is iteration 0.
    pub start: usize,
    /// The recorded ego after the last frame at 10 Hz, as far as the recording goes and eight seconds at most. The simulation
    /// ends before it; log replay and the open-loop metrics look at it, as in nuPlan.
    pub future: Vec<EgoState>,
}

impl Scenario {
    /// Number N of iterations: the frames from the start on. A simulation saves N−1 samples.
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

    /// The recorded ego from iteration 0 on, over the end of the scenario.
    pub fn recorded(&self) -> impl Iterator<Item = &EgoState> {
        self.expert().chain(&self.future)
    }

    /// The scene of one of its frames, as recorded.
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
