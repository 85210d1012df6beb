//! Reading the devkit's own metric vectors and comparing results with them.

use crate::outside::{Missing, data};
use planagent_score::metrics::{MetricResult, StatisticKind};
use planagent_world::geometry::{OrientedBox, Point, Pose, Vector};
use planagent_world::{EgoState, HistorySample, ObjectKind, TrackToken, TrackedObject};
use serde_json::Value;

/// Reads a vector.
pub(super) fn vector(file: &str) -> Result<Value, Missing> {
    let folder =
        "vectors/nuplan_devkit/nuplan/planning/metrics/evaluation_metrics/common/test/json";
    let text = std::fs::read_to_string(data(&format!("{folder}/{file}"))?).unwrap();
    // Python writes the bare word, which is no JSON.
    Ok(serde_json::from_str(&text.replace("Infinity", "1e308")).unwrap())
}

pub(super) fn triple(value: &Value) -> [f64; 3] {
    [0, 1, 2].map(|i| value[i].as_f64().unwrap())
}

/// The simulated states, moved to an origin at the first of them.
pub(super) fn states(vector: &Value) -> (Vec<EgoState>, Point) {
    let origin = Point::new(
        vector["ego"]["pose"][0].as_f64().unwrap(),
        vector["ego"]["pose"][1].as_f64().unwrap(),
    );
    let future = vector["ego_future_states"]
        .as_array()
        .map_or(&[][..], Vec::as_slice);
    (
        std::iter::once(&vector["ego"])
            .chain(future)
            .map(|row| state(row, origin))
            .collect(),
        origin,
    )
}

pub(super) fn state(row: &Value, origin: Point) -> EgoState {
    let [x, y, heading] = triple(&row["pose"]);
    let pair =
        |key: &str| Vector::new(row[key][0].as_f64().unwrap(), row[key][1].as_f64().unwrap());
    let pose = Pose::new(x - origin.x, y - origin.y, heading);
    EgoState::from_log(
        row["time_us"].as_i64().unwrap(),
        pose,
        pair("velocity"),
        pair("acceleration"),
    )
}

pub(super) fn objects(world: &Value, origin: Point) -> Vec<TrackedObject> {
    let kinds = [
        ("vehicles", ObjectKind::Vehicle),
        ("bicycles", ObjectKind::Bicycle),
        ("pedestrians", ObjectKind::Pedestrian),
    ];
    let mut found = Vec::new();
    for (key, kind) in kinds {
        for o in world[key].as_array().map_or(&[][..], Vec::as_slice) {
            let [x, y, heading] = triple(&o["box"]["pose"]);
            let size = |i: usize| o["box"]["size"][i].as_f64().unwrap();
            found.push(TrackedObject {
                token: TrackToken(o["id"].as_u64().unwrap() as u32),
                kind,
                shape: OrientedBox::new(
                    Pose::new(x - origin.x, y - origin.y, heading),
                    size(1),
                    size(0),
                ),
                velocity: Vector::new(o["speed"].as_f64().unwrap(), 0.0),
            });
        }
    }
    found
}

pub(super) fn history(vector: &Value) -> Vec<HistorySample> {
    let (states, origin) = states(vector);
    let future = vector["world_future_states"]
        .as_array()
        .map_or(&[][..], Vec::as_slice);
    let worlds = std::iter::once(&vector["world"]).chain(future);
    states
        .into_iter()
        .zip(worlds)
        .map(|(ego, world)| HistorySample {
            ego,
            objects: objects(world, origin).into(),
        })
        .collect()
}

pub(super) fn kind(name: &str) -> StatisticKind {
    serde_json::from_value(Value::String(name.to_owned())).unwrap()
}

/// The greatest deviation from the expected statistics, in their order, and from the series where
/// there is one; `with_boolean` keeps truth values that hang on thresholds. Panics where the kinds
/// of statistics differ.
pub(super) fn worst_deviation(
    file: &str,
    expected: &Value,
    result: &MetricResult,
    with_boolean: bool,
) -> f64 {
    let keep = |k: StatisticKind| with_boolean || k != StatisticKind::Boolean;
    let value = |v: &Value| {
        v.as_f64()
            .or_else(|| v.as_bool().map(|b| f64::from(u8::from(b))))
            .unwrap()
    };
    let pairs = expected["statistics"].as_array().unwrap().iter();
    let wanted: Vec<(StatisticKind, f64)> = pairs
        .map(|pair| (kind(pair[0].as_str().unwrap()), value(&pair[1])))
        .filter(|&(k, _)| keep(k))
        .collect();
    let found: Vec<_> = result
        .statistics
        .iter()
        .map(|s| (s.kind, s.value))
        .filter(|&(k, _)| keep(k))
        .collect();
    let kinds = |list: &[(StatisticKind, f64)]| list.iter().map(|&(k, _)| k).collect::<Vec<_>>();
    assert_eq!(kinds(&found), kinds(&wanted), "{file}");
    let off = |found: f64, wanted: f64| {
        if found.is_infinite() && wanted > 1e300 {
            0.0
        } else {
            (found - wanted).abs()
        }
    };
    let of_statistics = found.iter().zip(&wanted).map(|(f, w)| off(f.1, w.1));
    let of_series = expected["time_series"]["values"]
        .as_array()
        .map_or_else(Vec::new, |values| {
            let series = result.time_series.as_ref().unwrap();
            assert_eq!(values.len(), series.values.len(), "{file}");
            series
                .values
                .iter()
                .zip(values)
                .map(|(f, w)| off(*f, value(w)))
                .collect()
        });
    of_statistics.chain(of_series).fold(0.0, |worst, d| {
        if d.is_nan() {
            f64::INFINITY
        } else {
            worst.max(d)
        }
    })
}

/// The expert of a vector, moved to the origin of its ego; empty where it has none.
pub(super) fn expert(vector: &Value) -> Vec<EgoState> {
    let origin = states(vector).1;
    let rows = vector["expert_ego_states"]
        .as_array()
        .map_or(&[][..], Vec::as_slice);
    rows.iter().map(|row| state(row, origin)).collect()
}
