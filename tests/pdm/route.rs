//! Worked cases of the repair of the route and of the search for the centreline.

use super::town::{Town, blocks, route};
use planagent_score::pdm::{
    SearchDirection, centerline_poses, corrected_route, current_lane, lane_chain, roadblock_chain,
    starting_block,
};
use planagent_world::geometry::{Point, Pose, Vector};
use planagent_world::{EgoState, LaneId, LaneMap, RoadblockId};

fn corrected(map: &LaneMap, given: &[LaneId], x: f64, y: f64) -> Vec<u32> {
    corrected_route(map, &blocks(given), Pose::new(x, y, 0.0))
        .iter()
        .map(|block| block.0)
        .collect()
}

fn ego(x: f64, y: f64, heading: f64) -> EgoState {
    EgoState::from_log(
        0,
        Pose::new(x, y, heading),
        Vector::new(5.0, 0.0),
        Vector::zeros(),
    )
}

#[test]
fn a_route_that_begins_ahead_is_led_back_to_the_ego() {
    let mut town = Town::default();
    let lanes = town.row(5);
    let map = town.build();
    assert_eq!(corrected(&map, &lanes[2..], 10.0, 0.0), [0, 1, 2, 3, 4]);
    assert_eq!(
        corrected(&map, &lanes[2..], 50.0, 0.0),
        [2, 3, 4],
        "begun where the ego is: untouched"
    );
    assert_eq!(
        corrected(&map, &lanes[1..], 50.0, 0.0),
        [1, 2, 3, 4],
        "on the route, not at its start: untouched"
    );
}

#[test]
fn an_ego_beside_the_route_is_led_to_one_of_its_first_three_roadblocks() {
    let mut town = Town::default();
    let lanes = town.row(5);
    let (side, ramp) = (
        town.lane((0.0, -40.0), (20.0, -40.0)),
        town.lane((20.0, -40.0), (40.0, 0.0)),
    );
    town.link(side, ramp);
    town.link(ramp, lanes[2]);
    let map = town.build();
    assert_eq!(
        corrected(&map, &lanes, 10.0, -40.0),
        [5, 6, 2, 3, 4],
        "what lies before the entry is dropped"
    );
    let beside = [lanes[4], lanes[3], lanes[1], lanes[2]];
    assert_eq!(
        corrected(&map, &beside[..2], 10.0, -40.0)[..4],
        [5, 6, 2, 3]
    );
    let mut town = Town::default();
    let lanes = town.row(5);
    let (side, ramp) = (
        town.lane((0.0, -40.0), (20.0, -40.0)),
        town.lane((20.0, -40.0), (60.0, 0.0)),
    );
    town.link(side, ramp);
    town.link(ramp, lanes[3]);
    let map = town.build();
    assert_eq!(
        corrected(&map, &lanes, 10.0, -40.0),
        [0, 1, 2, 3, 4],
        "the fourth is no entry: left as it is"
    );
}

#[test]
fn searches_end_at_their_depth() {
    let mut town = Town::default();
    town.row(40);
    let map = town.build();
    let length = |start, target, direction, depth| {
        roadblock_chain(
            &map,
            RoadblockId(start),
            &[RoadblockId(target)],
            direction,
            depth,
        )
        .map(|chain| chain.len())
    };
    assert_eq!(length(20, 6, SearchDirection::Backward, 15), Some(15));
    assert_eq!(length(20, 5, SearchDirection::Backward, 15), None);
    assert_eq!(length(0, 29, SearchDirection::Forward, 30), Some(30));
    assert_eq!(length(0, 30, SearchDirection::Forward, 30), None);
    let forward: Vec<LaneId> = (30..40).map(LaneId).collect();
    assert_eq!(
        corrected(&map, &forward, 10.0, 0.0).len(),
        10,
        "31 roadblocks away: left as it is"
    );
    assert_eq!(
        corrected(&map, &forward, 30.0, 0.0).len(),
        39,
        "30 roadblocks away: joined"
    );
}

#[test]
fn of_equal_chains_the_roadblock_expanded_last_is_the_parent() {
    let mut town = Town::default();
    let [a, b, c, d] =
        [0.0, 1.0, 2.0, 3.0].map(|x| town.lane((20.0 * x, 0.0), (20.0 * x + 20.0, 0.0)));
    for (from, to) in [(a, b), (a, c), (b, d), (c, d)] {
        town.link(from, to);
    }
    let map = town.build();
    let chain = |from: LaneId, to: LaneId, direction| {
        let chain = roadblock_chain(
            &map,
            RoadblockId(from.0),
            &[RoadblockId(to.0)],
            direction,
            30,
        )
        .unwrap();
        chain.iter().map(|block| block.0).collect::<Vec<_>>()
    };
    assert_eq!(chain(a, d, SearchDirection::Forward), [0, 2, 3]);
    assert_eq!(
        chain(d, a, SearchDirection::Backward),
        [0, 2, 3],
        "in the direction of traffic as well"
    );
}

#[test]
fn gaps_are_closed_and_repetitions_dropped() {
    let mut town = Town::default();
    let lanes = town.row(6);
    let far = town.lane((0.0, 90.0), (20.0, 90.0));
    let map = town.build();
    assert_eq!(
        corrected(&map, &[lanes[0], lanes[1], lanes[4], lanes[5]], 10.0, 0.0),
        [0, 1, 2, 3, 4, 5]
    );
    assert_eq!(
        corrected(&map, &[lanes[0], far, lanes[3]], 10.0, 0.0),
        [0, 6, 3],
        "no way over: left as it is"
    );
    assert_eq!(
        corrected(&map, &[lanes[0], lanes[1], lanes[0], lanes[2]], 10.0, 0.0),
        [0, 1, 2]
    );
    assert!(corrected(&map, &[], 10.0, 0.0).is_empty());
}

#[test]
fn the_route_is_cut_before_a_connector_that_crosses_an_earlier_one() {
    let mut town = Town::default();
    let before = town.lane((-20.0, 0.0), (0.0, 0.0));
    let across = town.connector((0.0, 0.0), (20.0, 0.0));
    let between = town.lane((20.0, 0.0), (40.0, 0.0));
    // 4 m wide and long where it crosses: 16 m² are shared.
    let crossing = town.connector((10.0, -10.0), (10.0, 10.0));
    let after = town.lane((10.0, 10.0), (10.0, 30.0));
    // 4 m long, 0.2 m deep: 0.8 m² are shared.
    let touching = town.connector((10.0, 1.8), (10.0, 20.0));
    let map = town.build();
    assert_eq!(
        corrected(
            &map,
            &[before, across, between, crossing, after],
            -10.0,
            0.0
        ),
        [0, 1, 2]
    );
    assert_eq!(
        corrected(
            &map,
            &[before, across, between, touching, after],
            -10.0,
            0.0
        ),
        [0, 1, 2, 5, 4]
    );
    assert_eq!(
        corrected(&map, &[across, between], 10.0, 0.0),
        [1, 2],
        "the first can never cut"
    );
}

#[test]
fn the_starting_roadblock_is_on_the_route_if_it_can_be() {
    let mut town = Town::default();
    let (near, on) = (
        town.lane((0.0, 0.0), (20.0, 0.0)),
        town.lane((0.0, 1.5), (20.0, 1.5)),
    );
    let against = town.lane((20.0, 0.5), (0.0, 0.5));
    town.connector((100.0, 0.0), (120.0, 0.0));
    let map = town.build();
    let start = |route: &[LaneId], x, y, heading| {
        let found = starting_block(&map, &blocks(route), Pose::new(x, y, heading)).unwrap();
        (
            found.block.0,
            found
                .candidates
                .iter()
                .map(|block| block.0)
                .collect::<Vec<_>>(),
        )
    };
    assert_eq!(start(&[on], 10.0, 0.0, 0.0), (1, vec![1]));
    assert_eq!(
        start(&[], 10.0, 0.0, 0.0),
        (0, vec![0, 1]),
        "off the route: the nearest of those that qualify"
    );
    assert_eq!(
        start(&[near, on], 10.0, 0.0, 3.1),
        (2, vec![2]),
        "those against the traffic do not"
    );
    assert_eq!(
        start(&[near, on], 10.0, 0.0, 1.6).0,
        0,
        "none qualifies: the nearest of all"
    );
    assert_eq!(
        start(&[near], 60.0, 0.0, 0.0),
        (0, vec![0, 3]),
        "none here: the nearest of each kind"
    );
    assert_eq!(against, LaneId(2));
}

#[test]
fn the_current_lane_fits_by_heading_and_lies_on_the_route() {
    let mut town = Town::default();
    let straight = town.lane((0.0, 0.0), (20.0, 0.0));
    let turning = town.connector((0.0, 0.0), (14.0, 14.0));
    let beside = town.lane((0.0, 6.0), (20.0, 6.0));
    let map = town.build();
    let all = [straight, turning, beside];
    assert_eq!(
        current_lane(&map, &all, &ego(2.0, 0.0, 0.1)),
        Some(straight)
    );
    assert_eq!(current_lane(&map, &all, &ego(2.0, 0.0, 0.7)), Some(turning));
    assert_eq!(
        current_lane(&map, &[turning, beside], &ego(2.0, 0.0, 0.1)),
        Some(turning),
        "only the route counts"
    );
    // The rear axle is on no lane of the route; the centre, 1.461 m further, or the nearest polygon
    // decides.
    assert_eq!(
        current_lane(&map, &[beside, straight], &ego(-1.0, 0.0, 0.0)),
        Some(straight)
    );
    assert_eq!(
        current_lane(&map, &[straight, beside], &ego(10.0, 3.6, 0.0)),
        Some(beside)
    );
    assert_eq!(current_lane(&map, &[], &ego(2.0, 0.0, 0.0)), None);
}

#[test]
fn the_search_looks_thirty_roadblocks_ahead() {
    let mut town = Town::default();
    let lanes = town.row(35);
    let map = town.build();
    assert_eq!(
        lane_chain(&map, &blocks(&lanes), &lanes, lanes[0]),
        lanes[..30]
    );
    assert_eq!(
        lane_chain(&map, &blocks(&lanes), &lanes, lanes[10]),
        lanes[10..]
    );
}

#[test]
fn the_cheapest_chain_is_taken() {
    let mut town = Town::default();
    let start = town.lane((0.0, 0.0), (20.0, 0.0));
    let (long, short) = (
        town.lane((20.0, 0.0), (60.0, 0.0)),
        town.lane((20.0, 0.0), (50.0, 0.0)),
    );
    let end = town.lane((60.0, 0.0), (80.0, 0.0));
    for (from, to) in [(start, long), (start, short), (long, end), (short, end)] {
        town.link(from, to);
    }
    let map = town.build();
    let all = [start, long, short, end];
    assert_eq!(
        lane_chain(&map, &blocks(&all), &all, start),
        [start, short, end]
    );
    assert_eq!(
        lane_chain(&map, &blocks(&all), &[start, long, end], start),
        [start, long, end],
        "on the route only"
    );
}

#[test]
fn without_a_way_to_the_goal_the_deepest_and_then_the_cheapest_lane_ends_the_chain() {
    let mut town = Town::default();
    let start = town.lane((0.0, 0.0), (20.0, 0.0));
    // One link deep 5 m; two links deep 10 + 40 m and 15 + 20 m.
    let stub = town.lane((20.0, 0.0), (25.0, 0.0));
    let (a, b) = (
        town.lane((20.0, 0.0), (30.0, 0.0)),
        town.lane((20.0, 0.0), (35.0, 0.0)),
    );
    let (a_on, b_on) = (
        town.lane((30.0, 0.0), (70.0, 0.0)),
        town.lane((35.0, 0.0), (55.0, 0.0)),
    );
    let goal = town.lane((500.0, 0.0), (520.0, 0.0));
    for (from, to) in [(start, stub), (start, a), (start, b), (a, a_on), (b, b_on)] {
        town.link(from, to);
    }
    let map = town.build();
    let all = [start, stub, a, b, a_on, b_on, goal];
    assert_eq!(
        lane_chain(&map, &blocks(&all), &all, start),
        [start, b, b_on]
    );
    assert_eq!(route(&all).roadblocks.len(), 7);
}

#[test]
fn baselines_are_joined_with_both_poses_at_the_joint() {
    let mut town = Town::default();
    let lanes = town.row(2);
    let poses = centerline_poses(&town.build(), &lanes);
    let at_joint = poses
        .iter()
        .filter(|pose| (pose.position() - Point::new(20.0, 0.0)).norm() < 1e-12)
        .count();
    assert_eq!((poses.len(), at_joint), (2 * 41, 2));
}
