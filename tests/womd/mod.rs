//! Waymo Open Motion: every recording opens, its derived map keeps the rules, and log replay
//! complies.

#![expect(clippy::unwrap_used, reason = "helpers of tests are tests")]

use crate::outside::{Missing, Needy, data};
use planagent_scenario::womd::{self, WomdError, WomdFault};
use planagent_scenario::{Frame, Scenario};
use planagent_world::geometry::{Point, wrap_angle};
use planagent_world::{LaneId, LaneKind, LaneMap, Neighbor, SignalStatus};
use rayon::prelude::*;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

/// The files of recordings.
fn files() -> Result<Vec<PathBuf>, Missing> {
    let mut files: Vec<PathBuf> = std::fs::read_dir(data("womd")?)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .collect();
    files.retain(|file| {
        file.extension()
            .is_some_and(|extension| extension == "tfrecord")
    });
    files.sort();
    Ok(files)
}

/// The recordings of a file.
fn open(file: &Path) -> Result<Vec<Scenario>, WomdError> {
    womd::contents(file)?
        .enumerate()
        .map(|(record, contents)| contents.and_then(|_| womd::open_one(file, record)))
        .collect()
}

/// All recordings, opened once.
pub(crate) fn recordings() -> Result<&'static [Scenario], Missing> {
    static RECORDINGS: OnceLock<Vec<Scenario>> = OnceLock::new();
    let files = files()?;
    Ok(RECORDINGS.get_or_init(|| {
        files
            .par_iter()
            .flat_map_iter(|file| open(file).unwrap())
            .collect()
    }))
}

/// One recording by id.
fn recording(id: &str) -> Result<&'static Scenario, Missing> {
    Ok(recordings()?
        .iter()
        .find(|scenario| scenario.id == id)
        .unwrap())
}

fn source_ids(map: &LaneMap, lanes: &[LaneId]) -> Vec<i64> {
    lanes.iter().map(|&lane| map[lane].source_id).collect()
}

#[test]
fn every_recording_opens_with_its_window() -> Needy {
    for scenario in recordings()? {
        let id = &scenario.id;
        let times: Vec<i64> = scenario
            .frames
            .iter()
            .map(|frame| frame.ego.time_us)
            .collect();
        assert_eq!(times[0], 0, "{id}");
        let (history, driven) = (
            times[scenario.start],
            times[times.len() - 1] - times[scenario.start],
        );
        let expected = if scenario.frames.len() == 91 {
            (1_000_000, 8_000_000)
        } else {
            (2_000_000, 15_000_000)
        };
        assert!(
            (history - expected.0).abs() < 50_000 && (driven - expected.1).abs() < 50_000,
            "{id}: {history} {driven}"
        );
        assert!(
            matches!(scenario.iterations(), 81 | 150 | 151),
            "{id}: {}",
            scenario.iterations()
        );
        assert!(
            scenario
                .frames
                .iter()
                .all(|frame| frame.ego.rear_axle.position().coords.norm() < 1_000.0),
            "{id}"
        );
        assert!(scenario.route.goal.is_some(), "{id}");
    }
    Ok(())
}

#[test]
fn contents_count_what_opening_finds() -> Needy {
    for file in files()? {
        let recordings: Vec<_> = womd::contents(&file).unwrap().map(Result::unwrap).collect();
        let [(id, contents)] = &recordings[..] else {
            panic!("{recordings:?}")
        };
        let scenario = recording(id)?;
        assert_eq!(contents.iterations, scenario.iterations(), "{id}");
        assert!(contents.steps >= scenario.frames.len(), "{id}");
        assert_eq!(contents.lanes, scenario.map.lanes().len(), "{id}");
    }
    Ok(())
}

#[test]
fn the_recorded_motion_agrees_with_itself() -> Needy {
    for scenario in recordings()? {
        for (i, pair) in scenario.frames.windows(2).enumerate() {
            let (a, b) = (&pair[0].ego, &pair[1].ego);
            let dt = (b.time_us - a.time_us) as f64 / 1e6;
            let moved = (b.rear_axle.position() - a.rear_axle.position()) / dt;
            let recorded = a
                .rear_axle
                .rotate(a.velocity)
                .lerp(&b.rear_axle.rotate(b.velocity), 0.5);
            // 8d3d061e518531d0 hops by 10 cm at 1.8 s and at 6.6 s, as recorded.
            assert!(
                (moved - recorded).norm() < 0.6,
                "{} frame {i}: moved {moved:?}, velocity {recorded:?}",
                scenario.id
            );
            assert!(
                a.velocity.y.abs() < 0.3,
                "{} frame {i}: slides {:?}",
                scenario.id,
                a.velocity
            );
            assert!(
                a.acceleration.norm() < 5.0,
                "{} frame {i}: {:?}",
                scenario.id,
                a.acceleration
            );
            assert!(
                (b.acceleration - a.acceleration).norm() < 2.0,
                "{} frame {i} jerks",
                scenario.id
            );
        }
    }
    Ok(())
}

#[test]
fn every_lane_stands_in_one_roadblock_of_its_kind() -> Needy {
    for Scenario { id, map, .. } in recordings()? {
        let held: Vec<LaneId> = map
            .roadblocks()
            .iter()
            .flat_map(|block| block.lanes.iter().copied())
            .collect();
        assert_eq!(held.len(), map.lanes().len(), "{id}");
        assert_eq!(
            held.iter().collect::<BTreeSet<_>>().len(),
            held.len(),
            "{id}"
        );
        for block in map.roadblocks() {
            for &lane in &block.lanes {
                assert_eq!(map[lane].roadblock, block.id, "{id}");
                assert_eq!(
                    map[lane].kind, block.kind,
                    "{id} lane {}",
                    map[lane].source_id
                );
                let follower = map[lane]
                    .outgoing
                    .iter()
                    .find(|next| block.lanes.contains(next));
                assert_eq!(
                    follower, None,
                    "{id}: {} follows in its own roadblock",
                    map[lane].source_id
                );
                assert!(
                    map[lane]
                        .outgoing
                        .iter()
                        .all(|&next| block.outgoing.contains(&map[next].roadblock)),
                    "{id}"
                );
                assert!(
                    map[lane]
                        .incoming
                        .iter()
                        .all(|&from| block.incoming.contains(&map[from].roadblock)),
                    "{id}"
                );
            }
            assert!(
                block
                    .outgoing
                    .iter()
                    .all(|&next| map[next].incoming.contains(&block.id)),
                "{id}"
            );
        }
    }
    Ok(())
}

#[test]
fn neighbors_run_one_way_and_share_a_roadblock_unless_one_would_follow_the_other() -> Needy {
    let (mut listed, mut shared) = (0, 0);
    for Scenario { id, map, .. } in recordings()? {
        for lane in map.lanes() {
            for (neighbors, side) in [(&lane.left, 1.0), (&lane.right, -1.0)] {
                for &Neighbor {
                    lane: other,
                    from_s,
                    to_s,
                } in neighbors
                {
                    assert!(
                        0.0 <= from_s && from_s < to_s && to_s <= lane.centerline.length() + 1e-6,
                        "{id}"
                    );
                    let middle = lane.centerline.pose_at(f64::midpoint(from_s, to_s));
                    let foot = map[other].centerline.project(middle.position());
                    assert!(
                        wrap_angle(foot.heading - middle.heading).abs() < 0.8,
                        "{id} {}",
                        lane.source_id
                    );
                    let lateral = middle.to_local(foot.point).y;
                    assert!(
                        lateral * side > -0.5,
                        "{id}: {} is {lateral} m beside {}",
                        map[other].source_id,
                        lane.source_id
                    );
                    if !lane.is_connector() && !map[other].is_connector() {
                        listed += 1;
                        shared += usize::from(map[other].roadblock == lane.roadblock);
                    }
                }
            }
        }
    }
    assert!(
        listed == 0 || shared * 4 >= listed * 3,
        "{shared} of {listed}"
    );
    Ok(())
}

#[test]
fn at_most_one_lane_holds_a_point_and_lanes_do_not_cross() -> Needy {
    for Scenario { id, map, .. } in recordings()? {
        let lanes: Vec<_> = map
            .lanes()
            .iter()
            .filter(|lane| !lane.is_connector())
            .collect();
        for (i, a) in lanes.iter().enumerate() {
            for b in &lanes[..i] {
                let shared = a.polygon.shared_area(&b.polygon);
                assert!(
                    shared < 1e-3,
                    "{id}: lanes {} and {} share {shared} m²",
                    a.source_id,
                    b.source_id
                );
            }
            let (middle, length) = (
                a.centerline.point_at(a.centerline.length() / 2.0),
                a.centerline.length(),
            );
            let area = a.polygon.area();
            assert!(
                area < 6.0 * length + 1.0,
                "{id}: lane {} of {length} m has {area} m²",
                a.source_id
            );
            assert!(map.is_drivable(middle), "{id}: lane {}", a.source_id);
        }
    }
    Ok(())
}

#[test]
fn lights_stand_at_connectors() -> Needy {
    for Scenario {
        id, map, frames, ..
    } in recordings()?
    {
        for (lane, _) in frames.iter().flat_map(|frame| frame.lights.iter()) {
            assert!(
                map[lane].is_connector() && map[lane].has_traffic_lights,
                "{id} {}",
                map[lane].source_id
            );
            let lines = map[lane].stop_lines.iter().map(|&line| &map[line]);
            let start = map[lane].centerline.start();
            assert!(
                lines
                    .into_iter()
                    .any(|line| !line.stop_sign && line.polygon.distance_to(start) < 0.3),
                "{id}"
            );
        }
        for line in map.stop_lines() {
            assert!(
                line.lanes.iter().all(|&lane| map[lane].is_connector()),
                "{id}"
            );
            assert!(line.polygon.area() < 3.0, "{id}");
        }
    }
    // The ego of this recording waits at a light that turns green.
    let Scenario {
        map,
        frames,
        start,
        route,
        ..
    } = recording("eb4b91b10ca94ff2")?;
    let ahead: Vec<LaneId> = route
        .lanes(map)
        .into_iter()
        .filter(|&lane| map[lane].has_traffic_lights)
        .collect();
    assert_eq!(source_ids(map, &ahead), vec![184, 185, 259, 260, 261]);
    let shown = |frame: &Frame| frame.lights.status(ahead[1]).unwrap();
    assert_eq!(shown(&frames[*start]), SignalStatus::Red);
    assert_eq!(shown(&frames[frames.len() - 1]), SignalStatus::Green);
    // Of this one the lights were hardly seen.
    let Scenario { frames, .. } = recording("dd0c8c27fdd6ef59")?;
    let all: Vec<SignalStatus> = frames
        .iter()
        .flat_map(|frame| frame.lights.iter())
        .map(|(_, s)| s)
        .collect();
    let unknown = all
        .iter()
        .filter(|&&status| status == SignalStatus::Unknown)
        .count();
    assert!(unknown * 100 > all.len() * 95, "{unknown} of {}", all.len());
    Ok(())
}

#[test]
fn limits_are_known_where_they_were_recorded() -> Needy {
    for Scenario { id, map, .. } in recordings()? {
        let known = map.lanes().iter().filter_map(|lane| lane.speed_limit);
        let unlimited =
            ["8d3d061e518531d0", "1446dc44bd6fd420", "2831b6fde0420b0d"].contains(&id.as_str());
        assert_eq!(known.clone().count() == 0, unlimited, "{id}");
        assert!(
            known.clone().all(|limit| (2.0..40.0).contains(&limit)),
            "{id}"
        );
    }
    Ok(())
}

/// Places that the pictures of the maps show to be off the road: a median, a traffic island, the
/// inside of a block.
#[test]
fn medians_and_blocks_are_not_drivable() -> Needy {
    for (id, places) in [
        (
            "eb4b91b10ca94ff2",
            [(10.6, -22.9), (-36.4, -26.9), (35.2, -11.0)],
        ),
        (
            "8d3d061e518531d0",
            [(97.0, 76.1), (-13.2, 31.2), (27.6, 37.3)],
        ),
    ] {
        let scenario = recording(id)?;
        for (x, y) in places {
            assert!(
                !scenario.map.is_drivable(Point::new(x, y)),
                "{id} ({x}, {y})"
            );
        }
    }
    Ok(())
}

/// Where the recorded ego left the lane graph: between which lanes of the recording.
const BREAKS: [(&str, i64, i64); 1] = [
    // Turns round the end of the median, where the map has no lane.
    ("dd0c8c27fdd6ef59", 228, 257),
];

#[test]
fn routes_are_connected_chains() -> Needy {
    for Scenario {
        id,
        map,
        route,
        frames,
        start,
        ..
    } in recordings()?
    {
        assert!(!route.roadblocks.is_empty(), "{id}");
        for pair in route.roadblocks.windows(2) {
            let gap = (id.as_str(), map[pair[0]].source_id, map[pair[1]].source_id);
            assert!(
                map[pair[0]].outgoing.contains(&pair[1]) || BREAKS.contains(&gap),
                "{gap:?}"
            );
        }
        let held = |frame: &&Frame| {
            let center = frame.ego.center().position();
            route
                .roadblocks
                .iter()
                .any(|&block| map.roadblock_holds(block, center))
        };
        let driven = &frames[*start..];
        let on_route = driven.iter().filter(held).count();
        assert!(
            on_route * 100 >= driven.len() * 97,
            "{id}: {on_route} of {} on the route",
            driven.len()
        );
    }
    Ok(())
}

/// nuPlan's drivable-area compliance of the recorded ego: every corner within 0.3 m of the drivable
/// area.
#[test]
fn log_replay_stays_on_the_drivable_area() -> Needy {
    for scenario in recordings()? {
        for (iteration, ego) in scenario.expert().enumerate() {
            for corner in ego.footprint().corners() {
                let near = scenario.map.distance_to_drivable(corner, 0.3);
                assert!(
                    near.is_some(),
                    "{} iteration {iteration}: corner {corner:?} is off the road",
                    scenario.id
                );
            }
        }
    }
    Ok(())
}

/// nuPlan's driving-direction compliance of the recorded ego: within a second it comes less than 2
/// m backwards.
#[test]
fn log_replay_drives_in_direction() -> Needy {
    for scenario in recordings()? {
        let centers: Vec<Point> = scenario
            .expert()
            .map(|ego| ego.center().position())
            .collect();
        let progress = progress_along_lanes(&scenario.map, &centers[..centers.len() - 1]);
        for last in 0..progress.len() {
            let second: f64 = progress[last.saturating_sub(10)..=last].iter().sum();
            assert!(
                second > -2.0,
                "{} iteration {last}: {second} m",
                scenario.id
            );
        }
    }
    Ok(())
}

/// Progress of each sample along the first lane that nuPlan finds for it.
fn progress_along_lanes(map: &LaneMap, centers: &[Point]) -> Vec<f64> {
    let mut before: Option<LaneId> = None;
    let mut s_before: Option<f64> = None;
    let steps = lanes_along(map, centers)
        .into_iter()
        .zip(centers)
        .map(|(lanes, &center)| {
            let Some(&lane) = lanes.first() else {
                return 0.0;
            };
            if before.replace(lane) != Some(lane) {
                s_before = None;
                return 0.0;
            }
            let s = map[lane].centerline.project(center).s;
            s_before
                .replace(s)
                .filter(|_| s != 0.0)
                .map_or(0.0, |s_before| s - s_before)
        });
    steps.collect()
}

/// nuPlan's lane assignment of a driven path, before its clean-up: what was driven on while it
/// holds the point, then what follows it, then the lane at the point or else all connectors there;
/// in an intersection what lies within 5 m is kept.
fn lanes_along(map: &LaneMap, centers: &[Point]) -> Vec<Vec<LaneId>> {
    let mut found: Vec<Vec<LaneId>> = Vec::new();
    for (i, &center) in centers.iter().enumerate() {
        let before = found.last().cloned().unwrap_or_default();
        let holding = |lanes: &[LaneId]| -> Vec<LaneId> {
            lanes
                .iter()
                .copied()
                .filter(|&lane| map[lane].polygon.contains(center))
                .collect()
        };
        let mut now = holding(&before);
        if let ([], [only]) = (&now[..], &before[..]) {
            now = holding(&map[*only].outgoing);
        }
        if now.is_empty() {
            now = map.lanes_of_kind_at(center, LaneKind::Lane);
            assert!(
                now.len() <= 1,
                "lanes {:?} share {center:?}",
                source_ids(map, &now)
            );
            if now.is_empty() {
                now = map.lanes_of_kind_at(center, LaneKind::Connector);
            }
            let crossing = now.first().map_or(map.in_intersection(center), |&lane| {
                map[lane].is_connector()
            });
            if i > 1 && crossing && before.first().is_some_and(|&lane| map[lane].is_connector()) {
                let near: Vec<LaneId> = before
                    .into_iter()
                    .filter(|&lane| map[lane].polygon.distance_to(center) < 5.0)
                    .collect();
                now = if near.is_empty() { now } else { near };
            }
        }
        found.push(now);
    }
    found
}

#[test]
fn broken_files_are_reported_with_file_record_and_offset() -> Needy {
    let file = files()?.swap_remove(0);
    let whole = std::fs::read(&file).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("broken.tfrecord");
    let message_for = |bytes: &[u8]| {
        std::fs::write(&path, bytes).unwrap();
        open(&path).unwrap_err().to_string()
    };
    let place = format!("{}: record 0 at byte 0: ", path.display());
    for cut in [1, 7, 11, 12, 500, whole.len() - 4, whole.len() - 1] {
        let message = message_for(&whole[..cut]);
        assert!(
            message.starts_with(&place) && message.contains("ends inside"),
            "cut at {cut}: {message}"
        );
    }
    for flipped in [0, 9, 12, whole.len() / 2, whole.len() - 1] {
        let mut bytes = whole.clone();
        bytes[flipped] ^= 0x10;
        let message = message_for(&bytes);
        assert!(
            message.starts_with(&place) && message.contains("checksum"),
            "byte {flipped}: {message}"
        );
    }
    let second = [whole.clone(), whole[..100].to_vec()].concat();
    assert!(message_for(&second).contains(&format!("record 1 at byte {}", whole.len())));
    assert!(message_for(&[]).contains("the file is empty"));
    let wanted = womd::open_one(&file, 3).unwrap_err();
    assert!(
        matches!(
            wanted.fault,
            WomdFault::NotFound {
                wanted: 3,
                records: 1
            }
        ),
        "{wanted}"
    );
    Ok(())
}
