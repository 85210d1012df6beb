//! Exported folders read by geopandas, pyogrio and Python's sqlite3.

use super::compare::lanes;
use super::round_trip::generated;
use crate::argoverse2::all_logs as argoverse2_logs;
use crate::outside::{Missing, Needy};
use crate::womd::recordings;
use planagent_scenario::generator::{ScenarioType, types};
use planagent_scenario::nuplan::Extraction;
use planagent_scenario::nuplan::export::{ExportSettings, ExportedLog, write_scenarios};
use planagent_scenario::{Scenario, argoverse2};
use planagent_world::geometry::{Point, Polygon};
use planagent_world::{Lane, LaneKind};
use rayon::prelude::*;
use serde_json::{Map, Value, json};
use std::path::Path;
use std::process::Command;

/// The interpreter that reads what was written.
fn python() -> Result<String, Missing> {
    crate::outside::python(&["geopandas", "pyogrio", "shapely"])
}

fn placed(points: &[Point], origin: Point) -> Value {
    points
        .iter()
        .map(|p| json!([p.x + origin.x, p.y + origin.y]))
        .collect()
}

fn rings(areas: &[Polygon], origin: Point) -> Value {
    areas
        .iter()
        .map(|area| placed(area.ring(), origin))
        .collect()
}

/// The expected contents of the map package, in meters of the projection.
fn map_of(scenario: &Scenario, log: &ExportedLog, settings: &ExportSettings) -> Value {
    let (map, origin) = (&*scenario.map, settings.origin);
    let each = |kind: LaneKind, value: &dyn Fn(&Lane) -> Value| -> Map<String, Value> {
        let wanted = map.lanes().iter().filter(|lane| lane.kind == kind);
        wanted
            .map(|lane| (lane.source_id.to_string(), value(lane)))
            .collect()
    };
    let area = |lane: &Lane| placed(lane.polygon.ring(), origin);
    let path = |lane: &Lane| placed(lane.centerline.vertices(), origin);
    let ego = |frame: &planagent_scenario::Frame| frame.ego.center().position();
    let on_road: Vec<Point> = scenario.frames.iter().map(ego).collect();
    assert!(on_road.iter().all(|&point| map.is_drivable(point)));
    let far = on_road
        .iter()
        .map(|p| Point::new(p.x + 4000.0, p.y))
        .collect::<Vec<_>>();
    let lit: Vec<i64> = map
        .lanes()
        .iter()
        .filter(|lane| lane.has_traffic_lights)
        .map(|lane| lane.source_id)
        .collect();
    json!({
        "location": log.location,
        "epsg": settings.epsg,
        "lanes": each(LaneKind::Lane, &area),
        "connectors": each(LaneKind::Connector, &area),
        "lane_paths": each(LaneKind::Lane, &path),
        "connector_paths": each(LaneKind::Connector, &path),
        "outgoing": each(LaneKind::Lane, &|lane| json!(lanes(map, &lane.outgoing))),
        "incoming": each(LaneKind::Lane, &|lane| json!(lanes(map, &lane.incoming))),
        "left": each(LaneKind::Lane, &|lane| json!(lane.left.first().map(|beside| map[beside.lane].source_id))),
        "speed_limits": each(LaneKind::Lane, &|lane| json!(lane.speed_limit)),
        "lit": lit,
        "stop_lines": map.stop_lines().iter().map(|stop| placed(stop.polygon.ring(), origin)).collect::<Value>(),
        "intersections": rings(map.intersections(), origin),
        "crosswalks": rings(map.crosswalks(), origin),
        "road_segments": rings(map.road_segments(), origin),
        "generic_drivable": rings(map.generic_drivable(), origin),
        "carparks": rings(map.carparks(), origin),
        "on_road": placed(&on_road, origin),
        "off_road": placed(&far, origin),
    })
}

/// The expected contents of the log.
fn drive_of(scenario: &Scenario, log: &ExportedLog, settings: &ExportSettings) -> Value {
    let (map, origin) = (&*scenario.map, settings.origin);
    let extraction = Extraction::for_type(&scenario.scenario_type);
    let frames = scenario.frames[scenario.start..].iter().map(|frame| {
        let (ego, at) = (&frame.ego, frame.ego.rear_axle);
        let objects = frame.objects.iter().map(|object| {
            let (shape, v) = (object.shape, object.velocity);
            let c = shape.center;
            json!([
                object.kind.to_string(),
                c.x + origin.x,
                c.y + origin.y,
                c.heading,
                shape.length,
                shape.width,
                v.x,
                v.y
            ])
        });
        let lights = frame
            .lights
            .iter()
            .map(|(lane, status)| json!([map[lane].source_id, status.to_string()]));
        json!({
            "time_us": ego.time_us,
            "ego": [at.x + origin.x, at.y + origin.y, at.heading, ego.velocity.x, ego.velocity.y,
                    ego.acceleration.x, ego.acceleration.y],
            "objects": objects.collect::<Value>(),
            "lights": lights.collect::<Value>(),
        })
    });
    let goal = scenario.route.goal.unwrap();
    json!({
        "log": log.log,
        "token": log.token,
        "scenario_type": scenario.scenario_type,
        "offset_us": extraction.offset_us,
        "duration_us": extraction.duration_us,
        "frames": frames.collect::<Value>(),
        "past_us": scenario.past().iter().rev().map(|frame| frame.ego.time_us).collect::<Vec<_>>(),
        "route": scenario.route.roadblocks.iter().map(|&block| map[block].source_id).collect::<Vec<_>>(),
        "goal": [goal.x + origin.x, goal.y + origin.y, goal.heading],
    })
}

/// Runs the script with words; what it printed.
fn checked(python: &str, words: &[&Path]) -> String {
    let script = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/tests/nuplan/check_with_geopandas.py"
    );
    let output = Command::new(python)
        .arg(script)
        .args(words)
        .output()
        .unwrap();
    let (said, wrong) = (
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr),
    );
    assert!(
        output.status.success() && said.starts_with("ok: "),
        "{said}{wrong}"
    );
    said.into_owned()
}

#[test]
fn public_readers_see_what_was_written() -> Needy {
    let python = python()?;
    // Seed 3: the areas of its roundabout cross themselves unless they are mended.
    let scenarios: Vec<Scenario> = types::in_suites()
        .collect::<Vec<_>>()
        .into_par_iter()
        .map(|kind| generated(kind, 3))
        .collect();
    let settings = ExportSettings::default();
    let home = tempfile::tempdir().unwrap();
    let folder = home.path().join("out");
    let exported = write_scenarios(&scenarios, &folder, &settings).unwrap();
    let expected: Value = scenarios
        .iter()
        .zip(&exported.logs)
        .map(|(scenario, log)| json!({"map": map_of(scenario, log, &settings), "drive": drive_of(scenario, log, &settings)}))
        .collect();
    let expectations = home.path().join("expected.json");
    std::fs::write(&expectations, expected.to_string()).unwrap();
    let said = checked(&python, &[&folder, &expectations]);
    assert!(
        said.starts_with(&format!("ok: {} scenarios", scenarios.len())),
        "{said}"
    );
    Ok(())
}

#[test]
fn every_shape_of_more_seeds_is_valid() -> Needy {
    let python = python()?;
    let specs: Vec<(ScenarioType, u64)> = types::in_suites()
        .flat_map(|kind| [(kind, 1), (kind, 7)])
        .collect();
    let scenarios: Vec<Scenario> = specs
        .into_par_iter()
        .map(|(kind, seed)| generated(kind, seed))
        .collect();
    let home = tempfile::tempdir().unwrap();
    let folder = home.path().join("out");
    write_scenarios(&scenarios, &folder, &ExportSettings::default()).unwrap();
    checked(&python, &[&folder]);
    Ok(())
}

#[test]
fn every_shape_of_a_recording_is_valid() -> Needy {
    let python = python()?;
    let logs: Vec<Scenario> = argoverse2_logs()?
        .iter()
        .map(|log| argoverse2::open(log).unwrap())
        .collect();
    for scenarios in [recordings()?, &logs] {
        let home = tempfile::tempdir().unwrap();
        let folder = home.path().join("out");
        write_scenarios(scenarios, &folder, &ExportSettings::default()).unwrap();
        checked(&python, &[&folder]);
    }
    Ok(())
}
