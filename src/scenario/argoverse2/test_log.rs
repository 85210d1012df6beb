//! A synthetic log for the tests.

use super::{Argoverse2Error, Scenario, open};
use arrow_array::{ArrayRef, Float64Array, Int64Array, RecordBatch, StringArray};
use arrow_ipc::CompressionType;
use arrow_ipc::writer::{FileWriter, IpcWriteOptions};
use serde_json::{Value, json};
use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Where the parts of a log lie in its folder.
pub(super) const MAP: &str = "map/log_map_archive_synthetic____PIT_city_1.json";
pub(super) const ANNOTATIONS: &str = "annotations.feather";
pub(super) const POSES: &str = "city_SE3_egovehicle.feather";
/// Where the synthetic city begins, meters.
pub(super) const CITY: (f64, f64) = (1_000.0, -500.0);

/// A table: names and values.
pub(super) type Columns = Vec<(&'static str, ArrayRef)>;

/// A log in memory.
pub(super) struct Log {
    pub(super) annotations: Columns,
    pub(super) poses: Columns,
    pub(super) map: Value,
}

/// A line on the city's map; its points are relative to where that begins.
pub(super) fn line(points: &[(f64, f64)]) -> Value {
    points
        .iter()
        .map(|(x, y)| json!({"x": CITY.0 + x, "y": CITY.1 + y, "z": 7.0}))
        .collect()
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
                (
                    points[i].0 - dy / norm * offset,
                    points[i].1 + dx / norm * offset,
                )
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

/// Two lanes to the east (1, 2) beside one to the west (3) and a bike lane (9); ways straight on
/// (11, 12) and to the right (13) over a road from the south (31, 41, 51). Lane 3 leads out of the
/// map.
pub(super) fn crossing_map() -> Value {
    let lanes = [
        lane(1, &[(0.0, 3.5), (60.0, 3.5)], &[11]),
        lane(2, &[(0.0, 0.0), (60.0, 0.0)], &[12, 13]),
        lane(3, &[(60.0, 7.0), (0.0, 7.0)], &[999]),
        lane(9, &[(0.0, -3.5), (60.0, -3.5)], &[12]),
        lane(11, &[(60.0, 3.5), (80.0, 3.5)], &[21]),
        lane(12, &[(60.0, 0.0), (80.0, 0.0)], &[22]),
        lane(
            13,
            &[(60.0, 0.0), (65.0, -1.5), (68.0, -5.0), (68.0, -10.0)],
            &[23],
        ),
        lane(21, &[(80.0, 3.5), (140.0, 3.5)], &[]),
        lane(22, &[(80.0, 0.0), (140.0, 0.0)], &[]),
        lane(23, &[(68.0, -10.0), (68.0, -60.0)], &[]),
        lane(31, &[(72.0, -60.0), (72.0, -10.0)], &[41]),
        lane(41, &[(72.0, -10.0), (72.0, 13.0)], &[51]),
        lane(51, &[(72.0, 13.0), (72.0, 60.0)], &[]),
    ];
    let mut segments: serde_json::Map<String, Value> = lanes
        .into_iter()
        .map(|lane| (lane["id"].to_string(), lane))
        .collect();
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

/// The time of a sweep, nanoseconds.
pub(super) fn time_ns(step: usize) -> i64 {
    315_971_916_960_141_000 + 100_000_000 * step as i64
}

/// The ego on lane 2 at 8 m/s; a car 20 m ahead of it, a person that stands, a cone at steps 0 to 4
/// and the ego's own row.
pub(super) fn log(steps: usize) -> Log {
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
    let numbers =
        |value: f64, count: usize| -> ArrayRef { Arc::new(Float64Array::from(vec![value; count])) };
    let words =
        |column: fn(&(usize, &'static str, &'static str, f64, f64)) -> &'static str| -> ArrayRef {
            Arc::new(
                rows.iter()
                    .map(|row| Some(column(row)))
                    .collect::<StringArray>(),
            )
        };
    let places = |column: fn(&(usize, &str, &str, f64, f64)) -> f64| -> ArrayRef {
        Arc::new(
            rows.iter()
                .map(|row| Some(column(row)))
                .collect::<Float64Array>(),
        )
    };
    let annotations: Columns = vec![
        (
            "timestamp_ns",
            Arc::new(
                rows.iter()
                    .map(|row| Some(time_ns(row.0)))
                    .collect::<Int64Array>(),
            ),
        ),
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
        (
            "timestamp_ns",
            Arc::new(
                (0..steps)
                    .map(|step| Some(time_ns(step)))
                    .collect::<Int64Array>(),
            ),
        ),
        ("qw", numbers(1.0, steps)),
        ("qx", numbers(0.0, steps)),
        ("qy", numbers(0.0, steps)),
        ("qz", numbers(0.0, steps)),
        (
            "tx_m",
            Arc::new(
                (0..steps)
                    .map(|step| Some(CITY.0 + along(step)))
                    .collect::<Float64Array>(),
            ),
        ),
        ("ty_m", numbers(CITY.1, steps)),
        ("tz_m", numbers(7.0, steps)),
    ];
    Log {
        annotations,
        poses,
        map: crossing_map(),
    }
}

/// Puts another array in the place of a column.
pub(super) fn set(columns: &mut Columns, name: &str, array: impl arrow_array::Array + 'static) {
    columns
        .iter_mut()
        .find(|(column, _)| *column == name)
        .unwrap()
        .1 = Arc::new(array);
}

/// A column of numbers with one of them changed.
pub(super) fn with(columns: &Columns, name: &str, row: usize, value: Option<f64>) -> Float64Array {
    use arrow_array::cast::AsArray;
    let column = &columns
        .iter()
        .find(|(column, _)| *column == name)
        .unwrap()
        .1;
    let mut values: Vec<Option<f64>> = column
        .as_primitive::<arrow_array::types::Float64Type>()
        .iter()
        .collect();
    values[row] = value;
    Float64Array::from(values)
}

fn feather(path: &Path, columns: &Columns) {
    let batch = RecordBatch::try_from_iter(columns.clone()).unwrap();
    let options = IpcWriteOptions::default()
        .try_with_compression(Some(CompressionType::LZ4_FRAME))
        .unwrap();
    let file = File::create(path).unwrap();
    let mut writer = FileWriter::try_new_with_options(file, &batch.schema(), options).unwrap();
    writer.write(&batch).unwrap();
    writer.finish().unwrap();
}

impl Log {
    /// A folder that lasts as long as the guard.
    pub(super) fn written(&self) -> (tempfile::TempDir, PathBuf) {
        let guard = tempfile::tempdir().unwrap();
        let folder = guard.path().join("synthetic");
        std::fs::create_dir_all(folder.join("map")).unwrap();
        feather(&folder.join(ANNOTATIONS), &self.annotations);
        feather(&folder.join(POSES), &self.poses);
        std::fs::write(folder.join(MAP), self.map.to_string()).unwrap();
        (guard, folder)
    }

    pub(super) fn opened(&self) -> Result<Scenario, Argoverse2Error> {
        open(&self.written().1)
    }
}
