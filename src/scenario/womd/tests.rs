//! A synthetic recording: what is derived from it, and errors of broken ones.

use super::proto::{
    DynamicMapState, FeatureData, LaneCenter, LaneNeighbor, LaneType, Line, MapFeature, MapPoint,
    ObjectState, ObjectType, SignalState, Track, TrafficSignalLaneState,
};
use super::tfrecord::frame;
use super::*;
use crate::recording::error::RecordingFault;
use planagent_world::geometry::Point;
use planagent_world::{LaneId, LaneKind, SignalStatus};
use proptest::prelude::*;
use prost::Message;
use std::io::Write;

const MPH_25: f64 = 25.0 * 0.447_04;

fn line(points: &[(f64, f64)]) -> Vec<MapPoint> {
    let pairs = points.windows(2).flat_map(|pair| {
        let ((x0, y0), (x1, y1)) = (pair[0], pair[1]);
        (0..20).map(move |i| {
            (
                x0 + (x1 - x0) * f64::from(i) / 20.0,
                y0 + (y1 - y0) * f64::from(i) / 20.0,
            )
        })
    });
    pairs
        .chain(points.last().copied())
        .map(|(x, y)| MapPoint { x, y, z: 0.0 })
        .collect()
}

fn lane(id: i64, points: &[(f64, f64)], entries: &[i64], exits: &[i64]) -> MapFeature {
    let lane = LaneCenter {
        speed_limit_mph: 25.0,
        r#type: LaneType::SurfaceStreet as i32,
        polyline: line(points),
        entry_lanes: entries.to_vec(),
        exit_lanes: exits.to_vec(),
        ..LaneCenter::default()
    };
    MapFeature {
        id,
        feature_data: Some(FeatureData::Lane(lane)),
    }
}

fn edge(id: i64, points: &[(f64, f64)]) -> MapFeature {
    MapFeature {
        id,
        feature_data: Some(FeatureData::RoadEdge(Line {
            polyline: line(points),
        })),
    }
}

/// Two neighboring lanes to the east (1, 2), 60 m; connectors straight on (11, 12) and to the right
/// (13), 20 m; the lanes behind them (21, 22, 23); and a road from the south (31, 41, 51) that
/// crosses. Curbs 6 m beside lane 2 and 5 m beside lane 1.
fn crossing_map() -> Vec<MapFeature> {
    let mut map = vec![
        lane(1, &[(0.0, 3.5), (60.0, 3.5)], &[], &[11]),
        lane(2, &[(0.0, 0.0), (60.0, 0.0)], &[], &[12, 13]),
        lane(11, &[(60.0, 3.5), (80.0, 3.5)], &[1], &[21]),
        lane(12, &[(60.0, 0.0), (80.0, 0.0)], &[2], &[22]),
        lane(
            13,
            &[(60.0, 0.0), (65.0, -1.5), (68.0, -5.0), (68.0, -10.0)],
            &[2],
            &[23],
        ),
        lane(21, &[(80.0, 3.5), (140.0, 3.5)], &[11], &[]),
        lane(22, &[(80.0, 0.0), (140.0, 0.0)], &[12], &[]),
        lane(23, &[(68.0, -10.0), (68.0, -60.0)], &[13], &[]),
        lane(31, &[(72.0, -60.0), (72.0, -10.0)], &[], &[41]),
        lane(41, &[(72.0, -10.0), (72.0, 13.0)], &[31], &[51]),
        lane(51, &[(72.0, 13.0), (72.0, 60.0)], &[41], &[]),
        edge(101, &[(0.0, 8.5), (60.0, 8.5)]),
        edge(102, &[(0.0, -6.0), (60.0, -6.0)]),
    ];
    let neighbor = |feature_id| LaneNeighbor {
        feature_id,
        self_end_index: 20,
        ..LaneNeighbor::default()
    };
    for (own, left, right) in [
        (0, vec![], vec![2]),
        (1, vec![1], vec![]),
        (5, vec![], vec![22]),
        (6, vec![21], vec![]),
    ] {
        if let Some(FeatureData::Lane(lane)) = &mut map[own].feature_data {
            lane.left_neighbors = left.into_iter().map(neighbor).collect();
            lane.right_neighbors = right.into_iter().map(neighbor).collect();
        }
    }
    map
}

/// The ego on lane 2 at 8 m/s for 13 s, straight on; a pedestrian; a light for lane 12 that is
/// observed from step 10 on.
fn recording() -> proto::Scenario {
    let steps = 131;
    let moving = |speed: f64, y: f64, length: f32| {
        let states = (0..steps).map(move |i| ObjectState {
            center_x: Some(1_000.0 + 5.0 + speed * f64::from(i) * 0.1),
            center_y: Some(-500.0 + y),
            length,
            width: length / 2.0,
            velocity_x: Some(speed as f32),
            valid: true,
            ..ObjectState::default()
        });
        states.collect::<Vec<_>>()
    };
    let mut map_features = crossing_map();
    for feature in &mut map_features {
        let points = match &mut feature.feature_data {
            Some(FeatureData::Lane(lane)) => &mut lane.polyline,
            Some(FeatureData::RoadEdge(line)) => &mut line.polyline,
            _ => continue,
        };
        for point in points {
            (point.x, point.y) = (point.x + 1_000.0, point.y - 500.0);
        }
    }
    let light = |step: i32| TrafficSignalLaneState {
        lane: 12,
        state: if step < 60 {
            SignalState::Stop as i32
        } else {
            SignalState::ArrowGo as i32
        },
        stop_point: Some(MapPoint {
            x: 1_060.0,
            y: -500.0,
            z: 0.0,
        }),
    };
    let lights = (0..steps).map(|step| DynamicMapState {
        lane_states: (step >= 10).then(|| light(step)).into_iter().collect(),
    });
    proto::Scenario {
        scenario_id: "synthetic".to_owned(),
        timestamps_seconds: (0..steps).map(|i| 3.0 + f64::from(i) * 0.1).collect(),
        tracks: vec![
            Track {
                id: 5,
                object_type: ObjectType::Pedestrian as i32,
                states: moving(1.0, 7.0, 0.8),
            },
            Track {
                id: 9,
                object_type: ObjectType::Vehicle as i32,
                states: moving(8.0, 0.0, 4.6),
            },
        ],
        dynamic_map_states: lights.collect(),
        map_features,
        sdc_track_index: Some(1),
    }
}

fn lane_of(scenario: &crate::Scenario, source_id: i64) -> &planagent_world::Lane {
    &scenario.map[scenario.map.lane_by_source(source_id).unwrap()]
}

#[test]
fn the_crossing_becomes_nuplans_layers() {
    let scenario = convert::scenario(&recording(), "log").unwrap();
    let map = &scenario.map;
    let connectors: Vec<i64> = map
        .lanes()
        .iter()
        .filter(|l| l.is_connector())
        .map(|l| l.source_id)
        .collect();
    // 11 and 12 cross 41; 13 bends off; the rest are lanes.
    assert_eq!(connectors, vec![11, 12, 13, 41]);
    let ids = |lanes: &[LaneId]| lanes.iter().map(|&l| map[l].source_id).collect::<Vec<_>>();
    let block = |source_id| &map[lane_of(&scenario, source_id).roadblock];
    assert_eq!(ids(&block(1).lanes), vec![1, 2]);
    assert_eq!(ids(&block(11).lanes), vec![11, 12]);
    assert_eq!(ids(&block(13).lanes), vec![13]);
    assert_eq!(block(12).kind, LaneKind::Connector);
    assert_eq!(block(1).outgoing, vec![block(11).id, block(13).id]);
    let left = lane_of(&scenario, 2).left_at(30.0).unwrap();
    assert_eq!(map[left].source_id, 1);
    assert!((lane_of(&scenario, 1).speed_limit.unwrap() - MPH_25).abs() < 1e-9);
    assert_eq!(map.intersections().len(), 1);
    // The ego's first place, 5 m along lane 2, is the origin.
    assert!(
        map.in_intersection(Point::new(60.0, 2.0)) && !map.in_intersection(Point::new(30.0, 2.0))
    );
    assert!(map.name().contains("(1005, -500)"));
}

#[test]
fn lanes_meet_halfway_and_curbs_end_the_drivable_area() {
    let map = convert::scenario(&recording(), "log").unwrap().map;
    for x in [0.0, 17.3, 50.0] {
        assert_eq!(map.lanes_at(Point::new(x, 1.70)).len(), 1);
        assert_ne!(
            map.lanes_at(Point::new(x, 1.70)),
            map.lanes_at(Point::new(x, 1.80))
        );
        assert!(map.lanes_at(Point::new(x, -1.9)).is_empty());
        assert!(map.is_drivable(Point::new(x, -5.9)) && !map.is_drivable(Point::new(x, -6.1)));
        assert!(map.is_drivable(Point::new(x, 8.4)) && !map.is_drivable(Point::new(x, 8.6)));
    }
}

#[test]
fn time_route_lights_and_objects_are_as_recorded() {
    let scenario = convert::scenario(&recording(), "log").unwrap();
    assert_eq!(
        (scenario.id.as_str(), scenario.log_name.as_str()),
        ("synthetic", "log")
    );
    assert_eq!((scenario.start, scenario.iterations()), (20, 111));
    assert_eq!(scenario.frames[20].ego.time_us, 2_000_000);
    assert!((scenario.frames[50].ego.speed() - 8.0).abs() < 1e-5);
    assert!(scenario.frames[50].ego.acceleration.norm() < 1e-4);
    let route: Vec<i64> = scenario
        .route
        .roadblocks
        .iter()
        .map(|&b| scenario.map[b].source_id)
        .collect();
    assert_eq!(route, vec![1, 11, 21]);
    assert_eq!(
        scenario.route.goal,
        Some(scenario.frames[130].ego.rear_axle)
    );
    assert_eq!(scenario.frames[40].objects.len(), 1);
    let lit = lane_of(&scenario, 12);
    assert!(lit.has_traffic_lights && !lane_of(&scenario, 11).has_traffic_lights);
    let shown = [5, 30, 70].map(|step| scenario.frames[step].lights.status(lit.id).unwrap());
    assert_eq!(
        shown,
        [
            SignalStatus::Unknown,
            SignalStatus::Red,
            SignalStatus::Green
        ]
    );
    let stop = &scenario.map[lit.stop_lines[0]];
    assert!(!stop.stop_sign && stop.polygon.contains(lit.centerline.start()));
}

#[test]
fn faults_are_reported() {
    let fault = |change: fn(&mut proto::Scenario)| {
        let mut recording = recording();
        change(&mut recording);
        convert::scenario(&recording, "log").unwrap_err()
    };
    assert!(matches!(
        fault(|r| r.sdc_track_index = Some(-1)),
        WomdFault::NoEgoTrack {
            index: -1,
            tracks: 2
        }
    ));
    assert!(matches!(
        fault(|r| r.sdc_track_index = Some(2)),
        WomdFault::NoEgoTrack { .. }
    ));
    assert!(matches!(
        fault(|r| r.sdc_track_index = None),
        WomdFault::NoEgoIndex
    ));
    let lacking = |change: fn(&mut ObjectState)| {
        let mut recording = recording();
        recording.tracks[1].states.iter_mut().for_each(change);
        convert::scenario(&recording, "log")
    };
    let unplaced = lacking(|state| (state.center_x, state.center_y) = (None, None));
    assert!(
        matches!(
            unplaced,
            Err(WomdFault::NoEgoField { track: 9, fields }) if fields.contains("center_x")
        ),
        "{unplaced:?}"
    );
    let unmoved = lacking(|state| (state.velocity_x, state.velocity_y) = (None, None));
    assert!(
        matches!(
            unmoved,
            Err(WomdFault::NoEgoField { track: 9, fields }) if fields.contains("velocity_x")
        ),
        "{unmoved:?}"
    );
    // A field that is 0 throughout is absent in files of proto3.
    assert!(lacking(|state| state.velocity_y = None).is_ok());
    let shared = |change| match fault(change) {
        WomdFault::Recording(fault) => fault,
        other => panic!("{other}"),
    };
    assert!(matches!(
        shared(|r| r.tracks[0].id = 9),
        RecordingFault::DuplicateId {
            layer: "track",
            id: 9
        }
    ));
    assert!(matches!(
        fault(|r| r.tracks[0].states.truncate(9)),
        WomdFault::TrackLength { track: 5, .. }
    ));
    assert!(matches!(
        shared(|r| r.map_features[3].id = 1),
        RecordingFault::DuplicateId { id: 1, .. }
    ));
    assert!(matches!(
        shared(|r| r.map_features.clear()),
        RecordingFault::Map(_)
    ));
    let untimed = shared(|r| r.timestamps_seconds.clear());
    assert!(matches!(untimed, RecordingFault::TooShort { steps: 0, .. }));
    let still = shared(|r| r.timestamps_seconds.fill(0.0));
    assert!(matches!(still, RecordingFault::StepTime { step: 1, .. }));
    let short = shared(|r| r.timestamps_seconds.truncate(9));
    assert!(matches!(short, RecordingFault::TooShort { steps: 9, .. }));
    let lost = fault(|r| r.tracks[1].states.iter_mut().for_each(|s| s.valid = false));
    assert!(matches!(
        lost,
        WomdFault::EgoMissing {
            step: 0,
            missing: 131
        }
    ));
    let far = shared(|r| {
        if let Some(FeatureData::Lane(lane)) = &mut r.map_features[1].feature_data {
            lane.polyline[4].x = f64::INFINITY;
        }
    });
    assert_eq!(
        far,
        RecordingFault::NoPlace {
            feature: 2,
            point: 4
        }
    );
}

/// A file in a temporary folder, which the guard keeps.
fn written(bytes: &[u8]) -> (tempfile::TempDir, std::path::PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("recordings.tfrecord");
    std::fs::File::create(&path)
        .unwrap()
        .write_all(bytes)
        .unwrap();
    (folder, path)
}

#[test]
fn a_recording_is_opened_by_its_number() {
    let mut second = recording();
    second.scenario_id = "second".to_owned();
    let bytes = [
        frame(&recording().encode_to_vec()),
        frame(&second.encode_to_vec()),
    ]
    .concat();
    let (_folder, path) = written(&bytes);
    assert_eq!(open_one(&path, 0).unwrap().id, "synthetic");
    assert_eq!(open_one(&path, 1).unwrap().id, "second");
    let missing = open_one(&path, 2).unwrap_err();
    assert!(
        missing
            .to_string()
            .ends_with("no recording number 2 among the 2 of the file"),
        "{missing}"
    );
    let (id, contents) = contents(&path).unwrap().map(Result::unwrap).nth(1).unwrap();
    assert_eq!(
        (id.as_str(), contents.iterations, contents.lanes),
        ("second", 111, 11)
    );
}

#[test]
fn an_id_that_no_record_holds_is_refused() {
    let mut long = recording();
    long.scenario_id = "x".repeat(5000);
    let (_folder, path) = written(&frame(&long.encode_to_vec()));
    let error = contents(&path).unwrap().next().unwrap().unwrap_err();
    let error = error.to_string();
    assert!(error.contains("scenario_id has 5000 bytes"), "{error}");
}

#[test]
fn compressed_files_are_read_as_the_others() {
    use flate2::Compression;
    use flate2::write::{GzEncoder, ZlibEncoder};
    let mut second = recording();
    second.scenario_id = "second".to_owned();
    let plain = [
        frame(&recording().encode_to_vec()),
        frame(&second.encode_to_vec()),
    ]
    .concat();
    let gzip = |bytes: &[u8]| {
        let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
        encoder.write_all(bytes).unwrap();
        encoder.finish().unwrap()
    };
    let zlib = |level| {
        let mut encoder = ZlibEncoder::new(Vec::new(), level);
        encoder.write_all(&plain).unwrap();
        encoder.finish().unwrap()
    };
    let (_plain, path) = written(&plain);
    let whole = open_one(&path, 1).unwrap();
    for packed in [
        gzip(&plain),
        // Two members, as `cat a.gz b.gz` makes them.
        [gzip(&plain[..1000]), gzip(&plain[1000..])].concat(),
        zlib(Compression::default()),
        zlib(Compression::best()),
        zlib(Compression::fast()),
    ] {
        let (_folder, path) = written(&packed);
        assert_eq!(contents(&path).unwrap().map(Result::unwrap).count(), 2);
        let opened = open_one(&path, 1).unwrap();
        assert_eq!(opened.id, whole.id);
        assert_eq!(opened.frames.len(), whole.frames.len());
        assert_eq!(opened.frames[50].ego, whole.frames[50].ego);
        let cut = &packed[..packed.len() - 100];
        let (_folder, path) = written(cut);
        assert!(contents(&path).unwrap().any(|one| one.is_err()));
        assert!(open_one(&path, 1).is_err());
    }
    let (_folder, path) = written(&gzip(b"<html>Forbidden</html>"));
    let error = open_one(&path, 0).unwrap_err().to_string();
    assert!(error.contains("it is a web page"), "{error}");
}

#[test]
fn files_of_other_kinds_are_called_what_they_are() {
    for (bytes, said) in [
        (&b"<!DOCTYPE html><html></html>"[..], "a web page"),
        (b"PK\x03\x04\x14\x00\x00\x00\x08\x00", "a ZIP archive"),
        (b"\x00\x05\x16\x07\x00\x02\x00\x00Mac OS X", "macOS"),
        (b"Access denied", "a text"),
        (&[0; 4096], "unfinished download"),
    ] {
        let (_folder, path) = written(bytes);
        let error = open_one(&path, 0).unwrap_err();
        assert!(error.fault.is_of_another_kind(), "{error}");
        assert!(error.to_string().contains(said), "{error}");
    }
}

#[test]
fn broken_files_are_reported_with_their_place() {
    let payload = recording().encode_to_vec();
    let first = frame(&payload);
    let mut flipped = [first.clone(), first.clone()].concat();
    flipped[first.len() + 40] ^= 8;
    let (_folder, path) = written(&flipped);
    let error = open_one(&path, 1).unwrap_err().to_string();
    assert!(
        error.contains(&format!("record 1 at byte {}", first.len())) && error.contains("checksum"),
        "{error}"
    );
    let fault = |path: &Path| open_one(path, 0).unwrap_err().fault;
    let (_folder, path) = written(&first[..first.len() / 2]);
    assert!(matches!(fault(&path), WomdFault::Framing(_)));
    let (_folder, path) = written(&[]);
    assert!(matches!(fault(&path), WomdFault::Empty));
    let (_folder, path) = written(&frame(&[0xff; 30]));
    assert!(matches!(fault(&path), WomdFault::Decode(_)));
    assert!(matches!(fault(&path.join("nothing")), WomdFault::Open(_)));
    assert!(matches!(fault(path.parent().unwrap()), WomdFault::Open(_)));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// A damaged message with correct checksums causes no panic.
    #[test]
    fn damaged_messages_never_panic(damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..12)) {
        let mut payload = recording().encode_to_vec();
        for (place, byte) in damage {
            let place = place.index(payload.len());
            payload[place] = byte;
        }
        if let Ok(recording) = proto::Scenario::decode(&payload[..]) {
            drop(convert::scenario(&recording, "log"));
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    /// Nor do odd coordinates.
    #[test]
    fn odd_maps_never_panic(
        moves in prop::collection::vec((0..11usize, any::<prop::sample::Index>(), -200.0..200.0f64, -200.0..200.0f64), 1..40),
        links in prop::collection::vec((0..11usize, 0..60i64), 0..8),
    ) {
        let mut recording = recording();
        for (feature, place, x, y) in moves {
            if let Some(FeatureData::Lane(lane)) = &mut recording.map_features[feature].feature_data {
                let place = place.index(lane.polyline.len());
                (lane.polyline[place].x, lane.polyline[place].y) = (1_000.0 + x, -500.0 + y);
            }
        }
        for (feature, target) in links {
            if let Some(FeatureData::Lane(lane)) = &mut recording.map_features[feature].feature_data {
                lane.exit_lanes.push(target);
            }
        }
        prop_assert!(convert::scenario(&recording, "log").is_ok());
    }
}
