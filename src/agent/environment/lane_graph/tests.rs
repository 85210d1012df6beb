use super::*;
use crate::environment::sketch::{self, Drawn};
use planagent_world::ObjectKind::{Barrier, Bicycle, Pedestrian, TrafficCone, Vehicle};
use planagent_world::geometry::Vector;
use planagent_world::{EgoState, LaneId, PACIFICA, SignalStatus};
use proptest::prelude::*;
use std::f64::consts::{FRAC_PI_2, PI};

pub(super) fn graph(drawn: &Drawn) -> LaneGraph {
    LaneGraph::build(&drawn.scene(), DEFAULT_NODE_LENGTH).unwrap()
}

fn places(graph: &LaneGraph) -> Vec<&'static str> {
    graph.nodes.iter().map(|node| node.place.as_str()).collect()
}

#[test]
fn an_unknown_limit_is_estimated_by_lanes_and_traffic() {
    let estimate = |drawn: Drawn| format!("{:.1}", graph(&drawn).limit_estimate);
    let road = |lanes, speed| sketch::straight(lanes, 1, 0, speed);
    assert_eq!(
        [
            estimate(road(1, 5.0)),
            estimate(road(2, 5.0)),
            estimate(road(4, 5.0))
        ],
        ["11.2", "13.4", "15.6"]
    );
    assert_eq!(estimate(road(1, 17.0)), "15.6", "the ego is faster");
    assert_eq!(
        estimate(road(1, 5.0).put(Vehicle, 15.0, 0.0, 0.0, 18.0)),
        "17.9"
    );
    assert_eq!(
        estimate(road(1, 5.0).put(Vehicle, 15.0, 3.5, PI, 18.0)),
        "11.2",
        "the other direction"
    );
}

#[test]
fn a_three_lane_road_has_nine_nodes_of_one_length() {
    let graph = graph(&sketch::straight(3, 2, 1, 9.0));
    assert_eq!(places(&graph), NodePlace::TEXTS);
    for node in &graph.nodes {
        assert!(
            (node.to_s - node.from_s - DEFAULT_NODE_LENGTH).abs() < 1e-9,
            "{node:?}"
        );
    }
    let connections: Vec<&str> = graph
        .nodes
        .iter()
        .map(|node| node.connection.as_str())
        .collect();
    let beside = ["neighbor"; 6];
    assert_eq!(connections[..3], ["itself", "successor", "predecessor"]);
    assert_eq!(connections[3..], beside);
    let names: Vec<&str> = graph.centerlines.iter().map(|c| c.name.as_str()).collect();
    assert_eq!(names, ["ego_lane", "left_lane", "right_lane"]);
    assert!(
        graph
            .centerlines
            .iter()
            .all(|c| c.ahead() >= 8.0 * 13.4 && c.speed_limit == Some(13.4))
    );
}

#[test]
fn the_outer_lanes_have_a_side_less() {
    assert_eq!(
        graph(&sketch::straight(3, 2, 0, 9.0)).centerline(CenterlineName::LeftLane),
        None
    );
    assert_eq!(
        graph(&sketch::straight(3, 2, 2, 9.0)).centerline(CenterlineName::RightLane),
        None
    );
    assert_eq!(
        places(&graph(&sketch::straight(1, 2, 0, 9.0))),
        ["ego", "front", "back"]
    );
}

#[test]
fn nodes_that_the_map_does_not_reach_do_not_exist() {
    // The lane ends where the bend of a quarter circle does, 10 + 31.4 m ahead; a node there needs
    // its middle at 27.4 m.
    assert_eq!(
        places(&graph(&sketch::curve(20.0, 10.0, 5.0))),
        ["ego", "front", "back"]
    );
    assert_eq!(
        places(&graph(&sketch::curve(20.0, -8.0, 5.0))),
        ["ego", "back"]
    );
    // 100 m of road lie before the bend.
    assert_eq!(
        places(&graph(&sketch::curve(20.0, 97.0, 5.0))),
        ["ego", "front"]
    );
}

#[test]
fn agents_are_named_by_lane_nearest_ahead_first() {
    let drawn = sketch::straight(3, 1, 1, 9.0)
        .put(Vehicle, -9.0, 0.0, 0.0, 8.0)
        .put(Vehicle, 30.0, 0.0, 0.0, 8.0)
        .put(Vehicle, 14.0, 0.2, 0.0, 6.0)
        .put(Vehicle, 6.0, 3.5, 0.0, 7.0)
        .put(Bicycle, 20.0, -3.5, 0.0, 4.0)
        .put(TrafficCone, 22.0, -3.0, 0.0, 0.0)
        .put(Vehicle, 60.0, 0.0, 0.0, 8.0)
        .put(Vehicle, 10.0, 7.0, PI, 8.0);
    let graph = graph(&drawn);
    let named: Vec<(String, u32, &str)> = graph
        .agents
        .iter()
        .map(|a| (a.name.to_string(), a.token.0, a.place.as_str()))
        .collect();
    let expected = [
        ("vehicle1", 2, "ego"),
        ("vehicle2", 1, "front"),
        ("vehicle3", 0, "back"),
        ("vehicle4", 3, "left"),
        ("bicycle1", 4, "front_right"),
        ("obstacle1", 5, "front_right"),
    ];
    assert_eq!(
        named,
        expected.map(|(name, token, place)| (name.to_owned(), token, place))
    );
    let lead_agent = |name| graph.lead_agent(name).map(|agent| agent.name.to_string());
    assert_eq!(lead_agent(CenterlineName::EgoLane).unwrap(), "vehicle1");
    assert_eq!(lead_agent(CenterlineName::LeftLane).unwrap(), "vehicle4");
    assert_eq!(lead_agent(CenterlineName::RightLane).unwrap(), "bicycle1");
    let first = &graph.agents[0];
    assert!((first.offset - 14.0).abs() < 1e-9 && (first.gap - (14.0 - 2.588 - 2.3)).abs() < 1e-9);
    assert!((first.lateral - 0.2).abs() < 1e-9 && (first.along_speed - 6.0).abs() < 1e-9);
}

#[test]
fn who_reaches_into_the_ego_lane_leads_there() {
    // A vehicle that cuts in: its center is still on the left lane, its side in the ego's way.
    let drawn = sketch::straight(2, 0, 1, 9.0).put(Vehicle, 12.0, 2.2, -0.1, 7.0);
    let graph = graph(&drawn);
    assert_eq!(graph.agents[0].place, NodePlace::Ego);
    assert_eq!(
        graph.lead_agent(CenterlineName::EgoLane),
        Some(&graph.agents[0])
    );
    assert_eq!(
        graph.lead_agent(CenterlineName::LeftLane),
        Some(&graph.agents[0])
    );
}

#[test]
fn pedestrians_lead_when_they_are_about_to_cross() {
    let lead_agent = |left: f64, turn: f64, speed: f64| {
        let drawn = sketch::straight(1, 0, 0, 5.0).put(Pedestrian, 12.0, left, turn, speed);
        let graph = graph(&drawn);
        (
            graph.agents.len(),
            graph.lead_agent(CenterlineName::EgoLane).is_some(),
        )
    };
    assert_eq!(
        lead_agent(3.0, -FRAC_PI_2, 1.4),
        (1, true),
        "walks towards the lane"
    );
    assert_eq!(
        lead_agent(3.0, FRAC_PI_2, 1.4),
        (1, false),
        "walks away from it"
    );
    assert_eq!(lead_agent(3.0, 0.0, 0.0), (1, false), "waits at the kerb");
    assert_eq!(lead_agent(6.0, 0.0, 0.0), (0, false), "is far from it");
    assert_eq!(lead_agent(0.5, 0.0, 0.0), (1, true), "stands on it");
}

#[test]
fn headings_are_told_apart() {
    let heading = |turn: f64, speed: f64| {
        graph(&sketch::straight(1, 0, 0, 5.0).put(Vehicle, 14.0, 0.0, turn, speed)).agents[0]
            .heading
    };
    assert_eq!(heading(0.5, 4.0), Heading::Along);
    assert_eq!(heading(FRAC_PI_2, 4.0), Heading::Crossing);
    assert_eq!(heading(PI, 4.0), Heading::Oncoming);
    assert_eq!(heading(PI, 0.1), Heading::Along);
}

#[test]
fn lights_are_found_with_the_distance_to_the_stop_line() {
    let light = |before: f64| {
        let (drawn, _) = sketch::crossing(1, 0, before, 5.0);
        graph(&drawn.all_lights(SignalStatus::Red)).ego_lane().light
    };
    // The stop line lies one meter before the connector, the front bumper 2.588 m before the ego's
    // center.
    let found = light(20.0).unwrap();
    assert_eq!(found.status, SignalStatus::Red);
    assert!(
        (found.distance - (20.0 - 1.0 - 2.588)).abs() < 1e-6,
        "{}",
        found.distance
    );
    assert!(light(2.0).unwrap().distance.abs() < 1e-9);
    assert_eq!(light(0.0), None, "already under way");
    assert_eq!(light(70.0), None, "too far");
    let unseen = graph(&sketch::crossing(1, 0, 20.0, 5.0).0)
        .ego_lane()
        .light
        .unwrap();
    assert_eq!(unseen.status, SignalStatus::Unknown);
}

#[test]
fn the_route_decides_the_turn_and_lanes_that_leave_it_lie_apart() {
    let (drawn, arms) = sketch::crossing(2, 0, 10.0, 5.0);
    let (from, to) = (arms.inbound[0][0], arms.outbound[1][0]);
    let by = drawn.between(from, to);
    let graph = graph(&drawn.route_through(&[from, by, to]));
    assert_eq!(graph.ego_lane().turn, Turn::Left);
    assert!(graph.ego_lane().path.lanes.contains(&by));
    assert_eq!(
        graph.node(NodePlace::FrontRight).unwrap().connection,
        Connection::Apart
    );
    assert_eq!(
        graph.node(NodePlace::Right).unwrap().connection,
        Connection::Neighbor
    );
}

#[test]
fn on_a_crossing_the_route_decides_the_lane() {
    let (drawn, arms) = sketch::crossing(1, 0, 0.5, 5.0);
    for arm in [0, 1, 3] {
        let (from, to) = (arms.inbound[0][0], arms.outbound[arm][0]);
        let by = drawn.between(from, to);
        let mut there = sketch::crossing(1, 0, -1.0, 5.0).0;
        there = there.route_through(&[from, by, to]);
        let graph = graph(&there);
        assert_eq!(graph.node(NodePlace::Ego).unwrap().lane, by);
    }
}

#[test]
fn an_ego_that_cuts_a_corner_belongs_to_the_lane_of_the_route() {
    let (drawn, arms) = sketch::crossing(1, 0, 0.5, 5.0);
    let (from, to) = (arms.inbound[0][0], arms.outbound[1][0]);
    let by = drawn.between(from, to);
    let mut drawn = drawn.route_through(&[from, by, to]);
    let line = drawn.map[by].centerline.clone();
    let beside = line.pose_at(line.length() / 4.0).translated(0.0, -2.2);
    drawn.ego.rear_axle = beside.translated(-PACIFICA.rear_axle_to_center(), 0.0);
    let straight = drawn.between(from, arms.outbound[0][0]);
    assert_eq!(drawn.map.lane_of(beside, 0.0), Some(straight));
    assert_eq!(graph(&drawn).node(NodePlace::Ego).unwrap().lane, by);
}

#[test]
fn off_the_road_there_is_an_error_and_no_panic() {
    let mut drawn = sketch::straight(1, 0, 0, 5.0).put(Barrier, 5.0, 0.0, 0.0, 0.0);
    drawn.ego.rear_axle.y = 40.0;
    assert!(matches!(
        LaneGraph::build(&drawn.scene(), 20.0),
        Err(LaneGraphError::OffRoad { .. })
    ));
    drawn.ego.rear_axle.y = f64::NAN;
    assert!(matches!(
        LaneGraph::build(&drawn.scene(), 20.0),
        Err(LaneGraphError::NotFinite { .. })
    ));
    assert_eq!(
        LaneGraph::build(&drawn.scene(), 0.0),
        Err(LaneGraphError::NodeLength(0.0))
    );
    drawn.ego.rear_axle.y = 3.5;
    assert!(
        LaneGraph::build(&drawn.scene(), 20.0).is_ok(),
        "just beside the road"
    );
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn every_agent_is_on_a_node_that_exists_and_names_are_unique(
        lane in 0..3u32,
        objects in prop::collection::vec((-60.0..60.0f64, -12.0..12.0f64, -3.2..3.2f64, 0.0..15.0f64, 0..4usize), 0..20),
    ) {
        let kinds = [Vehicle, Bicycle, Pedestrian, TrafficCone];
        let mut drawn = sketch::straight(3, 1, lane, 8.0);
        for (forward, left, turn, speed, kind) in objects {
            drawn = drawn.put(kinds[kind], forward, left, turn, speed);
        }
        let graph = graph(&drawn);
        let mut names: Vec<AgentName> = graph.agents.iter().map(|agent| agent.name).collect();
        names.sort_unstable();
        names.dedup();
        prop_assert_eq!(names.len(), graph.agents.len());
        for agent in &graph.agents {
            prop_assert!(graph.node(agent.place).is_some());
            prop_assert!(agent.gap >= 0.0 && agent.gap <= agent.offset.abs());
        }
        for &name in CenterlineName::ALL {
            if let Some(lead_agent) = graph.lead_agent(name) {
                prop_assert!(lead_agent.offset > 0.0);
            }
        }
    }

    #[test]
    fn any_pose_gives_a_graph_or_an_error(x in -150.0..150.0f64, y in -40.0..40.0f64, heading in -3.2..3.2f64) {
        let (mut drawn, _) = sketch::crossing(2, 0, 10.0, 5.0);
        drawn.ego.rear_axle = planagent_world::geometry::Pose::new(x, y, heading);
        if let Ok(graph) = LaneGraph::build(&drawn.scene(), DEFAULT_NODE_LENGTH) {
            prop_assert_eq!(graph.nodes[0].place, NodePlace::Ego);
        }
    }
}

/// A road with three lanes and the ego on the middle one, with a goal so many lanes to the left and
/// meters ahead.
fn with_goal(to_the_left: i32, ahead: f64) -> Drawn {
    let mut drawn = sketch::straight(3, 0, 1, 10.0);
    let goal = drawn
        .ego
        .center()
        .translated(ahead, f64::from(to_the_left) * sketch::WIDTH);
    drawn.route.goal_lane = drawn.map.lanes_at(goal.position()).first().copied();
    drawn.route.goal = Some(PACIFICA.rear_axle_of(goal));
    drawn
}

#[test]
fn the_goal_is_counted_in_lane_changes_from_the_ego() {
    let goal = |drawn: Drawn| graph(&drawn).goal;
    assert_eq!(
        goal(sketch::straight(3, 0, 1, 10.0)),
        None,
        "the route has none"
    );
    for changes in [-1, 0, 1] {
        let found = goal(with_goal(changes, 80.0)).unwrap();
        assert!(
            found.changes == changes && (found.distance - 80.0).abs() < 0.1,
            "{found:?}"
        );
    }
    assert_eq!(goal(with_goal(1, -5.0)), None, "it lies behind");
    let mut recorded = with_goal(1, 80.0);
    recorded.route.goal_lane = None;
    assert_eq!(goal(recorded), None, "the end of a recording is no task");
    let [near, behind] =
        [0.5, -0.5].map(|ahead| GoalLane::from_scene(&with_goal(-1, ahead).scene()).unwrap());
    assert!(
        near.changes == -1 && behind.changes == -1 && behind.distance < 0.0,
        "{near:?} {behind:?}"
    );
}

#[test]
fn a_goal_beyond_the_ego_s_lane_is_counted_where_the_path_enters_its_roadblock() {
    let (mut drawn, arms) = sketch::crossing(2, 0, 30.0, 7.0);
    let (ahead, right) = (&arms.outbound[0], &arms.outbound[3]);
    let mut found = |from: LaneId, to: LaneId, goal: LaneId| {
        let route = [from, drawn.between(from, to), to];
        drawn.route.roadblocks = route
            .iter()
            .map(|&lane| drawn.map[lane].roadblock)
            .collect();
        drawn.route.goal = Some(drawn.map[goal].centerline.pose_at(20.0));
        drawn.route.goal_lane = Some(goal);
        graph(&drawn).goal.unwrap()
    };
    let [left_lane, right_lane] = [arms.inbound[0][0], arms.inbound[0][1]];
    let own = found(left_lane, ahead[0], ahead[0]);
    let beside = found(left_lane, ahead[0], ahead[1]);
    let turn = found(right_lane, right[1], right[1]);
    assert_eq!((own.changes, beside.changes), (0, -1));
    assert!(
        (own.distance - beside.distance).abs() < 1.0 && own.distance > 70.0,
        "{own:?} {beside:?}"
    );
    assert_eq!(turn.changes, -1, "only the lane to the right turns there");
}

#[test]
fn past_what_blocks_it_the_lane_that_the_ego_left_is_the_goal_s() {
    // A car that broke down 25 m ahead, in the right one of two lanes.
    let road = || sketch::straight(2, 0, 1, 8.0).put(Vehicle, 25.0, 0.0, 0.3, 0.0);
    let left_it = graph(&road());
    let lane = ReturnLane::from_graph(&left_it).unwrap();
    let at = |ahead: f64, aside: f64| {
        let mut drawn = road();
        let (rear_axle, velocity) = (
            drawn.ego.rear_axle.translated(ahead, aside),
            drawn.ego.velocity,
        );
        drawn.ego = EgoState::from_log(0, rear_axle, velocity, Vector::zeros());
        let graph = graph(&drawn);
        let is_reached = lane.is_reached(GraphedScene::new(&drawn.scene(), &graph));
        (
            graph.with_return_lane(&drawn.scene(), &lane).goal,
            is_reached,
        )
    };
    assert_eq!(at(0.0, 0.0), (None, false));
    assert_eq!(at(25.0, sketch::WIDTH), (None, false), "beside the car");
    let (goal, is_reached) = at(35.0, sketch::WIDTH);
    let goal = goal.unwrap();
    assert!(
        goal.changes == -1 && goal.distance > 50.0 && !is_reached,
        "{goal:?}"
    );
    assert_eq!(at(35.0, 0.0), (None, true));
    assert_eq!(
        ReturnLane::from_graph(&graph(&sketch::straight(2, 0, 1, 8.0))),
        None,
        "nothing blocks the lane"
    );
}

#[test]
fn a_lane_is_obstructed_by_what_blocks_it_and_by_a_lead_agent_that_stands() {
    let is_obstructed = |drawn: Drawn| graph(&drawn).is_obstructed();
    let road = || sketch::straight(2, 0, 1, 8.0);
    assert!(!is_obstructed(road()));
    assert!(
        !is_obstructed(road().put(Vehicle, 25.0, 0.0, 0.0, 4.0)),
        "it moves"
    );
    assert!(
        !is_obstructed(road().put(Bicycle, 25.0, 0.0, 0.0, 0.0)),
        "it may start"
    );
    assert!(
        !is_obstructed(road().put(Vehicle, 25.0, sketch::WIDTH, 0.0, 0.0)),
        "it stands in the other lane"
    );
    assert!(is_obstructed(road().put(Vehicle, 25.0, 0.0, 0.0, 0.0)));
    assert!(is_obstructed(road().put(TrafficCone, 25.0, 0.0, 0.0, 0.0)));
}
