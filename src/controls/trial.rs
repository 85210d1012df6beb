//! Trials of answers in a copy of the simulation, for oracles of every form of an answer.

use crate::search::HORIZON;
use planagent_agent::simulation::ClosedLoop;
use planagent_score::metrics::{self, EvaluatedSimulation, MetricList};
use planagent_world::{EgoState, HistorySample, SceneView, Trajectory};

/// What a meter of a trial counts beside the score, which is between 0 and 1. It breaks ties.
const METER: f64 = 0.001;

/// Iterations that the simulation has left for a trial.
pub fn horizon(simulation: &ClosedLoop<'_>) -> usize {
    HORIZON.min(to_end(simulation))
}

/// Iterations that the simulation has left.
pub(crate) fn to_end(simulation: &ClosedLoop<'_>) -> usize {
    simulation.scenario().iterations() - 1 - simulation.iteration()
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
    let score = score_of_window(simulation, &samples)?;
    let ends = samples.first().zip(samples.last());
    let driven = ends.map_or(0.0, |(first, last)| {
        first.ego.rear_axle.distance(&last.ego.rear_axle)
    });
    Some(score + METER * driven)
}

/// nuPlan's score of the samples from the present on, beside the recorded ego of the same time.
/// `None` where the recording ends before, or a metric cannot be computed.
pub(crate) fn score_of_window(
    simulation: &ClosedLoop<'_>,
    samples: &[HistorySample],
) -> Option<f64> {
    let scenario = simulation.scenario();
    let from = scenario.start + simulation.iteration();
    let frames = scenario.frames.get(from..=from + samples.len())?;
    let expert: Vec<EgoState> = frames.iter().map(|frame| frame.ego).collect();
    let judged = EvaluatedSimulation::new(&scenario.map, samples, &expert);
    score(&judged)
}

/// The score of a simulation with these samples before the present and from it on: interPlan's in a
/// modified scene. `None` where a metric cannot be computed.
pub(crate) fn score_of_whole(
    simulation: &ClosedLoop<'_>,
    past: &[HistorySample],
    samples: &[HistorySample],
) -> Option<f64> {
    let scenario = simulation.scenario();
    let whole: Vec<HistorySample> = past.iter().chain(samples).cloned().collect();
    let expert: Vec<EgoState> = scenario.expert().copied().collect();
    let judged = EvaluatedSimulation::new(&scenario.map, &whole, &expert)
        .with_interaction(scenario.interaction.as_deref());
    score(&judged)
}

fn score(judged: &EvaluatedSimulation<'_>) -> Option<f64> {
    let evaluated = metrics::evaluate(MetricList::ClosedLoop, judged).ok()?;
    Some(evaluated.score.value)
}

#[cfg(test)]
mod tests {
    use super::*;
    use planagent_agent::planner::IdmPlanner;
    use planagent_agent::simulation::{Challenge, simulate};
    use planagent_scenario::Scenario;
    use std::sync::Arc;

    #[test]
    fn the_score_of_the_whole_is_that_of_the_simulation_wherever_it_is_cut() {
        for name in [
            "generated/changing_lane/3",
            "generated/changing_lane/3~nudge_around_parked_vehicle",
        ] {
            let scenario = Arc::new(Scenario::open(name).unwrap());
            let challenge = Challenge::Reactive;
            let log = simulate(&scenario, &mut IdmPlanner::new(), challenge).unwrap();
            let wanted = log.evaluate(&scenario).unwrap().score.value;
            let simulation = ClosedLoop::new(&scenario, challenge).unwrap();
            for cut in [0, 40] {
                let (past, rest) = log.samples.split_at(cut);
                let score = score_of_whole(&simulation, past, rest);
                assert_eq!(score, Some(wanted), "{name} {cut}");
            }
        }
    }
}
