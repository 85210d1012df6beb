//! The scorer of proposals on a straight road.

use crate::road::{cruise, ego, object, straight};
use planagent_score::metrics::MetricError;
use planagent_score::pdm::{
    Collided, Contest, DrivableLayers, DrivableMap, Forecast, ProposalScore, ScoringScene,
    score_proposals,
};
use planagent_world::geometry::Pose;
use planagent_world::{EgoState, LaneId, ObjectKind, TrackedObject, TrafficLights};
use proptest::prelude::*;
use std::collections::BTreeSet;

/// Scores straight proposals (a horizon of `states` states at constant speed) on a straight road
/// that is empty but for `objects`.
fn straight_scores(
    speeds: &[f64],
    states: usize,
    objects: &[TrackedObject],
    rival: f64,
) -> Vec<ProposalScore> {
    let proposals = straight_proposals(speeds, states);
    on_straight_road(objects, rival, |scene| {
        score_proposals(scene, &proposals).unwrap()
    })
}

fn straight_proposals(speeds: &[f64], states: usize) -> Vec<Vec<EgoState>> {
    let straight = |&speed: &f64| cruise(states, 0.0, 0.0, speed);
    speeds.iter().map(straight).collect()
}

/// What `judge` makes of a straight road with `objects`.
fn on_straight_road<T>(
    objects: &[TrackedObject],
    rival: f64,
    judge: impl FnOnce(&ScoringScene<'_>) -> T,
) -> T {
    let map = straight();
    let route = BTreeSet::from([LaneId(0)]);
    let start = ego(0, 0.0, 0.0, 0.0, 5.0);
    let forecast = Forecast::new(
        &map,
        &route,
        &start,
        objects,
        &TrafficLights::default(),
        &mut Collided::default(),
    );
    let drivable = DrivableMap::around(
        &map,
        &route,
        start.center().position(),
        DrivableLayers::Lanes,
    );
    let centerline = map.lanes()[0].centerline.clone();
    let scene = ScoringScene {
        drivable: &drivable,
        forecast: &forecast,
        centerline: &centerline,
        rival_progress: rival,
    };
    judge(&scene)
}

proptest! {
    /// A contest judges no more than it must, and chooses as if it had judged all.
    #[test]
    fn the_best_of_a_contest_is_the_first_of_the_highest_scores(
        speeds in prop::collection::vec(prop_oneof![Just(0.0), Just(8.0), 0.0..15.0f64], 1..9),
        cones in prop::collection::vec((8.0..70.0f64, -2.5..2.5f64), 0..3),
        rival in prop_oneof![Just(0.0), 0.0..60.0f64],
        every in 1..4usize,
    ) {
        let objects: Vec<TrackedObject> = (1..)
            .zip(cones)
            .map(|(id, (x, y))| {
                let at = Pose::new(x, y, 0.0);
                object(id, ObjectKind::TrafficCone, at, (0.4, 0.4), 0.0)
            })
            .collect();
        let proposals = straight_proposals(&speeds, 41);
        let scores = straight_scores(&speeds, 41, &objects, rival);
        let among = |index: usize| index.is_multiple_of(every);
        let highest = (0..scores.len())
            .filter(|&index| among(index))
            .map(|index| scores[index].total)
            .fold(0.0, f64::max);
        let expected = (0..scores.len())
            .find(|&index| among(index) && scores[index].total >= highest)
            .map(|index| (index, scores[index]));
        on_straight_road(&objects, rival, |scene| {
            let mut contest = Contest::new(scene, &proposals).unwrap();
            prop_assert_eq!(contest.best(among).unwrap(), expected);
            prop_assert_eq!(contest.best(|_| false).unwrap(), None);
            prop_assert_eq!(contest.scores().unwrap(), scores);
            Ok(())
        })?;
    }
}

#[test]
fn progress_is_relative_to_the_best_or_to_a_rival() {
    // 40 steps at 5 and 10 m/s: 20 m and 40 m.
    let scores = straight_scores(&[5.0, 10.0], 41, &[], 0.0);
    assert!((scores[0].progress - 0.5).abs() < 1e-9 && (scores[1].progress - 1.0).abs() < 1e-9);
    assert!((scores[0].total - (5.0 * 0.5 + 7.0) / 12.0).abs() < 1e-9);
    let beside_rival = straight_scores(&[5.0, 10.0], 41, &[], 80.0);
    assert!(
        (beside_rival[0].progress - 0.25).abs() < 1e-9
            && (beside_rival[1].progress - 0.5).abs() < 1e-9
    );
    // Nobody can move: standing still is perfect.
    assert!((straight_scores(&[0.0, 0.0], 41, &[], 0.0)[1].total - 1.0).abs() < 1e-12);
}

#[test]
fn the_horizon_is_a_parameter() {
    let cone = [object(
        1,
        ObjectKind::TrafficCone,
        Pose::new(30.0, 0.0, 0.0),
        (0.4, 0.4),
        0.0,
    )];
    // The front reaches the cone (29.8 m) when the centre is at 27.212 m: at 10 m/s after 2.8 s.
    let long = &straight_scores(&[10.0], 41, &cone, 0.0)[0];
    assert_eq!(
        (long.no_at_fault_collisions, long.time_to_collision),
        (0.5, 0.0)
    );
    assert!((long.first_at_fault_s.unwrap() - 2.8).abs() < 1e-9);
    // Seen from 0.9 s before.
    assert!((long.first_ttc_s.unwrap() - 1.9).abs() < 1e-9);
    let short = &straight_scores(&[10.0], 19, &cone, 0.0)[0];
    assert_eq!(
        (short.no_at_fault_collisions, short.time_to_collision),
        (1.0, 1.0)
    );
    assert!((short.progress_m - 18.0).abs() < 1e-9);
}

#[test]
fn proposals_that_are_too_short_are_refused() {
    let map = straight();
    let route = BTreeSet::new();
    let start = ego(0, 0.0, 0.0, 0.0, 5.0);
    let forecast = Forecast::new(
        &map,
        &route,
        &start,
        &[],
        &TrafficLights::default(),
        &mut Collided::default(),
    );
    let drivable = DrivableMap::around(
        &map,
        &route,
        start.center().position(),
        DrivableLayers::Lanes,
    );
    let scene = ScoringScene {
        drivable: &drivable,
        forecast: &forecast,
        centerline: &map.lanes()[0].centerline,
        rival_progress: 0.0,
    };
    let error = score_proposals(&scene, &[cruise(3, 0.0, 0.0, 5.0)]).unwrap_err();
    assert_eq!(error, MetricError::TooFewSamples { got: 3, needed: 4 });
    assert!(score_proposals(&scene, &[]).unwrap().is_empty());
}
