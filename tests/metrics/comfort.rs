//! The smoothing filters and the signals of comfort beside scipy 1.9.1 and the devkit's extractors.

use planagent_score::metrics::{ComfortQuantity, SavitzkyGolay, ego_is_comfortable};
use planagent_world::EgoState;
use planagent_world::geometry::{Pose, Vector};
use serde_json::Value;

fn numbers(value: &Value) -> Vec<f64> {
    value
        .as_array()
        .unwrap()
        .iter()
        .map(|v| v.as_f64().unwrap())
        .collect()
}

fn worst(found: &[f64], expected: &[f64]) -> f64 {
    assert_eq!(found.len(), expected.len());
    found
        .iter()
        .zip(expected)
        .map(|(f, e)| (f - e).abs())
        .fold(0.0, f64::max)
}

/// Tolerance of what the reference computed: it rounds to 8 decimals.
pub(super) const TOLERANCE: f64 = 1e-8;

/// How many sequences each filter was run on and its greatest deviation from scipy's.
pub(super) fn filters() -> Vec<(&'static str, usize, f64)> {
    let vectors: Value =
        serde_json::from_str(include_str!("../fixtures/metrics/savgol.json")).unwrap();
    let cases = vectors["cases"].as_array().unwrap();
    assert_eq!(cases.len(), 11);
    let filters = [
        (
            "accel_w8_p2",
            SavitzkyGolay {
                window: 8,
                order: 2,
                derivative: 0,
            },
        ),
        (
            "jerk_w15_p2_d1",
            SavitzkyGolay {
                window: 15,
                order: 2,
                derivative: 1,
            },
        ),
        (
            "yaw_rate_w5_p2_d1",
            SavitzkyGolay {
                window: 5,
                order: 2,
                derivative: 1,
            },
        ),
        (
            "yaw_acc_w5_p3_d2",
            SavitzkyGolay {
                window: 5,
                order: 3,
                derivative: 2,
            },
        ),
    ];
    let compare = |(name, filter): (&'static str, SavitzkyGolay)| {
        let known = cases
            .iter()
            .filter_map(|case| Some((case, case.get(name).filter(|v| v.is_array())?)));
        let off = known.map(|(case, expected)| {
            let (x, dt) = (numbers(&case["x"]), case["dt"].as_f64().unwrap());
            worst(&filter.apply(&x, dt).unwrap(), &numbers(expected))
        });
        let off: Vec<f64> = off.collect();
        (name, off.len(), off.into_iter().fold(0.0, f64::max))
    };
    filters.into_iter().map(compare).collect()
}

#[test]
fn filters_match_scipy_at_every_length() {
    let compared = filters();
    for (name, _, worst) in &compared {
        assert!(*worst < TOLERANCE, "{name}: {worst:e}");
    }
    assert!(
        compared.iter().map(|c| c.1).sum::<usize>() >= 33,
        "{compared:?}"
    );
}

/// nuPlan's name of each signal of a drive of 149 states and its greatest deviation from the
/// devkit's extractor.
pub(super) fn extractors() -> Vec<(&'static str, f64)> {
    let vectors: Value =
        serde_json::from_str(include_str!("../fixtures/metrics/comfort_extractors.json")).unwrap();
    let states: Vec<EgoState> = vectors["ego_states"]
        .as_array()
        .unwrap()
        .iter()
        .map(state)
        .collect();
    assert_eq!(states.len(), 149);
    let pairs = [
        ("lon_accel", ComfortQuantity::LonAcceleration),
        ("lat_accel", ComfortQuantity::LatAcceleration),
        ("mag_accel", ComfortQuantity::Acceleration),
        ("jerk_mag", ComfortQuantity::Jerk),
        ("jerk_lon", ComfortQuantity::LonJerk),
        ("yaw_rate", ComfortQuantity::YawRate),
        ("yaw_accel", ComfortQuantity::YawAcceleration),
    ];
    let compare = |(key, quantity): (&str, ComfortQuantity)| {
        (
            quantity.name(),
            worst(&quantity.signal(&states).unwrap(), &numbers(&vectors[key])),
        )
    };
    pairs.into_iter().map(compare).collect()
}

fn state(row: &Value) -> EgoState {
    let of = |key: &str| row[key].as_f64().unwrap();
    let state = EgoState {
        time_us: row["time_us"].as_i64().unwrap(),
        rear_axle: Pose::new(of("x"), of("y"), of("heading")),
        velocity: Vector::new(of("vx"), of("vy")),
        acceleration: Vector::new(of("ax"), of("ay")),
        steering_angle: of("steer"),
        steering_rate: of("steer_rate"),
        angular_velocity: of("ang_vel"),
        angular_acceleration: of("ang_acc"),
    };
    assert!((state.center().x - of("center_x")).abs() < 1e-9);
    assert!((state.center_velocity().y - of("center_vy")).abs() < 1e-12);
    assert!((state.center_acceleration().x - of("center_ax")).abs() < 1e-12);
    state
}

#[test]
fn signals_match_the_devkits_extractors() {
    for (name, worst) in extractors() {
        assert!(worst < TOLERANCE, "{name}: {worst:e}");
    }
}

#[test]
fn bounds_are_strict_and_any_quantity_breaks_comfort() {
    let accelerating = |a: f64| -> Vec<EgoState> {
        (0..30)
            .map(|k| {
                let mut state = crate::road::ego(k, 0.0, 0.0, 0.0, 5.0);
                state.acceleration = Vector::new(a, 0.0);
                state
            })
            .collect()
    };
    let score = |a: f64| ego_is_comfortable(&accelerating(a)).unwrap().score;
    assert_eq!(score(2.39), Some(1.0));
    assert_eq!(score(2.40), Some(0.0));
    assert_eq!(score(-4.04), Some(1.0));
    assert_eq!(score(-4.05), Some(0.0));

    let turning = |rate: f64| -> Vec<EgoState> {
        (0..30)
            .map(|k| crate::road::ego(k, 0.0, 0.0, rate * 0.1 * k as f64, 5.0))
            .collect()
    };
    assert_eq!(ego_is_comfortable(&turning(0.94)).unwrap().score, Some(1.0));
    assert_eq!(ego_is_comfortable(&turning(0.96)).unwrap().score, Some(0.0));
}
