//! The scenes and plans of a replay, ready for drawing.

use super::Replay;
use super::deltas::Points;
use super::map::DrawnMap;
use super::track::{AgentTrack, LightTrack};
use planagent_world::geometry::Point;
use planagent_world::{EgoState, SignalStatus, TrackedObject};

/// A replay ready for drawing.
#[derive(Debug, Clone)]
pub(in crate::report) struct ReplayedSimulation {
    map: DrawnMap,
    moments: Vec<Moment>,
    /// Planning calls: iteration and the roll-out of each attempt.
    calls: Vec<(usize, Vec<Vec<Point>>)>,
    /// Lights by the start of their connector, with the iterations of their changes.
    lights: Vec<([Point; 2], LightTrack)>,
}

/// One iteration.
#[derive(Debug, Clone)]
pub(in crate::report) struct Moment {
    /// Seconds since the start.
    pub(in crate::report) at_s: f64,
    /// The ego.
    pub(in crate::report) ego: EgoState,
    /// The active plan: path of the rear axle, a point every half second.
    pub(in crate::report) plan: Vec<Point>,
    /// All other objects.
    pub(in crate::report) objects: Vec<TrackedObject>,
}

impl ReplayedSimulation {
    /// The scenes of a replay.
    pub(in crate::report) fn new(replay: &Replay) -> Self {
        let plans = replay
            .plans
            .iter()
            .map(|plan| plan.points().collect())
            // Iterations behind the last plan have none, and `zip` would drop them.
            .chain(std::iter::repeat(Vec::new()));
        let mut moments: Vec<Moment> = replay
            .ego
            .states()
            .zip(replay.times_ms.values(1e-3))
            .zip(plans)
            .map(|((ego, at_s), plan)| Moment {
                at_s,
                ego,
                plan,
                objects: Vec::new(),
            })
            .collect();
        for (i, object) in replay.agents.iter().flat_map(AgentTrack::objects) {
            if let Some(moment) = moments.get_mut(i) {
                moment.objects.push(object);
            }
        }
        let attempts = |tracks: &[Option<Points>]| {
            tracks
                .iter()
                .map(|track| track.iter().flat_map(Points::points).collect())
                .collect()
        };
        let map = DrawnMap::from(&replay.map);
        let light = |light: &LightTrack| Some((map.start_of(light.lane())?, light.clone()));
        Self {
            moments,
            calls: replay
                .calls
                .iter()
                .map(|call| (call.iteration, attempts(&call.attempts)))
                .collect(),
            lights: replay.lights.iter().filter_map(light).collect(),
            map,
        }
    }

    /// The map nearby.
    pub(in crate::report) fn map(&self) -> &DrawnMap {
        &self.map
    }

    /// The iterations in order.
    pub(in crate::report) fn moments(&self) -> &[Moment] {
        &self.moments
    }

    /// The lights at an iteration: the first segment of each connector with a light, and its
    /// status.
    pub(in crate::report) fn lights_at(&self, iteration: usize) -> Vec<([Point; 2], SignalStatus)> {
        self.lights
            .iter()
            .filter_map(|(start, light)| Some((*start, light.at(iteration)?)))
            .collect()
    }

    /// The last planning call up to an iteration: its number and the roll-outs of its attempts.
    pub(in crate::report) fn call_at(&self, iteration: usize) -> Option<(usize, &[Vec<Point>])> {
        let count = self
            .calls
            .iter()
            .take_while(|(at, _)| *at <= iteration)
            .count();
        let call = count.checked_sub(1)?;
        self.calls
            .get(call)
            .map(|(_, attempts)| (call, attempts.as_slice()))
    }
}
