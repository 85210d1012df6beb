//! Codes drawn uniformly from those that the grammar allows.

use crate::MAX_PROPOSALS;
use planagent_agent::environment::AgentName;
use planagent_agent::planner::{CodeCall, CodeList};
use planagent_agent::reasoning::{ACCELERATIONS, DECELERATIONS, Names, PlannerCode, target_speeds};
use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// A random code for each attempt.
pub(crate) struct RandomCodes;

impl CodeList for RandomCodes {
    fn codes(&self, call: &CodeCall<'_>) -> Vec<PlannerCode> {
        random_codes(call.names, call.seed, call.attempts)
    }
}

/// The best of four random codes, as many as a model proposes at most.
pub(crate) struct FourRandomCodes;

impl CodeList for FourRandomCodes {
    fn codes(&self, call: &CodeCall<'_>) -> Vec<PlannerCode> {
        random_codes(call.names, call.seed, MAX_PROPOSALS)
    }

    fn compares(&self) -> bool {
        true
    }
}

fn random_codes(names: &Names, seed: u64, count: usize) -> Vec<PlannerCode> {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let lead_agents: Vec<Option<AgentName>> = names
        .lead_agents
        .iter()
        .copied()
        .map(Some)
        .chain([None])
        .collect();
    let draw = |_| {
        Some(PlannerCode {
            centerline: *names.centerlines.choose(&mut random)?,
            lead_agent: *lead_agents.choose(&mut random)?,
            target_speed: f64::from(random.random_range(target_speeds(names))),
            accel_max: *ACCELERATIONS.choose(&mut random)?,
            decel_max: *DECELERATIONS.choose(&mut random)?,
        })
    };
    (0..count).map_while(draw).collect()
}
