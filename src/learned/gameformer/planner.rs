//! GameFormer as a planner (`MCZhi/GameFormer-Planner` `planner.py`, `planner_utils.py`).

use super::features::ActorFeatures;
use super::network::{GameFormer, GameFormerConfig, GameFormerOutputs};
use super::occupancy::{PredictedAgent, nearest_row, occupancy};
use super::reference_path::{ReferencePath, reference_path};
use super::refinement::Refinement;
use crate::blocks::Probe;
use crate::lattice::ROW;
use crate::slot::{Slot, learned_entry};
use crate::{network_failed, prediction};
use candle_core::{IndexOp, Result};
use planagent_agent::planner::{Planner, PlannerError, PlannerInitialization, PlannerInput};
use planagent_agent::planner_registry::PlannerEntry;
use planagent_world::{STEP_S, STEP_US, Trajectory};
use std::sync::Arc;

/// Half side of the square of the map, meters.
const RADIUS: f64 = 60.0;
/// Columns of the ego's speed and acceleration forward.
const SPEED: usize = 3;
const ACCELERATION: usize = 5;

/// The planners `gameformer` and `gameformer-small`.
pub(crate) fn entries() -> [PlannerEntry; 2] {
    let published = Slot::new("GameFormer", |weights| {
        GameFormer::take(weights, GameFormerConfig::PUBLISHED)
    });
    let small = Slot::new("GameFormer (small)", |weights| {
        GameFormer::take(weights, GameFormerConfig::SMALL)
    });
    [
        ("gameformer", "GameFormer, a learned planner", published),
        ("gameformer-small", "GameFormer in a small shape", small),
    ]
    .map(|(name, summary, slot)| {
        learned_entry(name, summary, slot, move |network| {
            Box::new(GameFormerPlanner { name, network })
        })
    })
}

/// GameFormer: it plans again at every iteration.
#[derive(Debug)]
struct GameFormerPlanner {
    name: &'static str,
    network: Arc<GameFormer>,
}

impl Planner for GameFormerPlanner {
    fn name(&self) -> &'static str {
        self.name
    }

    fn initialize(
        &mut self,
        _: &PlannerInitialization<'_>,
    ) -> std::result::Result<(), PlannerError> {
        Ok(())
    }

    fn compute_trajectory(
        &mut self,
        input: &PlannerInput<'_>,
    ) -> std::result::Result<Trajectory, PlannerError> {
        let scene = &input.scene;
        let features = ActorFeatures::from_scene(scene, RADIUS);
        let run = || {
            let inputs = features.inputs()?;
            let outputs = self
                .network
                .forward(&inputs, &features.route_input()?, &Probe::off())?;
            Ok((
                prediction::poses(&outputs.plan)?,
                agents(&outputs, &features.present_neighbors())?,
            ))
        };
        let (mut plan, agents) = run().map_err(network_failed)?;
        // As upstream, the network's plan is executed as it is where there is no reference path.
        if let Some(path) = reference_path(scene) {
            plan = placed(
                &path,
                &refinement(&path, &plan, &agents, features.present_ego()).solve(),
            );
        }
        prediction::trajectory(&plan, STEP_US, scene)
    }
}

/// The agents with the likeliest futures of the last level.
fn agents(outputs: &GameFormerOutputs, states: &[[f32; 11]]) -> Result<Vec<PredictedAgent>> {
    let Some((futures, scores)) = outputs.levels.last() else {
        return Ok(Vec::new());
    };
    let scores = scores.i(0)?.to_vec2::<f32>()?;
    // The ego is the first actor.
    let agents = scores.iter().enumerate().skip(1).zip(states);
    agents
        .map(|((actor, scores), &state)| {
            let mut best = 0;
            for (mode, score) in scores.iter().enumerate() {
                if *score > scores[best] {
                    best = mode;
                }
            }
            let future = futures.i((0, actor, best))?.to_vec2::<f32>()?;
            Ok(PredictedAgent {
                state,
                future: future.iter().map(|row| [row[0], row[1]]).collect(),
            })
        })
        .collect()
}

/// The refinement of a network's plan along a path, among agents, from the ego's present state
/// (seven columns).
pub fn refinement(
    path: &ReferencePath,
    plan: &[[f32; 3]],
    agents: &[PredictedAgent],
    ego: [f32; 7],
) -> Refinement {
    let places: Vec<f64> = plan
        .iter()
        .map(|&[x, y, _]| nearest_row(path, [x, y]).0 as f64 * ROW)
        .collect();
    let before = std::iter::once(0.0).chain(places.iter().copied());
    Refinement {
        speeds: places
            .iter()
            .zip(before)
            .map(|(place, before)| (place - before) / STEP_S)
            .collect(),
        occupancy: occupancy(path, agents),
        current: [SPEED, ACCELERATION].map(|column| f64::from(ego[column])),
        limits: path.iter().map(|row| f64::from(row[4])).collect(),
        places,
    }
}

/// The poses at these speeds along a path.
pub fn placed(path: &ReferencePath, speeds: &[f64]) -> Vec<[f32; 3]> {
    // PyTorch adds up in f64.
    let mut place = 0.0f64;
    let pose = |speed: &f64| {
        place += f64::from(*speed as f32 * STEP_S as f32);
        let row = ((place as f32 * 10.0) as usize).min(path.len().saturating_sub(1));
        let &[x, y, heading, ..] = path
            .get(row)
            .expect("a reference path has one row at least");
        [x, y, heading]
    };
    speeds.iter().map(pose).collect()
}
