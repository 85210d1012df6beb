use super::*;
use crate::environment::lane_graph::{DEFAULT_NODE_LENGTH, LaneGraph};
use crate::environment::sketch::{self, Drawn, MIDDLE};
use planagent_world::ObjectKind::{Barrier, Bicycle, Pedestrian, TrafficCone, Vehicle};
use std::f64::consts::{FRAC_PI_2, PI};

fn facts(drawn: &Drawn) -> SceneFacts {
    let scene = drawn.scene();
    let graph = LaneGraph::build(&scene, DEFAULT_NODE_LENGTH).unwrap();
    SceneFacts::from_scene(GraphedScene::new(&scene, &graph))
}

fn road() -> Drawn {
    sketch::straight(3, 1, 1, 8.0)
}

#[test]
fn scene_types() {
    assert_eq!(facts(&road()).scene_type, SceneType::Straight);
    assert_eq!(
        facts(&sketch::curve(30.0, 5.0, 8.0)).scene_type,
        SceneType::CurveLeft
    );
    assert_eq!(
        facts(&sketch::curve(-30.0, 5.0, 8.0)).scene_type,
        SceneType::CurveRight
    );
    assert_eq!(
        facts(&sketch::curve(30.0, 60.0, 8.0)).scene_type,
        SceneType::Straight
    );
    assert_eq!(
        facts(&sketch::crossing(2, 0, 10.0, 8.0).0).scene_type,
        SceneType::Intersection
    );
    assert_eq!(
        facts(&sketch::crossing(2, 0, 50.0, 8.0).0).scene_type,
        SceneType::Straight
    );
    assert_eq!(
        facts(&sketch::roundabout(16.0, 5.0, 8.0)).scene_type,
        SceneType::Roundabout
    );
    assert_eq!(
        facts(&sketch::roundabout(16.0, 50.0, 8.0)).scene_type,
        SceneType::Straight
    );
}

#[test]
fn crossing_connectors_make_an_intersection_without_an_area() {
    let (with, _) = sketch::crossing(1, 0, 10.0, 8.0);
    let without = with.with_intersections(vec![]);
    assert!(without.map.intersections().is_empty());
    assert_eq!(facts(&without).scene_type, SceneType::Intersection);
}

#[test]
fn an_area_in_which_no_ways_cross_is_no_intersection() {
    let area = OrientedBox::new(Pose::new(15.0, 0.0, 0.0), 10.0, 30.0).to_polygon();
    assert_eq!(
        facts(&road().with_intersections(vec![area])).scene_type,
        SceneType::Straight
    );
}

#[test]
fn lights_and_turns_come_from_the_way_ahead() {
    use planagent_world::SignalStatus::{Green, Red, Unknown, Yellow};
    for (status, light) in [
        (Green, Light::Green),
        (Yellow, Light::Yellow),
        (Red, Light::Red),
        (Unknown, Light::None),
    ] {
        assert_eq!(
            facts(&sketch::crossing(1, 0, 20.0, 8.0).0.all_lights(status)).light,
            light
        );
    }
    assert_eq!(
        facts(&sketch::crossing(1, 0, 70.0, 8.0).0.all_lights(Red)).light,
        Light::None
    );
    assert_eq!(facts(&road()).light, Light::None);
    for (arm, turn) in [(0, Turn::Straight), (1, Turn::Left), (3, Turn::Right)] {
        let (drawn, arms) = sketch::crossing(1, 0, 20.0, 8.0);
        let (from, to) = (arms.inbound[0][0], arms.outbound[arm][0]);
        let by = drawn.between(from, to);
        assert_eq!(facts(&drawn.route_through(&[from, by, to])).turn, turn);
    }
}

#[test]
fn lanes_are_counted_from_the_left() {
    let abreast = |own, ego| {
        let facts = facts(&sketch::straight(own, 2, ego, 8.0));
        (facts.lane_count.as_str(), facts.lane_index.as_str())
    };
    assert_eq!(abreast(1, 0), ("1", "1"));
    assert_eq!(abreast(2, 1), ("2", "2"));
    assert_eq!(abreast(3, 0), ("3", "1"));
    assert_eq!(abreast(4, 3), ("4+", "4+"));
    assert_eq!(abreast(6, 2), ("4+", "3"));
}

#[test]
fn crosswalks_by_distance_from_the_front() {
    // The crosswalk of the own arm begins half a meter beyond the middle's edge.
    let at = |before: f64| facts(&sketch::crossing(1, 0, before, 8.0).0).crosswalk;
    let front = PACIFICA_FRONT;
    assert_eq!(at(front + 5.0 - 0.5), Ahead::Near);
    assert_eq!(at(front + 13.0 - 0.5), Ahead::Mid);
    assert_eq!(at(front + 25.0 - 0.5), Ahead::Far);
    assert_eq!(at(front + 35.0 - 0.5), Ahead::None);
    // On the middle, the crosswalk of the far arm comes next.
    assert_eq!(at(-MIDDLE), Ahead::Near);
    assert_eq!(facts(&road()).crosswalk, Ahead::None);
}

/// From the ego's box center to its front bumper, meters.
const PACIFICA_FRONT: f64 = 2.588;
/// From the center of a sketched vehicle to its rear bumper, meters.
const VEHICLE_REAR: f64 = 2.3;

#[test]
fn the_lead_is_the_nearest_that_drives_along_in_the_way() {
    let lead = |gap: f64, speed: f64| {
        let facts = facts(&road().put(
            Vehicle,
            PACIFICA_FRONT + VEHICLE_REAR + gap,
            0.3,
            0.0,
            speed,
        ));
        (facts.lead_distance, facts.lead_speed)
    };
    assert_eq!(lead(11.9, 0.2), (Ahead::Near, LeadSpeed::Stopped));
    assert_eq!(lead(12.1, 6.9), (Ahead::Mid, LeadSpeed::Slower));
    assert_eq!(lead(25.0, 7.1), (Ahead::Far, LeadSpeed::SameOrFaster));
    assert_eq!(
        lead(29.8, 7.1),
        (Ahead::None, LeadSpeed::None),
        "beyond the view"
    );
    let others = road()
        .put(Vehicle, 10.0, 3.5, 0.0, 5.0)
        .put(Vehicle, 12.0, 0.0, FRAC_PI_2, 5.0)
        .put(Vehicle, 16.0, 0.0, PI, 5.0)
        .put(Vehicle, -8.0, 0.0, 0.0, 5.0)
        .put(Pedestrian, 14.0, 0.0, 0.0, 0.0);
    assert_eq!(facts(&others).lead_distance, Ahead::None);
    assert_eq!(
        facts(&others.put(Bicycle, 28.0, 0.5, 0.0, 4.0)).lead_distance,
        Ahead::Far
    );
}

#[test]
fn pedestrians_count_in_the_corridor_of_the_path() {
    let at = |forward: f64, left: f64| {
        facts(&road().put(Pedestrian, forward, left, 0.0, 0.0)).pedestrian
    };
    assert_eq!(at(10.0, 3.1), Ahead::Near);
    assert_eq!(at(10.0, -3.1), Ahead::Near);
    assert_eq!(at(10.0, 3.3), Ahead::None);
    assert_eq!(at(20.0, 0.0), Ahead::Mid);
    assert_eq!(at(30.0, 0.0), Ahead::Far);
    assert_eq!(at(-5.0, 0.0), Ahead::None);
    // In a curve the corridor bends with the path.
    let bend = |forward: f64, left: f64| {
        facts(&sketch::curve(20.0, 3.0, 5.0).put(Pedestrian, forward, left, 0.0, 0.0)).pedestrian
    };
    assert_eq!(bend(22.5, 0.0), Ahead::None);
    assert_eq!(bend(21.0, 12.0), Ahead::Mid);
}

#[test]
fn what_stands_in_the_way_blocks() {
    assert_eq!(
        facts(&road().put(Vehicle, 15.0, 0.0, 0.0, 0.3)).blocked,
        Ahead::Near
    );
    assert_eq!(
        facts(&road().put(Vehicle, 15.0, 0.0, 0.0, 0.7)).blocked,
        Ahead::None
    );
    assert_eq!(
        facts(&road().put(TrafficCone, 20.0, 1.0, 0.0, 0.0)).blocked,
        Ahead::Mid
    );
    assert_eq!(
        facts(&road().put(Barrier, 30.0, 0.0, FRAC_PI_2, 0.0)).blocked,
        Ahead::Far
    );
    assert_eq!(
        facts(&road().put(TrafficCone, 20.0, 2.0, 0.0, 0.0)).blocked,
        Ahead::None
    );
    assert_eq!(
        facts(&road().put(Pedestrian, 20.0, 0.0, 0.0, 0.0)).blocked,
        Ahead::None
    );
}

#[test]
fn vehicles_across_and_against_and_persons_on_the_path_are_told() {
    // From the right toward the path, and away from it.
    let crossing = |left: f64, speed: f64| {
        facts(&road().put(Vehicle, 18.0, left, FRAC_PI_2, speed)).crossing_vehicle
    };
    assert_eq!(
        (crossing(-8.0, 5.0), crossing(8.0, 5.0), crossing(-8.0, 0.0)),
        (Ahead::Mid, Ahead::None, Ahead::None)
    );
    assert_eq!(crossing(0.0, 5.0), Ahead::Mid, "on the path");
    let oncoming = |left: f64, heading: f64| {
        facts(&road().put(Vehicle, 13.0, left, heading, 5.0)).oncoming_vehicle
    };
    assert_eq!(
        (oncoming(6.5, PI), oncoming(6.5, 0.0), oncoming(12.0, PI)),
        (Ahead::Near, Ahead::None, Ahead::None)
    );
    // Two meters beside the strip: standing, and walking onto it.
    let person =
        |speed: f64| facts(&road().put(Pedestrian, 20.0, -3.0, FRAC_PI_2, speed)).person_on_path;
    assert_eq!((person(0.0), person(1.5)), (Ahead::None, Ahead::Mid));
}

#[test]
fn side_lanes_are_free_or_occupied() {
    use SideLane::{Free, None, Occupied};
    let sides = |drawn: Drawn| (facts(&drawn).left_lane, facts(&drawn).right_lane);
    assert_eq!(sides(road()), (Free, Free));
    assert_eq!(sides(sketch::straight(2, 1, 0, 8.0)), (None, Free));
    assert_eq!(sides(sketch::straight(1, 1, 0, 8.0)), (None, None));
    assert_eq!(
        sides(road().put(Vehicle, -12.0, 3.5, 0.0, 9.0)),
        (Occupied, Free)
    );
    assert_eq!(
        sides(road().put(Vehicle, -13.5, 3.5, 0.0, 9.0)),
        (Free, Free)
    );
    assert_eq!(
        sides(road().put(TrafficCone, 10.0, -3.5, 0.0, 0.0)),
        (Free, Occupied)
    );
    assert_eq!(
        sides(road().put(Vehicle, 0.0, 7.0, PI, 9.0)),
        (Free, Free),
        "oncoming lane"
    );
}

#[test]
fn counts_oncoming_and_speed() {
    let mut drawn = road();
    let counts = [
        (0, "0"),
        (1, "1-2"),
        (2, "1-2"),
        (3, "3-5"),
        (5, "3-5"),
        (6, "6+"),
    ];
    for (count, text) in counts {
        while drawn.objects.len() < count {
            let forward = -25.0 + 8.0 * drawn.objects.len() as f64;
            drawn = drawn.put(Vehicle, forward, 7.0, PI, 5.0);
        }
        assert_eq!(facts(&drawn).vehicle_count.as_str(), text);
    }
    assert_eq!(
        facts(&road().put(Vehicle, 40.0, 0.0, 0.0, 0.0)).vehicle_count,
        VehicleCount::Zero
    );
    assert_eq!(facts(&road()).oncoming, Oncoming::Yes);
    assert_eq!(
        facts(&sketch::straight(3, 0, 1, 8.0)).oncoming,
        Oncoming::No
    );
    assert_eq!(
        facts(&sketch::crossing(1, 0, 30.0, 8.0).0).oncoming,
        Oncoming::Yes
    );
    for (speed, text) in [
        (0.0, "stopped"),
        (3.0, "slow"),
        (7.0, "medium"),
        (12.0, "fast"),
    ] {
        assert_eq!(
            facts(&sketch::straight(1, 0, 0, speed)).ego_speed.as_str(),
            text
        );
    }
}

#[test]
fn every_answer_is_one_of_the_choices_and_reads_back() {
    let facts = facts(&road().put(Vehicle, 15.0, 0.0, 0.0, 3.0));
    for &question in Question::ALL {
        assert!(
            question.choices().contains(&facts.answer(question)),
            "{question}"
        );
    }
    for &text in SceneType::TEXTS {
        assert_eq!(text.parse::<SceneType>().unwrap().as_str(), text);
    }
    let unknown = "ramp".parse::<SceneType>().unwrap_err();
    assert_eq!(unknown.choice, "SceneType");
    let json = serde_json::to_string(&facts).unwrap();
    assert_eq!(serde_json::from_str::<SceneFacts>(&json).unwrap(), facts);
}
