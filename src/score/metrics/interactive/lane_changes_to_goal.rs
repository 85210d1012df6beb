//! `lane_changes_to_goal`: how many of the lane changes to the expert's lane the ego made.

use super::neighbors::{LaneRelations, changes_between};
use crate::metrics::route::driven_route;
use crate::metrics::{MetricInput, MetricList, MetricResult, MetricSpec, Statistic};
use planagent_world::geometry::Pose;
use planagent_world::{EgoState, LaneId};

/// The score where the changes at the start cannot be counted (interPlan
/// `lane_changes_to_goal.py`).
pub(crate) const UNCOUNTED: f64 = 0.2607;

pub(super) const SPEC: MetricSpec =
    MetricSpec::new("lane_changes_to_goal", |input| Ok(result(input)))
        .only(MetricList::ClosedLoop)
        .weight(4.0)
        .label("lanes");

/// The score for the numbers of changes at the start and at the end. No number at the end means
/// that the ego is on no lane of the expert's: interPlan fails there, and the value here is 0.
pub(crate) fn lane_changes_score(at_start: Option<usize>, at_end: Option<usize>) -> f64 {
    match (at_start, at_end) {
        (None, _) => UNCOUNTED,
        (Some(0), Some(0)) => 1.0,
        (Some(0), _) => 0.5,
        (Some(_), None) => 0.0,
        (Some(at_start), Some(at_end)) => (1.0 - at_end as f64 / at_start as f64).max(0.0),
    }
}

/// The changes at the start and at the end, from the lanes of the expert and of the ego at each
/// frame.
pub(super) fn counted(
    map: &impl LaneRelations,
    expert: &[Vec<LaneId>],
    ego: &[Vec<LaneId>],
) -> (Option<usize>, Option<usize>) {
    let first = |lanes: &[Vec<LaneId>], frame: usize| {
        lanes.get(frame).and_then(|lanes| lanes.first()).copied()
    };
    let mut of_expert: Vec<LaneId> = expert
        .iter()
        .filter_map(|lanes| lanes.first().copied())
        .collect();
    of_expert.dedup();
    let at_start = if of_expert.len() <= 1 {
        Some(0)
    } else {
        first(ego, 0)
            .zip(first(expert, 0))
            .and_then(|(own, start)| {
                let second =
                    first(expert, 1).filter(|&lane| map.roadblock(lane) == map.roadblock(start));
                changes_between(map, own, second.unwrap_or(start))
            })
    };
    let last_in = |lanes: &[Vec<LaneId>], wanted: LaneId| {
        let mut back = lanes
            .iter()
            .rev()
            .filter_map(|lanes| lanes.first().copied());
        back.find(|&lane| map.roadblock(lane) == map.roadblock(wanted))
    };
    // The ego may leave the expert's roads; then its last lane on them counts.
    let mut common = ego.iter().rev().filter_map(|lanes| lanes.first().copied());
    let at_end = common.find_map(|own| last_in(expert, own).map(|goal| (own, goal)));
    (
        at_start,
        at_end.and_then(|(own, goal)| changes_between(map, own, goal)),
    )
}

fn result(input: &MetricInput<'_>) -> Option<MetricResult> {
    input.simulation.interaction?.kind?;
    let centers = |states: &[EgoState]| states.iter().map(EgoState::center).collect::<Vec<Pose>>();
    let (map, states) = (input.simulation.map, input.states());
    let cut = input.simulation.expert.len().min(states.len());
    let expert = driven_route(map, &centers(&input.simulation.expert[..cut]));
    let (at_start, at_end) = counted(map, &expert, &driven_route(map, &centers(states)));
    let count = |name: &str, count: Option<usize>| count.map(|count| Statistic::count(name, count));
    let statistics = [
        count("lane_changes_at_start", at_start),
        count("lane_changes_at_end", at_end),
    ];
    Some(SPEC.scored(
        lane_changes_score(at_start, at_end),
        statistics.into_iter().flatten().collect(),
    ))
}
