//! Reactive traffic of modified scenarios: vehicles with a behavior towards the ego, vehicles that
//! never move, and actors whose crossing the ego's progress triggers (interPlan
//! `idm_modified_agent_manager.py`, `agents_modifier.py`).

mod ego_path;
mod lane_change;

use super::agent::IdmAgent;
use super::footprint::Footprint;
use super::{
    IDM_AGENT, Obstacle, RADIUS, Seen, build, is_open_loop, nearest_on_path, stop_lines_of,
};
use crate::dynamics::idm::Lead;
use crate::geometry::{Point, wrap_angle};
use crate::{
    CrossingActor, DriverBehavior, EgoState, Interaction, LaneMap, TrackToken, TrackedObject,
    TrafficLights,
};
use std::collections::BTreeSet;
use std::sync::Arc;

#[cfg(test)]
mod tests;

use ego_path::EgoPath;

/// The actors of a scene that cross when the ego triggers them, each with the time since then.
#[derive(Debug, Clone, Default)]
pub struct CrossingActors {
    all: Arc<[CrossingActor]>,
    /// Seconds since the start of each; `None` before it.
    since_s: Vec<Option<f64>>,
}

impl CrossingActors {
    /// All of them, unseen; the ego at its start triggers those that are near.
    pub fn new(all: &[CrossingActor], ego: &EgoState) -> Self {
        let mut crossing = Self {
            all: all.into(),
            since_s: vec![None; all.len()],
        };
        crossing.trigger(ego);
        crossing
    }

    fn trigger(&mut self, ego: &EgoState) {
        let center = ego.center().position();
        for (actor, since) in self.all.iter().zip(&mut self.since_s) {
            if since.is_none() && actor.starts_for(center) {
                *since = Some(0.0);
            }
        }
    }

    /// Moves on by `dt_s`; `ego` is the state before the step.
    pub fn step(&mut self, ego: &EgoState, dt_s: f64) {
        for since in self.since_s.iter_mut().flatten() {
            *since += dt_s;
        }
        self.trigger(ego);
    }

    /// Those on the road now.
    pub fn objects(&self) -> impl Iterator<Item = TrackedObject> + '_ {
        self.all
            .iter()
            .zip(&self.since_s)
            .filter_map(|(actor, since)| Some(actor.after((*since)?)))
    }

    /// Whether a track is one of them, seen or not.
    pub fn has(&self, token: TrackToken) -> bool {
        self.all.iter().any(|actor| actor.token == token)
    }
}

/// A reactive vehicle with its behavior.
#[derive(Debug, Clone)]
struct Driver {
    agent: IdmAgent,
    behavior: DriverBehavior,
    /// Whether it brakes for the ego as for a wall.
    halts: bool,
    /// Seconds until it may think about another lane.
    patience_s: f64,
}

/// All that moves in a modified scenario with reactive agents.
#[derive(Debug, Clone)]
pub struct InteractiveTraffic {
    map: Arc<LaneMap>,
    drivers: Vec<Driver>,
    standing: BTreeSet<TrackToken>,
    lane_changes: bool,
    /// Standing vehicles and logged objects.
    others: Vec<TrackedObject>,
    crossing: CrossingActors,
}

impl InteractiveTraffic {
    /// The traffic at iteration 0, from the objects and the ego of that instant.
    pub fn new(
        map: &Arc<LaneMap>,
        objects: &[TrackedObject],
        ego: &EgoState,
        interaction: &Interaction,
    ) -> Self {
        let crossing = CrossingActors::new(&interaction.crossing, ego);
        let standing = interaction.standing.clone();
        let others = others(objects, &standing, &crossing);
        let drives = |o: &&TrackedObject| !standing.contains(&o.token) && !crossing.has(o.token);
        let moving: Vec<TrackedObject> = objects.iter().filter(drives).copied().collect();
        let agents = build::agents(map, &moving, &others, ego, IDM_AGENT);
        let behavior = |token: TrackToken| match interaction
            .behaviors
            .get(&token)
            .copied()
            .unwrap_or(interaction.behavior)
        {
            // The coin depends on seed and token alone, so an agent keeps its behavior when others
            // join or leave.
            DriverBehavior::Mixed if coin(interaction.seed, token) => DriverBehavior::Assertive,
            DriverBehavior::Mixed => DriverBehavior::Cautious,
            behavior => behavior,
        };
        let driver = |agent: IdmAgent| {
            let token = agent.token();
            Driver {
                behavior: behavior(token),
                halts: interaction.halting.contains(&token),
                patience_s: 0.0,
                agent,
            }
        };
        let drivers = agents.into_iter().map(driver).collect();
        let lane_changes = interaction.lane_changes;
        Self {
            map: Arc::clone(map),
            drivers,
            standing,
            lane_changes,
            others,
            crossing,
        }
    }

    /// The objects now: the reactive vehicles, what stands, the logged objects, those that cross.
    pub fn objects(&self) -> Arc<[TrackedObject]> {
        let drivers = self.drivers.iter().map(|driver| driver.agent.object());
        drivers
            .chain(self.others.iter().copied())
            .chain(self.crossing.objects())
            .collect()
    }

    /// Moves from iteration k to k+1, `dt` seconds later, with the ego at k and the logged objects
    /// and lights of k+1, as nuPlan's agents do.
    pub fn step(
        &mut self,
        ego: &EgoState,
        logged: &[TrackedObject],
        lights: &TrafficLights,
        dt: f64,
    ) {
        self.others = others(logged, &self.standing, &self.crossing);
        self.crossing.step(ego, dt);
        let center = ego.center().position();
        self.drivers
            .retain(|driver| (driver.agent.pose().position() - center).norm() <= RADIUS);
        let path = EgoPath::new(ego);
        let things = self.others.iter().copied().chain(self.crossing.objects());
        let things: Vec<Obstacle> = things
            .map(|o| Obstacle::standing(Footprint::of_box(o.shape)))
            .collect();
        for index in 0..self.drivers.len() {
            self.drivers[index].agent.extend_route(&self.map, lights);
            if self.lane_changes {
                self.consider_lane_change(index, ego, dt);
            }
            let stop_lines = stop_lines_of(&self.map, &self.drivers[index].agent, lights);
            let lead = self.lead_of(index, ego, &path, &things, &stop_lines);
            self.drivers[index].agent.propagate(lead, &self.map, dt);
        }
    }

    fn lead_of(
        &self,
        index: usize,
        ego: &EgoState,
        path: &EgoPath,
        things: &[Obstacle],
        stop_lines: &[Obstacle],
    ) -> Option<Lead> {
        let Driver {
            agent,
            behavior,
            halts,
            ..
        } = &self.drivers[index];
        let speed = if *halts { 0.0 } else { ego.speed() };
        let heading = ego.rear_axle.heading;
        let mut of_ego = vec![Obstacle {
            footprint: Footprint::of_box(ego.footprint()),
            heading,
            speed,
        }];
        // Only agents that yield see where the ego will be; to the others it is what it is now.
        if path.counts_for(&self.map, agent, *behavior, ego) {
            of_ego.push(Obstacle {
                footprint: path.footprint().clone(),
                heading,
                speed,
            });
        }
        let fellows = self.drivers.iter().enumerate().filter(|&(i, _)| i != index);
        let fellows = fellows.map(|(i, fellow)| (Seen::Agent(i), fellow.agent.footprint()));
        let rest = of_ego
            .iter()
            .chain(things)
            .chain(stop_lines)
            .map(|one| (Seen::Obstacle(one), &one.footprint));
        let (gap, seen) = nearest_on_path(agent, fellows.chain(rest))?;
        let (speed, direction) = match seen {
            Seen::Agent(i) => (
                self.drivers[i].agent.speed(),
                self.drivers[i].agent.pose().heading,
            ),
            Seen::Obstacle(other) => (other.speed, other.heading),
        };
        Some(Lead {
            gap,
            speed: speed * wrap_angle(direction - agent.pose().heading).cos(),
        })
    }
}

/// What stands, and the logged objects of open-loop kinds.
fn others(
    objects: &[TrackedObject],
    standing: &BTreeSet<TrackToken>,
    crossing: &CrossingActors,
) -> Vec<TrackedObject> {
    let is_other = |o: &&TrackedObject| {
        (standing.contains(&o.token) || is_open_loop(o.kind)) && !crossing.has(o.token)
    };
    objects.iter().filter(is_other).copied().collect()
}

/// A coin for each vehicle that no other vehicle changes.
fn coin(seed: u64, token: TrackToken) -> bool {
    let mixed = (seed ^ u64::from(token.0)).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    (mixed ^ (mixed >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9) >> 63 == 1
}

/// The center of a pose ahead of which another lies.
pub(super) fn is_behind(point: Point, agent: &IdmAgent) -> bool {
    agent.pose().to_local(point).x < 0.0
}
