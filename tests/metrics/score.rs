//! Whole drives on a hand-made road: what `evaluate` says of them, and what it refuses.

use crate::road::{cruise, ego, object, samples, straight};
use planagent_score::metrics::{
    EvaluatedSimulation, Evaluation, MetricError, MetricList, MetricRegistry, MetricSpec,
    ScoreUnit, evaluate,
};
use planagent_world::geometry::Pose;
use planagent_world::{EgoState, LaneMap, ObjectKind, TrackedObject};

const PROGRESS: &str = "ego_progress_along_expert_route";

fn judge(
    map: &LaneMap,
    states: &[EgoState],
    expert: &[EgoState],
    objects: &[TrackedObject],
) -> Evaluation {
    evaluate(
        MetricList::ClosedLoop,
        &EvaluatedSimulation::new(map, &samples(states, objects), expert),
    )
    .unwrap()
}

#[test]
fn log_replay_on_a_free_road_loses_only_the_last_step_of_progress() {
    let map = straight();
    let expert = cruise(150, 0.0, 0.0, 10.0);
    let evaluation = judge(&map, &expert[..149], &expert, &[]);
    // The expert has one state more than the simulation saved: 148 m of 149 m.
    let ratio = 148.0 / 149.0;
    assert!((evaluation.score.metric(PROGRESS).unwrap() - ratio).abs() < 1e-9);
    assert!((evaluation.score.value - (5.0 * ratio + 11.0) / 16.0).abs() < 1e-9);
    assert_eq!(evaluation.score.zero_multipliers().next(), None);
}

#[test]
fn every_metric_has_nuplans_name_and_comes_once() {
    let map = straight();
    let expert = cruise(30, 0.0, 0.0, 5.0);
    let evaluation = judge(&map, &expert[..29], &expert, &[]);
    let names: Vec<&str> = evaluation.metrics.iter().map(|m| m.name.as_str()).collect();
    for metric in MetricList::ClosedLoop.scored() {
        assert_eq!(
            names.iter().filter(|name| **name == metric.name).count(),
            1,
            "{}",
            metric.name
        );
    }
    assert!(
        evaluation
            .metric("corners_in_drivable_area")
            .unwrap()
            .score
            .is_none()
    );
    for metric in &evaluation.metrics {
        if let Some(series) = &metric.time_series {
            assert_eq!(
                (series.values.len(), series.time_stamps.len()),
                (29, 29),
                "{}",
                metric.name
            );
        }
    }
}

#[test]
fn standing_still_while_the_expert_drives_is_named_as_the_cause_of_zero() {
    let map = straight();
    let evaluation = judge(
        &map,
        &cruise(149, 0.0, 0.0, 0.0),
        &cruise(150, 0.0, 0.0, 10.0),
        &[],
    );
    // 0 m counts as 2 m: 2/149 is below a fifth.
    assert!((evaluation.score.metric(PROGRESS).unwrap() - 2.0 / 149.0).abs() < 1e-9);
    assert!(evaluation.score.value.abs() < 1e-12);
    assert_eq!(
        evaluation.score.zero_multipliers().next(),
        Some("ego_is_making_progress")
    );
}

#[test]
fn standing_still_beside_a_standing_expert_is_perfect() {
    let map = straight();
    let still = cruise(150, 0.0, 0.0, 0.0);
    let cone = object(
        1,
        ObjectKind::TrafficCone,
        Pose::new(4.0, 0.0, 0.0),
        (0.5, 0.5),
        0.0,
    );
    // A standing ego is never at fault, not even for what stands inside its box.
    assert!((judge(&map, &still[..149], &still, &[cone]).score.value - 1.0).abs() < 1e-12);
}

#[test]
fn one_cone_halves_and_the_time_to_collision_goes() {
    let map = straight();
    let expert = cruise(150, 0.0, 0.0, 10.0);
    let cone = object(
        1,
        ObjectKind::TrafficCone,
        Pose::new(60.0, 0.0, 0.0),
        (0.5, 0.5),
        0.0,
    );
    let score = judge(&map, &expert[..149], &expert, &[cone]).score;
    assert!((score.metric("no_ego_at_fault_collisions").unwrap() - 0.5).abs() < 1e-12);
    assert!(
        score
            .metric("time_to_collision_within_bound")
            .unwrap()
            .abs()
            < 1e-12
    );
    let ratio = 148.0 / 149.0;
    assert!((score.value - 0.5 * (5.0 * ratio + 6.0) / 16.0).abs() < 1e-9);
}

#[test]
fn drives_that_cannot_be_judged_are_refused() {
    let map = straight();
    let expert = cruise(10, 0.0, 0.0, 5.0);
    let of = |states: &[EgoState], expert: &[EgoState]| {
        evaluate(
            MetricList::ClosedLoop,
            &EvaluatedSimulation::new(&map, &samples(states, &[]), expert),
        )
        .unwrap_err()
    };
    assert_eq!(
        of(&expert[..3], &expert),
        MetricError::TooFewSamples { got: 3, needed: 4 }
    );
    assert_eq!(
        of(&[], &expert),
        MetricError::TooFewSamples { got: 0, needed: 4 }
    );
    assert_eq!(of(&expert, &[]), MetricError::NoExpert);
    let mut stuck = expert.clone();
    stuck[4].time_us = stuck[3].time_us;
    assert_eq!(
        of(&stuck, &expert),
        MetricError::TimeNotIncreasing {
            index: 4,
            time_us: 300_000
        }
    );
    let mut lost = expert.clone();
    lost[2] = ego(2, f64::NAN, 0.0, 0.0, 5.0);
    assert_eq!(
        of(&lost, &expert),
        MetricError::NotFinite {
            whose: "ego",
            index: 2
        }
    );
    assert_eq!(
        of(&expert, &lost),
        MetricError::NotFinite {
            whose: "expert",
            index: 2
        }
    );
}

#[test]
fn off_every_lane_there_is_no_expert_route_and_progress_is_free() {
    let map = straight();
    let away = cruise(20, 0.0, 500.0, 5.0);
    let evaluation = judge(&map, &away, &away, &[]);
    assert!((evaluation.score.metric(PROGRESS).unwrap() - 1.0).abs() < 1e-12);
    let progress = evaluation
        .metric("ego_progress_along_expert_route")
        .unwrap();
    assert_eq!(progress.statistic("ego_total_progress_along_route"), None);
    assert_eq!(
        evaluation.score.zero_multipliers().next(),
        Some("drivable_area_compliance")
    );
}

/// nuPlan's categories and score units (devkit `simulation_metric/**/*.yaml`).
#[test]
fn every_result_carries_nuplans_category_unit_and_computator() {
    let map = straight();
    let expert = cruise(30, 0.0, 0.0, 5.0);
    let evaluation = judge(&map, &expert[..29], &expert, &[]);
    let expected = [
        ("ego_mean_speed", "Dynamics", None),
        ("ego_expert_L2_error", "Planning", None),
        ("ego_expert_l2_error_with_yaw", "Planning", None),
        ("ego_lane_change", "Planning", None),
        ("ego_jerk", "Dynamics", None),
        ("ego_lat_jerk", "Dynamics", None),
        ("ego_lon_jerk", "Dynamics", None),
        ("ego_acceleration", "Dynamics", None),
        ("ego_lat_acceleration", "Dynamics", None),
        ("ego_lon_acceleration", "Dynamics", None),
        ("ego_yaw_acceleration", "Dynamics", None),
        ("ego_yaw_rate", "Dynamics", None),
        ("ego_progress_along_expert_route", "Planning", Some("float")),
        ("no_ego_at_fault_collisions", "Dynamics", Some("float")),
        ("drivable_area_compliance", "Planning", Some("bool")),
        ("corners_in_drivable_area", "Planning", None),
        ("time_to_collision_within_bound", "Planning", Some("bool")),
        ("speed_limit_compliance", "Violations", Some("float")),
        ("ego_is_comfortable", "Violations", Some("bool")),
        ("ego_is_making_progress", "Planning", Some("bool")),
        ("driving_direction_compliance", "Planning", Some("bool")),
    ];
    let found: Vec<_> = evaluation
        .metrics
        .iter()
        .map(|m| {
            (
                m.name.as_str(),
                m.category.as_str(),
                m.score_unit.map(ScoreUnit::as_str),
            )
        })
        .collect();
    assert_eq!(found, expected);
    for metric in &evaluation.metrics {
        let second = metric.name == "corners_in_drivable_area";
        assert_eq!(
            metric.computator,
            if second {
                "drivable_area_compliance"
            } else {
                &metric.name
            }
        );
        assert_eq!(
            metric.score.is_some(),
            metric.score_unit.is_some(),
            "{}",
            metric.name
        );
    }
    // Meters and weighted radians together have the unit `None`.
    for (name, unit) in [
        ("ego_expert_L2_error", "meters"),
        ("ego_expert_l2_error_with_yaw", "None"),
    ] {
        let metric = evaluation.metric(name).unwrap();
        let units = metric
            .statistics
            .iter()
            .map(|s| s.unit.as_str())
            .chain(metric.time_series.as_ref().map(|s| s.unit.as_str()));
        assert_eq!(units.collect::<Vec<_>>(), [unit; 4], "{name}");
    }
}

/// A metric of a user: the share of samples above a speed.
const STEADY: MetricSpec = MetricSpec::new("ego_is_steady", |input| {
    let slow = input
        .states()
        .iter()
        .filter(|state| state.speed() < 6.0)
        .count();
    Ok(Some(
        STEADY.scored(slow as f64 / input.states().len() as f64, vec![]),
    ))
})
.only(MetricList::ClosedLoop)
.weight(16.0);

#[test]
fn an_own_metric_enters_the_results_and_the_score() {
    let map = straight();
    let expert = cruise(30, 0.0, 0.0, 5.0);
    let samples = samples(&expert[..29], &[]);
    let simulation = EvaluatedSimulation::new(&map, &samples, &expert);
    let ours = evaluate(MetricList::ClosedLoop, &simulation).unwrap();
    let theirs = MetricRegistry::default()
        .with(STEADY)
        .evaluate(MetricList::ClosedLoop, &simulation)
        .unwrap();
    assert_eq!(theirs.metric("ego_is_steady").unwrap().score, Some(1.0));
    assert!((theirs.score.value - f64::midpoint(ours.score.value, 1.0)).abs() < 1e-12);
    // As a multiplier, and only where its list is evaluated.
    let fails = MetricSpec::new("fails", |_| Ok(Some(STEADY.scored(0.0, vec![]))))
        .only(MetricList::OpenLoop)
        .multiplier();
    let score = MetricRegistry::default()
        .with(fails)
        .evaluate(MetricList::ClosedLoop, &simulation)
        .unwrap()
        .score;
    assert_eq!(score, ours.score);
    // A scored metric without a result is an error.
    let absent =
        MetricRegistry::default().with(MetricSpec::new("absent", |_| Ok(None)).weight(1.0));
    let error = absent
        .evaluate(MetricList::ClosedLoop, &simulation)
        .unwrap_err();
    assert_eq!(error, MetricError::NoScore("absent"));
}
