//! Monitoring: which version of the active plan is executed, when it stops, when a lane change is
//! aborted.

use crate::agent::{Script, code_source, planner_at, scenario, settings_with};
use planagent_agent::environment::{CenterlineName, DEFAULT_NODE_LENGTH, LaneGraph};
use planagent_agent::planner::{AgentLayer, PlanAgent, Planner, PlannerInput, PlannerName};
use planagent_agent::reasoning::Round;
use planagent_agent::reflection::{LeadPolicy, PlanMonitor, Version};
use planagent_agent::simulation::{Challenge, ClosedLoop};
use planagent_score::pdm::PdmMemory;
use planagent_world::geometry::{OrientedBox, Pose, Vector};
use planagent_world::{
    EgoState, LanePath, ObjectKind, STEP_US, SceneView, TrackToken, TrackedObject,
};
use std::sync::{Arc, Mutex};

/// How often each version of a plan was chosen: the plan itself, another one on its path, one
/// beside it, and the stop.
fn monitored_simulation(id: &str, monitor: &PlanMonitor, v0: f64) -> [usize; 4] {
    let scenario = scenario(id);
    let mut drive = ClosedLoop::new(&scenario, Challenge::NonReactive).unwrap();
    let mut count = [0; 4];
    for _ in 0..60 {
        let scene = drive.scene();
        let graph = LaneGraph::build(&scene, DEFAULT_NODE_LENGTH).unwrap();
        let planner = planner_at(&drive, &graph, v0, LeadPolicy::Nearest);
        let versions = planner.roll_out_versions(&scene, monitor.steps);
        assert_eq!(versions.len(), 16);
        assert_eq!(
            versions[0].1,
            planner.roll_out(&scene, monitor.steps),
            "the first is the plan itself"
        );
        assert_eq!(versions[15].0, Version::STOP);
        let choice = monitor
            .choose(&scene, &planner, &mut PdmMemory::default())
            .unwrap();
        let place = versions
            .iter()
            .position(|(version, _)| *version == choice.version)
            .unwrap();
        assert_eq!(choice.version.is_on_own_path(), place < 5);
        let again = planner.roll_out_version(choice.version, &scene, monitor.steps);
        assert_eq!(versions[place].1, again);
        count[match place {
            0 => 0,
            1..5 => 1,
            5..15 => 2,
            _ => 3,
        }] += 1;
        drive
            .advance(&again.to_trajectory(scene.ego).unwrap(), "monitored")
            .unwrap();
    }
    count
}

#[test]
fn a_monitored_plan_is_executed_itself_or_in_one_of_its_versions() {
    let monitor = PlanMonitor {
        steps: 40,
        threshold: 0.75,
        emergency_brake: true,
        handover: false,
        evasion: None,
    };
    let pedestrians = "generated/waiting_for_pedestrian_to_cross/0";
    let [unmonitored, slower, ..] = monitored_simulation(pedestrians, &monitor, 12.0);
    assert!(
        unmonitored > 0 && slower > 0,
        "itself {unmonitored}, slower {slower}"
    );

    // The path beside is taken only where the own one does not pass; if nothing passes, it is
    // compared with all.
    let never_passes = PlanMonitor {
        threshold: 1.1,
        ..monitor
    };
    let scenes = [
        "high_lateral_acceleration/0",
        "traversing_roundabout/0",
        "low_magnitude_speed/0",
    ];
    let beside = |monitor: &PlanMonitor| -> usize {
        scenes
            .iter()
            .map(|scene| monitored_simulation(&format!("generated/{scene}"), monitor, 12.0)[2])
            .sum()
    };
    let (first, compared) = (beside(&monitor), beside(&never_passes));
    assert!(first < compared, "{first} {compared}");
}

/// A vehicle that stands across `width` meters.
fn standing(at: Pose, width: f64) -> TrackedObject {
    let (token, velocity) = (TrackToken(9999), Vector::zeros());
    TrackedObject {
        token,
        kind: ObjectKind::Vehicle,
        shape: OrientedBox::new(at, 2.0, width),
        velocity,
    }
}

#[test]
fn a_lane_change_whose_score_falls_is_aborted() {
    let scenario = scenario("generated/changing_lane/4");
    let drive = ClosedLoop::new(&scenario, Challenge::NonReactive).unwrap();
    let free = SceneView {
        objects: &[],
        ..drive.scene()
    };
    let graph = LaneGraph::build(&free, DEFAULT_NODE_LENGTH).unwrap();
    let (own, left) = (
        graph.ego_lane(),
        graph.centerline(CenterlineName::LeftLane).unwrap(),
    );
    let answers = vec!["Generate_IDM_Planner(c=left_lane, la=None, v0=12, acc=1.5, dec=3)"];
    let code_source = code_source(
        Arc::new(Script {
            answers,
            asked: Mutex::default(),
        }),
        &[Round::Code],
    );
    let mut agent = PlanAgent::new(
        PlannerName::PLAN_AGENT,
        code_source,
        settings_with(|settings| settings.reflection.monitoring = true),
    )
    .layered();
    let mut step = |iteration, scene| {
        agent
            .compute_trajectory(&PlannerInput { iteration, scene })
            .unwrap();
        let bound_for = agent.state().active_plan().unwrap().lane_now(&free);
        (bound_for, agent.calls()[0].aborted_lane_change)
    };
    let lane =
        |path: &LanePath| path.lane_at(path.centerline.project(free.ego.center().position()).s);
    assert_eq!(step(0, free), (lane(&left.path), None));

    // A vehicle stands in the other lane now.
    let at = left.path.centerline.smooth_pose_at(left.ego_s + 28.0);
    let objects = [standing(at, 2.0)];
    let blocked = SceneView {
        objects: &objects,
        ..free
    };
    assert_eq!(step(1, blocked), (lane(&own.path), Some(1)));
    assert_eq!(
        step(2, free),
        (lane(&own.path), Some(1)),
        "until the next call"
    );
}

#[test]
fn planning_calls_come_early_while_something_stands_ahead() {
    let scenario = scenario("generated/changing_lane/4");
    let drive = ClosedLoop::new(&scenario, Challenge::NonReactive).unwrap();
    let before = drive.scene();
    let graph = LaneGraph::build(&before, DEFAULT_NODE_LENGTH).unwrap();
    let at = graph
        .ego_lane()
        .path
        .centerline
        .smooth_pose_at(graph.ego_lane().ego_s + 25.0);
    let calls = |objects: &[TrackedObject], blocked_interval_s: f64| -> Vec<usize> {
        let answers = vec!["Generate_IDM_Planner(c=ego_lane, la=None, v0=12, acc=1.5, dec=3)"];
        let code_source = code_source(
            Arc::new(Script {
                answers,
                asked: Mutex::default(),
            }),
            &[Round::Code],
        );
        let settings =
            settings_with(|settings| settings.agent.blocked_interval_s = blocked_interval_s);
        let mut agent = PlanAgent::new(PlannerName::PLAN_AGENT, code_source, settings).layered();
        for iteration in 0..=20 {
            let time_us = before.ego.time_us + iteration as i64 * STEP_US;
            let ego = EgoState::from_log(
                time_us,
                before.ego.rear_axle,
                before.ego.velocity,
                Vector::zeros(),
            );
            agent
                .compute_trajectory(&PlannerInput {
                    iteration,
                    scene: SceneView {
                        ego: &ego,
                        objects,
                        ..before
                    },
                })
                .unwrap();
        }
        agent.calls().iter().map(|call| call.iteration).collect()
    };
    let stands = [standing(at, 2.0)];
    assert_eq!(calls(&[], 0.5), [0, 20]);
    assert_eq!(calls(&stands, 0.5), [0, 5, 10, 15, 20]);
    assert_eq!(calls(&stands, 2.0), [0, 20], "the paper's interval");
}

#[test]
fn a_monitored_plan_stops_only_in_danger_and_only_if_it_may() {
    let scenario = scenario("generated/waiting_for_pedestrian_to_cross/0");
    let drive = ClosedLoop::new(&scenario, Challenge::NonReactive).unwrap();
    let before = drive.scene();
    let ego = EgoState::from_log(
        before.ego.time_us,
        before.ego.rear_axle,
        Vector::new(9.0, 0.0),
        Vector::zeros(),
    );
    let graph = LaneGraph::build(&before, DEFAULT_NODE_LENGTH).unwrap();
    let planner = planner_at(&drive, &graph, 12.0, LeadPolicy::Nearest);
    // A wall across all lanes, so far from the rear axle.
    let choose = |meters, emergency_brake| {
        let at = planner
            .path()
            .smooth_pose_at(planner.path().project(ego.rear_axle.position()).s + meters);
        let objects = [standing(at, 30.0)];
        let scene = SceneView {
            ego: &ego,
            objects: &objects,
            ..before
        };
        let monitor = PlanMonitor {
            steps: 40,
            threshold: 0.75,
            emergency_brake,
            handover: false,
            evasion: None,
        };
        monitor
            .choose(&scene, &planner, &mut PdmMemory::default())
            .unwrap()
    };
    // The code's 3 m/s² do not stop before it, 6 m/s² do.
    let (stops, drives) = (choose(16.0, true), choose(16.0, false));
    assert_eq!(stops.version, Version::STOP);
    assert_ne!(drives.version, Version::STOP);
    assert!(
        stops.score > 0.0 && drives.score == 0.0,
        "{stops:?} {drives:?}"
    );
    // Farther away they do, but the time to collision is short.
    let near = (17..40)
        .map(f64::from)
        .find(|&meters| choose(meters, false).score > 0.0)
        .unwrap();
    let (stops, drives) = (choose(near, true), choose(near, false));
    assert_eq!(stops.version, Version::STOP);
    assert!(
        stops.score > drives.score && drives.score < 0.75,
        "{near} m: {stops:?} {drives:?}"
    );
    // Nothing is near.
    assert_ne!(choose(60.0, true).version, Version::STOP);
}
