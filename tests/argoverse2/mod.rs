//! Argoverse 2: every log opens, its derived map keeps the rules, and log replay complies.

#![expect(clippy::unwrap_used, reason = "helpers of tests are tests")]

use crate::outside::{Missing, Needy, data};
use planagent_agent::planner::{IdmPlanner, LogReplay, Planner};
use planagent_agent::simulation::{Challenge, simulate};
use planagent_scenario::argoverse2;
use planagent_scenario::{DataRoots, Readers, Scenario, ScenarioRef};
use planagent_score::metrics;
use planagent_world::geometry::wrap_angle;
use planagent_world::{BASELINE_SPACING, EgoState, LaneKind, PACIFICA};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// The logs of a dataset of Argoverse 2.
fn logs(dataset: &str) -> Result<Vec<PathBuf>, Missing> {
    Ok(argoverse2::logs_in(&data(&format!("argoverse2/{dataset}"))?, &mut Vec::new()).unwrap())
}

/// The words of the scenarios that a word names.
fn found(word: &str) -> Vec<String> {
    let readers = Readers::new(&DataRoots::default());
    readers
        .find(word)
        .unwrap()
        .iter()
        .map(ScenarioRef::to_string)
        .collect()
}

/// All logs.
pub(crate) fn all_logs() -> Result<Vec<PathBuf>, Missing> {
    Ok([logs("sensor")?, logs("motion_forecasting")?].concat())
}

/// The map of a log as it stands in its file.
fn map_file(log: &Path) -> serde_json::Value {
    let folder = if log.join("map").is_dir() {
        log.join("map")
    } else {
        log.to_owned()
    };
    let mut files = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path());
    let map = files.find(|path| {
        path.file_name()
            .unwrap()
            .to_string_lossy()
            .starts_with("log_map_archive_")
    });
    serde_json::from_slice(&std::fs::read(map.unwrap()).unwrap()).unwrap()
}

#[test]
fn logs_open_with_their_window() -> Needy {
    for log in all_logs()? {
        let scenario = argoverse2::open(&log).unwrap();
        let contents = argoverse2::contents(&log).unwrap();
        let id = &scenario.id;
        assert_eq!(*id, log.file_name().unwrap().to_string_lossy());
        assert_eq!(contents.iterations, scenario.iterations(), "{id}");
        assert_eq!(contents.lanes, scenario.map.lanes().len(), "{id}");
        let sensor = log.join("map").is_dir();
        assert_eq!(scenario.start, if sensor { 20 } else { 10 }, "{id}");
        assert!(
            scenario
                .frames
                .windows(2)
                .all(|pair| pair[1].ego.time_us > pair[0].ego.time_us),
            "{id}"
        );
        assert!(
            scenario
                .frames
                .iter()
                .all(|frame| frame.ego.rear_axle.position().coords.norm() < 500.0),
            "{id}"
        );
        assert!(
            scenario
                .frames
                .iter()
                .all(|frame| !frame.objects.is_empty()),
            "{id}"
        );
        let word = log.display().to_string();
        assert_eq!(found(&word), std::slice::from_ref(&word));
        for above in log.ancestors().skip(1).take(2) {
            assert!(found(&above.to_string_lossy()).contains(&word));
        }
    }
    Ok(())
}

/// The sideways velocity of the point ahead of the rear axle by d is d times the yaw rate: a fit
/// tells d.
#[test]
fn the_ego_frame_stands_on_the_rear_axle() -> Needy {
    for log in logs("sensor")? {
        let scenario = argoverse2::open(&log).unwrap();
        let egos: Vec<&EgoState> = scenario.frames.iter().map(|frame| &frame.ego).collect();
        let (mut product, mut square) = (0.0, 0.0);
        for pair in egos.windows(3) {
            let seconds = (pair[2].time_us - pair[0].time_us) as f64 / 1e6;
            let yaw_rate =
                wrap_angle(pair[2].rear_axle.heading - pair[0].rear_axle.heading) / seconds;
            product += yaw_rate * pair[1].velocity.y;
            square += yaw_rate * yaw_rate;
        }
        assert!(square > 1.0, "the log turns too little");
        let ahead = product / square;
        assert!(
            ahead.abs() < 0.3,
            "{}: {ahead} m ahead of the rear axle",
            scenario.id
        );
        assert!(ahead.abs() < PACIFICA.rear_axle_to_center() / 2.0);
    }
    Ok(())
}

#[test]
fn the_recorded_motion_agrees_with_itself() -> Needy {
    for log in all_logs()? {
        let Scenario { id, frames, .. } = argoverse2::open(&log).unwrap();
        for (i, pair) in frames.windows(2).enumerate() {
            let (a, b) = (&pair[0].ego, &pair[1].ego);
            let moved = (b.rear_axle.position() - a.rear_axle.position())
                / ((b.time_us - a.time_us) as f64 / 1e6);
            let recorded = a
                .rear_axle
                .rotate(a.velocity)
                .lerp(&b.rear_axle.rotate(b.velocity), 0.5);
            // Positions of a motion-forecasting scenario run off within its first and last second.
            let smooth = log.join("map").is_dir() || (10..frames.len() - 11).contains(&i);
            assert!(
                !smooth || (moved - recorded).norm() < 0.6,
                "{id} frame {i}: moved {moved:?}, velocity {recorded:?}"
            );
            assert!(
                a.velocity.y.abs() < 0.3,
                "{id} frame {i}: slides {:?}",
                a.velocity
            );
            assert!(
                a.acceleration.norm() < 6.0,
                "{id} frame {i}: {:?}",
                a.acceleration
            );
            for object in &*pair[0].objects {
                // The recording car is none of the objects.
                assert!(
                    !object.shape.contains(a.rear_axle.position()),
                    "{id} frame {i}: {object:?}"
                );
                assert!(
                    object.kind.is_agent() || object.speed() == 0.0,
                    "{id} frame {i}: {object:?}"
                );
                assert!(object.speed() < 40.0, "{id} frame {i}: {object:?}");
            }
        }
        // Kinds of a track do not change, and most tracks are seen for long.
        let mut kinds = BTreeMap::new();
        let seen = frames.iter().flat_map(|frame| frame.objects.iter());
        assert!(
            seen.clone()
                .all(|object| *kinds.entry(object.token).or_insert(object.kind) == object.kind),
            "{id}"
        );
        assert!(seen.count() > 10 * kinds.len(), "{id}");
    }
    Ok(())
}

#[test]
fn derived_maps_keep_the_rules() -> Needy {
    for log in all_logs()? {
        let Scenario { id, map, route, .. } = argoverse2::open(&log).unwrap();
        let file = map_file(&log);
        let wanted: BTreeMap<i64, bool> = file["lane_segments"]
            .as_object()
            .unwrap()
            .values()
            .filter(|lane| lane["lane_type"] != "BIKE")
            .map(|lane| {
                (
                    lane["id"].as_i64().unwrap(),
                    lane["is_intersection"].as_bool().unwrap(),
                )
            })
            .collect();
        let found: BTreeMap<i64, bool> = map
            .lanes()
            .iter()
            .map(|l| (l.source_id, l.is_connector()))
            .collect();
        assert_eq!(found, wanted, "{id}");
        assert_eq!(
            map.crosswalks().len(),
            file["pedestrian_crossings"].as_object().unwrap().len(),
            "{id}"
        );
        assert_eq!(
            map.generic_drivable().len(),
            file["drivable_areas"].as_object().unwrap().len(),
            "{id}"
        );
        let lanes: Vec<_> = map
            .lanes()
            .iter()
            .filter(|lane| !lane.is_connector())
            .collect();
        for (i, lane) in lanes.iter().enumerate() {
            for other in &lanes[..i] {
                let shared = lane.polygon.shared_area(&other.polygon);
                assert!(
                    shared < 1e-3,
                    "{id}: {} and {} share {shared} m²",
                    lane.source_id,
                    other.source_id
                );
            }
        }
        for lane in map.lanes() {
            let steps = lane
                .centerline
                .vertices()
                .windows(2)
                .map(|pair| (pair[1] - pair[0]).norm());
            assert!(
                steps.fold(0.0, f64::max) < BASELINE_SPACING + 1e-6,
                "{id}: lane {}",
                lane.source_id
            );
            let middle = lane.centerline.pose_at(lane.centerline.length() / 2.0);
            assert!(
                map.is_drivable(middle.position()),
                "{id}: lane {}",
                lane.source_id
            );
            assert!(
                lane.is_connector() || lane.polygon.distance_to(middle.position()) < 2.0,
                "{id}: {}",
                lane.source_id
            );
            for beside in lane.left.iter().chain(&lane.right) {
                let foot = map[beside.lane].centerline.project(middle.position());
                assert!(
                    wrap_angle(foot.heading - middle.heading).abs() < 0.8,
                    "{id}: lane {}",
                    lane.source_id
                );
            }
            for &next in &lane.outgoing {
                let gap = (map[next].centerline.start() - lane.centerline.end()).norm();
                assert!(
                    gap < 1.0,
                    "{id}: {} m from {} to {}",
                    gap,
                    lane.source_id,
                    map[next].source_id
                );
                assert!(map[next].incoming.contains(&lane.id), "{id}");
            }
        }
        let held: BTreeSet<_> = map
            .roadblocks()
            .iter()
            .flat_map(|block| block.lanes.iter().copied())
            .collect();
        assert_eq!(held.len(), map.lanes().len(), "{id}");
        assert!(
            map.lanes()
                .iter()
                .any(|lane| lane.kind == LaneKind::Connector),
            "{id}"
        );
        assert!(
            route
                .roadblocks
                .windows(2)
                .all(|pair| map[pair[0]].outgoing.contains(&pair[1])),
            "{id}"
        );
    }
    Ok(())
}

fn scores(scenario: &Scenario, planner: &mut dyn Planner, challenge: Challenge) -> metrics::Score {
    simulate(scenario, planner, challenge)
        .unwrap()
        .evaluate(scenario)
        .unwrap()
        .score
}

#[test]
fn log_replay_complies_and_idm_drives() -> Needy {
    for log in all_logs()? {
        let scenario = argoverse2::open(&log).unwrap();
        let replay = &mut LogReplay::new(scenario.expert().copied().collect());
        let replayed = scores(&scenario, replay, Challenge::NonReactive);
        for name in [
            "no_ego_at_fault_collisions",
            "drivable_area_compliance",
            "driving_direction_compliance",
            "ego_is_making_progress",
        ] {
            let score = replayed.metric(name).unwrap();
            assert!(
                (score - 1.0).abs() < 1e-12,
                "{}: {} is {score}",
                scenario.id,
                name
            );
        }
        for challenge in [Challenge::NonReactive, Challenge::Reactive] {
            let driven = scores(&scenario, &mut IdmPlanner::default(), challenge);
            let on_road = driven.metric("drivable_area_compliance").unwrap();
            assert!((on_road - 1.0).abs() < 1e-12, "{}", scenario.id);
        }
    }
    Ok(())
}
