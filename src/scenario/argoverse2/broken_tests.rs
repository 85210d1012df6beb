//! Broken logs: errors name the place, and none makes the reader panic.

use super::test_log::{ANNOTATIONS, CITY, Log, MAP, POSES, log, set, time_ns, with};
use super::*;
use crate::recording::error::{FileError, RecordingFault};
use arrow_array::{Int64Array, StringArray};
use proptest::prelude::*;
use serde_json::{Value, json};

#[test]
fn broken_tables_are_reported_with_file_column_and_row() {
    let check = |file: &str, change: &dyn Fn(&mut Log), what: &str| {
        let mut log = log(30);
        change(&mut log);
        let message = log.opened().unwrap_err().to_string();
        assert!(
            message.contains(file) && message.contains(what),
            "{message}"
        );
    };
    let drop_column = |name: &'static str| {
        move |log: &mut Log| log.annotations.retain(|(column, _)| *column != name)
    };
    check(
        ANNOTATIONS,
        &drop_column("track_uuid"),
        "no column 'track_uuid'",
    );
    check(ANNOTATIONS, &drop_column("tx_m"), "no column 'tx_m'");
    check(
        POSES,
        &|log| log.poses.retain(|(column, _)| *column != "qz"),
        "no column 'qz'",
    );
    let number = |name: &'static str, row: usize, value: Option<f64>| {
        move |log: &mut Log| {
            let array = with(&log.annotations, name, row, value);
            set(&mut log.annotations, name, array);
        }
    };
    check(
        ANNOTATIONS,
        &number("ty_m", 7, Some(f64::NAN)),
        "column 'ty_m', row 7: NaN",
    );
    check(
        ANNOTATIONS,
        &number("tx_m", 3, Some(f64::INFINITY)),
        "column 'tx_m', row 3: inf",
    );
    check(
        ANNOTATIONS,
        &number("tx_m", 3, None),
        "column 'tx_m', row 3: no value",
    );
    check(
        ANNOTATIONS,
        &number("width_m", 9, Some(0.0)),
        "column 'width_m', row 9: 0",
    );
    check(
        ANNOTATIONS,
        &number("qw", 2, Some(0.0)),
        "row 2: a quaternion of norm 0",
    );
    check(
        ANNOTATIONS,
        &|log| set(&mut log.annotations, "qx", StringArray::from(vec!["x"; 95])),
        "not numbers",
    );
    check(
        ANNOTATIONS,
        &|log| {
            set(
                &mut log.annotations,
                "category",
                Int64Array::from(vec![1; 95]),
            );
        },
        "not text",
    );
    let strange = |log: &mut Log| {
        set(
            &mut log.annotations,
            "category",
            StringArray::from(vec!["SPACESHIP"; 95]),
        );
    };
    check(ANNOTATIONS, &strange, "row 0: unknown category 'SPACESHIP'");
    let one_track = |log: &mut Log| {
        set(
            &mut log.annotations,
            "track_uuid",
            StringArray::from(vec!["same"; 95]),
        );
    };
    check(ANNOTATIONS, &one_track, "row 1: a second row of track same");
    let empty = |log: &mut Log| {
        log.annotations
            .iter_mut()
            .for_each(|(_, array)| *array = array.slice(0, 0));
    };
    check(ANNOTATIONS, &empty, "no rows");
    let short = |log: &mut Log| {
        log.poses
            .iter_mut()
            .for_each(|(_, array)| *array = array.slice(0, 20));
    };
    check(POSES, &short, &format!("no ego pose at {} ns", time_ns(20)));
    let late = |log: &mut Log| {
        log.poses
            .iter_mut()
            .for_each(|(_, array)| *array = array.slice(1, 29));
    };
    check(POSES, &late, &format!("no ego pose at {} ns", time_ns(0)));
}

#[test]
fn short_logs_and_gaps_are_reported() {
    let fault = |log: &Log| match log.opened().unwrap_err() {
        FileError {
            fault: LogFault::Recording(fault),
            ..
        } => fault,
        other => panic!("{other}"),
    };
    assert_eq!(
        fault(&log(20)),
        RecordingFault::TooShort {
            steps: 20,
            needed: 21
        }
    );
    let mut gap = log(40);
    // All rows of sweep 10, of which there are three, are gone.
    for (_, array) in &mut gap.annotations {
        let parts = [array.slice(0, 35), array.slice(38, array.len() - 38)];
        *array = arrow_select::concat::concat(&[&parts[0], &parts[1]]).unwrap();
    }
    assert!(matches!(
        fault(&gap),
        RecordingFault::StepTime { step: 10, .. }
    ));
}

#[test]
fn broken_maps_are_reported() {
    let fault = |change: &dyn Fn(&mut Value)| {
        let mut log = log(30);
        change(&mut log.map);
        match log.opened().unwrap_err() {
            FileError { place, fault } if place.path.ends_with(MAP) => fault,
            other => panic!("{other}"),
        }
    };
    let lane =
        |map: &mut Value, field: &str, value: Value| map["lane_segments"]["2"][field] = value;
    let message = fault(&|map| lane(map, "lane_type", json!("RAIL"))).to_string();
    assert!(message.contains("unknown variant `RAIL`"), "{message}");
    let message =
        fault(&|map| drop(map.as_object_mut().unwrap().remove("drivable_areas"))).to_string();
    assert!(
        message.contains("missing field `drivable_areas`"),
        "{message}"
    );
    assert!(matches!(
        fault(&|map| lane(map, "successors", json!([1.5]))),
        LogFault::Json(_)
    ));
    assert!(matches!(
        fault(&|map| lane(map, "id", json!(1))),
        LogFault::Recording(RecordingFault::DuplicateId { id: 1, .. })
    ));
    assert!(matches!(
        fault(&|map| lane(map, "left_lane_boundary", json!([]))),
        LogFault::NoArea { id: 2 }
    ));
    let far = json!([{"x": 1e6, "y": 0.0, "z": 0.0}, {"x": 0.0, "y": 0.0, "z": 0.0}]);
    let far = fault(&|map| lane(map, "right_lane_boundary", far.clone()));
    assert!(matches!(
        far,
        LogFault::Recording(RecordingFault::NoPlace {
            feature: 2,
            point: 0
        })
    ));
    let no_lanes = fault(&|map| map["lane_segments"] = json!({}));
    assert!(matches!(
        no_lanes,
        LogFault::Recording(RecordingFault::Map(planagent_world::MapError::NoLanes))
    ));
}

#[test]
fn missing_and_damaged_files_are_reported() {
    let check = |change: &dyn Fn(&Path)| {
        let (_guard, folder) = log(30).written();
        change(&folder);
        open(&folder).unwrap_err().to_string()
    };
    let without =
        |file: &'static str| check(&|folder| std::fs::remove_file(folder.join(file)).unwrap());
    assert!(without(POSES).contains("there is no city_SE3_egovehicle.feather"));
    assert!(without(ANNOTATIONS).contains("there is no annotations*.feather"));
    assert!(without(MAP).contains("there is no map/log_map_archive_*.json"));
    let cut = |file: &'static str, share: usize| {
        check(&|folder| {
            let bytes = std::fs::read(folder.join(file)).unwrap();
            std::fs::write(folder.join(file), &bytes[..bytes.len() * share / 100]).unwrap();
        })
    };
    for (file, word) in [
        (ANNOTATIONS, "Feather"),
        (POSES, "Feather"),
        (MAP, "not a map"),
    ] {
        for share in [0, 1, 50, 99] {
            let message = cut(file, share);
            assert!(
                message.contains(file) && message.contains(word),
                "{share} %: {message}"
            );
        }
    }
    let old = check(&|folder| std::fs::write(folder.join(POSES), b"FEA1 and so on").unwrap());
    assert!(old.contains("Feather version 1"), "{old}");
    let stream = check(&|folder| std::fs::write(folder.join(POSES), [0xff; 64]).unwrap());
    assert!(stream.contains("a stream of Arrow"), "{stream}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Damaged bytes cause no panic.
    #[test]
    fn damaged_tables_never_panic(
        of_poses: bool,
        damage in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..12),
    ) {
        let (_guard, folder) = log(21).written();
        let path = folder.join(if of_poses { POSES } else { ANNOTATIONS });
        let mut bytes = std::fs::read(&path).unwrap();
        for (place, byte) in damage {
            let place = place.index(bytes.len());
            bytes[place] = byte;
        }
        std::fs::write(&path, bytes).unwrap();
        drop(open(&folder));
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// Boundaries that cross themselves and each other, and relations at random.
    #[test]
    fn odd_maps_never_panic(
        moves in prop::collection::vec((0..13usize, any::<bool>(), 0..4usize, -200.0..200.0f64, -200.0..200.0f64), 1..40),
        links in prop::collection::vec((0..13usize, 0..60i64, 0..60i64), 0..12),
    ) {
        let mut log = log(21);
        let segments = log.map["lane_segments"].as_object_mut().unwrap();
        let ids: Vec<String> = segments.keys().cloned().collect();
        for (lane, left, place, x, y) in moves {
            let boundary = if left { "left_lane_boundary" } else { "right_lane_boundary" };
            let points = segments[&ids[lane]][boundary].as_array_mut().unwrap();
            let place = place % points.len();
            points[place] = json!({"x": CITY.0 + x, "y": CITY.1 + y, "z": 7.0});
        }
        for (lane, successor, neighbor) in links {
            segments[&ids[lane]]["successors"].as_array_mut().unwrap().push(json!(successor));
            segments[&ids[lane]]["left_neighbor_id"] = json!(neighbor);
        }
        prop_assert!(log.opened().is_ok());
    }
}
