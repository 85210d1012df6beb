//! A synthetic scenario of the motion-forecasting dataset.

use super::test_log::{CITY, Columns, crossing_map, set, with};
use super::*;
use arrow_array::{ArrayRef, Float64Array, Int64Array, RecordBatch, StringArray};
use parquet::arrow::ArrowWriter;
use parquet::basic::{BrotliLevel, Compression, GzipLevel, ZstdLevel};
use parquet::file::properties::WriterProperties;
use std::sync::Arc;

/// Tracks of a motion-forecasting scenario: the recording car on lane 2 and a bus beside it.
fn forecasting(steps: usize) -> Columns {
    let count = 2 * steps;
    let of = |value: &dyn Fn(usize, bool) -> f64| -> ArrayRef {
        Arc::new(
            (0..count)
                .map(|row| Some(value(row / 2, row % 2 == 0)))
                .collect::<Float64Array>(),
        )
    };
    let words = |ego: &str, bus: &str| -> ArrayRef {
        Arc::new(
            (0..count)
                .map(|row| Some(if row % 2 == 0 { ego } else { bus }))
                .collect::<StringArray>(),
        )
    };
    vec![
        ("track_id", words("AV", "7")),
        ("object_type", words("vehicle", "bus")),
        (
            "timestep",
            Arc::new(
                (0..count)
                    .map(|row| Some((row / 2) as i64))
                    .collect::<Int64Array>(),
            ),
        ),
        (
            "position_x",
            of(&|step, ego| CITY.0 + 5.0 + 0.8 * step as f64 + if ego { 0.0 } else { 10.0 }),
        ),
        (
            "position_y",
            of(&|_, ego| CITY.1 + if ego { 0.0 } else { 3.5 }),
        ),
        ("heading", of(&|_, _| 0.0)),
        ("velocity_x", of(&|_, _| 8.0)),
        ("velocity_y", of(&|_, _| 0.0)),
        ("city", words("pittsburgh", "pittsburgh")),
    ]
}

fn forecasting_opened(columns: Columns) -> Result<Scenario, Argoverse2Error> {
    let mut bytes = Vec::new();
    let batch = RecordBatch::try_from_iter(columns).unwrap();
    let mut writer = ArrowWriter::try_new(&mut bytes, batch.schema(), None).unwrap();
    writer.write(&batch).unwrap();
    writer.close().unwrap();
    opened_of(&bytes)
}

/// Opens a scenario whose tracks are a file with these bytes.
fn opened_of(bytes: &[u8]) -> Result<Scenario, Argoverse2Error> {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("scenario_synthetic.parquet"), bytes).unwrap();
    std::fs::write(
        folder.path().join("log_map_archive_synthetic.json"),
        crossing_map().to_string(),
    )
    .unwrap();
    open(folder.path())
}

#[test]
fn a_forecasting_scenario_opens() {
    let scenario = forecasting_opened(forecasting(110)).unwrap();
    assert_eq!((scenario.start, scenario.iterations()), (10, 100));
    assert_eq!(
        scenario.map.name(),
        "argoverse 2 pittsburgh, origin (1005, -500)"
    );
    let frame = &scenario.frames[10];
    assert!((frame.ego.rear_axle.x - 8.0).abs() < 1e-9 && (frame.ego.speed() - 8.0).abs() < 1e-6);
    let [bus] = &frame.objects[..] else {
        panic!("{:?}", frame.objects)
    };
    assert!((bus.shape.center.x - 18.0).abs() < 1e-9 && (bus.shape.length - 12.0).abs() < 1e-9);
    let route: Vec<i64> = scenario
        .route
        .roadblocks
        .iter()
        .map(|&b| scenario.map[b].source_id)
        .collect();
    assert_eq!(route, vec![1, 11, 21]);
}

#[test]
fn every_compression_of_parquet_is_read() {
    let batch = RecordBatch::try_from_iter(forecasting(110)).unwrap();
    for compression in [
        Compression::UNCOMPRESSED,
        Compression::SNAPPY,
        Compression::GZIP(GzipLevel::default()),
        Compression::BROTLI(BrotliLevel::default()),
        Compression::LZ4,
        Compression::LZ4_RAW,
        Compression::ZSTD(ZstdLevel::default()),
    ] {
        let properties = WriterProperties::builder()
            .set_compression(compression)
            .build();
        let mut bytes = Vec::new();
        let mut writer =
            ArrowWriter::try_new(&mut bytes, batch.schema(), Some(properties)).unwrap();
        writer.write(&batch).unwrap();
        writer.close().unwrap();
        let scenario = opened_of(&bytes).unwrap();
        assert_eq!(scenario.iterations(), 100, "{compression:?}");
        assert!((scenario.frames[10].ego.speed() - 8.0).abs() < 1e-6);
    }
}

#[test]
fn a_file_of_another_kind_is_never_called_feather() {
    for (bytes, said) in [
        (
            &b"<html>Forbidden</html>"[..],
            "no Parquet file: it is a web page",
        ),
        (
            b"ARROW1\0\0 and so on",
            "no Parquet file: it is a Feather file",
        ),
        (b"PAR1 cut off", "not a valid Parquet file"),
        (b"\x01\x02\x03", "not a valid Parquet file"),
        (b"", "not a valid Parquet file"),
    ] {
        let error = opened_of(bytes).unwrap_err().to_string();
        assert!(error.contains(said), "{error}");
        assert!(!error.contains("valid Feather"), "{error}");
    }
}

#[test]
fn broken_forecasting_scenarios_are_reported() {
    let fault = |change: &dyn Fn(&mut Columns)| {
        let mut columns = forecasting(30);
        change(&mut columns);
        forecasting_opened(columns).unwrap_err().to_string()
    };
    let no_ego = fault(&|columns| set(columns, "track_id", StringArray::from(vec!["7"; 60])));
    assert!(
        no_ego.contains("track 'AV' is missing at step 0"),
        "{no_ego}"
    );
    let twice = fault(&|columns| set(columns, "timestep", Int64Array::from(vec![0; 60])));
    assert!(twice.contains("row 2: a second row of track AV"), "{twice}");
    let fast = fault(&|columns| {
        set(
            columns,
            "velocity_y",
            with(columns, "velocity_y", 5, Some(1e6)),
        );
    });
    assert!(fast.contains("column 'velocity_y', row 5"), "{fast}");
    let endless = fault(&|columns| set(columns, "timestep", Int64Array::from(vec![i64::MAX; 60])));
    assert!(endless.contains("column 'timestep', row 0"), "{endless}");
}

#[test]
fn a_small_file_of_many_equal_rows_is_refused_before_it_fills_the_memory() {
    let batch = RecordBatch::try_from_iter(forecasting(110)).unwrap();
    let long = StringArray::from(vec!["z".repeat(100_000); 4_000]);
    let long = RecordBatch::try_from_iter([("city", Arc::new(long) as ArrayRef)]).unwrap();
    for (batch, times) in [(batch, 20_000), (long, 1)] {
        let properties = WriterProperties::builder()
            .set_compression(Compression::ZSTD(ZstdLevel::default()))
            .build();
        let mut bytes = Vec::new();
        let mut writer =
            ArrowWriter::try_new(&mut bytes, batch.schema(), Some(properties)).unwrap();
        for _ in 0..times {
            writer.write(&batch).unwrap();
        }
        writer.close().unwrap();
        let error = opened_of(&bytes).unwrap_err().to_string();
        assert!(error.contains("no log is so long"), "{error}");
    }
}
