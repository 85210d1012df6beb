//! The devkit's own metric vectors, as far as they need no nuPlan map: tolerance 0.01, as upstream.

use super::vectors::{expert, history, states, vector, worst_deviation};
use crate::outside::{Missing, Needy};
use planagent_agent::planner::SimplePlanner;
use planagent_score::metrics::{
    Bound, ComfortQuantity, CornerAgreement, DrivenLanes, MetricError, MetricResult,
    PlannerExpertErrors, Statistic, compare_with_expert, ego_expert_l2_error,
    ego_expert_l2_error_with_yaw, ego_is_comfortable, ego_mean_speed, find_collisions,
    no_ego_at_fault_collisions, planner_expert_average_heading_error_within_bound,
    planner_expert_average_l2_error_within_bound, planner_expert_final_heading_error_within_bound,
    planner_expert_final_l2_error_within_bound, planner_miss_rate_within_bound, time_to_collision,
    time_to_collision_within_bound,
};
use planagent_world::{EgoState, LaneId, Trajectory};
use std::collections::BTreeSet;

/// Upstream's own tolerance; its expectations are written with two decimals.
pub(super) const TOLERANCE: f64 = 1e-2;

/// One vector beside our result.
pub(super) struct Compared {
    /// nuPlan's name of the metric.
    pub(super) metric: String,
    file: String,
    /// The greatest deviation of any of its numbers.
    pub(super) worst: f64,
}

impl Compared {
    fn new(
        file: &str,
        expected: &serde_json::Value,
        result: &MetricResult,
        with_boolean: bool,
    ) -> Self {
        let worst = worst_deviation(file, expected, result, with_boolean);
        Self {
            metric: result.name.clone(),
            file: file.to_owned(),
            worst,
        }
    }
}

/// Compares the vectors of one kind.
type Compare = fn() -> Result<Vec<Compared>, Missing>;

/// Every comparison with a vector: how many there are of each kind, and their results.
const KINDS: [(usize, Compare); 6] = [
    (8, motion),
    (1, comfort),
    (7, collisions),
    (5, times),
    (4, beside_expert),
    (5, plans),
];

/// Every comparison with a vector.
pub(super) fn all() -> Result<Vec<Compared>, Missing> {
    let mut all = Vec::new();
    for (count, compare) in KINDS {
        let compared = compare()?;
        assert_eq!(compared.len(), count, "{}", compared[0].file);
        all.extend(compared);
    }
    Ok(all)
}

#[test]
fn every_vector_is_met_within_upstreams_tolerance() -> Needy {
    let all = all()?;
    let missed = all.iter().filter(|vector| vector.worst > TOLERANCE);
    let missed: Vec<String> = missed
        .map(|vector| format!("{}: off by {}", vector.file, vector.worst))
        .collect();
    assert!(missed.is_empty(), "{missed:#?}");
    Ok(())
}

/// Lanes as the vector needs them: the corners agree at every sample, or never do.
fn lanes(samples: usize, in_common: bool) -> DrivenLanes {
    let agreement = if in_common {
        CornerAgreement::Shared(BTreeSet::from([LaneId(0)]))
    } else {
        CornerAgreement::Split
    };
    DrivenLanes {
        center: vec![vec![LaneId(0)]; samples],
        corners: vec![Default::default(); samples],
        agreement: vec![agreement; samples],
    }
}

fn motion() -> Result<Vec<Compared>, Missing> {
    let quantities = [
        ComfortQuantity::Acceleration,
        ComfortQuantity::LonAcceleration,
        ComfortQuantity::LatAcceleration,
        ComfortQuantity::Jerk,
        ComfortQuantity::LonJerk,
        ComfortQuantity::LatJerk,
        ComfortQuantity::YawRate,
        ComfortQuantity::YawAcceleration,
    ];
    let compare = |quantity: ComfortQuantity| {
        let name = quantity.name();
        let file = format!("{name}/{name}.json");
        let vector = vector(&file)?;
        // Upstream's test of the yaw rate sets a bound of 5.0 rad/s; nuPlan's configuration 0.95.
        let with_boolean = quantity != ComfortQuantity::YawRate;
        Ok(Compared::new(
            &file,
            &vector["expected"],
            &quantity.evaluate(&states(&vector).0).unwrap(),
            with_boolean,
        ))
    };
    quantities.into_iter().map(compare).collect()
}

/// Upstream's test of comfort sets bounds of its own; nuPlan's configuration would let this drive
/// pass.
fn comfort() -> Result<Vec<Compared>, Missing> {
    let file = "ego_is_comfortable/ego_is_comfortable.json";
    let vector = vector(file)?;
    let states = states(&vector).0;
    let bounds = [
        (
            ComfortQuantity::LonAcceleration,
            Bound {
                min: 0.0,
                max: 10.0,
            },
        ),
        (ComfortQuantity::LatAcceleration, Bound::magnitude(10.0)),
        (ComfortQuantity::Jerk, Bound::magnitude(7.0)),
        (ComfortQuantity::LonJerk, Bound::magnitude(8.0)),
        (ComfortQuantity::YawRate, Bound::magnitude(5.0)),
        (ComfortQuantity::YawAcceleration, Bound::magnitude(3.0)),
    ];
    let comfortable = bounds
        .iter()
        .all(|(quantity, bound)| bound.holds(&quantity.signal(&states).unwrap()));
    let ours = ego_is_comfortable(&states).unwrap();
    assert_eq!(ours.score, Some(1.0));
    let statistics = vec![Statistic::boolean(ours.name.as_str(), comfortable)];
    Ok(vec![Compared::new(
        file,
        &vector["expected"],
        &MetricResult { statistics, ..ours },
        true,
    )])
}

/// The seven files, each with what its corners must be in: common lanes or not, or (most) either.
fn collisions() -> Result<Vec<Compared>, Missing> {
    let files = [
        ("active_front_collision", [true, false].as_slice()),
        ("active_lateral_collision", &[false]),
        ("active_rear_collision", &[true, false]),
        ("multiple_collisions", &[true]),
        ("no_collision", &[true, false]),
        ("stopped_ego_collision", &[true, false]),
        ("stopped_track_collision", &[true, false]),
    ];
    let compare = |(name, in_common): (&str, &[bool])| {
        let file = format!("no_ego_at_fault_collision/{name}.json");
        let vector = vector(&file)?;
        let samples = history(&vector);
        let worst = in_common.iter().map(|&in_common| {
            let collisions = find_collisions(&samples, &lanes(samples.len(), in_common));
            Compared::new(
                &file,
                &vector["expected"],
                &no_ego_at_fault_collisions(&collisions),
                true,
            )
        });
        Ok(worst.max_by(|a, b| a.worst.total_cmp(&b.worst)).unwrap())
    };
    files.into_iter().map(compare).collect()
}

fn times() -> Result<Vec<Compared>, Missing> {
    let map = crate::road::straight();
    let names = [
        "ego_stopped",
        "in_collision",
        "no_collisions",
        "no_relevant_tracks",
        "time_to_collision_above_threshold",
    ];
    let compare = |name: &str| {
        let file = format!("time_to_collision_within_bound/{name}.json");
        let vector = vector(&file)?;
        let samples = history(&vector);
        // The vectors' own horizon; nuPlan's configuration has 3 s.
        let horizon = vector["metric_parameters"]["time_horizon"]
            .as_f64()
            .unwrap_or(5.0);
        let lanes = lanes(samples.len(), true);
        let collisions = find_collisions(&samples, &lanes);
        let ttc = time_to_collision(&map, &samples, &lanes, &collisions, horizon);
        let states: Vec<EgoState> = samples.iter().map(|s| s.ego).collect();
        Ok(Compared::new(
            &file,
            &vector["expected"],
            &time_to_collision_within_bound(&states, ttc, horizon),
            true,
        ))
    };
    names.into_iter().map(compare).collect()
}

fn beside_expert() -> Result<Vec<Compared>, Missing> {
    type Metric = fn(&[EgoState], &[EgoState]) -> Result<MetricResult, MetricError>;
    let files: [(&str, Metric); 4] = [
        (
            "ego_expert_l2_error/ego_expert_l2_error.json",
            ego_expert_l2_error,
        ),
        (
            "ego_expert_l2_error_with_yaw/ego_expert_l2_error_with_yaw.json",
            ego_expert_l2_error_with_yaw,
        ),
        (
            "ego_expert_l2_error_with_yaw/ego_expert_l2_error_with_yaw_zero.json",
            ego_expert_l2_error_with_yaw,
        ),
        ("ego_mean_speed/ego_mean_speed.json", |states, _| {
            Ok(ego_mean_speed(states))
        }),
    ];
    let compare = |(file, metric): (&str, Metric)| {
        let vector = vector(file)?;
        Ok(Compared::new(
            file,
            &vector["expected"],
            &metric(&states(&vector).0, &expert(&vector)).unwrap(),
            true,
        ))
    };
    files.into_iter().map(compare).collect()
}

/// Upstream's tests drive with the simple planner at 1 Hz, from every state of the drive.
fn plans() -> Result<Vec<Compared>, Missing> {
    type Metric = fn(&PlannerExpertErrors) -> MetricResult;
    let files: [(&str, Metric); 5] = [
        (
            "planner_expert_average_l2_error_within_bound/high_average_l2_error.json",
            planner_expert_average_l2_error_within_bound,
        ),
        (
            "planner_expert_final_l2_error_within_bound/high_final_l2_error.json",
            planner_expert_final_l2_error_within_bound,
        ),
        (
            "planner_expert_average_heading_error_within_bound/low_average_heading_error.json",
            planner_expert_average_heading_error_within_bound,
        ),
        (
            "planner_expert_final_heading_error_within_bound/low_final_heading_error.json",
            planner_expert_final_heading_error_within_bound,
        ),
        (
            "planner_miss_rate_within_bound/high_miss_rate.json",
            planner_miss_rate_within_bound,
        ),
    ];
    let planner = SimplePlanner {
        sampling_us: 1_000_000,
        ..SimplePlanner::default()
    };
    let compare = |(file, metric): (&str, Metric)| {
        let vector = vector(file)?;
        let plans: Vec<Trajectory> = states(&vector)
            .0
            .iter()
            .map(|ego| planner.trajectory(ego).unwrap())
            .collect();
        let errors = compare_with_expert(&plans, &expert(&vector), &[], 1).unwrap();
        assert_eq!(errors.frames, [0, 1, 2, 3, 4]);
        Ok(Compared::new(
            file,
            &vector["expected"][0],
            &metric(&errors),
            true,
        ))
    };
    files.into_iter().map(compare).collect()
}
