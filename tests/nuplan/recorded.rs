//! Waymo recordings as nuPlan's files. Their maps are derived and freer than nuPlan's: lanes follow each other without a connector,
//! connectors end at the edge of the map. What is put in for that must not change what was driven, nor any verdict on it.

use super::compare::Pair;
use super::round_trip::{Driver, check_scores, read_back};
use crate::womd::recordings;
use planagent::internals::geometry::Polyline;
use planagent::internals::scenario::Scenario;
use planagent::internals::scenario::nuplan::export::{ExportSettings, ExportedLog, STITCH, write_scenarios};
use planagent::internals::simulation::Challenge;
use planagent::internals::world::{Lane, LaneKind, LaneMap, RoadblockId};
use rayon::prelude::*;

/// Progress moves by the pieces that are put in: measured, at most 2e-4.
const SAME_MAP: f64 = 5e-4;
/// The replayed ego no longer knows where the recording goes on after the end: measured, at most 8e-3.
const SAME_DRIVE: f64 = 2e-2;

/// nuPlan's graph: a connector leads from one lane to one lane, and lanes follow each other only over connectors.
fn check_graph(map: &LaneMap) {
    let kind_of =
        |lanes: &[planagent::internals::world::LaneId]| lanes.iter().map(|&id| map[id].kind).collect::<Vec<_>>();
    for lane in map.lanes() {
        if lane.is_connector() {
            assert_eq!(
                (kind_of(&lane.incoming), kind_of(&lane.outgoing)),
                (vec![LaneKind::Lane], vec![LaneKind::Lane])
            );
        } else {
            assert!(kind_of(&lane.outgoing).iter().chain(&kind_of(&lane.incoming)).all(|&k| k == LaneKind::Connector));
        }
    }
}

/// Lanes keep their area; their centreline at most loses a stitch at its end.
fn check_lane(pair: &Pair<'_>, lane: &Lane) {
    let twin = pair.twin(lane);
    assert!(pair.same_polygon(&lane.polygon, &twin.polygon), "{} lane {}", pair.before.id, lane.source_id);
    assert_eq!((lane.kind, lane.has_traffic_lights), (twin.kind, twin.has_traffic_lights));
    let [whole, kept]: [&Polyline; 2] = [&lane.centerline, &twin.centerline];
    let lost = whole.length() - kept.length();
    assert!(lost < STITCH + 1e-6 && lost > -1e-6, "{} lane {}: {lost} m", pair.before.id, lane.source_id);
    let off =
        |share: f64| (whole.point_at(kept.length() * share) + pair.shift - kept.point_at(kept.length() * share)).norm();
    assert!([0.0, 0.3, 0.7, 1.0].into_iter().all(|share| off(share) < 1e-5), "{} {}", pair.before.id, lane.source_id);
}

/// Where the route went on from block to block it still does.
fn check_route(pair: &Pair<'_>) {
    let joined =
        |map: &LaneMap, route: &[RoadblockId]| route.windows(2).all(|two| map[two[0]].outgoing.contains(&two[1]));
    let (before, after) = (&pair.before.route.roadblocks, &pair.after.route.roadblocks);
    assert!(!joined(&pair.before.map, before) || joined(&pair.after.map, after), "{}", pair.before.id);
    assert!(after.len() >= before.len());
}

#[test]
fn recordings_come_back_with_their_verdicts() {
    let scenarios = recordings();
    if scenarios.is_empty() {
        return;
    }
    let settings = ExportSettings::default();
    let home = tempfile::tempdir().unwrap();
    let exported = write_scenarios(scenarios, &home.path().join("out"), &settings).unwrap();
    let read = read_back(&exported, &settings, home.path());
    let each = scenarios.par_iter().zip(&read).zip(&exported.logs);
    each.for_each(|((before, (after, shift)), log): ((_, _), &ExportedLog)| {
        let pair = Pair { before, after, shift: *shift };
        pair.check_drive();
        check_graph(&after.map);
        before.map.lanes().iter().for_each(|lane| check_lane(&pair, lane));
        assert!(pair.same_polygons(before.map.intersections(), after.map.intersections()));
        assert!(pair.same_polygons(before.map.road_segments(), after.map.road_segments()));
        assert!(pair.same_polygons(before.map.generic_drivable(), after.map.generic_drivable()));
        let put_in = log.departures;
        let more =
            put_in.connectors_put_in + put_in.lanes_put_in + put_in.open_ends_closed + put_in.connectors_repeated;
        assert_eq!(after.map.lanes().len(), before.map.lanes().len() + more, "{}: {put_in:?}", before.id);
        assert_eq!(after.map.stop_lines().len(), before.map.stop_lines().len() + put_in.stop_lines_put_in);
        check_route(&pair);
        assert_eq!(put_in.future_left_out, before.future.len());
        let as_recorded = (Driver::LogReplay, Challenge::NonReactive);
        check_scores(before, after, as_recorded, SAME_DRIVE);
        let until_the_end = Scenario { future: Vec::new(), ..(*before).clone() };
        check_scores(&until_the_end, after, as_recorded, SAME_MAP);
    });
}
