//! The best action, tried out in the simulation itself.

use super::{Dilu, SetPoints};
use planagent_agent::environment::{DEFAULT_NODE_LENGTH, GraphedScene, LaneGraph};
use planagent_agent::reasoning::DrivingAction;
use planagent_agent::simulation::ClosedLoop;
use planagent_controls::trial::value_of_drive;

/// Iterations between two actions of a trial.
const ACTION_STEPS: usize = 10;

/// The action after which nuPlan's score over six seconds is best, whether the set-points are kept
/// after it or the ego slows down every second; among equals the first that is offered.
pub(super) fn best_action(simulation: &ClosedLoop<'_>, agent: &Dilu) -> Option<DrivingAction> {
    let scene = simulation.scene();
    let graph = LaneGraph::build(&scene, DEFAULT_NODE_LENGTH).ok()?;
    let set = agent.set_points_in(GraphedScene::new(&scene, &graph));
    let mut best: Option<(f64, DrivingAction)> = None;
    for action in set.offered(&scene) {
        let next = set.moved(action, &scene);
        let values = [DrivingAction::Idle, DrivingAction::Slower]
            .into_iter()
            .filter_map(|then| value(simulation, next, then));
        let Some(value) = values.max_by(f64::total_cmp) else {
            continue;
        };
        if best.is_none_or(|(other, _)| value > other) {
            best = Some((value, action));
        }
    }
    best.map(|(_, action)| action)
}

/// The value of a drive from these set-points, with an action every second; `None` where it cannot
/// be scored.
fn value(simulation: &ClosedLoop<'_>, mut set: SetPoints, then: DrivingAction) -> Option<f64> {
    value_of_drive(simulation, |scene, step| {
        set = set.tracked(scene);
        if step > 0 && step % ACTION_STEPS == 0 {
            set = set.moved(then, scene);
        }
        set.trajectory(scene).ok()
    })
}
