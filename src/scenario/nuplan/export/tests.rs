//! Maps that nuPlan's formats cannot express, and folders that must not be written.

use super::graph::{ConnectorRow, Graph, LaneRow, OPEN_END};
use super::route::{extend_short, route_ids};
use super::stops::stop_rows;
use super::*;
use crate::generator::{ScenarioType, Spec, generate, types};
use planagent_world::geometry::{OrientedBox, Polyline, Pose};
use planagent_world::{Lane, LaneId, LaneKind, MapParts, Neighbor, Roadblock, RoadblockId};
use rusqlite::Connection;

/// A map of straight lanes along the x axis, each in its own roadblock: kind, start, end, and
/// successors.
fn road(pieces: &[(LaneKind, f64, f64, &[u32])]) -> LaneMap {
    let ids = |list: &[u32]| list.iter().map(|&id| LaneId(id)).collect::<Vec<_>>();
    let before = |id: usize| -> Vec<u32> {
        (0..pieces.len() as u32)
            .filter(|&other| pieces[other as usize].3.contains(&(id as u32)))
            .collect()
    };
    let area = |from: f64, to: f64| {
        OrientedBox::new(Pose::new(f64::midpoint(from, to), 0.0, 0.0), to - from, 3.0).to_polygon()
    };
    let lanes = pieces
        .iter()
        .enumerate()
        .map(|(id, &(kind, from, to, onward))| Lane {
            id: LaneId(id as u32),
            source_id: id as i64 + 10,
            kind,
            centerline: Polyline::new([Point::new(from, 0.0), Point::new(to, 0.0)]).unwrap(),
            polygon: area(from, to),
            incoming: ids(&before(id)),
            outgoing: ids(onward),
            left: vec![],
            right: vec![],
            roadblock: RoadblockId(id as u32),
            speed_limit: Some(10.0),
            has_traffic_lights: false,
            stop_lines: vec![],
        });
    let blocks = pieces
        .iter()
        .enumerate()
        .map(|(id, &(kind, from, to, onward))| Roadblock {
            id: RoadblockId(id as u32),
            source_id: id as i64 + 100,
            kind,
            lanes: vec![LaneId(id as u32)],
            areas: vec![area(from, to)],
            incoming: before(id).into_iter().map(RoadblockId).collect(),
            outgoing: onward.iter().map(|&id| RoadblockId(id)).collect(),
        });
    let parts = MapParts {
        name: "road".to_owned(),
        lanes: lanes.collect(),
        roadblocks: blocks.collect(),
        ..MapParts::default()
    };
    LaneMap::new(parts.with_roadblocks_as_road()).unwrap()
}

use LaneKind::{Connector as C, Lane as L};

fn lane(graph: &Graph, fid: i64) -> &LaneRow {
    graph.lanes.iter().find(|row| row.fid == fid).unwrap()
}

/// Each connector with the lanes that it joins.
fn joints(graph: &Graph) -> Vec<(i64, i64, i64)> {
    graph
        .connectors
        .iter()
        .map(
            |&ConnectorRow {
                 fid,
                 exit_lane,
                 entry_lane,
                 ..
             }| (fid, exit_lane, entry_lane),
        )
        .collect()
}

#[test]
fn successive_lanes_get_a_connector() {
    let map = road(&[
        (L, 0.0, 50.0, &[1]),
        (L, 50.0, 90.0, &[2]),
        (L, 95.0, 99.0, &[]),
    ]);
    let graph = Graph::from_map(&map).unwrap();
    assert_eq!(joints(&graph), [(13, 10, 11), (14, 11, 12)]);
    assert_eq!(
        graph.changes,
        ExportChanges {
            inserted_connectors: 2,
            ..ExportChanges::default()
        }
    );
    assert!((lane(&graph, 10).centerline.length() - (50.0 - STITCH)).abs() < 1e-9);
    assert_eq!(
        lane(&graph, 11).centerline,
        map.lanes()[1].centerline,
        "a gap needs no cut"
    );
    assert_eq!(lane(&graph, 10).polygon, map.lanes()[0].polygon);
    let ends = |i: usize| {
        (
            graph.connectors[i].centerline.start().x,
            graph.connectors[i].centerline.end().x,
        )
    };
    assert_eq!((ends(0), ends(1)), ((50.0 - STITCH, 50.0), (90.0, 95.0)));
    let between: Vec<(i64, i64)> = graph
        .group_connectors
        .iter()
        .map(|row| (row.from, row.to))
        .collect();
    assert_eq!(between, [(100, 101), (101, 102)]);
    let route = [0, 1, 2].map(RoadblockId);
    assert_eq!(route_ids(&map, &graph, &route), [100, 103, 101, 104, 102]);
}

#[test]
fn connectors_lead_from_a_lane_to_a_lane() {
    let map = road(&[
        (C, 0.0, 10.0, &[1]),
        (C, 10.0, 20.0, &[2, 3]),
        (L, 20.0, 60.0, &[]),
        (L, 20.0, 70.0, &[4]),
        (C, 70.0, 80.0, &[]),
    ]);
    let graph = Graph::from_map(&map).unwrap();
    let inserted = ExportChanges {
        inserted_lanes: 1,
        open_ends_closed: 2,
        connectors_repeated: 1,
        ..ExportChanges::default()
    };
    assert_eq!(graph.changes, inserted);
    // 15 is the open start, 16 lies between 10 and 11, 17 repeats 11, 18 is the open end.
    assert_eq!(
        joints(&graph),
        [(10, 15, 16), (11, 16, 12), (14, 13, 18), (17, 16, 13)]
    );
    let spans = [15, 16, 18].map(|fid| {
        (
            lane(&graph, fid).centerline.start().x,
            lane(&graph, fid).centerline.end().x,
        )
    });
    assert_eq!(
        spans,
        [
            (-OPEN_END, 0.0),
            (10.0 - STITCH, 10.0),
            (80.0, 80.0 + OPEN_END)
        ]
    );
    assert_eq!(graph.connectors_by_lane()[&LaneId(1)], [11, 17]);
    let route = [0, 1, 3, 4].map(RoadblockId);
    let ids = route_ids(&map, &graph, &route);
    let group = |fid: i64| {
        graph
            .connectors
            .iter()
            .find(|row| row.fid == fid)
            .unwrap()
            .group
    };
    assert_eq!(ids, [100, lane(&graph, 16).group, group(17), 103, 104]);
}

#[test]
fn a_route_of_one_roadblock_is_extended() {
    let map = road(&[
        (L, 0.0, 50.0, &[1]),
        (C, 50.0, 70.0, &[2]),
        (L, 70.0, 90.0, &[]),
        (C, 90.0, 99.0, &[]),
    ]);
    let graph = Graph::from_map(&map).unwrap();
    let extended = |blocks: &[u32]| {
        let mut route = route_ids(
            &map,
            &graph,
            &blocks.iter().copied().map(RoadblockId).collect::<Vec<_>>(),
        );
        let appended = extend_short(&mut route, &graph);
        (route, appended)
    };
    assert_eq!(extended(&[0]), (vec![100, 101, 102], 2));
    assert_eq!(extended(&[1]), (vec![101, 102], 1));
    assert_eq!(extended(&[2]), (vec![102], 0), "it leads nowhere");
    assert_eq!(extended(&[0, 1]), (vec![100, 101], 0));
}

#[test]
fn of_several_connectors_the_straightest_extends_a_route() {
    let scenario = scenario(types::starting_left_turn::TYPE, 3);
    let map = &scenario.map;
    let graph = Graph::from_map(map).unwrap();
    let turn = |id: LaneId| {
        let line = &map[id].centerline;
        planagent_world::geometry::wrap_angle(line.heading_at(line.length()) - line.heading_at(0.0))
            .abs()
    };
    let choices = |block: &&Roadblock| block.kind == LaneKind::Lane && block.outgoing.len() > 1;
    let block = map.roadblocks().iter().find(choices).unwrap();
    let mut route = route_ids(map, &graph, &[block.id]);
    assert_eq!(extend_short(&mut route, &graph), 2);
    let straightest = block
        .outgoing
        .iter()
        .flat_map(|&next| &map[next].lanes)
        .map(|&lane| turn(lane));
    let taken = map
        .roadblocks()
        .iter()
        .find(|other| other.source_id == route[1])
        .unwrap();
    let least = taken
        .lanes
        .iter()
        .map(|&lane| turn(lane))
        .fold(f64::INFINITY, f64::min);
    assert!(
        least <= straightest.fold(f64::INFINITY, f64::min),
        "{route:?}"
    );
}

#[test]
fn a_light_without_a_stop_line_gets_one() {
    let mut map = road(&[
        (L, 0.0, 50.0, &[1]),
        (C, 50.0, 70.0, &[2]),
        (L, 70.0, 90.0, &[]),
    ]);
    let mut lanes = map.lanes().to_vec();
    lanes[1].has_traffic_lights = true;
    map = LaneMap::new(MapParts {
        lanes,
        roadblocks: map.roadblocks().to_vec(),
        ..MapParts::default()
    })
    .unwrap();
    let graph = Graph::from_map(&map).unwrap();
    assert_eq!(graph.changes, ExportChanges::default());
    let stops = stop_rows(&map, &graph);
    assert_eq!(
        stops
            .iter()
            .map(|stop| (stop.fid, stop.inserted, stop.governs.clone()))
            .collect::<Vec<_>>(),
        [(1, true, vec![11])]
    );
    assert!(
        stops[0].polygon.meets_line(&lanes_line(&map, 1))
            && !stops[0].polygon.meets_line(&lanes_line(&map, 2))
    );
}

fn lanes_line(map: &LaneMap, lane: usize) -> Polyline {
    map.lanes()[lane].centerline.clone()
}

#[test]
fn lane_indices_express_neighbors() {
    let map = road(&[(L, 0.0, 50.0, &[] as &[u32]); 4]);
    let mut lanes = map.lanes().to_vec();
    let beside = |lane: u32, to_s: f64| Neighbor {
        lane: LaneId(lane),
        from_s: 0.0,
        to_s,
    };
    // 2 is left of 0 along its length, 1 right of 0 along a part, 3 has no neighbor.
    lanes[2].right.push(beside(0, 50.0));
    lanes[0].left.push(beside(2, 50.0));
    lanes[0].right.push(beside(1, 20.0));
    lanes[1].left.push(beside(0, 20.0));
    let block = Roadblock {
        lanes: [0, 1, 2, 3].map(LaneId).to_vec(),
        ..map.roadblocks()[0].clone()
    };
    for lane in &mut lanes {
        lane.roadblock = RoadblockId(0);
    }
    let map = LaneMap::new(MapParts {
        lanes,
        roadblocks: vec![block],
        ..MapParts::default()
    })
    .unwrap();
    let indices = lane_order::lane_indices(&map, &map.roadblocks()[0]);
    assert_eq!(
        indices
            .into_iter()
            .map(|(lane, index)| (lane.0, index))
            .collect::<Vec<_>>(),
        [(0, 1), (1, 2), (2, 0), (3, 4)]
    );
    let indices = lane_order::lane_indices(&map, &map.roadblocks()[0]);
    assert_eq!(
        lane_order::changed_neighbors(&map, &indices),
        2,
        "those along a part"
    );
}

fn scenario(kind: ScenarioType, seed: u64) -> Scenario {
    generate(&Spec::new(kind, seed)).unwrap()
}

#[test]
fn a_folder_is_written_whole_or_not_at_all() {
    let home = tempfile::tempdir().unwrap();
    let (folder, settings) = (home.path().join("out"), ExportSettings::default());
    let one = scenario(types::following_lane_with_lead::TYPE, 1);
    let left = || std::fs::read_dir(home.path()).unwrap().count();
    let refused = |scenarios: &[Scenario], settings: &ExportSettings| {
        let error = write_scenarios(scenarios, &folder, settings).unwrap_err();
        assert_eq!(left(), 0, "{error}");
        error
    };
    assert!(matches!(refused(&[], &settings), ExportError::Nothing));
    assert!(matches!(
        refused(&[one.clone(), one.clone()], &settings),
        ExportError::SameLog(_)
    ));
    let outside = ExportSettings {
        location: Some("../maps".to_owned()),
        ..settings.clone()
    };
    assert!(matches!(
        refused(std::slice::from_ref(&one), &outside),
        ExportError::Location(_)
    ));
    let nowhere = ExportSettings {
        epsg: 4326,
        ..settings.clone()
    };
    assert!(matches!(
        refused(std::slice::from_ref(&one), &nowhere),
        ExportError::Zone(ProjectionError::NotUtm(4326))
    ));
    let off_earth = ExportSettings {
        origin: Point::new(f64::NAN, 0.0),
        ..settings.clone()
    };
    assert!(matches!(
        refused(std::slice::from_ref(&one), &off_earth),
        ExportError::Scenario {
            fault: ScenarioExportFault::Shape(_),
            ..
        }
    ));
    let named = ExportSettings {
        location: Some("here".to_owned()),
        ..settings.clone()
    };
    let other = scenario(types::following_lane_with_lead::TYPE, 2);
    assert!(matches!(
        refused(&[one.clone(), other], &named),
        ExportError::MapsDiffer { .. }
    ));
    let mut short = one.clone();
    short.frames.truncate(one.start + 10);
    assert!(matches!(
        refused(&[short], &settings),
        ExportError::Scenario {
            fault: ScenarioExportFault::Timeline(TimelineError::Window { .. }),
            ..
        }
    ));
    write_scenario(&one, &folder, &named).unwrap();
    let again = write_scenario(&one, &folder, &named).unwrap_err();
    assert!(matches!(again, ExportError::Exists(path) if path == folder));
    assert_eq!(left(), 1);
}

#[test]
fn the_same_scenarios_give_the_same_bytes_and_equal_maps_are_one() {
    let home = tempfile::tempdir().unwrap();
    let one = scenario(types::starting_right_turn::TYPE, 1);
    let renamed = Scenario {
        id: "another".to_owned(),
        ..one.clone()
    };
    let settings = ExportSettings::default();
    let write = |name: &str| {
        write_scenarios(
            &[one.clone(), renamed.clone()],
            &home.path().join(name),
            &settings,
        )
        .unwrap()
    };
    let (first, second) = (write("first"), write("second"));
    assert_eq!(first.logs, second.logs);
    assert_eq!(first.logs[0].location, first.logs[1].location);
    assert_ne!(first.logs[0].token, first.logs[1].token);
    for log in &first.logs {
        let bytes = |exported: &Exported| {
            std::fs::read(exported.data.join(format!("{}.db", log.log))).unwrap()
        };
        assert!(bytes(&first) == bytes(&second), "{}", log.log);
    }
    let map = |exported: &Exported| {
        std::fs::read(
            exported
                .maps
                .join(&exported.logs[0].location)
                .join(MAP_VERSION)
                .join("map.gpkg"),
        )
        .unwrap()
    };
    assert!(map(&first) == map(&second));
    assert_eq!(
        std::fs::read_dir(&first.maps).unwrap().count(),
        2,
        "the list and one map"
    );
}

#[test]
fn every_table_is_there_and_types_without_a_window_are_tagged_at_their_start() {
    let home = tempfile::tempdir().unwrap();
    let scenarios = [scenario(types::traversing_roundabout::TYPE, 1), {
        let one = scenario(types::following_lane_with_lead::TYPE, 1);
        Scenario {
            scenario_type: "unknown".to_owned(),
            ..one
        }
    }];
    let exported = write_scenarios(
        &scenarios,
        &home.path().join("out"),
        &ExportSettings::default(),
    )
    .unwrap();
    let database = |place: usize| {
        Connection::open(
            exported
                .data
                .join(format!("{}.db", exported.logs[place].log)),
        )
        .unwrap()
    };
    let tables = [
        "log",
        "ego_pose",
        "lidar",
        "lidar_pc",
        "lidar_box",
        "track",
        "category",
        "scene",
        "scenario_tag",
        "traffic_light_status",
        "image",
        "camera",
    ];
    let count = |place: usize, table: &str| -> i64 {
        database(place)
            .query_row(&format!("SELECT COUNT(*) FROM {table}"), [], |row| {
                row.get(0)
            })
            .unwrap()
    };
    for table in tables {
        assert!(
            count(0, table)
                >= i64::from(!["image", "camera", "traffic_light_status"].contains(&table)),
            "{table}"
        );
    }
    assert_eq!(
        (
            count(0, "category"),
            count(0, "scene"),
            count(0, "scenario_tag"),
            count(1, "scenario_tag")
        ),
        (7, 5, 1, 1)
    );
    let rows = scenarios[0].frames.len() as i64 * 2 - 1;
    assert_eq!(
        (count(0, "lidar_pc"), count(0, "ego_pose")),
        (rows, rows + 1),
        "the goal is a pose more"
    );
    let null: i64 = database(0)
        .query_row(
            "SELECT COUNT(*) FROM lidar_pc WHERE prev_token IS NULL OR next_token IS NULL",
            [],
            |row| row.get(0),
        )
        .unwrap();
    assert_eq!(null, 0, "the devkit calls `.hex()` on both");
    for (place, scenario) in scenarios.iter().enumerate() {
        let time: i64 = database(place)
            .query_row(
                "SELECT timestamp FROM lidar_pc WHERE lower(hex(token)) = ?",
                [&exported.logs[place].token],
                |row| row.get(0),
            )
            .unwrap();
        assert_eq!(time, scenario.frame(0).unwrap().ego.time_us);
    }
}

#[test]
fn the_log_goes_on_for_nine_seconds_with_ego_objects_and_lights() {
    let home = tempfile::tempdir().unwrap();
    let one = scenario(
        types::starting_straight_traffic_light_intersection_traversal::TYPE,
        1,
    );
    let exported =
        write_scenario(&one, &home.path().join("out"), &ExportSettings::default()).unwrap();
    let database =
        Connection::open(exported.data.join(format!("{}.db", exported.logs[0].log))).unwrap();
    let last = one.frames.last().unwrap();
    let after = |what: &str| -> i64 {
        let query =
            format!("SELECT COUNT(*) FROM lidar_pc AS lp JOIN {what} WHERE lp.timestamp > ?");
        database
            .query_row(&query, [last.ego.time_us], |row| row.get(0))
            .unwrap()
    };
    assert_eq!(after("ego_pose AS ep ON lp.ego_pose_token = ep.token"), 180);
    assert_eq!(
        after("lidar_box AS lb ON lb.lidar_pc_token = lp.token"),
        180 * last.objects.len() as i64
    );
    let lights = after("traffic_light_status AS tl ON tl.lidar_pc_token = lp.token");
    assert!(lights > 0 && lights % 180 == 0, "{lights}");
    let end: i64 = database
        .query_row("SELECT MAX(timestamp) FROM lidar_pc", [], |row| row.get(0))
        .unwrap();
    assert_eq!(end, last.ego.time_us + 9_000_000);
}

#[test]
fn no_connector_is_without_an_intersection_number() {
    let home = tempfile::tempdir().unwrap();
    let one = scenario(types::traversing_roundabout::TYPE, 3);
    let settings = ExportSettings::default();
    let exported = write_scenario(&one, &home.path().join("out"), &settings).unwrap();
    let path = exported
        .maps
        .join(&exported.logs[0].location)
        .join(MAP_VERSION)
        .join("map.gpkg");
    let map = Connection::open(path).unwrap();
    for layer in ["lane_group_connectors", "lane_connectors"] {
        let count = |condition: &str| -> i64 {
            let query = format!("SELECT COUNT(*) FROM {layer} WHERE {condition}");
            map.query_row(&query, [], |row| row.get(0)).unwrap()
        };
        assert_eq!(count("intersection_fid IS NULL"), 0, "{layer}");
        assert!(count("intersection_fid > 0") > 0, "{layer}");
        assert_eq!(
            count(
                "intersection_fid > 0 AND intersection_fid NOT IN (SELECT fid FROM intersections)"
            ),
            0
        );
    }
}

#[test]
fn stand_in_maps_complete_the_four_locations() {
    let home = tempfile::tempdir().unwrap();
    let one = scenario(types::changing_lane::TYPE, 1);
    let location = Some("us-ma-boston".to_owned());
    let settings = ExportSettings {
        stand_in_maps: true,
        location,
        ..ExportSettings::default()
    };
    let exported = write_scenario(&one, &home.path().join("out"), &settings).unwrap();
    let list: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(exported.maps.join(MAPS_INDEX)).unwrap())
            .unwrap();
    assert_eq!(
        list.as_object().unwrap().keys().collect::<Vec<_>>(),
        OFFICIAL_LOCATIONS
    );
    for location in OFFICIAL_LOCATIONS {
        assert_eq!(list[location]["version"], MAP_VERSION);
        let map = Connection::open(
            exported
                .maps
                .join(location)
                .join(MAP_VERSION)
                .join("map.gpkg"),
        )
        .unwrap();
        let count = |from: &str| -> i64 {
            map.query_row(&format!("SELECT COUNT(*) FROM {from}"), [], |row| {
                row.get(0)
            })
            .unwrap()
        };
        assert_eq!(
            count("lane_connectors") > 0,
            location == "us-ma-boston",
            "{location}"
        );
        assert_eq!(
            count("meta WHERE key = 'standIn'") > 0,
            location != "us-ma-boston",
            "{location}"
        );
        assert_eq!(count("meta WHERE key = 'projectedCoordSystem'"), 1);
        assert_eq!(
            count("gpkg_contents WHERE data_type = 'features'"),
            16,
            "{location}"
        );
    }
    let without = write_scenario(
        &one,
        &home.path().join("without"),
        &ExportSettings::default(),
    )
    .unwrap();
    assert_eq!(std::fs::read_dir(&without.maps).unwrap().count(), 2);
}

#[test]
fn a_mapped_type_lets_the_log_of_an_unmapped_one_go_on() {
    let home = tempfile::tempdir().unwrap();
    let one = scenario(types::traversing_roundabout::TYPE, 1);
    let kind = "traversing_intersection";
    let settings = ExportSettings {
        scenario_type: Some(kind.to_owned()),
        ..ExportSettings::default()
    };
    let exported = write_scenario(&one, &home.path().join("out"), &settings).unwrap();
    assert_eq!(exported.logs[0].changes.dropped_future_states, 0);
    let database =
        Connection::open(exported.data.join(format!("{}.db", exported.logs[0].log))).unwrap();
    let tag: String = database
        .query_row("SELECT type FROM scenario_tag", [], |row| row.get(0))
        .unwrap();
    assert_eq!(tag, kind);
    let rows: i64 = database
        .query_row("SELECT COUNT(*) FROM lidar_pc", [], |row| row.get(0))
        .unwrap();
    assert_eq!(rows, one.frames.len() as i64 * 2 - 1 + 180);
}
