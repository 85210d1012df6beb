//! The scenes and plans of a replay.

use super::Replay;
use super::track::AgentTrack;
use crate::geometry::Point;
use crate::world::{EgoState, History, LaneMap, MapError, Route, SceneView, TrackedObject, TrafficLights};

/// A replay ready for drawing.
#[derive(Debug, Clone)]
pub(in crate::report) struct ReplayedSimulation {
    map: LaneMap,
    moments: Vec<Moment>,
    /// Planning calls: iteration and the roll-out of each attempt.
    calls: Vec<(usize, Vec<Vec<Point>>)>,
    route: Route,
    lights: TrafficLights,
    history: History,
}

/// One iteration.
#[derive(Debug, Clone)]
pub(in crate::report) struct Moment {
    /// Seconds since the start.
    pub(in crate::report) at_s: f64,
    /// The ego.
    pub(in crate::report) ego: EgoState,
    /// The active plan: path of the rear axle.
    pub(in crate::report) plan: Vec<Point>,
    objects: Vec<TrackedObject>,
}

impl ReplayedSimulation {
    /// The scenes of a replay.
    pub(in crate::report) fn new(replay: &Replay) -> Result<Self, MapError> {
        let plans = replay.plans.iter().map(|plan| plan.points().collect()).chain(std::iter::repeat(Vec::new()));
        let mut moments: Vec<Moment> = replay
            .ego
            .states()
            .zip(replay.times_ms.values(1e-3))
            .zip(plans)
            .map(|((ego, at_s), plan)| Moment { at_s, ego, plan, objects: Vec::new() })
            .collect();
        for (i, object) in replay.agents.iter().flat_map(AgentTrack::objects) {
            if let Some(moment) = moments.get_mut(i) {
                moment.objects.push(object);
            }
        }
        let attempts = |tracks: &[Option<super::Points>]| {
            tracks.iter().map(|track| track.iter().flat_map(super::Points::points).collect()).collect()
        };
        Ok(Self {
            map: replay.map.to_map()?,
            moments,
            calls: replay.calls.iter().map(|call| (call.iteration, attempts(&call.attempts))).collect(),
            route: Route::default(),
            lights: TrafficLights::default(),
            history: History::default(),
        })
    }

    /// The iterations in order.
    pub(in crate::report) fn moments(&self) -> &[Moment] {
        &self.moments
    }

    /// The scene of a moment, without route, lights and history.
    pub(in crate::report) fn scene<'a>(&'a self, moment: &'a Moment) -> SceneView<'a> {
        SceneView {
            map: &self.map,
            route: &self.route,
            ego: &moment.ego,
            objects: &moment.objects,
            lights: &self.lights,
            history: &self.history,
        }
    }

    /// The last planning call up to an iteration: its number and the roll-outs of its attempts.
    pub(in crate::report) fn call_at(&self, iteration: usize) -> Option<(usize, &[Vec<Point>])> {
        let count = self.calls.iter().take_while(|(at, _)| *at <= iteration).count();
        let call = count.checked_sub(1)?;
        self.calls.get(call).map(|(_, attempts)| (call, attempts.as_slice()))
    }
}
