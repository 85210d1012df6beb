//! The logs: the expert stays on the road, obeys the rules and is comfortable; other agents are
//! plausible.

use super::super::{log, types};
use super::{CORPUS, SEEDS};
use crate::Scenario;
use planagent_world::geometry::wrap_angle;
use planagent_world::{LaneId, ObjectKind, STEP_S, STEP_US, SignalStatus};

#[test]
fn every_type_and_seed_gives_a_full_log() {
    assert_eq!(CORPUS.len(), types::in_suites().count() * SEEDS as usize);
    for generated in CORPUS.iter() {
        let scenario = &generated.scenario;
        assert_eq!(
            (scenario.iterations(), scenario.past().len()),
            (log::ITERATIONS, log::PAST)
        );
        let steady = scenario
            .frames
            .windows(2)
            .all(|w| w[1].ego.time_us - w[0].ego.time_us == STEP_US);
        assert!(steady && scenario.route.goal.is_some());
    }
}

#[test]
fn the_expert_stays_on_the_road_and_touches_nothing() {
    for generated in CORPUS.iter() {
        let scenario = &generated.scenario;
        for frame in &scenario.frames {
            let shape = frame.ego.footprint();
            assert!(
                shape
                    .corners()
                    .iter()
                    .all(|&corner| scenario.map.is_drivable(corner)),
                "{}",
                scenario.id
            );
            assert!(
                frame
                    .objects
                    .iter()
                    .all(|object| !object.shape.overlaps(&shape)),
                "{}",
                scenario.id
            );
        }
    }
}

#[test]
fn the_expert_stays_on_its_route() {
    for generated in CORPUS.iter() {
        let Scenario {
            map, route, frames, ..
        } = &generated.scenario;
        for frame in frames {
            let blocks = map.roadblocks_at(frame.ego.center().position());
            assert!(
                blocks.iter().any(|&block| route.contains(block)),
                "{}",
                generated.scenario.id
            );
        }
        let linked = route
            .roadblocks
            .windows(2)
            .all(|w| map[w[0]].outgoing.contains(&w[1]));
        assert!(
            linked && route.roadblocks.len() >= 3,
            "{}",
            generated.scenario.id
        );
    }
}

#[test]
fn velocities_agree_with_positions() {
    for generated in CORPUS.iter() {
        for pair in generated.scenario.frames.windows(2) {
            let (a, b) = (&pair[0].ego, &pair[1].ego);
            let moved = b.rear_axle.position() - a.rear_axle.position();
            let expected = f64::midpoint(a.speed(), b.speed()) * STEP_S;
            assert!(
                (moved.norm() - expected).abs() < 0.01,
                "{}: {moved} {expected}",
                generated.scenario.id
            );
            assert!(
                moved.dot(&a.rear_axle.direction()) > -1e-3,
                "{}: backwards by {moved}",
                generated.scenario.id
            );
            assert!(
                (b.speed() - a.speed() - b.acceleration.x * STEP_S).abs() < 0.05
                    || b.speed() < 0.05
            );
            let turned = wrap_angle(b.rear_axle.heading - a.rear_axle.heading).abs() / STEP_S;
            assert!(
                turned < 0.95,
                "{}: yaw rate {turned}",
                generated.scenario.id
            );
        }
    }
}

/// nuPlan's comfort bounds on the raw log: longitudinal −4.05..2.40, lateral 4.89, jerk by centred
/// differences over 0.8 s.
#[test]
fn the_expert_is_comfortable_nearly_always() {
    let mut rough = Vec::new();
    for generated in CORPUS.iter() {
        let states: Vec<_> = generated.scenario.expert().collect();
        let accelerations = states
            .iter()
            .all(|s| (-4.05..2.40).contains(&s.acceleration.x) && s.acceleration.y.abs() < 4.89);
        assert!(accelerations, "{}", generated.scenario.id);
        let jerk = states
            .windows(9)
            .map(|w| (w[8].acceleration.x - w[0].acceleration.x).abs() / (8.0 * STEP_S));
        if jerk.fold(0.0, f64::max) > 4.13 {
            rough.push(generated.scenario.id.clone());
        }
    }
    assert!(rough.len() * 20 < CORPUS.len(), "{rough:?}");
}

#[test]
fn the_expert_keeps_to_the_limit_and_stops_at_red() {
    for generated in CORPUS.iter() {
        let Scenario {
            map, frames, id, ..
        } = &generated.scenario;
        let mut before: Option<LaneId> = None;
        for frame in frames {
            let front = frame
                .ego
                .rear_axle
                .translated(planagent_world::PACIFICA.front_length, 0.0);
            let center = map.lanes_of_kind_at(
                frame.ego.center().position(),
                planagent_world::LaneKind::Lane,
            );
            if let Some(limit) = center.first().and_then(|&lane| map[lane].speed_limit) {
                assert!(
                    frame.ego.speed() < limit + 0.9,
                    "{id}: {} over {limit}",
                    frame.ego.speed()
                );
            }
            // Between two frames the front comes onto a connector: one of those that start there
            // must not be red.
            let lane = map
                .lanes_of_kind_at(front.position(), planagent_world::LaneKind::Lane)
                .first()
                .copied();
            if let (Some(from), None) = (before, lane) {
                let onward = map[from]
                    .outgoing
                    .iter()
                    .filter_map(|&connector| frame.lights.status(connector));
                let statuses: Vec<SignalStatus> = onward.collect();
                let open = statuses.is_empty()
                    || statuses.iter().any(|&status| status != SignalStatus::Red);
                assert!(open, "{id}: runs a red light at {}", frame.ego.time_us);
            }
            before = lane;
        }
    }
}

#[test]
fn nothing_overlaps_at_the_start_and_vehicles_move_along_their_heading() {
    for generated in CORPUS.iter() {
        let first = &generated.scenario.frames[0].objects;
        for (i, a) in first.iter().enumerate() {
            for b in first[i + 1..]
                .iter()
                .filter(|b| a.kind != ObjectKind::Pedestrian || b.kind != a.kind)
            {
                assert!(
                    !a.shape.overlaps(&b.shape),
                    "{}: {} {}",
                    generated.scenario.id,
                    a.token,
                    b.token
                );
            }
        }
        for object in generated
            .scenario
            .frames
            .iter()
            .flat_map(|frame| frame.objects.iter())
        {
            assert!(object.shape.center.is_finite() && object.speed() < 30.0);
            if object.kind == ObjectKind::Vehicle && object.speed() > 0.5 {
                let off = wrap_angle(
                    object.velocity.y.atan2(object.velocity.x) - object.shape.center.heading,
                );
                assert!(off.abs() < 1e-6, "{}", generated.scenario.id);
            }
            if !object.kind.is_agent() {
                assert!(object.speed() == 0.0);
            }
        }
    }
}

#[test]
fn tokens_are_unique_and_tracks_do_not_jump() {
    for generated in CORPUS.iter() {
        for pair in generated.scenario.frames.windows(2) {
            let (before, after) = (&pair[0].objects, &pair[1].objects);
            assert!(after.windows(2).all(|w| w[0].token < w[1].token));
            for object in after.iter() {
                if let Ok(place) = before.binary_search_by_key(&object.token, |o| o.token) {
                    let moved = before[place].shape.center.distance(&object.shape.center);
                    assert!(
                        moved < 3.2,
                        "{}: {} moves {moved}",
                        generated.scenario.id,
                        object.token
                    );
                }
            }
        }
    }
}
