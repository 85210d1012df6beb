//! A log of our own making: what is derived from it, and what happens when it is broken.

use super::*;
use crate::geometry::Point;
use crate::scenario::TimeFault;
use crate::world::{LaneId, LaneKind, ObjectKind};
use arrow::array::{ArrayRef, Float64Array, Int64Array, RecordBatch, StringArray};
use arrow::ipc::CompressionType;
use arrow::ipc::writer::{FileWriter, IpcWriteOptions};
use parquet::arrow::ArrowWriter;
use proptest::prelude::*;
use serde_json::{Value, json};
use std::fs::File;
use std::path::PathBuf;
use std::sync::Arc;

const MAP: &str = "map/log_map_archive_synthetic____PIT_city_1.json";
const ANNOTATIONS: &str = "annotations.feather";
const POSES: &str = "city_SE3_egovehicle.feather";
/// Where the synthetic city begins, metres.
const CITY: (f64, f64) = (1_000.0, -500.0);

type Columns = Vec<(&'static str, ArrayRef)>;

/// A log in memory.
struct Log {
    annotations: Columns,
    poses: Columns,
    map: Value,
}

fn line(points: &[(f64, f64)]) -> Value {
    points.iter().map(|(x, y)| json!({"x": CITY.0 + x, "y": CITY.1 + y, "z": 7.0})).collect()
}

/// A lane 3.5 m wide around a line that is straight or turns right.
fn lane(id: i64, points: &[(f64, f64)], successors: &[i64]) -> Value {
    let beside = |offset: f64| -> Vec<(f64, f64)> {
        let last = points.len() - 1;
        (0..points.len())
            .map(|i| {
                let (from, to) = (points[i.saturating_sub(1)], points[(i + 1).min(last)]);
                let (dx, dy) = (to.0 - from.0, to.1 - from.1);
                let norm = dx.hypot(dy);
                (points[i].0 - dy / norm * offset, points[i].1 + dx / norm * offset)
            })
            .collect()
    };
    json!({
        "id": id, "is_intersection": matches!(id, 11 | 12 | 13 | 41), "lane_type": if id == 9 { "BIKE" } else { "VEHICLE" },
        "left_lane_boundary": line(&beside(1.75)), "right_lane_boundary": line(&beside(-1.75)),
        "left_lane_mark_type": "NONE", "right_lane_mark_type": "NONE",
        "predecessors": [], "successors": successors, "left_neighbor_id": null, "right_neighbor_id": null,
    })
}

/// Two lanes to the east (1, 2) beside one to the west (3) and a bike lane (9); ways straight on (11, 12) and to the right (13)
/// over a road from the south (31, 41, 51). Lane 3 leads out of the map.
fn crossing_map() -> Value {
    let lanes = [
        lane(1, &[(0.0, 3.5), (60.0, 3.5)], &[11]),
        lane(2, &[(0.0, 0.0), (60.0, 0.0)], &[12, 13]),
        lane(3, &[(60.0, 7.0), (0.0, 7.0)], &[999]),
        lane(9, &[(0.0, -3.5), (60.0, -3.5)], &[12]),
        lane(11, &[(60.0, 3.5), (80.0, 3.5)], &[21]),
        lane(12, &[(60.0, 0.0), (80.0, 0.0)], &[22]),
        lane(13, &[(60.0, 0.0), (65.0, -1.5), (68.0, -5.0), (68.0, -10.0)], &[23]),
        lane(21, &[(80.0, 3.5), (140.0, 3.5)], &[]),
        lane(22, &[(80.0, 0.0), (140.0, 0.0)], &[]),
        lane(23, &[(68.0, -10.0), (68.0, -60.0)], &[]),
        lane(31, &[(72.0, -60.0), (72.0, -10.0)], &[41]),
        lane(41, &[(72.0, -10.0), (72.0, 13.0)], &[51]),
        lane(51, &[(72.0, 13.0), (72.0, 60.0)], &[]),
    ];
    let mut segments: serde_json::Map<String, Value> =
        lanes.into_iter().map(|lane| (lane["id"].to_string(), lane)).collect();
    let left_of = [("1", 3), ("2", 1), ("3", 1), ("22", 21)].map(|(id, other)| (id, "left", other));
    let right_of = [("1", 2), ("2", 9), ("21", 22)].map(|(id, other)| (id, "right", other));
    for (id, side, other) in left_of.into_iter().chain(right_of) {
        segments[id][format!("{side}_neighbor_id")] = json!(other);
    }
    let area = |id: i64, ring: &[(f64, f64)]| json!({"id": id, "area_boundary": line(ring)});
    json!({
        "lane_segments": segments,
        "pedestrian_crossings": {"5": {
            "id": 5, "edge1": line(&[(55.0, -6.0), (55.0, 10.0)]), "edge2": line(&[(58.0, -6.0), (58.0, 10.0)]),
        }},
        "drivable_areas": {
            "6": area(6, &[(-5.0, -6.0), (66.0, -6.0), (66.0, 10.0), (-5.0, 10.0)]),
            "7": area(7, &[(66.0, -65.0), (145.0, -65.0), (145.0, 65.0), (66.0, 65.0)]),
        },
    })
}

fn time_ns(step: usize) -> i64 {
    315_971_916_960_141_000 + 100_000_000 * step as i64
}

/// The ego on lane 2 at 8 m/s; a car 20 m ahead of it, a person that stands, a cone at steps 0 to 4 and the ego's own row.
fn log(steps: usize) -> Log {
    let along = |step: usize| 5.0 + 0.8 * step as f64;
    let mut rows: Vec<(usize, &str, &str, f64, f64)> = Vec::new();
    for step in 0..steps {
        rows.push((step, "car", "REGULAR_VEHICLE", 20.0, 0.0));
        rows.push((step, "person", "PEDESTRIAN", 30.0 - along(step), 12.0));
        rows.push((step, "ego", "EGO_VEHICLE", 0.0, 0.0));
        if step < 5 {
            rows.push((step, "cone", "CONSTRUCTION_CONE", 40.0 - along(step), -5.0));
        }
    }
    let count = rows.len();
    let numbers = |value: f64, count: usize| -> ArrayRef { Arc::new(Float64Array::from(vec![value; count])) };
    let words = |column: fn(&(usize, &'static str, &'static str, f64, f64)) -> &'static str| -> ArrayRef {
        Arc::new(rows.iter().map(|row| Some(column(row))).collect::<StringArray>())
    };
    let places = |column: fn(&(usize, &str, &str, f64, f64)) -> f64| -> ArrayRef {
        Arc::new(rows.iter().map(|row| Some(column(row))).collect::<Float64Array>())
    };
    let annotations: Columns = vec![
        ("timestamp_ns", Arc::new(rows.iter().map(|row| Some(time_ns(row.0))).collect::<Int64Array>())),
        ("track_uuid", words(|row| row.1)),
        ("category", words(|row| row.2)),
        ("length_m", numbers(2.0, count)),
        ("width_m", numbers(1.0, count)),
        ("qw", numbers(1.0, count)),
        ("qx", numbers(0.0, count)),
        ("qy", numbers(0.0, count)),
        ("qz", numbers(0.0, count)),
        ("tx_m", places(|row| row.3)),
        ("ty_m", places(|row| row.4)),
        ("tz_m", numbers(0.5, count)),
    ];
    let poses: Columns = vec![
        ("timestamp_ns", Arc::new((0..steps).map(|step| Some(time_ns(step))).collect::<Int64Array>())),
        ("qw", numbers(1.0, steps)),
        ("qx", numbers(0.0, steps)),
        ("qy", numbers(0.0, steps)),
        ("qz", numbers(0.0, steps)),
        ("tx_m", Arc::new((0..steps).map(|step| Some(CITY.0 + along(step))).collect::<Float64Array>())),
        ("ty_m", numbers(CITY.1, steps)),
        ("tz_m", numbers(7.0, steps)),
    ];
    Log { annotations, poses, map: crossing_map() }
}

/// Puts another array in the place of a column.
fn set(columns: &mut Columns, name: &str, array: impl arrow::array::Array + 'static) {
    columns.iter_mut().find(|(column, _)| *column == name).unwrap().1 = Arc::new(array);
}

/// A column of numbers with one of them changed.
fn with(columns: &Columns, name: &str, row: usize, value: Option<f64>) -> Float64Array {
    use arrow::array::AsArray;
    let column = &columns.iter().find(|(column, _)| *column == name).unwrap().1;
    let mut values: Vec<Option<f64>> = column.as_primitive::<arrow::datatypes::Float64Type>().iter().collect();
    values[row] = value;
    Float64Array::from(values)
}

fn feather(path: &Path, columns: &Columns) {
    let batch = RecordBatch::try_from_iter(columns.clone()).unwrap();
    let options = IpcWriteOptions::default().try_with_compression(Some(CompressionType::LZ4_FRAME)).unwrap();
    let file = File::create(path).unwrap();
    let mut writer = FileWriter::try_new_with_options(file, &batch.schema(), options).unwrap();
    writer.write(&batch).unwrap();
    writer.finish().unwrap();
}

impl Log {
    /// A folder that lasts as long as the guard.
    fn written(&self) -> (tempfile::TempDir, PathBuf) {
        let guard = tempfile::tempdir().unwrap();
        let folder = guard.path().join("synthetic");
        std::fs::create_dir_all(folder.join("map")).unwrap();
        feather(&folder.join(ANNOTATIONS), &self.annotations);
        feather(&folder.join(POSES), &self.poses);
        std::fs::write(folder.join(MAP), self.map.to_string()).unwrap();
        (guard, folder)
    }

    fn opened(&self) -> Result<Scenario, Argoverse2Error> {
        open(&self.written().1)
    }
}

fn lane_of(scenario: &Scenario, source_id: i64) -> &crate::world::Lane {
    &scenario.map[scenario.map.lane_by_source(source_id).unwrap()]
}

#[test]
fn the_crossing_becomes_nuplans_layers() {
    let scenario = log(131).opened().unwrap();
    let map = &scenario.map;
    assert_eq!(map.name(), "argoverse 2 PIT, origin (1005, -500)");
    let ids = |lanes: &[LaneId]| lanes.iter().map(|&lane| map[lane].source_id).collect::<Vec<_>>();
    let of_kind = |kind| map.lanes().iter().filter(|lane| lane.kind == kind).map(|l| l.source_id).collect::<Vec<_>>();
    assert_eq!(of_kind(LaneKind::Connector), vec![11, 12, 13, 41]);
    assert_eq!(of_kind(LaneKind::Lane), vec![1, 2, 3, 21, 22, 23, 31, 51], "the bike lane is none");
    // A neighbour is one of the same direction.
    let (first, second) = (lane_of(&scenario, 1), lane_of(&scenario, 2));
    assert!(first.left.is_empty() && second.right.is_empty());
    assert_eq!((first.right_at(30.0), second.left_at(30.0)), (Some(second.id), Some(first.id)));
    assert_eq!(ids(&map[first.roadblock].lanes), vec![1, 2]);
    assert_eq!(ids(&lane_of(&scenario, 13).incoming), vec![2]);
    assert!(lane_of(&scenario, 3).outgoing.is_empty());
    assert_eq!(map.intersections().len(), 1);
    assert!(map.in_intersection(Point::new(67.0, 3.0)) && !map.in_intersection(Point::new(30.0, 0.0)));
    assert!(map.on_crosswalk(Point::new(51.0, 0.0)));
    assert!(map.is_drivable(Point::new(20.0, -5.9)) && !map.is_drivable(Point::new(20.0, -6.1)));
    assert!(map.lanes().iter().all(|lane| lane.speed_limit.is_none() && !lane.has_traffic_lights));
}

#[test]
fn centrelines_run_in_the_middle_a_vertex_a_metre() {
    let scenario = log(30).opened().unwrap();
    let straight = &lane_of(&scenario, 2).centerline;
    assert_eq!(straight.vertices().len(), 61);
    assert!(straight.vertices().iter().all(|v| v.y.abs() < 1e-9));
    assert!((straight.length() - 60.0).abs() < 1e-9);
    assert!((lane_of(&scenario, 2).polygon.area() - 210.0).abs() < 1e-6);
}

#[test]
fn a_cul_de_sac_turns_round_a_point() {
    let mut log = log(30);
    let point = (30.0, 0.0);
    log.map["lane_segments"]["2"]["left_lane_boundary"] = line(&[point, point]);
    let scenario = log.opened().unwrap();
    let centerline = &lane_of(&scenario, 2).centerline;
    // Half-way between the point and the right boundary.
    assert!((centerline.start() - Point::new(10.0, -0.875)).norm() < 1e-9);
    assert!((centerline.length() - 30.0).abs() < 1e-9);
}

#[test]
fn ego_objects_route_and_window_are_as_recorded() {
    let scenario = log(131).opened().unwrap();
    assert_eq!((scenario.id.as_str(), scenario.log_name.as_str()), ("synthetic", "synthetic"));
    assert_eq!((scenario.start, scenario.iterations()), (20, 111));
    assert_eq!(scenario.frames[20].ego.time_us, 2_000_000);
    let ego = &scenario.frames[40].ego;
    assert!((ego.rear_axle.x - 32.0).abs() < 1e-9 && ego.rear_axle.y.abs() < 1e-9);
    assert!((ego.speed() - 8.0).abs() < 1e-6 && ego.acceleration.norm() < 1e-6);
    let route: Vec<i64> = scenario.route.roadblocks.iter().map(|&b| scenario.map[b].source_id).collect();
    assert_eq!(route, vec![1, 11, 21]);
    assert_eq!(scenario.route.goal, Some(scenario.frames[130].ego.rear_axle));
    assert_eq!(scenario.frames[2].objects.len(), 3);
    let [car, person] = &scenario.frames[40].objects[..] else { panic!("{:?}", scenario.frames[40].objects) };
    assert_eq!((car.kind, person.kind), (ObjectKind::Vehicle, ObjectKind::Pedestrian));
    assert!((car.shape.center.x - 52.0).abs() < 1e-9 && (car.velocity.x - 8.0).abs() < 1e-6);
    assert!((person.shape.center.x - 25.0).abs() < 1e-9 && person.speed() < 1e-6);
    assert_eq!(car.token, scenario.frames[2].objects[0].token);
    let summary = summary(&log(131).written().1).unwrap();
    assert_eq!(
        (summary.steps, summary.iterations, summary.tracks, summary.lanes),
        (131, 111, 4, 12),
        "the bike lane is none"
    );
}

#[test]
fn a_turned_ego_turns_its_boxes() {
    let mut log = log(30);
    let quarter = std::f64::consts::FRAC_1_SQRT_2;
    set(&mut log.poses, "qw", Float64Array::from(vec![quarter; 30]));
    set(&mut log.poses, "qz", Float64Array::from(vec![quarter; 30]));
    let scenario = log.opened().unwrap();
    let frame = &scenario.frames[0];
    assert!((frame.ego.rear_axle.heading - std::f64::consts::FRAC_PI_2).abs() < 1e-9);
    // 8 m/s to the east are to its right.
    assert!((frame.ego.velocity.y + 8.0).abs() < 1e-6);
    let car = frame.objects.iter().find(|object| object.kind == ObjectKind::Vehicle).unwrap();
    assert!((car.shape.center.position() - Point::new(0.0, 20.0)).norm() < 1e-9, "{car:?}");
    assert!((car.shape.center.heading - std::f64::consts::FRAC_PI_2).abs() < 1e-9);
}

#[test]
fn a_pose_that_is_missing_at_a_sweep_lies_between_its_neighbours() {
    let mut log = log(30);
    // The pose of sweep 7 was taken, and is told, 5 ms early: 0.04 m behind. From there to sweep 8 it is 0.84 m in 105 ms.
    let early = |step: usize| if step == 7 { 5_000_000 } else { 0 };
    set(&mut log.poses, "timestamp_ns", (0..30).map(|step| Some(time_ns(step) - early(step))).collect::<Int64Array>());
    let behind = with(&log.poses, "tx_m", 7, Some(CITY.0 + 5.0 + 5.6 - 0.04));
    set(&mut log.poses, "tx_m", behind);
    assert!((log.opened().unwrap().frames[7].ego.rear_axle.x - 5.6).abs() < 1e-9);
}

#[test]
fn broken_tables_are_told_with_file_column_and_row() {
    let told = |file: &str, change: &dyn Fn(&mut Log), what: &str| {
        let mut log = log(30);
        change(&mut log);
        let message = log.opened().unwrap_err().to_string();
        assert!(message.contains(file) && message.contains(what), "{message}");
    };
    let drop_column = |name: &'static str| move |log: &mut Log| log.annotations.retain(|(column, _)| *column != name);
    told(ANNOTATIONS, &drop_column("track_uuid"), "no column `track_uuid`");
    told(ANNOTATIONS, &drop_column("tx_m"), "no column `tx_m`");
    told(POSES, &|log| log.poses.retain(|(column, _)| *column != "qz"), "no column `qz`");
    let number = |name: &'static str, row: usize, value: Option<f64>| {
        move |log: &mut Log| {
            let array = with(&log.annotations, name, row, value);
            set(&mut log.annotations, name, array);
        }
    };
    told(ANNOTATIONS, &number("ty_m", 7, Some(f64::NAN)), "column `ty_m`, row 7: NaN");
    told(ANNOTATIONS, &number("tx_m", 3, Some(f64::INFINITY)), "column `tx_m`, row 3: inf");
    told(ANNOTATIONS, &number("tx_m", 3, None), "column `tx_m`, row 3: no value");
    told(ANNOTATIONS, &number("width_m", 9, Some(0.0)), "column `width_m`, row 9: 0");
    told(ANNOTATIONS, &number("qw", 2, Some(0.0)), "row 2: a quaternion of norm 0");
    told(ANNOTATIONS, &|log| set(&mut log.annotations, "qx", StringArray::from(vec!["x"; 95])), "not numbers");
    told(ANNOTATIONS, &|log| set(&mut log.annotations, "category", Int64Array::from(vec![1; 95])), "not words");
    let strange = |log: &mut Log| set(&mut log.annotations, "category", StringArray::from(vec!["SPACESHIP"; 95]));
    told(ANNOTATIONS, &strange, "row 0: no category is called `SPACESHIP`");
    let one_track = |log: &mut Log| set(&mut log.annotations, "track_uuid", StringArray::from(vec!["same"; 95]));
    told(ANNOTATIONS, &one_track, "row 1: track same stands there twice");
    let empty = |log: &mut Log| log.annotations.iter_mut().for_each(|(_, array)| *array = array.slice(0, 0));
    told(ANNOTATIONS, &empty, "no rows");
    let short = |log: &mut Log| log.poses.iter_mut().for_each(|(_, array)| *array = array.slice(0, 20));
    told(POSES, &short, &format!("no ego pose at {} ns", time_ns(20)));
    let late = |log: &mut Log| log.poses.iter_mut().for_each(|(_, array)| *array = array.slice(1, 29));
    told(POSES, &late, &format!("no ego pose at {} ns", time_ns(0)));
}

#[test]
fn short_logs_and_gaps_are_told() {
    let fault = |log: &Log| match log.opened().unwrap_err() {
        Argoverse2Error::Content { fault: LogFault::Time(fault), .. } => fault,
        other => panic!("{other}"),
    };
    assert_eq!(fault(&log(20)), TimeFault::TooShort { steps: 20, needed: 21 });
    let mut gap = log(40);
    // All rows of sweep 10, of which there are three, are gone.
    for (_, array) in &mut gap.annotations {
        let parts = [array.slice(0, 35), array.slice(38, array.len() - 38)];
        *array = arrow::compute::concat(&[&parts[0], &parts[1]]).unwrap();
    }
    assert!(matches!(fault(&gap), TimeFault::StepTime { step: 10, .. }));
}

#[test]
fn broken_maps_are_told() {
    let fault = |change: &dyn Fn(&mut Value)| {
        let mut log = log(30);
        change(&mut log.map);
        match log.opened().unwrap_err() {
            Argoverse2Error::Content { path, fault } if path.ends_with(MAP) => fault,
            other => panic!("{other}"),
        }
    };
    let lane = |map: &mut Value, field: &str, value: Value| map["lane_segments"]["2"][field] = value;
    let message = fault(&|map| lane(map, "lane_type", json!("RAIL"))).to_string();
    assert!(message.contains("unknown variant `RAIL`"), "{message}");
    let message = fault(&|map| drop(map.as_object_mut().unwrap().remove("drivable_areas"))).to_string();
    assert!(message.contains("missing field `drivable_areas`"), "{message}");
    assert!(matches!(fault(&|map| lane(map, "successors", json!([1.5]))), LogFault::Json(_)));
    assert!(matches!(fault(&|map| lane(map, "id", json!(1))), LogFault::DuplicateId { id: 1 }));
    assert!(matches!(fault(&|map| lane(map, "left_lane_boundary", json!([]))), LogFault::NoArea { id: 2 }));
    let far = json!([{"x": 1e6, "y": 0.0, "z": 0.0}, {"x": 0.0, "y": 0.0, "z": 0.0}]);
    let line_fault = |fault| matches!(fault, LogFault::Line(super::super::LineFault::NoPlace { feature: 2, point: 0 }));
    assert!(line_fault(fault(&|map| lane(map, "right_lane_boundary", far.clone()))));
    let no_lanes = fault(&|map| map["lane_segments"] = json!({}));
    assert!(matches!(no_lanes, LogFault::Map(crate::world::MapError::NoLanes)));
}

#[test]
fn missing_and_damaged_files_are_told() {
    let told = |change: &dyn Fn(&Path)| {
        let (_guard, folder) = log(30).written();
        change(&folder);
        open(&folder).unwrap_err().to_string()
    };
    let without = |file: &'static str| told(&|folder| std::fs::remove_file(folder.join(file)).unwrap());
    assert!(without(POSES).contains("neither city_SE3_egovehicle.feather"));
    assert!(without(ANNOTATIONS).contains("there is no annotations*.feather"));
    assert!(without(MAP).contains("there is no map/log_map_archive_*.json"));
    let cut = |file: &'static str, share: usize| {
        told(&|folder| {
            let bytes = std::fs::read(folder.join(file)).unwrap();
            std::fs::write(folder.join(file), &bytes[..bytes.len() * share / 100]).unwrap();
        })
    };
    for (file, word) in [(ANNOTATIONS, "Feather"), (POSES, "Feather"), (MAP, "not a map")] {
        for share in [0, 1, 50, 99] {
            let message = cut(file, share);
            assert!(message.contains(file) && message.contains(word), "{share} %: {message}");
        }
    }
    let old = told(&|folder| std::fs::write(folder.join(POSES), b"FEA1 and so on").unwrap());
    assert!(old.contains("Feather version 1"), "{old}");
}

/// Tracks of a motion-forecasting scenario: the recording car on lane 2 and a bus beside it.
fn forecasting(steps: usize) -> Columns {
    let count = 2 * steps;
    let of = |value: &dyn Fn(usize, bool) -> f64| -> ArrayRef {
        Arc::new((0..count).map(|row| Some(value(row / 2, row % 2 == 0))).collect::<Float64Array>())
    };
    let words = |ego: &str, bus: &str| -> ArrayRef {
        Arc::new((0..count).map(|row| Some(if row % 2 == 0 { ego } else { bus })).collect::<StringArray>())
    };
    vec![
        ("track_id", words("AV", "7")),
        ("object_type", words("vehicle", "bus")),
        ("timestep", Arc::new((0..count).map(|row| Some((row / 2) as i64)).collect::<Int64Array>())),
        ("position_x", of(&|step, ego| CITY.0 + 5.0 + 0.8 * step as f64 + if ego { 0.0 } else { 10.0 })),
        ("position_y", of(&|_, ego| CITY.1 + if ego { 0.0 } else { 3.5 })),
        ("heading", of(&|_, _| 0.0)),
        ("velocity_x", of(&|_, _| 8.0)),
        ("velocity_y", of(&|_, _| 0.0)),
        ("city", words("pittsburgh", "pittsburgh")),
    ]
}

fn forecasting_opened(columns: Columns) -> Result<Scenario, Argoverse2Error> {
    let folder = tempfile::tempdir().unwrap();
    let batch = RecordBatch::try_from_iter(columns).unwrap();
    let file = File::create(folder.path().join("scenario_synthetic.parquet")).unwrap();
    let mut writer = ArrowWriter::try_new(file, batch.schema(), None).unwrap();
    writer.write(&batch).unwrap();
    writer.close().unwrap();
    std::fs::write(folder.path().join("log_map_archive_synthetic.json"), crossing_map().to_string()).unwrap();
    open(folder.path())
}

#[test]
fn a_forecasting_scenario_is_a_drive_too() {
    let scenario = forecasting_opened(forecasting(110)).unwrap();
    assert_eq!((scenario.start, scenario.iterations()), (10, 100));
    assert_eq!(scenario.map.name(), "argoverse 2 pittsburgh, origin (1005, -500)");
    let frame = &scenario.frames[10];
    assert!((frame.ego.rear_axle.x - 8.0).abs() < 1e-9 && (frame.ego.speed() - 8.0).abs() < 1e-6);
    let [bus] = &frame.objects[..] else { panic!("{:?}", frame.objects) };
    assert!((bus.shape.center.x - 18.0).abs() < 1e-9 && (bus.shape.length - 12.0).abs() < 1e-9);
    let route: Vec<i64> = scenario.route.roadblocks.iter().map(|&b| scenario.map[b].source_id).collect();
    assert_eq!(route, vec![1, 11, 21]);
}

#[test]
fn broken_forecasting_scenarios_are_told() {
    let fault = |change: &dyn Fn(&mut Columns)| {
        let mut columns = forecasting(30);
        change(&mut columns);
        forecasting_opened(columns).unwrap_err().to_string()
    };
    let nobody = fault(&|columns| set(columns, "track_id", StringArray::from(vec!["7"; 60])));
    assert!(nobody.contains("track `AV` is not there at step 0"), "{nobody}");
    let twice = fault(&|columns| set(columns, "timestep", Int64Array::from(vec![0; 60])));
    assert!(twice.contains("row 2: track AV stands there twice"), "{twice}");
    let fast = fault(&|columns| set(columns, "velocity_y", with(columns, "velocity_y", 5, Some(1e6))));
    assert!(fast.contains("column `velocity_y`, row 5"), "{fast}");
    let endless = fault(&|columns| set(columns, "timestep", Int64Array::from(vec![i64::MAX; 60])));
    assert!(endless.contains("column `timestep`, row 0"), "{endless}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Damaged bytes: whatever comes of them, it is no panic.
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
