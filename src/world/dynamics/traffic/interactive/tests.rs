//! The numbers of interPlan's own agents.

use super::{EgoPath, Footprint, InteractiveTraffic};
use crate::geometry::{OrientedBox, Point, Pose, Vector};
use crate::{
    DriverBehavior, EgoState, Interaction, Lane, LaneMap, MapBuilder, MapParts, ObjectKind,
    PACIFICA, TrackToken, TrackedObject, TrafficLights,
};
use serde_json::Value;
use std::path::Path;
use std::sync::Arc;

const MAX_ERROR: f64 = 1e-6;

fn list(value: &Value) -> impl Iterator<Item = &Value> {
    value.as_array().unwrap().iter()
}

fn numbers(value: &Value) -> Vec<f64> {
    list(value).map(|number| number.as_f64().unwrap()).collect()
}

fn vectors(name: &str) -> Value {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../tests/fixtures/vectors/interplan")
        .join(name);
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

fn ego(values: &[f64]) -> EgoState {
    let center = Pose::new(values[0], values[1], values[2]);
    EgoState::from_log(
        0,
        PACIFICA.rear_axle_of(center),
        Vector::new(values[3], 0.0),
        Vector::zeros(),
    )
}

/// The roads of the file: two lanes from left to right, an oncoming lane, and a connector across,
/// with a vertex every meter.
fn world() -> Arc<LaneMap> {
    let mut map = MapBuilder::default();
    let line =
        |from: (f64, f64), to: (f64, f64)| [Point::new(from.0, from.1), Point::new(to.0, to.1)];
    let mut lane = |from, to| map.lane(line(from, to), 3.5, Some(13.41)).unwrap();
    let a = [
        lane((0.0, 0.0), (150.0, 0.0)),
        lane((0.0, -3.5), (150.0, -3.5)),
    ];
    let b = [
        lane((150.0, 0.0), (300.0, 0.0)),
        lane((150.0, -3.5), (300.0, -3.5)),
    ];
    lane((150.0, 3.5), (0.0, 3.5));
    let x = map
        .connector(line((60.0, -60.0), (60.0, 60.0)), 3.5)
        .unwrap();
    map.parts.lanes[x.index()].speed_limit = Some(8.0);
    map.parts
        .intersections
        .push(map.parts.lanes[x.index()].polygon.clone());
    map.abreast(&a);
    map.abreast(&b);
    map.connect(a[0], b[0]);
    map.connect(a[1], b[1]);
    let built = map.finish().unwrap();
    let sparse = |lane: &Lane| Lane {
        centerline: lane.centerline.resampled(1.0),
        ..lane.clone()
    };
    let parts = MapParts {
        lanes: built.lanes().iter().map(sparse).collect(),
        roadblocks: built.roadblocks().to_vec(),
        intersections: built.intersections().to_vec(),
        ..MapParts::default()
    };
    Arc::new(LaneMap::new(parts).unwrap())
}

#[test]
fn vehicles_yield_to_the_ego_as_interplans_do() {
    let file = vectors("agent_behaviours.json");
    let map = world();
    let mut steps = 0;
    for row in list(&file["rows"]) {
        let mode = match row["mode"].as_str().unwrap() {
            "DEFAULT" => DriverBehavior::Default,
            "ASSERTIVE" => DriverBehavior::Assertive,
            "CAUTIOUS" => DriverBehavior::Cautious,
            // The coins of the original are tossed at each step.
            _ => continue,
        };
        // Stopped and logged cars are not reactive here: the simulation takes them from elsewhere.
        if list(&row["cars"])
            .any(|car| car["behavior"] != "default" && car["behavior"] != "cautious")
        {
            continue;
        }
        let ego = ego(&numbers(&row["ego_center_pose_speed"]));
        let mut interaction = Interaction {
            behavior: mode,
            ..Interaction::default()
        };
        let mut objects = Vec::new();
        for (place, car) in list(&row["cars"]).enumerate() {
            let (token, pose) = (TrackToken(place as u32), numbers(&car["pose"]));
            let center = Pose::new(pose[0], pose[1], pose[2]);
            let shape = OrientedBox::new(center, 4.5, 2.0);
            let velocity = center.direction() * car["v"].as_f64().unwrap();
            objects.push(TrackedObject {
                token,
                kind: ObjectKind::Vehicle,
                shape,
                velocity,
            });
            if car["behavior"] == "cautious" {
                interaction.halting.insert(token);
            }
        }
        let mut traffic = InteractiveTraffic::new(&map, &objects, &ego, &interaction);
        let built = row["built"].as_object().unwrap();
        assert_eq!(
            traffic.objects().len(),
            built.len(),
            "{} {}",
            row["name"],
            row["mode"]
        );
        for step in list(&row["steps"]) {
            traffic.step(&ego, &[], &TrafficLights::default(), 0.1);
            for (name, after) in step["after"].as_object().unwrap() {
                let token = TrackToken(name[1..].parse().unwrap());
                let theirs = numbers(after);
                let object = traffic
                    .objects()
                    .iter()
                    .find(|object| object.token == token)
                    .copied()
                    .unwrap();
                let (place, speed) = (object.shape.center, object.speed());
                let off = (place.x - theirs[2])
                    .abs()
                    .max((place.y - theirs[3]).abs())
                    .max((speed - theirs[1]).abs());
                assert!(
                    off < MAX_ERROR,
                    "{} {}: {off} {object:?} {theirs:?}",
                    row["name"],
                    row["mode"]
                );
                steps += 1;
            }
        }
    }
    assert!(steps > 60, "{steps}");
}

#[test]
fn the_path_of_the_ego_is_interplans() {
    let mut compared = 0;
    for row in list(&vectors("ego_expanded.json")["rows"]) {
        let (center, velocity) = (numbers(&row["center"]), numbers(&row["rear_axle_velocity"]));
        // A strip that turns has other joints; going back is not covered.
        if velocity[1] != 0.0 || velocity[0] < 0.0 {
            continue;
        }
        let path = EgoPath::new(&ego(&[center[0], center[1], center[2], velocity[0]]));
        let corners: Vec<Point> = list(&row["exterior"])
            .map(numbers)
            .map(|point| Point::new(point[0], point[1]))
            .collect();
        let middle = corners
            .iter()
            .fold(Vector::zeros(), |sum, corner| sum + corner.coords)
            / corners.len() as f64;
        let distance = |point: Point| {
            let probe = OrientedBox::new(Pose::at(point, 0.0), 1e-9, 1e-9);
            path.footprint().distance(&Footprint::of_box(probe))
        };
        for corner in corners {
            let outward = (corner.coords - middle).normalize();
            assert!(distance(corner) < MAX_ERROR, "{corner} {row}");
            assert!(distance(corner + outward * 0.01) > 1e-4, "{corner} {row}");
        }
        compared += 1;
    }
    assert!(compared >= 8, "{compared}");
}
