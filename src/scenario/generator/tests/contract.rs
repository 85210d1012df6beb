//! What the other stages rely on: nuPlan's window, states as in a log, ids, areas.

use super::super::{Generated, log};
use super::{CORPUS, one_each};
use geo::Validation;
use planagent_world::geometry::{Point, Polygon};
use planagent_world::{EgoState, LaneKind, LaneMap, PACIFICA, STEP_US};
use std::collections::BTreeSet;

/// All polygons of a map with the layer of each.
fn polygons(map: &LaneMap) -> impl Iterator<Item = (&'static str, &Polygon)> {
    let of = |layer, areas| std::iter::repeat(layer).zip::<std::slice::Iter<'_, Polygon>>(areas);
    let blocks = map.roadblocks().iter().flat_map(|block| &block.areas);
    map.lanes()
        .iter()
        .map(|lane| ("lane", &lane.polygon))
        .chain(blocks.map(|area| ("roadblock", area)))
        .chain(
            map.stop_lines()
                .iter()
                .map(|line| ("stop line", &line.polygon)),
        )
        .chain(of("intersection", map.intersections().iter()))
        .chain(of("crosswalk", map.crosswalks().iter()))
        .chain(of("generic drivable area", map.generic_drivable().iter()))
        .chain(of("car park", map.carparks().iter()))
}

/// Twice the signed area of a ring, positive when it runs counter-clockwise.
fn turn(ring: &[Point]) -> f64 {
    (0..ring.len())
        .map(|i| ring[i].coords.perp(&ring[(i + 1) % ring.len()].coords))
        .sum()
}

#[test]
fn frames_are_nuplans_window() {
    for Generated { scenario, .. } in CORPUS.iter() {
        let times: Vec<i64> = scenario
            .frames
            .iter()
            .map(|frame| frame.ego.time_us)
            .collect();
        assert!(
            times.windows(2).all(|w| w[1] - w[0] == STEP_US),
            "{}",
            scenario.id
        );
        assert_eq!(scenario.iterations(), log::ITERATIONS);
        // With the present sample the history buffer holds 22 samples: 2.1 s.
        assert_eq!(scenario.past().len() + 1, planagent_world::HISTORY_SAMPLES);
        assert_eq!(times[scenario.start] - times[0], 2_100_000);
    }
}

/// nuPlan's logs hold pose, velocity and acceleration. The rest is 0 until the controller has moved
/// the ego.
#[test]
fn ego_states_are_those_of_a_log() {
    for ego in CORPUS
        .iter()
        .flat_map(|generated| generated.scenario.frames.iter().map(|frame| frame.ego))
    {
        assert_eq!(
            ego,
            EgoState::from_log(ego.time_us, ego.rear_axle, ego.velocity, ego.acceleration)
        );
    }
}

#[test]
fn one_number_names_one_lane_connector_or_roadblock() {
    for Generated { scenario, .. } in CORPUS.iter() {
        let map = &scenario.map;
        let lanes = map.lanes().iter().map(|lane| lane.source_id);
        let ids: Vec<i64> = lanes
            .chain(map.roadblocks().iter().map(|block| block.source_id))
            .collect();
        let distinct: BTreeSet<i64> = ids.iter().copied().collect();
        assert_eq!(ids.len(), distinct.len(), "{}", scenario.id);
    }
}

#[test]
fn stop_lines_belong_to_lights_or_signs() {
    let (mut lights, mut signs) = (0, 0);
    for Generated { scenario, .. } in CORPUS.iter() {
        let map = &scenario.map;
        for lane in map.lanes() {
            assert_eq!(
                lane.has_traffic_lights,
                lane.stop_lines.iter().any(|&stop| !map[stop].stop_sign)
            );
            assert!(
                lane.is_connector() || lane.stop_lines.is_empty(),
                "{}",
                scenario.id
            );
            let shown = scenario
                .frames
                .iter()
                .all(|frame| frame.lights.status(lane.id).is_some());
            assert_eq!(
                lane.has_traffic_lights, shown,
                "{}: {:?}",
                scenario.id, lane.id
            );
        }
        for line in map.stop_lines() {
            assert!(!line.lanes.is_empty(), "{}", scenario.id);
            if line.stop_sign {
                signs += 1;
            } else {
                lights += 1;
            }
        }
    }
    assert!(lights > 0 && signs > 0);
}

#[test]
fn areas_are_simple_and_counter_clockwise() {
    for Generated { scenario, .. } in one_each() {
        for (layer, polygon) in polygons(&scenario.map) {
            let outline = polygon.ring().iter().map(|p| (p.x, p.y)).collect();
            let valid = geo::Polygon::new(outline, Vec::new()).is_valid();
            assert!(valid, "{}: a {layer} crosses itself", scenario.id);
            assert!(
                turn(polygon.ring()) > 0.0,
                "{}: a {layer} runs clockwise",
                scenario.id
            );
        }
    }
}

#[test]
fn no_lane_is_degenerate() {
    for Generated { scenario, .. } in CORPUS.iter() {
        for lane in scenario.map.lanes() {
            let length = lane.centerline.length();
            assert!(
                length > 1.0,
                "{}: {:?} is {length} m long",
                scenario.id,
                lane.id
            );
            let width = lane.polygon.area() / length;
            assert!(
                (2.5..6.0).contains(&width),
                "{}: {:?} is {width} m wide",
                scenario.id,
                lane.id
            );
        }
    }
}

#[test]
fn connectors_lie_in_their_intersection() {
    for Generated { scenario, .. } in CORPUS.iter() {
        let map = &scenario.map;
        for lane in map
            .lanes()
            .iter()
            .filter(|lane| lane.kind == LaneKind::Connector)
        {
            let line = &lane.centerline;
            let count = line.length().ceil() as usize;
            for k in 1..count {
                let point = line.point_at(line.length() * k as f64 / count as f64);
                assert!(
                    map.in_intersection(point),
                    "{}: {:?} at {point}",
                    scenario.id,
                    lane.id
                );
            }
        }
    }
}

/// No gap opens between lanes and connectors: a car that crosses the joint along the line stays on
/// the drivable area.
#[test]
fn a_car_on_a_joint_stands_on_drivable_ground() {
    for Generated { scenario, .. } in CORPUS.iter() {
        let map = &scenario.map;
        for lane in map.lanes() {
            for &next in &lane.outgoing {
                let joint = map[next].centerline.pose_at(0.0);
                for ahead in [-2.0, -0.5, 0.0, 0.5] {
                    let shape = PACIFICA.footprint(joint.translated(ahead, 0.0));
                    let off = shape
                        .corners()
                        .into_iter()
                        .find(|&corner| !map.is_drivable(corner));
                    assert!(
                        off.is_none(),
                        "{}: {:?} to {next:?}: {off:?}",
                        scenario.id,
                        lane.id
                    );
                }
            }
        }
    }
}

#[test]
fn the_ego_after_the_end_goes_on_where_the_scenario_ends() {
    let mut complete = 0;
    for Generated { scenario, .. } in CORPUS.iter() {
        let recorded: Vec<EgoState> = scenario.recorded().copied().collect();
        for pair in recorded.windows(2) {
            assert_eq!(
                pair[1].time_us - pair[0].time_us,
                STEP_US,
                "{}",
                scenario.id
            );
            let moved = pair[0].rear_axle.distance(&pair[1].rear_axle);
            let expected = f64::midpoint(pair[0].speed(), pair[1].speed()) * 0.1;
            assert!(
                (moved - expected).abs() < 0.05,
                "{}: {moved} m, expected {expected} m",
                scenario.id
            );
        }
        assert!(scenario.future.len() <= crate::FUTURE_FRAMES);
        complete += usize::from(scenario.future.len() == crate::FUTURE_FRAMES);
    }
    // Where the roads end, so do the states.
    assert!(
        complete * 10 >= CORPUS.len() * 7,
        "{complete} of {}",
        CORPUS.len()
    );
}

#[test]
fn baselines_are_dense_and_lead_to_each_other() {
    for Generated { scenario, .. } in CORPUS.iter() {
        for lane in scenario.map.lanes() {
            let line = &lane.centerline;
            let longest = line
                .vertices()
                .windows(2)
                .map(|pair| (pair[1] - pair[0]).norm())
                .fold(0.0, f64::max);
            assert!(
                longest < planagent_world::BASELINE_SPACING + 1e-6,
                "{} {:?}: {longest} m",
                scenario.id,
                lane.id
            );
            for beside in lane
                .left
                .iter()
                .chain(&lane.right)
                .filter(|beside| beside.from_s <= 0.0)
            {
                assert!(
                    beside.to_s >= line.length(),
                    "{} {:?}",
                    scenario.id,
                    lane.id
                );
            }
        }
    }
}
