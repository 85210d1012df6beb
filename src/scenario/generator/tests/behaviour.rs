//! Behavior of other agents: the share of scenarios with difficult situations.

use super::CORPUS;
use crate::{Frame, Scenario};
use planagent_world::geometry::{Pose, wrap_angle};
use planagent_world::{LaneKind, ObjectKind, TrackedObject};

fn share(shows: impl Fn(&Scenario) -> bool) -> f64 {
    CORPUS
        .iter()
        .filter(|generated| shows(&generated.scenario))
        .count() as f64
        / CORPUS.len() as f64
}

fn vehicles(frame: &Frame) -> impl Iterator<Item = &TrackedObject> {
    frame
        .objects
        .iter()
        .filter(|object| object.kind == ObjectKind::Vehicle)
}

/// True if `object` is straight ahead of `ego`, from `from` to `to` meters.
fn in_lane(ego: &Pose, object: &TrackedObject, from: f64, to: f64) -> bool {
    let place = ego.to_local(object.shape.center.position());
    let turned = wrap_angle(object.shape.center.heading - ego.heading).abs();
    place.x > from && place.x < to && place.y.abs() < 1.2 && turned < 0.3
}

/// A vehicle moves from a neighboring lane to less than 25 m ahead of the ego, which drives
/// straight on.
fn cuts_in(scenario: &Scenario) -> bool {
    /// Maximum duration, frames.
    const WITHIN: usize = 35;
    scenario
        .frames
        .iter()
        .skip(WITHIN)
        .zip(&scenario.frames)
        .any(|(now, before)| {
            let (ego, ego_before) = (now.ego.center(), before.ego.center());
            let straight =
                ego_before.to_local(ego.position()).y.abs() < 0.8 && now.ego.speed() > 2.0;
            straight
                && vehicles(now)
                    .filter(|object| in_lane(&ego, object, 3.0, 25.0))
                    .any(|object| {
                        let then = vehicles(before).find(|other| other.token == object.token);
                        then.is_some_and(|then| {
                            let place = ego_before.to_local(then.shape.center.position());
                            (2.5..5.5).contains(&place.y.abs()) && place.x > -5.0
                        })
                    })
        })
}

/// A vehicle stands through the whole scenario in a lane of the route that the ego passes, without
/// a traffic light.
fn stands_on_the_path(scenario: &Scenario) -> bool {
    let Scenario {
        map, route, frames, ..
    } = scenario;
    let first = &frames[scenario.start];
    first.lights.iter().next().is_none()
        && vehicles(first).any(|object| {
            let center = object.shape.center.position();
            let lanes = map.lanes_of_kind_at(center, LaneKind::Lane);
            let on_route = lanes
                .iter()
                .any(|&lane| route.contains(map[lane].roadblock));
            let passed = frames
                .iter()
                .any(|frame| (frame.ego.center().position() - center).norm() < 15.0);
            let stands = |frame: &Frame| {
                vehicles(frame).all(|o| o.token != object.token || o.speed() == 0.0)
            };
            on_route && passed && frames.iter().all(stands)
        })
}

/// A vehicle first drives and then stands near the ego for the last three seconds, without a
/// traffic light.
fn breaks_down(scenario: &Scenario) -> bool {
    let (first, last) = (
        &scenario.frames[scenario.start],
        &scenario.frames[scenario.frames.len() - 30..],
    );
    let moved = |object: &TrackedObject| {
        vehicles(first).any(|o| o.token == object.token && o.speed() > 3.0)
    };
    first.lights.iter().next().is_none()
        && vehicles(&last[0])
            .filter(|object| moved(object))
            .any(|object| {
                let stands = |frame: &Frame| {
                    vehicles(frame).any(|o| o.token == object.token && o.speed() < 0.1)
                };
                let near = (object.shape.center.position() - last[0].ego.center().position())
                    .norm()
                    < 30.0;
                near && last.iter().all(stands)
            })
}

/// A pedestrian walks on the road less than 50 m ahead of the ego.
fn crosses_on_foot(scenario: &Scenario) -> bool {
    scenario.frames.iter().any(|frame| {
        let ego = frame.ego.center();
        frame.objects.iter().any(|object| {
            let center = object.shape.center.position();
            let place = ego.to_local(center);
            let ahead = place.x > 0.0 && place.x < 50.0 && place.y.abs() < 12.0;
            object.kind == ObjectKind::Pedestrian
                && object.speed() > 0.3
                && ahead
                && !scenario.map.lanes_at(center).is_empty()
        })
    })
}

/// The bounds are somewhat below the measured shares (docs/generator.md).
#[test]
fn difficult_situations_are_frequent_enough() {
    let shares = [
        ("cuts in", share(cuts_in), 0.02),
        ("stands in the way", share(stands_on_the_path), 0.02),
        ("breaks down", share(breaks_down), 0.03),
        ("crosses on foot", share(crosses_on_foot), 0.05),
    ];
    for (what, share, least) in shares {
        assert!(
            share >= least,
            "{what}: {share} of the scenarios, fewer than {least}: {shares:?}"
        );
    }
}
