//! The replay of a simulation that just ran.

use super::deltas::{Deltas, Points};
use super::map::ReplayMap;
use super::track::{AgentTrack, EgoTrack, LightTrack};
use super::{CallTrack, FORMAT, PLAN_POINTS, PLAN_STEP_US, Replay};
use crate::worker::run::SimulationOutcome;
use planagent_agent::planner::{Attempt, PlanningCall};
use planagent_world::geometry::{Bounds, Point};
use planagent_world::{STEP_US, Trajectory};

/// The replay holds map and objects up to this distance from the paths of the ego and the recorded
/// ego, meters.
const REACH_M: f64 = 80.0;

impl Replay {
    /// The replay of a simulation.
    pub(in crate::report) fn from_outcome(outcome: &SimulationOutcome) -> Self {
        let (scenario, log) = (&outcome.scenario, &outcome.log);
        let samples = &log.samples;
        let expert: Vec<Point> = scenario
            .expert()
            .take(samples.len())
            .map(|ego| ego.rear_axle.position())
            .collect();
        let mut path: Vec<Point> = samples
            .iter()
            .map(|sample| sample.ego.rear_axle.position())
            .collect();
        // The page draws both paths, so the map covers both.
        path.extend(&expert);
        let map = ReplayMap::from_map(
            &scenario.map,
            &scenario.route,
            &Bounds::around(&path).grown(REACH_M),
        );
        let start = samples.first().map_or(0, |sample| sample.ego.time_us);
        let lights = LightTrack::all(map.lane_ids(), samples.len(), |i, lane| {
            scenario
                .frame(i)
                .and_then(|frame| frame.lights.status(lane))
        });
        Self {
            format: FORMAT,
            times_ms: Deltas::from_values(
                samples
                    .iter()
                    .map(|sample| (sample.ego.time_us - start) as f64),
                1e3,
            ),
            map,
            ego: EgoTrack::from_samples(samples),
            expert: Points::from_points(&expert),
            agents: AgentTrack::all(samples, REACH_M),
            lights,
            plans: samples
                .iter()
                .zip(&log.trajectories)
                .map(|(s, plan)| plan_points(plan, s.ego.time_us))
                .collect(),
            calls: outcome.calls.iter().map(CallTrack::from_call).collect(),
        }
    }
}

impl CallTrack {
    fn from_call(call: &PlanningCall) -> Self {
        Self {
            iteration: call.iteration,
            attempts: call.attempts.iter().map(rolled_out).collect(),
        }
    }
}

/// Reflection's roll-out of an attempt, every half second.
fn rolled_out(attempt: &Attempt) -> Option<Points> {
    let states = &attempt.reflection.as_ref()?.states;
    let every = (PLAN_STEP_US / STEP_US) as usize;
    let points: Vec<Point> = states
        .iter()
        .step_by(every)
        .map(|state| state.rear_axle.position())
        .collect();
    Some(Points::from_points(&points))
}

/// A plan from `now_us` to its end, every half second.
fn plan_points(plan: &Trajectory, now_us: i64) -> Points {
    let times = (0..PLAN_POINTS as i64).map(|k| now_us + k * PLAN_STEP_US);
    let points: Vec<Point> = times
        .map_while(|t| plan.at(t).ok())
        .map(|state| state.rear_axle.position())
        .collect();
    Points::from_points(&points)
}
