//! PDM-Closed's proposals: five IDM roll-outs along each of three paths (`tuplan_garage`
//! `pdm_generator.py`, `batch_idm_policy.py`).

use super::lead::{LeadState, PathTraffic};
use super::parameters::{PdmParameters, TRAJECTORY_STEPS};
use super::{Forecast, PdmPath};
use planagent_world::dynamics::Lead;
use planagent_world::geometry::Pose;
use planagent_world::{EgoState, LaneMap, STEP_S};

/// Target velocities of the five policies, as fractions of the speed limit.
pub const SPEED_FRACTIONS: [f64; 5] = [0.2, 0.4, 0.6, 0.8, 1.0];
/// Lateral offsets of the paths from the centerline, meters, positive to the left.
pub const LATERAL_OFFSETS: [f64; 3] = [0.0, -1.0, 1.0];
/// Speed limit of a lane without one, m/s.
pub const FALLBACK_LIMIT: f64 = 15.0;
/// Steps of 0.1 s of each proposal, which are simulated and scored.
pub const PROPOSAL_STEPS: usize = 40;

/// Steps between two searches for the lead object.
const LEAD_REFRESH: usize = 2;

/// A state of a roll-out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct IdmState {
    /// Progress of the rear axle along the path, meters; may pass its end.
    pub progress: f64,
    /// Speed, m/s; not clamped, so it may fall a little below zero.
    pub velocity: f64,
}

/// One IDM roll-out, a state every 0.1 s, the present one first.
#[derive(Debug, Clone, PartialEq)]
pub struct Proposal {
    /// Index of its path in [`LATERAL_OFFSETS`].
    pub path: usize,
    /// Its speed on a free road, m/s.
    pub target_velocity: f64,
    /// Its states at each step.
    pub states: Vec<IdmState>,
    /// Its lead objects at each step; the first two are zero.
    pub leads: Vec<LeadState>,
    /// Rear-axle poses on the path at each step, map frame.
    pub poses: Vec<Pose>,
}

impl Proposal {
    /// One step on behind `lead`: forward Euler with the speed of before.
    fn advance(&mut self, path: &PdmPath, parameters: &PdmParameters, lead: LeadState) {
        let IdmState { progress, velocity } = self.states[self.states.len() - 1];
        let ahead = Lead {
            gap: lead.progress - progress - lead.length_rear,
            speed: lead.velocity,
        };
        let acceleration = parameters
            .policy(self.target_velocity)
            .acceleration(velocity, Some(ahead));
        let next = IdmState {
            progress: progress + STEP_S * velocity,
            velocity: velocity + STEP_S * acceleration,
        };
        self.states.push(next);
        self.leads.push(lead);
        self.poses.push(path.pose_at(next.progress));
    }
}

/// The proposals of one instant; one of them can be rolled out further.
pub struct Proposals<'a> {
    paths: [&'a PdmPath; LATERAL_OFFSETS.len()],
    traffic: [PathTraffic<'a>; LATERAL_OFFSETS.len()],
    parameters: PdmParameters,
    rolled_out: Vec<Proposal>,
}

impl<'a> Proposals<'a> {
    /// Rolls all proposals out for `steps` steps of 0.1 s along `paths` (those of
    /// [`LATERAL_OFFSETS`]), from the projection of the ego on each, on a road with this
    /// `speed_limit` in m/s.
    pub fn generate(
        map: &'a LaneMap,
        paths: &'a [PdmPath; LATERAL_OFFSETS.len()],
        forecast: &'a Forecast,
        ego: &EgoState,
        speed_limit: Option<f64>,
        parameters: PdmParameters,
        steps: usize,
    ) -> Self {
        let limit = parameters.fastest(speed_limit.unwrap_or(FALLBACK_LIMIT));
        let targets = SPEED_FRACTIONS.map(|fraction| fraction * limit);
        let reach = targets.into_iter().fold(0.0, f64::max) * TRAJECTORY_STEPS as f64 * STEP_S;
        let starts = paths
            .each_ref()
            .map(|path| path.project(ego.rear_axle.position()));
        let traffic = std::array::from_fn(|i| {
            PathTraffic::new(map, &paths[i], forecast, starts[i], starts[i] + reach)
        });
        let begun = |(path, target_velocity): (usize, f64)| Proposal {
            path,
            target_velocity,
            states: vec![IdmState {
                progress: starts[path],
                velocity: ego.velocity.x,
            }],
            leads: vec![LeadState::default()],
            poses: vec![paths[path].pose_at(starts[path])],
        };
        let all = (0..paths.len()).flat_map(|path| targets.map(|target| (path, target)));
        let mut proposals = Self {
            paths: paths.each_ref(),
            traffic,
            parameters,
            rolled_out: all.map(begun).collect(),
        };
        // Path by path, because the proposals of a path share the record of their lead.
        for batch in 0..paths.len() {
            let members = batch * SPEED_FRACTIONS.len()..(batch + 1) * SPEED_FRACTIONS.len();
            for step in 1..=steps {
                proposals.advance(members.clone(), step);
            }
        }
        proposals
    }

    /// The proposals in their order.
    pub fn all(&self) -> &[Proposal] {
        &self.rolled_out
    }

    /// The proposals, taken out.
    pub(crate) fn into_all(self) -> Vec<Proposal> {
        self.rolled_out
    }

    /// Rolls one proposal out further, alone, up to `steps` steps from the present, and gives its
    /// poses.
    pub fn continued(&mut self, index: usize, steps: usize) -> &[Pose] {
        for step in self.rolled_out[index].states.len()..=steps {
            self.advance(index..index + 1, step);
        }
        &self.rolled_out[index].poses
    }

    /// One step of proposals that share a path. At even steps the lead is looked up where each was
    /// the step before; the record of the lead is one for all of them in turn, as upstream's, so
    /// that what is not set for one is inherited from the one before. At odd steps each keeps its
    /// lead.
    fn advance(&mut self, members: std::ops::Range<usize>, step: usize) {
        let Some(path) = self
            .rolled_out
            .get(members.start)
            .map(|proposal| proposal.path)
        else {
            return;
        };
        let traffic = &self.traffic[path];
        let refresh = step.is_multiple_of(LEAD_REFRESH);
        let blocking = if refresh {
            traffic.blocking(step)
        } else {
            Vec::new()
        };
        // One record outside the loop: what a lookup leaves unset is the proposal's before, as
        // upstream.
        let mut shared = LeadState::default();
        for proposal in &mut self.rolled_out[members] {
            let last = proposal.states.len() - 1;
            if refresh {
                traffic.find_lead(
                    &blocking,
                    proposal.states[last].progress,
                    proposal.poses[last],
                    &mut shared,
                );
            }
            let lead = if refresh {
                shared
            } else {
                proposal.leads[last]
            };
            proposal.advance(self.paths[path], &self.parameters, lead);
        }
    }
}
