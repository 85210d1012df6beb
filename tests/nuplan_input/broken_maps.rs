//! Every fault of a map is an error that names the place.

use super::fixture::{DataSet, LOCATION, run};
use geo::{LineString, MultiPolygon, Polygon};
use planagent_scenario::nuplan::geometry_blob::encode;
use planagent_scenario::nuplan::projection::{Utm, WGS84};
use planagent_scenario::nuplan::{MAPS_INDEX, MapStore};
use planagent_world::geometry::Point;
use rusqlite::Connection;

#[test]
fn the_maps_folder() {
    let set = DataSet::new();
    let index = set.folder.path().join("maps").join(MAPS_INDEX);
    let found = set.found().unwrap();
    let nowhere =
        planagent_scenario::nuplan::open(&MapStore::with_cache(None, None), &found).unwrap_err();
    assert!(
        nowhere.to_string().contains("NUPLAN_MAPS_ROOT"),
        "{nowhere}"
    );
    std::fs::write(
        &index,
        format!("{{\"{LOCATION}\": {{\"version\": \"9.9\"}}}}"),
    )
    .unwrap();
    set.assert_error_has(&["9.9/map.gpkg: missing", "version 1.0 there"]);
    std::fs::write(&index, format!("{{\"{LOCATION}\": {{}}}}")).unwrap();
    set.assert_error_has(&[MAPS_INDEX, "has no version"]);
    std::fs::write(&index, "{\"us-ma-boston\": {\"version\": \"9.12.1817\"}}").unwrap();
    set.assert_error_has(&["no map of 'test-town'; there are us-ma-boston"]);
    std::fs::write(&index, "[").unwrap();
    set.assert_error_has(&[MAPS_INDEX, "not a JSON object"]);
    std::fs::remove_file(&index).unwrap();
    set.assert_error_has(&[MAPS_INDEX, "cannot open"]);
}

#[test]
fn missing_layers_and_projections() {
    DataSet::map_with("DROP TABLE road_segments")
        .assert_error_has(&["no table road_segments; is it a nuPlan map?"]);
    DataSet::map_with("ALTER TABLE lane_connectors DROP COLUMN exit_lane_fid")
        .assert_error_has(&["table lane_connectors has no column exit_lane_fid"]);
    DataSet::map_with("DELETE FROM meta WHERE key = 'projectedCoordSystem'")
        .assert_error_has(&["layer meta: no row with key `projectedCoordSystem`"]);
    DataSet::map_with("UPDATE meta SET value = 'epsg:3857' WHERE key = 'projectedCoordSystem'")
        .assert_error_has(&["layer meta", "EPSG:3857 is not a UTM zone"]);
}

#[test]
fn geometries() {
    for (sql, parts) in [
        (
            "UPDATE lanes_polygons SET geom = NULL",
            ["table lanes_polygons, fid ", "column geom is NULL"],
        ),
        (
            "UPDATE intersections SET geom = 'POLYGON'; UPDATE lane_groups_polygons SET geom = 'POLYGON'",
            ["fid ", "column geom holds a text"],
        ),
        (
            "UPDATE baseline_paths SET geom = x'4750000100'",
            ["table baseline_paths, fid ", "its header is damaged"],
        ),
        (
            "UPDATE baseline_paths SET geom = substr(geom, 1, length(geom) - 9)",
            ["table baseline_paths, fid ", "damaged"],
        ),
        (
            "UPDATE lanes_polygons SET geom = CAST(x'00' || substr(geom, 2) AS BLOB)",
            ["table lanes_polygons, fid ", "it begins with"],
        ),
        (
            "UPDATE baseline_paths SET geom = CAST(substr(geom, 1, 4) || x'110F0000' || substr(geom, 9) AS BLOB)",
            [
                "table baseline_paths, fid ",
                "reference system 3857, expected 4326",
            ],
        ),
        (
            "UPDATE baseline_paths SET geom = CAST(substr(geom, 1, length(geom) - 8) || x'000000000000F87F' AS BLOB)",
            ["table baseline_paths, fid ", "is not finite"],
        ),
        (
            "UPDATE baseline_paths SET geom = (SELECT geom FROM lanes_polygons)",
            ["table baseline_paths, fid ", "expected a line"],
        ),
    ] {
        DataSet::map_with(sql).assert_error_has(&parts);
    }
}

#[test]
fn relations() {
    for (sql, parts) in [
        (
            "UPDATE lanes_polygons SET lane_group_fid = 987654321",
            [
                "table lanes_polygons",
                "names lane group 987654321, which table lane_groups_polygons",
            ],
        ),
        (
            "DELETE FROM baseline_paths WHERE lane_fid IS NOT NULL",
            [
                "table lanes_polygons",
                "names its baseline path, which table baseline_paths",
            ],
        ),
        (
            "DELETE FROM gen_lane_connectors_scaled_width_polygons",
            ["table lane_connectors", "its area"],
        ),
        (
            "UPDATE lane_connectors SET traffic_light_stop_line_fids = '987654321'",
            ["table lane_connectors", "stop polygon 987654321"],
        ),
        (
            "UPDATE lane_connectors SET traffic_light_stop_line_fids = '1;2'",
            ["table lane_connectors", "ids separated by commas"],
        ),
        (
            "UPDATE lanes_polygons SET lane_fid = 1",
            ["table lanes_polygons, fid 1", "holds 1 for the second time"],
        ),
        (
            "UPDATE lanes_polygons SET speed_limit_mps = -3",
            ["column speed_limit_mps holds -3", "m/s from 0 on"],
        ),
    ] {
        DataSet::map_with(sql).assert_error_has(&parts);
    }
}

#[test]
fn speed_limits_may_be_missing() {
    let set = DataSet::map_with("UPDATE lanes_polygons SET speed_limit_mps = NULL");
    assert!(
        set.open()
            .unwrap()
            .map
            .lanes()
            .iter()
            .all(|lane| lane.speed_limit.is_none())
    );
}

#[test]
fn ends_of_connectors_outside_the_map_are_noted() {
    let set = DataSet::map_with("UPDATE lane_connectors SET entry_lane_fid = 987654321");
    let maps = set.maps();
    let map = maps.map(LOCATION).unwrap();
    assert!(
        map.lanes
            .lanes()
            .iter()
            .filter(|lane| lane.is_connector())
            .all(|lane| lane.outgoing.is_empty())
    );
    assert!(
        maps.take_notes()[0]
            .contains("ends of lane connectors name lanes that the map does not have")
    );
}

#[test]
fn areas_of_several_parts_with_holes() {
    let set = DataSet::new();
    let origin = set.maps().map(LOCATION).unwrap().origin;
    let utm = Utm::from_epsg(32_611).unwrap();
    // Far from the scene, where nothing else is drivable.
    let degrees = |x: f64, y: f64| {
        let (lon, lat) = utm
            .to_geographic(origin.x + x - 3000.0, origin.y + y)
            .unwrap();
        geo::Coord { x: lon, y: lat }
    };
    let square = |x: f64, side: f64| {
        [(x, 0.0), (x + side, 0.0), (x + side, side), (x, side)].map(|(x, y)| degrees(x, y))
    };
    let mut island = square(0.0, 30.0);
    island
        .iter_mut()
        .zip([(10.0, 10.0), (20.0, 10.0), (20.0, 20.0), (10.0, 20.0)])
        .for_each(|(c, (x, y))| *c = degrees(x, y));
    let ring = Polygon::new(
        LineString(square(0.0, 30.0).to_vec()),
        vec![LineString(island.to_vec())],
    );
    let apart = Polygon::new(LineString(square(100.0, 30.0).to_vec()), vec![]);
    let blob = encode(&MultiPolygon(vec![ring, apart]).into(), WGS84)
        .unwrap()
        .0;
    run(&set.map, "DELETE FROM carpark_areas");
    Connection::open(&set.map)
        .unwrap()
        .execute(
            "INSERT INTO carpark_areas (fid, geom) VALUES (987, ?1)",
            [blob],
        )
        .unwrap();
    let map = set.open().unwrap().map;
    assert_eq!(map.carparks().len(), 2);
    let drivable = |x: f64, y: f64| map.is_drivable(Point::new(x - 3000.0, y));
    assert!(drivable(5.0, 5.0) && drivable(115.0, 15.0));
    assert!(!drivable(15.0, 15.0), "the hole");
    assert!(!drivable(60.0, 15.0), "between the parts");
    let distance = map
        .distance_to_drivable(Point::new(15.0 - 3000.0, 15.0), 10.0)
        .unwrap();
    assert!((distance - 5.0).abs() < 1e-3, "{distance}");
}
