//! PDM's scorer beside the recorded scores of `tuplan_garage`: 9 cases of 15 proposals, simulated here with PDM's
//! tracker.

use super::road::{Road, cruise, ego, object, straight};
use planagent::dynamics::{JerkPenalty, simulate_proposal};
use planagent::geometry::{OrientedBox, Point, Polygon, Polyline, Pose, Vector};
use planagent::metrics::MetricError;
use planagent::pdm::{Collided, DrivableLayers, DrivableMap, Forecast, ProposalScore, ScoringScene, score_proposals};
use planagent::world::{
    EgoState, LaneId, LaneKind, LaneMap, ObjectKind, SignalStatus, TrackToken, TrackedObject, TrafficLights,
};
use serde_json::Value;
use std::collections::BTreeSet;
use std::path::PathBuf;

fn record() -> Option<Value> {
    let root = std::env::var_os("PLANAGENT_DATA")
        .map_or_else(|| PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/data")), PathBuf::from);
    let path = root.join("vectors/generated/pdm_closed.json");
    match std::fs::read_to_string(&path) {
        Ok(text) => Some(serde_json::from_str(&text).unwrap()),
        Err(error) => {
            eprintln!("SKIPPED: {}: {error}", path.display());
            None
        }
    }
}

fn number(value: &Value, key: &str) -> f64 {
    value[key].as_f64().unwrap()
}

fn points(value: &Value) -> Vec<Point> {
    value.as_array().unwrap().iter().map(|p| Point::new(p[0].as_f64().unwrap(), p[1].as_f64().unwrap())).collect()
}

/// The lanes of a case as a map; the pieces of the centreline are of no account here.
fn map_of(case: &Value) -> (LaneMap, BTreeSet<LaneId>) {
    let mut road = Road::default();
    let on_route: Vec<&str> = case["on_route"].as_array().unwrap().iter().map(|n| n.as_str().unwrap()).collect();
    let mut route = BTreeSet::new();
    for (name, ring) in case["lanes"].as_object().unwrap() {
        let red = name.parse::<u32>().is_ok();
        let kind = if red { LaneKind::Connector } else { LaneKind::Lane };
        let id = road.piece(kind, (0.0, 0.0), (1.0, 0.0), None);
        let polygon = Polygon::new(points(ring)).unwrap();
        road.parts.roadblocks[id.index()].areas = vec![polygon.clone()];
        road.parts.lanes[id.index()].polygon = polygon;
        if on_route.contains(&name.as_str()) {
            route.insert(id);
        }
    }
    (road.build(), route)
}

fn objects_of(case: &Value) -> Vec<TrackedObject> {
    let objects = case["objects"].as_array().unwrap().iter().enumerate();
    objects
        .map(|(i, o)| TrackedObject {
            token: TrackToken(i as u32),
            kind: match o["type"].as_str().unwrap() {
                "VEHICLE" => ObjectKind::Vehicle,
                "PEDESTRIAN" => ObjectKind::Pedestrian,
                "TRAFFIC_CONE" => ObjectKind::TrafficCone,
                other => panic!("unexpected object {other}"),
            },
            shape: OrientedBox::new(
                Pose::new(number(o, "x"), number(o, "y"), number(o, "heading")),
                number(o, "length"),
                number(o, "width"),
            ),
            velocity: Vector::new(number(o, "vx"), number(o, "vy")),
        })
        .collect()
}

fn proposals_of(case: &Value) -> Vec<Vec<EgoState>> {
    let ego = &case["ego"];
    let pose = Pose::new(number(ego, "x"), number(ego, "y"), number(ego, "heading"));
    let start = EgoState::from_log(0, pose, Vector::new(number(ego, "vx"), 0.0), Vector::new(number(ego, "ax"), 0.0));
    case["proposals_se2"]
        .as_array()
        .unwrap()
        .iter()
        .map(|proposal| {
            let poses: Vec<Pose> = proposal
                .as_array()
                .unwrap()
                .iter()
                .map(|p| Pose::new(p[0].as_f64().unwrap(), p[1].as_f64().unwrap(), p[2].as_f64().unwrap()))
                .collect();
            simulate_proposal(&start, &poses, JerkPenalty::PdmClosed)
        })
        .collect()
}

fn scores_of(case: &Value) -> Vec<ProposalScore> {
    let (map, route) = map_of(case);
    let proposals = proposals_of(case);
    let lights: TrafficLights =
        map.lanes().iter().filter(|l| l.is_connector()).map(|l| (l.id, SignalStatus::Red)).collect();
    let start = &proposals[0][0];
    let forecast = Forecast::new(&map, &route, start, &objects_of(case), &lights, &mut Collided::default());
    assert_eq!(forecast.red_lights().len(), usize::from(!case["red_light"].is_null()));
    let drivable = DrivableMap::around(&map, &route, start.center().position(), DrivableLayers::Lanes);
    let centerline = Polyline::new(points(&case["centerline"])).unwrap();
    let scene = ScoringScene { drivable: &drivable, forecast: &forecast, centerline: &centerline, rival_progress: 0.0 };
    score_proposals(&scene, &proposals).unwrap()
}

#[test]
fn every_term_of_every_proposal_matches_the_record() {
    let Some(record) = record() else { return };
    for case in record["cases"].as_array().unwrap() {
        let name = case["name"].as_str().unwrap();
        let scores = scores_of(case);
        for (i, score) in scores.iter().enumerate() {
            let terms = [
                ("no_collision", &case["multi"]["no_collision"], score.no_at_fault_collisions, 0.0),
                ("drivable", &case["multi"]["drivable"], score.drivable_area, 0.0),
                ("direction", &case["multi"]["direction"], score.driving_direction, 0.0),
                ("ttc", &case["weighted"]["ttc"], score.time_to_collision, 0.0),
                ("comfort", &case["weighted"]["comfort"], score.comfort, 0.0),
                ("progress", &case["weighted"]["progress"], score.progress, 1e-6),
                ("progress_raw", &case["progress_raw"], score.progress_m, 1e-5),
                ("scores", &case["scores"], score.total, 1e-6),
            ];
            for (term, expected, found, tolerance) in terms {
                let expected = expected[i].as_f64().unwrap();
                assert!((found - expected).abs() <= tolerance, "{name} {i} {term}: {found} {expected}");
            }
            let times = [("collision_time_idx", score.first_at_fault_s), ("ttc_time_idx", score.first_ttc_s)];
            for (term, found) in times {
                let expected = case[term][i].as_f64().map(|steps| steps * 0.1);
                assert_eq!(found.is_some(), expected.is_some(), "{name} {i} {term}");
                assert!((found.unwrap_or(0.0) - expected.unwrap_or(0.0)).abs() < 1e-9, "{name} {i} {term}");
            }
        }
        // The first of equal scores is the best.
        let best = scores.iter().enumerate().rev().max_by(|a, b| a.1.total.total_cmp(&b.1.total)).unwrap().0;
        assert_eq!(best as u64, case["best"].as_u64().unwrap(), "{name}");
    }
}

/// Scores straight proposals (a horizon of `states` states at constant speed) on an empty straight road.
fn straight_scores(speeds: &[f64], states: usize, objects: &[TrackedObject], rival: f64) -> Vec<ProposalScore> {
    let map = straight();
    let route = BTreeSet::from([LaneId(0)]);
    let proposals: Vec<Vec<EgoState>> = speeds.iter().map(|&v| cruise(states, 0.0, 0.0, v)).collect();
    let start = ego(0, 0.0, 0.0, 0.0, 5.0);
    let forecast = Forecast::new(&map, &route, &start, objects, &TrafficLights::default(), &mut Collided::default());
    let drivable = DrivableMap::around(&map, &route, start.center().position(), DrivableLayers::Lanes);
    let centerline = map.lanes()[0].centerline.clone();
    let scene =
        ScoringScene { drivable: &drivable, forecast: &forecast, centerline: &centerline, rival_progress: rival };
    score_proposals(&scene, &proposals).unwrap()
}

#[test]
fn progress_is_relative_to_the_best_or_to_a_rival() {
    // 40 steps at 5 and 10 m/s: 20 m and 40 m.
    let scores = straight_scores(&[5.0, 10.0], 41, &[], 0.0);
    assert!((scores[0].progress - 0.5).abs() < 1e-9 && (scores[1].progress - 1.0).abs() < 1e-9);
    assert!((scores[0].total - (5.0 * 0.5 + 7.0) / 12.0).abs() < 1e-9);
    let beside_rival = straight_scores(&[5.0, 10.0], 41, &[], 80.0);
    assert!((beside_rival[0].progress - 0.25).abs() < 1e-9 && (beside_rival[1].progress - 0.5).abs() < 1e-9);
    // Nobody can move: standing still is perfect.
    assert!((straight_scores(&[0.0, 0.0], 41, &[], 0.0)[1].total - 1.0).abs() < 1e-12);
}

#[test]
fn the_horizon_is_a_parameter() {
    let cone = [object(1, ObjectKind::TrafficCone, Pose::new(30.0, 0.0, 0.0), (0.4, 0.4), 0.0)];
    // The front reaches the cone (29.8 m) when the centre is at 27.212 m: at 10 m/s after 2.8 s.
    let long = &straight_scores(&[10.0], 41, &cone, 0.0)[0];
    assert_eq!((long.no_at_fault_collisions, long.time_to_collision), (0.5, 0.0));
    assert!((long.first_at_fault_s.unwrap() - 2.8).abs() < 1e-9);
    // Seen from 0.9 s before.
    assert!((long.first_ttc_s.unwrap() - 1.9).abs() < 1e-9);
    let short = &straight_scores(&[10.0], 19, &cone, 0.0)[0];
    assert_eq!((short.no_at_fault_collisions, short.time_to_collision), (1.0, 1.0));
    assert!((short.progress_m - 18.0).abs() < 1e-9);
}

#[test]
fn proposals_that_are_too_short_are_refused() {
    let map = straight();
    let route = BTreeSet::new();
    let start = ego(0, 0.0, 0.0, 0.0, 5.0);
    let forecast = Forecast::new(&map, &route, &start, &[], &TrafficLights::default(), &mut Collided::default());
    let drivable = DrivableMap::around(&map, &route, start.center().position(), DrivableLayers::Lanes);
    let scene = ScoringScene {
        drivable: &drivable,
        forecast: &forecast,
        centerline: &map.lanes()[0].centerline,
        rival_progress: 0.0,
    };
    let error = score_proposals(&scene, &[cruise(3, 0.0, 0.0, 5.0)]).unwrap_err();
    assert_eq!(error, MetricError::TooFewSamples { got: 3, needed: 4 });
    assert!(score_proposals(&scene, &[]).unwrap().is_empty());
}
