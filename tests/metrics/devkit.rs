//! The devkit's own metric vectors, as far as they need no nuPlan map: tolerance 0.01, as upstream.

use planagent::geometry::{OrientedBox, Point, Pose, Vector};
use planagent::metrics::{
    Bound, ComfortQuantity, CornerAgreement, DrivenLanes, MetricResult, StatisticKind, ego_is_comfortable,
    find_collisions, no_ego_at_fault_collisions, time_to_collision, time_to_collision_within_bound,
};
use planagent::world::{EgoState, HistorySample, LaneId, ObjectKind, TrackToken, TrackedObject};
use serde_json::Value;
use std::collections::BTreeSet;
use std::path::PathBuf;

const TOLERANCE: f64 = 1e-2;

/// Reads a vector; `None`, with a word on stderr, where the data folder is missing.
fn vector(file: &str) -> Option<Value> {
    let root = std::env::var_os("PLANAGENT_DATA")
        .map_or_else(|| PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/data")), PathBuf::from);
    let folder = "vectors/nuplan_devkit/nuplan/planning/metrics/evaluation_metrics/common/test/json";
    let path = root.join(folder).join(file);
    match std::fs::read_to_string(&path) {
        // Python writes the bare word, which is no JSON.
        Ok(text) => Some(serde_json::from_str(&text.replace("Infinity", "1e308")).unwrap()),
        Err(error) => {
            eprintln!("SKIPPED: {}: {error}", path.display());
            None
        }
    }
}

fn triple(value: &Value) -> [f64; 3] {
    [0, 1, 2].map(|i| value[i].as_f64().unwrap())
}

/// The simulated states, moved to an origin at the first of them.
fn states(vector: &Value) -> (Vec<EgoState>, Point) {
    let origin = Point::new(vector["ego"]["pose"][0].as_f64().unwrap(), vector["ego"]["pose"][1].as_f64().unwrap());
    let read = |s: &Value| {
        let [x, y, heading] = triple(&s["pose"]);
        let pair = |key: &str| Vector::new(s[key][0].as_f64().unwrap(), s[key][1].as_f64().unwrap());
        let pose = Pose::new(x - origin.x, y - origin.y, heading);
        EgoState::from_log(s["time_us"].as_i64().unwrap(), pose, pair("velocity"), pair("acceleration"))
    };
    let future = vector["ego_future_states"].as_array().map_or(&[][..], Vec::as_slice);
    (std::iter::once(&vector["ego"]).chain(future).map(read).collect(), origin)
}

fn objects(world: &Value, origin: Point) -> Vec<TrackedObject> {
    let kinds =
        [("vehicles", ObjectKind::Vehicle), ("bicycles", ObjectKind::Bicycle), ("pedestrians", ObjectKind::Pedestrian)];
    let mut found = Vec::new();
    for (key, kind) in kinds {
        for o in world[key].as_array().map_or(&[][..], Vec::as_slice) {
            let [x, y, heading] = triple(&o["box"]["pose"]);
            let size = |i: usize| o["box"]["size"][i].as_f64().unwrap();
            found.push(TrackedObject {
                token: TrackToken(o["id"].as_u64().unwrap() as u32),
                kind,
                shape: OrientedBox::new(Pose::new(x - origin.x, y - origin.y, heading), size(1), size(0)),
                velocity: Vector::new(o["speed"].as_f64().unwrap(), 0.0),
            });
        }
    }
    found
}

fn history(vector: &Value) -> Vec<HistorySample> {
    let (states, origin) = states(vector);
    let future = vector["world_future_states"].as_array().map_or(&[][..], Vec::as_slice);
    let worlds = std::iter::once(&vector["world"]).chain(future);
    states
        .into_iter()
        .zip(worlds)
        .map(|(ego, world)| HistorySample { ego, objects: objects(world, origin).into() })
        .collect()
}

/// Lanes as the vector needs them: the corners agree at every sample, or never do.
fn lanes(samples: usize, in_common: bool) -> DrivenLanes {
    let agreement =
        if in_common { CornerAgreement::Shared(BTreeSet::from([LaneId(0)])) } else { CornerAgreement::Split };
    DrivenLanes {
        center: vec![vec![LaneId(0)]; samples],
        corners: vec![Default::default(); samples],
        agreement: vec![agreement; samples],
    }
}

fn kind(name: &str) -> StatisticKind {
    serde_json::from_value(Value::String(name.to_owned())).unwrap()
}

/// Compares the statistics in their order, and the series where there is one; `with_boolean` keeps truth values that
/// hang on thresholds.
fn check(file: &str, vector: &Value, result: &MetricResult, with_boolean: bool) {
    let keep = |k: StatisticKind| with_boolean || k != StatisticKind::Boolean;
    let expected: Vec<(StatisticKind, f64)> = vector["expected"]["statistics"]
        .as_array()
        .unwrap()
        .iter()
        .map(|pair| {
            let value = pair[1].as_f64().or_else(|| pair[1].as_bool().map(|b| f64::from(u8::from(b))));
            (kind(pair[0].as_str().unwrap()), value.unwrap())
        })
        .filter(|&(k, _)| keep(k))
        .collect();
    let found: Vec<_> = result.statistics.iter().map(|s| (s.kind, s.value)).filter(|&(k, _)| keep(k)).collect();
    assert_eq!(
        found.iter().map(|f| f.0).collect::<Vec<_>>(),
        expected.iter().map(|e| e.0).collect::<Vec<_>>(),
        "{file}"
    );
    let close = |f: f64, e: f64| (f - e).abs() <= TOLERANCE || (f.is_infinite() && e > 1e300);
    for (f, e) in found.iter().zip(&expected) {
        assert!(close(f.1, e.1), "{file}: {found:?} {expected:?}");
    }
    if let Some(values) = vector["expected"]["time_series"]["values"].as_array() {
        let series = result.time_series.as_ref().unwrap();
        assert_eq!(values.len(), series.values.len(), "{file}");
        for (f, e) in series.values.iter().zip(values) {
            assert!(close(*f, e.as_f64().unwrap()), "{file}: {:?}", series.values);
        }
    }
}

#[test]
fn motion_statistics() {
    let files = [
        ("ego_acceleration/ego_acceleration.json", ComfortQuantity::Acceleration, true),
        ("ego_lon_acceleration/ego_lon_acceleration.json", ComfortQuantity::LonAcceleration, true),
        ("ego_lat_acceleration/ego_lat_acceleration.json", ComfortQuantity::LatAcceleration, true),
        ("ego_jerk/ego_jerk.json", ComfortQuantity::Jerk, true),
        ("ego_lon_jerk/ego_lon_jerk.json", ComfortQuantity::LonJerk, true),
        ("ego_lat_jerk/ego_lat_jerk.json", ComfortQuantity::LatJerk, true),
        // Upstream's test of this one sets a bound of 5.0 rad/s; nuPlan's configuration 0.95.
        ("ego_yaw_rate/ego_yaw_rate.json", ComfortQuantity::YawRate, false),
        ("ego_yaw_acceleration/ego_yaw_acceleration.json", ComfortQuantity::YawAcceleration, true),
    ];
    for (file, quantity, with_boolean) in files {
        let Some(vector) = vector(file) else { return };
        check(file, &vector, &quantity.evaluate(&states(&vector).0).unwrap(), with_boolean);
    }
}

/// Upstream's test of comfort sets bounds of its own; nuPlan's configuration would let this drive pass.
#[test]
fn comfort() {
    let Some(vector) = vector("ego_is_comfortable/ego_is_comfortable.json") else { return };
    let states = states(&vector).0;
    let bounds = [
        (ComfortQuantity::LonAcceleration, Bound { min: 0.0, max: 10.0 }),
        (ComfortQuantity::LatAcceleration, Bound::magnitude(10.0)),
        (ComfortQuantity::Jerk, Bound::magnitude(7.0)),
        (ComfortQuantity::LonJerk, Bound::magnitude(8.0)),
        (ComfortQuantity::YawRate, Bound::magnitude(5.0)),
        (ComfortQuantity::YawAcceleration, Bound::magnitude(3.0)),
    ];
    let comfortable = bounds.iter().all(|(quantity, bound)| bound.holds(&quantity.signal(&states).unwrap()));
    assert_eq!(Some(comfortable), vector["expected"]["statistics"][0][1].as_bool());
    assert_eq!(ego_is_comfortable(&states).unwrap().score, Some(1.0));
}

#[test]
fn collisions_at_fault() {
    let files = [
        ("active_front_collision", [true, false].as_slice()),
        ("active_lateral_collision", &[false]),
        ("active_rear_collision", &[true, false]),
        ("multiple_collisions", &[true]),
        ("no_collision", &[true, false]),
        ("stopped_ego_collision", &[true, false]),
        ("stopped_track_collision", &[true, false]),
    ];
    for (name, in_common) in files {
        let file = format!("no_ego_at_fault_collision/{name}.json");
        let Some(vector) = vector(&file) else { return };
        let samples = history(&vector);
        for &in_common in in_common {
            let collisions = find_collisions(&samples, &lanes(samples.len(), in_common));
            check(&file, &vector, &no_ego_at_fault_collisions(&collisions), true);
        }
    }
}

#[test]
fn times_to_collision() {
    let map = super::road::straight();
    for name in
        ["ego_stopped", "in_collision", "no_collisions", "no_relevant_tracks", "time_to_collision_above_threshold"]
    {
        let file = format!("time_to_collision_within_bound/{name}.json");
        let Some(vector) = vector(&file) else { return };
        let samples = history(&vector);
        // The vectors' own horizon; nuPlan's configuration has 3 s.
        let horizon = vector["metric_parameters"]["time_horizon"].as_f64().unwrap_or(5.0);
        let lanes = lanes(samples.len(), true);
        let collisions = find_collisions(&samples, &lanes);
        let ttc = time_to_collision(&map, &samples, &lanes, &collisions, horizon);
        let states: Vec<EgoState> = samples.iter().map(|s| s.ego).collect();
        check(&file, &vector, &time_to_collision_within_bound(&states, ttc, horizon), true);
    }
}
