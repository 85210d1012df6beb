//! Waymo recordings in nuPlan's formats. Their derived maps break nuPlan's rules: lanes succeed
//! each other without a connector, and connectors end at the edge of the map. The inserted pieces
//! must change neither the recorded trajectories nor any metric.

use super::compare::Pair;
use super::round_trip::{SimulatedPlanner, check_scores, read_back};
use crate::outside::Needy;
use crate::womd::recordings;
use planagent_agent::simulation::Challenge;
use planagent_scenario::Scenario;
use planagent_scenario::nuplan::export::{ExportSettings, ExportedLog, STITCH, write_scenarios};
use planagent_world::geometry::{Polygon, Polyline};
use planagent_world::{Lane, LaneKind, LaneMap, RoadblockId};
use rayon::prelude::*;

/// Inserted pieces change the progress: by at most 2e-4, measured.
const SAME_MAP: f64 = 5e-4;
/// Log replay lacks the recorded states after the end: at most 8e-3, measured.
const SAME_LOG_REPLAY: f64 = 2e-2;

/// nuPlan's rules: a connector leads from one lane to one lane, and lanes are joined by connectors
/// only.
fn check_graph(map: &LaneMap) {
    let kind_of = |lanes: &[planagent_world::LaneId]| {
        lanes.iter().map(|&id| map[id].kind).collect::<Vec<_>>()
    };
    for lane in map.lanes() {
        if lane.is_connector() {
            assert_eq!(
                (kind_of(&lane.incoming), kind_of(&lane.outgoing)),
                (vec![LaneKind::Lane], vec![LaneKind::Lane])
            );
        } else {
            assert!(
                kind_of(&lane.outgoing)
                    .iter()
                    .chain(&kind_of(&lane.incoming))
                    .all(|&k| k == LaneKind::Connector)
            );
        }
    }
}

/// At most one lane holds a point: nuPlan's metrics fail where two do. Connectors may overlap.
fn check_apart(map: &LaneMap) {
    /// m².
    const SLIVER: f64 = 1e-3;
    let lanes: Vec<&Lane> = map
        .lanes()
        .iter()
        .filter(|lane| !lane.is_connector())
        .collect();
    for (place, a) in lanes.iter().enumerate() {
        for b in &lanes[..place] {
            let shared = a.polygon.shared_area(&b.polygon);
            assert!(
                shared < SLIVER,
                "{}: lanes {} and {} share {shared} m²",
                map.name(),
                a.source_id,
                b.source_id
            );
        }
    }
}

/// A lane keeps its area, or that of the valid area which replaces one that crosses or touches
/// itself; its centerline loses at most a stitch at the end.
fn check_lane(pair: &Pair<'_>, lane: &Lane) {
    let twin = pair.twin(lane);
    let mended = (twin.polygon.area() / lane.polygon.area() - 1.0).abs() < 1e-3;
    assert!(
        mended || pair.same_polygon(&lane.polygon, &twin.polygon),
        "{} lane {}",
        pair.before.id,
        lane.source_id
    );
    assert_eq!(
        (lane.kind, lane.has_traffic_lights),
        (twin.kind, twin.has_traffic_lights)
    );
    let [whole, kept]: [&Polyline; 2] = [&lane.centerline, &twin.centerline];
    let lost = whole.length() - kept.length();
    assert!(
        lost < STITCH + 1e-6 && lost > -1e-6,
        "{} lane {}: {lost} m",
        pair.before.id,
        lane.source_id
    );
    let off = |share: f64| {
        (whole.point_at(kept.length() * share) + pair.shift - kept.point_at(kept.length() * share))
            .norm()
    };
    assert!(
        [0.0, 0.3, 0.7, 1.0]
            .into_iter()
            .all(|share| off(share) < 1e-5),
        "{} {}",
        pair.before.id,
        lane.source_id
    );
}

/// A connected route stays connected.
fn check_route(pair: &Pair<'_>) {
    let joined = |map: &LaneMap, route: &[RoadblockId]| {
        route
            .windows(2)
            .all(|two| map[two[0]].outgoing.contains(&two[1]))
    };
    let (before, after) = (&pair.before.route.roadblocks, &pair.after.route.roadblocks);
    assert!(
        !joined(&pair.before.map, before) || joined(&pair.after.map, after),
        "{}",
        pair.before.id
    );
    assert!(after.len() >= before.len());
}

#[test]
fn recordings_come_back_with_their_metrics() -> Needy {
    let scenarios = recordings()?;
    let settings = ExportSettings::default();
    let home = tempfile::tempdir().unwrap();
    let exported = write_scenarios(scenarios, &home.path().join("out"), &settings).unwrap();
    let read = read_back(&exported, &settings, home.path());
    let each = scenarios.par_iter().zip(&read).zip(&exported.logs);
    each.for_each(|((before, (after, shift)), log): ((_, _), &ExportedLog)| {
        let pair = Pair {
            before,
            after,
            shift: *shift,
        };
        pair.check_frames();
        check_graph(&after.map);
        check_apart(&before.map);
        check_apart(&after.map);
        before
            .map
            .lanes()
            .iter()
            .for_each(|lane| check_lane(&pair, lane));
        // Areas that cross or touch themselves are written as valid ones, which are a few square
        // centimeters larger.
        let area = |areas: &[Polygon]| areas.iter().map(Polygon::area).sum::<f64>();
        for of in [
            LaneMap::intersections,
            LaneMap::road_segments,
            LaneMap::generic_drivable,
        ] {
            let (drawn, written) = (area(of(&before.map)), area(of(&after.map)));
            assert!(
                (written - drawn).abs() <= 1e-4 * drawn,
                "{}: {drawn} m², {written} m²",
                before.id
            );
        }
        let changes = log.changes;
        let more = changes.inserted_connectors
            + changes.inserted_lanes
            + changes.open_ends_closed
            + changes.connectors_repeated;
        assert_eq!(
            after.map.lanes().len(),
            before.map.lanes().len() + more,
            "{}: {changes:?}",
            before.id
        );
        assert_eq!(
            after.map.stop_lines().len(),
            before.map.stop_lines().len() + changes.inserted_stop_lines
        );
        check_route(&pair);
        assert_eq!(changes.dropped_future_states, before.future.len());
        let as_recorded = (SimulatedPlanner::LogReplay, Challenge::NonReactive);
        check_scores(before, after, as_recorded, SAME_LOG_REPLAY);
        let until_the_end = Scenario {
            future: Vec::new(),
            ..(*before).clone()
        };
        check_scores(&until_the_end, after, as_recorded, SAME_MAP);
    });
    Ok(())
}
