//! The maps: relations, joints, areas.

use super::{CORPUS, one_each};
use planagent_world::geometry::{Point, wrap_angle};
use planagent_world::{LaneKind, LaneMap};

#[test]
fn relations_are_symmetric_and_kinds_alternate() {
    for generated in CORPUS.iter() {
        let map = &generated.scenario.map;
        for lane in map.lanes() {
            for &next in &lane.outgoing {
                assert!(map[next].incoming.contains(&lane.id));
                assert_ne!(map[next].kind, lane.kind, "lanes and connectors take turns");
                assert!(map[lane.roadblock].outgoing.contains(&map[next].roadblock));
            }
            for &before in &lane.incoming {
                assert!(map[before].outgoing.contains(&lane.id));
            }
            for beside in &lane.left {
                assert!(
                    map[beside.lane]
                        .right
                        .iter()
                        .any(|back| back.lane == lane.id)
                );
                assert_eq!(map[beside.lane].roadblock, lane.roadblock);
            }
            for beside in &lane.right {
                assert!(
                    map[beside.lane]
                        .left
                        .iter()
                        .any(|back| back.lane == lane.id)
                );
                assert!(
                    beside.from_s == 0.0 && (beside.to_s - lane.centerline.length()).abs() < 1e-9
                );
            }
            assert!(map[lane.roadblock].lanes.contains(&lane.id));
            assert_eq!(lane.speed_limit.is_some(), lane.kind == LaneKind::Lane);
            for &stop in &lane.stop_lines {
                assert!(
                    map[stop].polygon.meets_line(&lane.centerline),
                    "stop lines lie across their connectors"
                );
            }
        }
        for block in map.roadblocks() {
            assert!(
                block
                    .lanes
                    .iter()
                    .all(|&lane| map[lane].roadblock == block.id)
            );
            assert!(
                block
                    .incoming
                    .iter()
                    .all(|&before| map[before].outgoing.contains(&block.id))
            );
        }
    }
}

#[test]
fn lanes_join_without_gap_or_kink() {
    for generated in CORPUS.iter() {
        let map = &generated.scenario.map;
        for lane in map.lanes() {
            for &next in &lane.outgoing {
                let (a, b) = (&lane.centerline, &map[next].centerline);
                assert!(
                    (a.end() - b.start()).norm() < 1e-6,
                    "{}: {:?} to {next:?}",
                    generated.scenario.id,
                    lane.id
                );
                let kink = wrap_angle(b.heading_at(0.0) - a.heading_at(a.length())).abs();
                assert!(
                    kink < 0.05,
                    "{}: {:?} to {next:?} turns by {kink}",
                    generated.scenario.id,
                    lane.id
                );
            }
        }
    }
}

/// Lanes at the edge of the map have no predecessor; every other one can be entered.
#[test]
fn every_lane_can_be_entered_or_begins_at_the_edge() {
    for generated in CORPUS.iter() {
        let map = &generated.scenario.map;
        for lane in map.lanes().iter().filter(|lane| lane.incoming.is_empty()) {
            assert_eq!(lane.kind, LaneKind::Lane);
            let block = &map[lane.roadblock];
            let entered = block
                .lanes
                .iter()
                .any(|&other| !map[other].incoming.is_empty());
            let beside = !lane.left.is_empty() || !lane.right.is_empty();
            assert!(
                !entered || beside,
                "{}: {:?}",
                generated.scenario.id,
                lane.id
            );
        }
    }
}

fn points_of(map: &LaneMap) -> impl Iterator<Item = (usize, Point)> + '_ {
    map.lanes()
        .iter()
        .filter(|lane| lane.kind == LaneKind::Lane)
        .flat_map(|lane| {
            let count = (lane.centerline.length() / 4.0) as usize;
            (1..count.max(2)).flat_map(move |k| {
                let s = k as f64 * lane.centerline.length() / (count.max(2) + 1) as f64;
                [-1.4, 0.0, 1.4].map(|d| (lane.id.index(), lane.centerline.frenet_to_map(s, d)))
            })
        })
}

#[test]
fn a_point_of_a_lane_lies_in_that_lane_alone() {
    for generated in CORPUS.iter() {
        let map = &generated.scenario.map;
        for (lane, point) in points_of(map) {
            let held = map.lanes_of_kind_at(point, LaneKind::Lane);
            assert!(
                held.len() == 1 && held[0].index() == lane,
                "{}: {held:?} {lane}",
                generated.scenario.id
            );
            assert!(!map.in_intersection(point) && map.is_drivable(point));
        }
    }
}

#[test]
fn lane_areas_do_not_overlap() {
    for generated in one_each() {
        let lanes: Vec<_> = generated
            .scenario
            .map
            .lanes()
            .iter()
            .filter(|l| l.kind == LaneKind::Lane)
            .collect();
        for (i, a) in lanes.iter().enumerate() {
            for b in &lanes[i + 1..] {
                let shared = a.polygon.shared_area(&b.polygon);
                assert!(
                    shared < 1e-6,
                    "{}: {:?} and {:?} share {shared}",
                    generated.scenario.id,
                    a.id,
                    b.id
                );
            }
        }
    }
}

#[test]
fn connectors_are_drivable_with_a_margin() {
    for generated in CORPUS.iter() {
        let map = &generated.scenario.map;
        for lane in map.lanes().iter().filter(|lane| lane.is_connector()) {
            let line = &lane.centerline;
            let count = (line.length() / 2.0) as usize;
            for k in 0..=count {
                for d in [-1.5, 0.0, 1.5] {
                    let point = line.frenet_to_map(k as f64 * 2.0, d);
                    assert!(
                        map.is_drivable(point),
                        "{}: {:?} at {k}",
                        generated.scenario.id,
                        lane.id
                    );
                }
            }
        }
    }
}
