//! Samples of GameFormer and DTPP, which read the same features in squares of different sizes.

use super::tensors::Columns;
use super::{Moment, futures};
use candle_core::Tensor;
use planagent_learned::dtpp::{Step, first_stage, paths, second_stage};
use planagent_learned::gameformer::ActorFeatures;

/// Half sides of the squares of the map, meters.
const GAMEFORMER_RADIUS: f64 = 60.0;
const DTPP_RADIUS: f64 = 80.0;
/// Agents with a target.
const AGENTS: usize = 10;
/// Branches of a tree, steps and columns of each.
const BRANCHES: usize = 30;
const STEPS: usize = 80;
const COLUMNS: usize = 6;
/// A sample counts when a candidate ends this near to the driver after either stage, meters
/// (`data_process.py`).
const NEAR: [f32; 2] = [1.5, 4.0];

/// Features of GameFormer, the ego's poses and those of its ten nearest agents (80, 3).
pub(super) fn gameformer(moment: &Moment<'_>) -> Option<Columns> {
    let features = ActorFeatures::from_scene(&moment.scene, GAMEFORMER_RADIUS);
    let route = features.route_input().ok()?;
    actors(moment, &features)?.with_tensor("route", &route)
}

/// Features of DTPP with the trajectories of both stages, the nearest to the driver first. `None`
/// where none ends near the driver.
pub(super) fn dtpp(moment: &Moment<'_>) -> Option<Columns> {
    let scene = &moment.scene;
    let (paths, limit) = paths(scene);
    let start = [scene.ego.velocity.x as f32, scene.ego.acceleration.x as f32];
    let first = first_stage(&paths, start, limit as f32).ok()?;
    let mut second = Vec::new();
    for begun in &first {
        let later = second_stage(&paths, begun.last()?, limit as f32).ok()?;
        second.extend(
            later
                .into_iter()
                .map(|steps| [begun.clone(), steps].concat()),
        );
    }
    let future = futures::tenths(moment);
    let (first, one) = sorted(first, &future)?;
    let (second, two) = sorted(second, &future)?;
    if one > NEAR[0] && two > NEAR[1] {
        return None;
    }
    let features = ActorFeatures::from_scene(scene, DTPP_RADIUS);
    let columns = actors(moment, &features)?;
    Some(
        columns
            .with("first", &[BRANCHES, STEPS, COLUMNS], tree(&first))
            .with("second", &[BRANCHES, STEPS, COLUMNS], tree(&second)),
    )
}

fn actors(moment: &Moment<'_>, features: &ActorFeatures) -> Option<Columns> {
    let inputs = features.inputs().ok()?;
    let mut futures: Vec<f32> = features
        .tokens
        .iter()
        .take(AGENTS)
        .flat_map(|&token| futures::of_agent(moment, token))
        .collect();
    futures.resize(AGENTS * STEPS * 3, 0.0);
    Columns::default()
        .with("target", &[STEPS, 3], futures::tenths(moment))
        .with("futures", &[AGENTS, STEPS, 3], futures)
        .with_tensor("ego", &inputs.ego)?
        .with_tensor("neighbors", &inputs.neighbors)?
        .with_tensor("lanes", &inputs.lanes)?
        .with_tensor("crosswalks", &inputs.crosswalks)
}

impl Columns {
    /// With the one sample of a batch of one.
    fn with_tensor(self, name: &'static str, tensor: &Tensor) -> Option<Self> {
        let row = tensor.dims().get(1..)?.to_vec();
        Some(self.with(name, &row, tensor.flatten_all().ok()?.to_vec1().ok()?))
    }
}

/// Trajectories by the distance of their ends from the driver, and the least distance, meters.
fn sorted(mut trajectories: Vec<Vec<Step>>, future: &[f32]) -> Option<(Vec<Vec<Step>>, f32)> {
    let distance = |steps: &Vec<Step>| {
        let driver = future.get(3 * (steps.len().checked_sub(1)?)..)?;
        let &[x, y, ..] = steps.last()?;
        Some((x - driver.first()?).hypot(y - driver.get(1)?))
    };
    trajectories.sort_by(|a, b| {
        distance(a)
            .unwrap_or(f32::INFINITY)
            .total_cmp(&distance(b).unwrap_or(f32::INFINITY))
    });
    let least = distance(trajectories.first()?)?;
    Some((trajectories, least))
}

/// The first branches as the network reads them.
fn tree(branches: &[Vec<Step>]) -> Vec<f32> {
    let mut values = vec![0f32; BRANCHES * STEPS * COLUMNS];
    for (branch, place) in branches
        .iter()
        .zip(values.chunks_exact_mut(STEPS * COLUMNS))
    {
        for (step, row) in branch.iter().zip(place.chunks_exact_mut(COLUMNS)) {
            row.copy_from_slice(step);
        }
    }
    values
}
