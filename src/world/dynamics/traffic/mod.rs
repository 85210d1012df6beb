//! Reactive agents: vehicles that follow their lanes by the intelligent driver model (devkit
//! `idm_agents.py`, `idm_agent_manager.py`, `idm_agents_builder.py`).
//!
//! nuPlan's quirks are kept: bicycles are removed; only vehicles on a lane at iteration 0 become
//! agents; an agent more than 100 m from the ego is removed and does not return; the end of a path
//! is an obstacle. Two differences: tokens are compared as a whole, not as substrings, which is the
//! same for nuPlan's tokens of equal length. And of several obstacles at distance 0, upstream takes
//! the first in its tree; here agents come before the ego, logged objects and stop lines.

mod agent;
mod build;
mod footprint;
mod interactive;

#[cfg(test)]
mod tests;

pub use interactive::{CrossingActors, InteractiveTraffic};

use super::idm::{IdmParameters, Lead};
use crate::geometry::wrap_angle;
use crate::{EgoState, LaneMap, ObjectKind, SignalStatus, TrackedObject, TrafficLights};
use agent::IdmAgent;
use footprint::Footprint;
use std::sync::Arc;

/// Parameters of nuPlan's IDM agents. The target velocity applies until the first lane with a speed
/// limit.
pub const IDM_AGENT: IdmParameters = IdmParameters {
    target_velocity: 10.0,
    min_gap: 1.0,
    headway: 1.5,
    accel_max: 1.0,
    decel_max: 2.0,
    exponent: 4,
};

/// Agents farther from the ego are removed, center to center, meters.
const RADIUS: f64 = 100.0;

/// Whether objects of a kind replay the log.
fn is_open_loop(kind: ObjectKind) -> bool {
    match kind {
        ObjectKind::Pedestrian
        | ObjectKind::Barrier
        | ObjectKind::CzoneSign
        | ObjectKind::TrafficCone
        | ObjectKind::GenericObject => true,
        ObjectKind::Vehicle | ObjectKind::Bicycle => false,
    }
}

/// All reactive agents of a scenario and the objects that replay the log. Clones share map and
/// paths, so that many futures can be tried from one state.
#[derive(Debug, Clone)]
pub struct IdmTraffic {
    map: Arc<LaneMap>,
    agents: Vec<IdmAgent>,
    open_loop: Vec<TrackedObject>,
}

/// An obstacle on the path of an agent.
struct Obstacle {
    footprint: Footprint,
    heading: f64,
    /// Along its heading, m/s.
    speed: f64,
}

impl Obstacle {
    fn standing(footprint: Footprint) -> Self {
        Self {
            footprint,
            heading: 0.0,
            speed: 0.0,
        }
    }
}

impl IdmTraffic {
    /// The agents at iteration 0, from the logged objects and the ego of that instant.
    pub fn new(map: &Arc<LaneMap>, objects: &[TrackedObject], ego: &EgoState) -> Self {
        Self::with_law(map, objects, ego, IDM_AGENT)
    }

    /// Like [`Self::new`] with other parameters of the law.
    pub(crate) fn with_law(
        map: &Arc<LaneMap>,
        objects: &[TrackedObject],
        ego: &EgoState,
        law: IdmParameters,
    ) -> Self {
        let open_loop: Vec<TrackedObject> = objects
            .iter()
            .filter(|o| is_open_loop(o.kind))
            .copied()
            .collect();
        let agents = build::agents(map, objects, &open_loop, ego, law);
        Self {
            map: Arc::clone(map),
            agents,
            open_loop,
        }
    }

    /// Number of reactive agents.
    pub fn agent_count(&self) -> usize {
        self.agents.len()
    }

    /// The objects now: the reactive agents, then the logged objects.
    pub fn objects(&self) -> Arc<[TrackedObject]> {
        self.agents
            .iter()
            .map(IdmAgent::object)
            .chain(self.open_loop.iter().copied())
            .collect()
    }

    /// Moves the agents from iteration k to k+1, `dt` seconds later. As in nuPlan, they see the ego
    /// at k but the logged objects and lights of k+1, and each sees earlier agents already moved.
    pub fn step(
        &mut self,
        ego: &EgoState,
        logged: &[TrackedObject],
        lights: &TrafficLights,
        dt: f64,
    ) {
        self.open_loop = logged
            .iter()
            .filter(|object| is_open_loop(object.kind))
            .copied()
            .collect();
        let center = ego.center().position();
        self.agents
            .retain(|agent| (agent.pose().position() - center).norm() <= RADIUS);
        let mut others = vec![Obstacle {
            footprint: Footprint::of_box(ego.footprint()),
            heading: ego.rear_axle.heading,
            speed: ego.speed(),
        }];
        others.extend(
            self.open_loop
                .iter()
                .map(|object| Obstacle::standing(Footprint::of_box(object.shape))),
        );
        // In place and in order: nuPlan's later agents see where the earlier ones have moved to.
        for index in 0..self.agents.len() {
            self.agents[index].extend_route(&self.map, lights);
            let stop_lines = stop_lines_of(&self.map, &self.agents[index], lights);
            let lead = self.lead_of(index, &others, &stop_lines);
            self.agents[index].propagate(lead, &self.map, dt);
        }
    }

    /// The nearest obstacle whose footprint meets the path of an agent; the distance is that
    /// between footprints.
    fn lead_of(&self, index: usize, others: &[Obstacle], stop_lines: &[Obstacle]) -> Option<Lead> {
        let agent = &self.agents[index];
        let fellows = self.agents.iter().enumerate().filter(|&(i, _)| i != index);
        let fellows = fellows.map(|(i, fellow)| (Seen::Agent(i), fellow.footprint()));
        let rest = others
            .iter()
            .chain(stop_lines)
            .map(|other| (Seen::Obstacle(other), &other.footprint));
        nearest_on_path(agent, fellows.chain(rest)).map(|(gap, seen)| {
            let (speed, direction) = match seen {
                Seen::Agent(i) => (self.agents[i].speed(), self.agents[i].pose().heading),
                Seen::Obstacle(other) => (other.speed, other.heading),
            };
            Lead {
                gap,
                speed: speed * wrap_angle(direction - agent.pose().heading).cos(),
            }
        })
    }
}

/// The stop lines of those segments of an agent's route that show red.
fn stop_lines_of(map: &LaneMap, agent: &IdmAgent, lights: &TrafficLights) -> Vec<Obstacle> {
    agent
        .route()
        .filter(|&lane| lights.status(lane) == Some(SignalStatus::Red))
        .flat_map(|lane| &map[lane].stop_lines)
        .map(|&line| Obstacle::standing(Footprint::of_polygon(&map[line].polygon)))
        .collect()
}

/// The nearest of those footprints that meet the path of an agent, with its distance, meters.
fn nearest_on_path<'a>(
    agent: &IdmAgent,
    seen: impl Iterator<Item = (Seen<'a>, &'a Footprint)>,
) -> Option<(f64, Seen<'a>)> {
    let path = agent.path_ahead()?;
    let own = agent.footprint();
    let mut candidates: Vec<(f64, Seen<'_>, &Footprint)> = seen
        .filter(|(_, footprint)| footprint.bounds().overlaps(path.bounds()))
        .map(|(seen, footprint)| (own.distance_at_least(footprint), seen, footprint))
        .collect();
    candidates.sort_by(|a, b| a.0.total_cmp(&b.0));

    let mut nearest: Option<(f64, Seen<'_>)> = None;
    for (at_least, seen, footprint) in candidates {
        if nearest.is_some_and(|(best, _)| at_least >= best) {
            break;
        }
        if path.meets(footprint) {
            let distance = own.distance(footprint);
            if nearest.is_none_or(|(best, _)| distance < best) {
                nearest = Some((distance, seen));
            }
        }
    }
    nearest
}

/// An obstacle that an agent sees.
#[derive(Clone, Copy)]
enum Seen<'a> {
    Agent(usize),
    Obstacle(&'a Obstacle),
}
