//! DTPP's tree of trajectories: two stages, each scored by the network
//! (`trajectory_tree_planner.py`).

use super::network::{COLUMNS, Dtpp, STEPS};
use super::speed_profile::{FIRST_S, NoTrajectory, STEPS_PER_S, Step, first_stage, second_stage};
use crate::blocks::Probe;
use crate::gameformer::SceneInputs;
use crate::lattice::Course;
use candle_core::{Device, Tensor};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;

/// Trajectories that go on after the first stage.
const EXPANDED: usize = 5;
/// Branches that the network scores at once.
const BRANCHES: usize = 30;

/// Why a tree gives no plan.
#[derive(Debug)]
pub enum TreeError {
    /// Upstream's program raises an exception and plans to stay.
    NoTrajectory,
    /// The network failed.
    Network(candle_core::Error),
}

impl From<NoTrajectory> for TreeError {
    fn from(_: NoTrajectory) -> Self {
        Self::NoTrajectory
    }
}

impl From<candle_core::Error> for TreeError {
    fn from(error: candle_core::Error) -> Self {
        Self::Network(error)
    }
}

/// A tree with its scores.
#[derive(Debug, Clone, PartialEq)]
pub struct ScoredTree {
    /// The trajectories of the first stage and their scores.
    pub first: (Vec<Vec<Step>>, Vec<f32>),
    /// Those of eight seconds and theirs.
    pub second: (Vec<Vec<Step>>, Vec<f32>),
    /// The poses of the best trajectory.
    pub best: Vec<[f32; 3]>,
}

/// The tree over candidate paths from a speed (m/s) and an acceleration (m/s²) under a speed limit.
/// Of more than thirty long trajectories, a draw of `seed` scores thirty, as upstream's unseeded
/// draw does.
///
/// # Errors
/// Where upstream raises an exception, and when the network fails.
pub fn scored_tree(
    network: &Dtpp,
    inputs: &SceneInputs,
    paths: &[Course],
    limit: f64,
    start: [f32; 2],
    seed: u64,
) -> Result<ScoredTree, TreeError> {
    if paths.is_empty() {
        return Err(TreeError::NoTrajectory);
    }
    let limit = limit as f32;
    let scene = network.encode(inputs, &Probe::off())?;
    let first = first_stage(paths, start, limit)?;
    let score = |branches: &[Vec<Step>], steps: usize| -> Result<Vec<f32>, TreeError> {
        let tree = tree(branches)?;
        let outputs = network.branches(inputs, &scene, &tree, steps, &Probe::off())?;
        Ok(outputs.scores.squeeze(0)?.to_vec1()?)
    };
    let first_scores = score(&first, (FIRST_S * STEPS_PER_S) as usize)?;
    let mut order: Vec<usize> = (0..first_scores.len()).collect();
    order.sort_by(|&a, &b| first_scores[b].total_cmp(&first_scores[a]));
    let parents: Vec<usize> = order
        .into_iter()
        .take(EXPANDED)
        .filter(|&parent| parent < first.len())
        .collect();
    // Children of each trajectory of the first stage, the whole eight seconds.
    let mut children: Vec<Vec<Vec<Step>>> = vec![Vec::new(); first.len()];
    for &parent in &parents {
        let end = first[parent].last().ok_or(TreeError::NoTrajectory)?;
        let later = second_stage(paths, end, limit)?;
        children[parent] = later
            .into_iter()
            .map(|steps| [first[parent].clone(), steps].concat())
            .collect();
    }
    let mut leaves: Vec<(usize, &Vec<Step>)> = children
        .iter()
        .enumerate()
        .flat_map(|(parent, own)| own.iter().map(move |leaf| (parent, leaf)))
        .collect();
    if leaves.len() > BRANCHES {
        leaves = drawn(leaves, seed);
    }
    let second: Vec<Vec<Step>> = leaves.iter().map(|(_, leaf)| (*leaf).clone()).collect();
    let second_scores = score(&second, STEPS)?;
    let mut best: Option<(f32, usize, usize)> = None;
    for &parent in &parents {
        let own = leaves
            .iter()
            .zip(&second_scores)
            .filter(|((of, _), _)| *of == parent)
            .map(|(_, &score)| score);
        // The first of equal scores.
        let top = own
            .enumerate()
            .reduce(|top, next| if next.1 > top.1 { next } else { top });
        // Upstream raises where none of a parent's children was drawn.
        let (child, score) = top.ok_or(TreeError::NoTrajectory)?;
        let sum = first_scores[parent] + score;
        if sum > best.map_or(f32::NEG_INFINITY, |(best, ..)| best) {
            best = Some((sum, parent, child));
        }
    }
    let (_, parent, child) = best.ok_or(TreeError::NoTrajectory)?;
    // As upstream, the place among the drawn children is read as one among all.
    let best = children[parent].get(child).ok_or(TreeError::NoTrajectory)?;
    let best = best
        .iter()
        .map(|&[x, y, heading, ..]| [x, y, heading])
        .collect();
    Ok(ScoredTree {
        first: (first, first_scores),
        second: (second, second_scores),
        best,
    })
}

/// Thirty leaves in a random order.
fn drawn<T>(mut leaves: Vec<T>, seed: u64) -> Vec<T> {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    for place in 0..BRANCHES.min(leaves.len()) {
        let other = random.random_range(place..leaves.len());
        leaves.swap(place, other);
    }
    leaves.truncate(BRANCHES);
    leaves
}

/// Branches as the network reads them (1, 30, 80, 6).
fn tree(branches: &[Vec<Step>]) -> candle_core::Result<Tensor> {
    let mut values = vec![0f32; BRANCHES * STEPS * COLUMNS];
    for (branch, place) in branches
        .iter()
        .zip(values.chunks_exact_mut(STEPS * COLUMNS))
    {
        for (step, row) in branch.iter().zip(place.chunks_exact_mut(COLUMNS)) {
            row.copy_from_slice(step);
        }
    }
    Tensor::from_vec(values, (1, BRANCHES, STEPS, COLUMNS), &Device::Cpu)
}
