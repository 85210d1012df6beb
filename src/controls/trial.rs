//! Trials of answers in a copy of the simulation, for oracles of every form of an answer.

use crate::search::HORIZON;
use planagent_agent::simulation::ClosedLoop;
use planagent_score::metrics::{self, EvaluatedSimulation, MetricList};
use planagent_world::{EgoState, HistorySample, SceneView, Trajectory};

/// What a meter of a trial counts beside the score, which is between 0 and 1. It breaks ties.
const METER: f64 = 0.001;

/// Iterations that the simulation has left for a trial.
pub fn horizon(simulation: &ClosedLoop<'_>) -> usize {
    let last = simulation.scenario().iterations() - 1;
    HORIZON.min(last - simulation.iteration())
}

/// The value of a drive from the present on: nuPlan's score and, for ties, the way. `next` gives the
/// trajectory of a scene and a step of the trial, from 0. `None` where it gives none, or the drive
/// cannot be scored.
pub fn value_of_drive(
    simulation: &ClosedLoop<'_>,
    mut next: impl FnMut(&SceneView<'_>, usize) -> Option<Trajectory>,
) -> Option<f64> {
    let mut trial = simulation.clone();
    let mut samples: Vec<HistorySample> = Vec::new();
    for step in 0..horizon(simulation) {
        if trial.is_over() {
            break;
        }
        let trajectory = next(&trial.scene(), step)?;
        samples.push(trial.present().clone());
        trial.advance(&trajectory, "trial").ok()?;
    }
    let scenario = simulation.scenario();
    let from = scenario.start + simulation.iteration();
    let frames = scenario.frames.get(from..=from + samples.len())?;
    let expert: Vec<EgoState> = frames.iter().map(|frame| frame.ego).collect();
    let judged = EvaluatedSimulation::new(&scenario.map, &samples, &expert);
    let evaluation = metrics::evaluate(MetricList::ClosedLoop, &judged).ok()?;
    let ends = samples.first().zip(samples.last());
    let driven = ends.map_or(0.0, |(first, last)| {
        first.ego.rear_axle.distance(&last.ego.rear_axle)
    });
    Some(evaluation.score.value + METER * driven)
}
