//! What holds of every recording of Waymo: of its derived map, of its ego, and of log replay.

use planagent_scenario::{Frame, Scenario};
use planagent_world::geometry::{Point, wrap_angle};
use planagent_world::{LaneId, LaneKind, LaneMap, Neighbor};
use rayon::prelude::*;
use std::collections::BTreeSet;
use std::panic::{AssertUnwindSafe, catch_unwind};

/// A rule and its name. It panics where a recording breaks it.
type Rule = (&'static str, fn(&Scenario));

/// Of derived maps.
pub(super) const OF_MAPS: &[Rule] = &[
    ("every lane stands in one roadblock of its kind", roadblocks),
    ("neighbors lie beside a lane in its direction", neighbors),
    ("at most one lane holds a point", lanes_apart),
    ("lights and stop lines stand at connectors", stop_lines),
    ("speed limits are those of roads", speed_limits),
];

/// Of recorded egos.
pub(super) const OF_EGOS: &[Rule] = &[
    ("the recorded motion agrees with itself", motion),
    ("the route is a connected chain that holds the ego", route),
    ("log replay stays on the drivable area", drivable_area),
    ("log replay drives in direction", direction),
];

/// Checks rules of recordings, and names every recording that breaks one.
pub(super) fn check(recordings: &[Scenario], rules: &[Rule]) {
    let broken = |scenario: &Scenario| {
        let broken = rules.iter().filter(|(_, rule)| {
            let kept = catch_unwind(AssertUnwindSafe(|| rule(scenario)));
            kept.is_err()
        });
        let names = broken.map(|(name, _)| format!("{}: {name}", scenario.id));
        names.collect::<Vec<_>>()
    };
    let broken: Vec<String> = recordings.par_iter().flat_map_iter(broken).collect();
    assert!(broken.is_empty(), "broken rules: {broken:#?}");
}

fn motion(scenario: &Scenario) {
    for (i, pair) in scenario.frames.windows(2).enumerate() {
        let (a, b) = (&pair[0].ego, &pair[1].ego);
        let dt = (b.time_us - a.time_us) as f64 / 1e6;
        let moved = (b.rear_axle.position() - a.rear_axle.position()) / dt;
        let recorded = a
            .rear_axle
            .rotate(a.velocity)
            .lerp(&b.rear_axle.rotate(b.velocity), 0.5);
        // 8d3d061e518531d0 hops by 10 cm at 1.8 s and at 6.6 s, as recorded.
        assert!(
            (moved - recorded).norm() < 0.6,
            "{} frame {i}: moved {moved:?}, velocity {recorded:?}",
            scenario.id
        );
        assert!(
            a.velocity.y.abs() < 0.3,
            "{} frame {i}: slides {:?}",
            scenario.id,
            a.velocity
        );
        assert!(
            a.acceleration.norm() < 5.0,
            "{} frame {i}: {:?}",
            scenario.id,
            a.acceleration
        );
        assert!(
            (b.acceleration - a.acceleration).norm() < 2.0,
            "{} frame {i} jerks",
            scenario.id
        );
    }
}

fn roadblocks(Scenario { id, map, .. }: &Scenario) {
    let held: Vec<LaneId> = map
        .roadblocks()
        .iter()
        .flat_map(|block| block.lanes.iter().copied())
        .collect();
    assert_eq!(held.len(), map.lanes().len(), "{id}");
    assert_eq!(
        held.iter().collect::<BTreeSet<_>>().len(),
        held.len(),
        "{id}"
    );
    for block in map.roadblocks() {
        for &lane in &block.lanes {
            assert_eq!(map[lane].roadblock, block.id, "{id}");
            assert_eq!(
                map[lane].kind, block.kind,
                "{id} lane {}",
                map[lane].source_id
            );
            let follower = map[lane]
                .outgoing
                .iter()
                .find(|next| block.lanes.contains(next));
            assert_eq!(
                follower, None,
                "{id}: {} follows in its own roadblock",
                map[lane].source_id
            );
            assert!(
                map[lane]
                    .outgoing
                    .iter()
                    .all(|&next| block.outgoing.contains(&map[next].roadblock)),
                "{id}"
            );
            assert!(
                map[lane]
                    .incoming
                    .iter()
                    .all(|&from| block.incoming.contains(&map[from].roadblock)),
                "{id}"
            );
        }
        assert!(
            block
                .outgoing
                .iter()
                .all(|&next| map[next].incoming.contains(&block.id)),
            "{id}"
        );
    }
}

fn neighbors(Scenario { id, map, .. }: &Scenario) {
    for lane in map.lanes() {
        for (neighbors, side) in [(&lane.left, 1.0), (&lane.right, -1.0)] {
            for &Neighbor {
                lane: other,
                from_s,
                to_s,
            } in neighbors
            {
                assert!(
                    0.0 <= from_s && from_s < to_s && to_s <= lane.centerline.length() + 1e-6,
                    "{id}"
                );
                let middle = lane.centerline.pose_at(f64::midpoint(from_s, to_s));
                let foot = map[other].centerline.project(middle.position());
                assert!(
                    wrap_angle(foot.heading - middle.heading).abs() < 0.8,
                    "{id} {}",
                    lane.source_id
                );
                let lateral = middle.to_local(foot.point).y;
                assert!(
                    lateral * side > -0.5,
                    "{id}: {} is {lateral} m beside {}",
                    map[other].source_id,
                    lane.source_id
                );
            }
        }
    }
}

/// Numbers of pairs of neighboring lanes, and of those that share a roadblock.
pub(super) fn neighbors_in_one_roadblock(map: &LaneMap) -> [usize; 2] {
    let lanes = map.lanes().iter().filter(|lane| !lane.is_connector());
    let pairs = lanes.flat_map(|lane| {
        let beside = lane.left.iter().chain(&lane.right);
        beside.map(move |neighbor| (lane, &map[neighbor.lane]))
    });
    let mut counts = [0, 0];
    for (lane, other) in pairs.filter(|(_, other)| !other.is_connector()) {
        counts[0] += 1;
        counts[1] += usize::from(other.roadblock == lane.roadblock);
    }
    counts
}

fn lanes_apart(Scenario { id, map, .. }: &Scenario) {
    let lanes: Vec<_> = map
        .lanes()
        .iter()
        .filter(|lane| !lane.is_connector())
        .collect();
    for (i, a) in lanes.iter().enumerate() {
        for b in &lanes[..i] {
            let shared = a.polygon.shared_area(&b.polygon);
            assert!(
                shared < 1e-3,
                "{id}: lanes {} and {} share {shared} m²",
                a.source_id,
                b.source_id
            );
        }
        let (middle, length) = (
            a.centerline.point_at(a.centerline.length() / 2.0),
            a.centerline.length(),
        );
        let area = a.polygon.area();
        assert!(
            area < 6.0 * length + 1.0,
            "{id}: lane {} of {length} m has {area} m²",
            a.source_id
        );
        assert!(map.is_drivable(middle), "{id}: lane {}", a.source_id);
    }
}

fn stop_lines(
    Scenario {
        id, map, frames, ..
    }: &Scenario,
) {
    for (lane, _) in frames.iter().flat_map(|frame| frame.lights.iter()) {
        assert!(
            map[lane].is_connector() && map[lane].has_traffic_lights,
            "{id} {}",
            map[lane].source_id
        );
        let lines = map[lane].stop_lines.iter().map(|&line| &map[line]);
        let start = map[lane].centerline.start();
        assert!(
            lines
                .into_iter()
                .any(|line| !line.stop_sign && line.polygon.distance_to(start) < 0.3),
            "{id}"
        );
    }
    for line in map.stop_lines() {
        assert!(
            line.lanes.iter().all(|&lane| map[lane].is_connector()),
            "{id}"
        );
        assert!(line.polygon.area() < 3.0, "{id}");
    }
}

fn speed_limits(Scenario { id, map, .. }: &Scenario) {
    let known = map.lanes().iter().filter_map(|lane| lane.speed_limit);
    for limit in known {
        assert!((2.0..40.0).contains(&limit), "{id}: {limit} m/s");
    }
}

/// Where the recorded ego left the lane graph: between which lanes of the recording.
const BREAKS: [(&str, i64, i64); 1] = [
    // Turns round the end of the median, where the map has no lane.
    ("dd0c8c27fdd6ef59", 228, 257),
];

fn route(scenario: &Scenario) {
    let Scenario {
        id,
        map,
        route,
        frames,
        start,
        ..
    } = scenario;
    assert!(!route.roadblocks.is_empty(), "{id}");
    for pair in route.roadblocks.windows(2) {
        let gap = (id.as_str(), map[pair[0]].source_id, map[pair[1]].source_id);
        assert!(
            map[pair[0]].outgoing.contains(&pair[1]) || BREAKS.contains(&gap),
            "{gap:?}"
        );
    }
    let held = |frame: &&Frame| {
        let center = frame.ego.center().position();
        route
            .roadblocks
            .iter()
            .any(|&block| map.roadblock_holds(block, center))
    };
    let driven = &frames[*start..];
    let on_route = driven.iter().filter(held).count();
    assert!(
        on_route * 100 >= driven.len() * 97,
        "{id}: {on_route} of {} on the route",
        driven.len()
    );
}

/// nuPlan's drivable-area compliance of the recorded ego: every corner within 0.3 m of the drivable
/// area.
fn drivable_area(scenario: &Scenario) {
    for (iteration, ego) in scenario.expert().enumerate() {
        for corner in ego.footprint().corners() {
            let near = scenario.map.distance_to_drivable(corner, 0.3);
            assert!(
                near.is_some(),
                "{} iteration {iteration}: corner {corner:?} is off the road",
                scenario.id
            );
        }
    }
}

/// nuPlan's driving-direction compliance of the recorded ego: within a second it comes less than 2
/// m backwards.
fn direction(scenario: &Scenario) {
    let centers: Vec<Point> = scenario
        .expert()
        .map(|ego| ego.center().position())
        .collect();
    let progress = progress_along_lanes(&scenario.map, &centers[..centers.len() - 1]);
    for last in 0..progress.len() {
        let second: f64 = progress[last.saturating_sub(10)..=last].iter().sum();
        assert!(
            second > -2.0,
            "{} iteration {last}: {second} m",
            scenario.id
        );
    }
}

/// Progress of each sample along the first lane that nuPlan finds for it.
fn progress_along_lanes(map: &LaneMap, centers: &[Point]) -> Vec<f64> {
    let mut before: Option<LaneId> = None;
    let mut s_before: Option<f64> = None;
    let steps = lanes_along(map, centers)
        .into_iter()
        .zip(centers)
        .map(|(lanes, &center)| {
            let Some(&lane) = lanes.first() else {
                return 0.0;
            };
            if before.replace(lane) != Some(lane) {
                s_before = None;
                return 0.0;
            }
            let s = map[lane].centerline.project(center).s;
            s_before
                .replace(s)
                .filter(|_| s != 0.0)
                .map_or(0.0, |s_before| s - s_before)
        });
    steps.collect()
}

/// nuPlan's lane assignment of a driven path, before its clean-up: what was driven on while it
/// holds the point, then what follows it, then the lane at the point or else all connectors there;
/// in an intersection what lies within 5 m is kept.
fn lanes_along(map: &LaneMap, centers: &[Point]) -> Vec<Vec<LaneId>> {
    let mut found: Vec<Vec<LaneId>> = Vec::new();
    for (i, &center) in centers.iter().enumerate() {
        let before = found.last().cloned().unwrap_or_default();
        let holding = |lanes: &[LaneId]| -> Vec<LaneId> {
            lanes
                .iter()
                .copied()
                .filter(|&lane| map[lane].polygon.contains(center))
                .collect()
        };
        let mut now = holding(&before);
        if let ([], [only]) = (&now[..], &before[..]) {
            now = holding(&map[*only].outgoing);
        }
        if now.is_empty() {
            now = map.lanes_of_kind_at(center, LaneKind::Lane);
            assert!(
                now.len() <= 1,
                "lanes {:?} share {center:?}",
                source_ids(map, &now)
            );
            if now.is_empty() {
                now = map.lanes_of_kind_at(center, LaneKind::Connector);
            }
            let crossing = now.first().map_or(map.in_intersection(center), |&lane| {
                map[lane].is_connector()
            });
            if i > 1 && crossing && before.first().is_some_and(|&lane| map[lane].is_connector()) {
                let near: Vec<LaneId> = before
                    .into_iter()
                    .filter(|&lane| map[lane].polygon.distance_to(center) < 5.0)
                    .collect();
                now = if near.is_empty() { now } else { near };
            }
        }
        found.push(now);
    }
    found
}

pub(super) fn source_ids(map: &LaneMap, lanes: &[LaneId]) -> Vec<i64> {
    lanes.iter().map(|&lane| map[lane].source_id).collect()
}
