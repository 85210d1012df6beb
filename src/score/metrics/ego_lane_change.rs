//! `ego_lane_change`: number and duration of the ego's lane changes, without score.

use super::corners::{CornerAgreement, DrivenLanes};
use super::{MetricList, MetricResult, MetricSpec, Statistic, StatisticKind};
use planagent_world::{EgoState, LaneId, LaneMap, MICROS_PER_SECOND};
use std::collections::BTreeSet;

/// Acceptable share of failed lane changes (devkit `ego_lane_change.yaml`).
const MAX_FAIL_RATE: f64 = 0.3;

pub(super) const SPEC: MetricSpec = MetricSpec::new("ego_lane_change", |input| {
    Ok(Some(ego_lane_change(
        input.simulation.map,
        input.states(),
        input.lanes(),
    )))
})
.only(MetricList::ClosedLoop);

/// One lane change.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct LaneChange {
    /// Time at which the corners first were in different lanes, µs.
    pub start_us: i64,
    /// Time until they agreed again or the simulation ended, µs.
    pub duration_us: i64,
    /// Whether the ego ended in a lane that is not, and does not follow, the one it left.
    pub success: bool,
}

/// The lane changes of a simulation.
pub fn find_lane_changes(
    map: &LaneMap,
    states: &[EgoState],
    agreement: &[CornerAgreement],
) -> Vec<LaneChange> {
    let mut found = Vec::new();
    let mut open: Option<(i64, &BTreeSet<LaneId>)> = None;
    for (pair, state) in agreement.windows(2).zip(states.iter().skip(1)) {
        match (open, &pair[1]) {
            (None, CornerAgreement::Split) => {
                if let CornerAgreement::Shared(initial) = &pair[0] {
                    open = Some((state.time_us, initial));
                }
            }
            (Some((start_us, initial)), CornerAgreement::Shared(last)) => {
                let success = !last.iter().any(|id| {
                    initial.contains(id) || initial.iter().any(|&i| map[i].outgoing.contains(id))
                });
                found.push(LaneChange {
                    start_us,
                    duration_us: state.time_us - start_us,
                    success,
                });
                open = None;
            }
            (Some((start_us, _)), CornerAgreement::Outside) => {
                found.push(LaneChange {
                    start_us,
                    duration_us: state.time_us - start_us,
                    success: false,
                });
                open = None;
            }
            _ => {}
        }
    }
    // A change that the end of the simulation cuts off counts as failed.
    if let (Some((start_us, _)), Some(last)) = (open, states.last()) {
        found.push(LaneChange {
            start_us,
            duration_us: last.time_us - start_us,
            success: false,
        });
    }
    found
}

/// Counts the lane changes and their failures.
pub fn ego_lane_change(map: &LaneMap, states: &[EgoState], lanes: &DrivenLanes) -> MetricResult {
    const NAME: &str = SPEC.name;
    let changes = find_lane_changes(map, states, &lanes.agreement);
    let mut statistics = vec![Statistic::count(format!("number_of_{NAME}"), changes.len())];
    let mut acceptable = true;
    // Without a lane change there is no duration to average, so these statistics are absent.
    if !changes.is_empty() {
        let seconds: Vec<f64> = changes
            .iter()
            .map(|c| c.duration_us as f64 / MICROS_PER_SECOND)
            .collect();
        let total = changes.len() as f64;
        let failed = changes.iter().filter(|c| !c.success).count() as f64 / total;
        acceptable = failed <= MAX_FAIL_RATE;
        let longest = seconds.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let mean = seconds.iter().sum::<f64>() / total;
        statistics.extend([
            Statistic::new(
                StatisticKind::Max,
                format!("max_{NAME}_duration"),
                "seconds",
                longest,
            ),
            Statistic::new(
                StatisticKind::Mean,
                format!("avg_{NAME}_duration"),
                "seconds",
                mean,
            ),
            Statistic::new(
                StatisticKind::Ratio,
                format!("ratio_of_failed_{NAME}"),
                "ratio",
                failed,
            ),
        ]);
    }
    statistics.push(Statistic::boolean(
        format!("{NAME}_fail_rate_below_threshold"),
        acceptable,
    ));
    SPEC.unscored(statistics)
}
