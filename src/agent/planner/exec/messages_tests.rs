//! The documented messages, and the bounds of a plan.

use super::agents::ExecAgentsStep;
use super::messages::*;
use planagent_world::geometry::{Pose, Vector};
use planagent_world::{EgoState, PACIFICA, STEP_S, Trajectory};

fn plan(states: &[(f64, f64)]) -> Result<Trajectory, String> {
    let still = Vector::new(0.0, 0.0);
    let ego = EgoState::from_log(0, Pose::new(1000.0, 0.0, 0.0), still, still);
    let state = |&(t, x): &(f64, f64)| ExecState {
        t,
        x,
        y: 0.0,
        heading: 0.0,
        speed: 0.0,
        acceleration: 0.0,
        steering_angle: 0.0,
    };
    trajectory(&states.iter().map(state).collect::<Vec<_>>(), &ego)
}

/// The messages of `docs/exec.md`, in their order.
fn documented() -> Vec<serde_json::Value> {
    let page = include_str!("../../../../docs/exec.md");
    let blocks = page.split("```json\n").skip(1);
    blocks
        .map(|block| block.split("```").next().unwrap_or_default())
        .map(|block| serde_json::from_str(block).unwrap())
        .collect()
}

#[test]
fn the_documented_messages_are_complete() {
    let ego = |time_us, x| ExecEgo {
        time_us,
        x,
        y: 0.0,
        heading: 0.0,
        velocity: [8.0, 0.0],
        acceleration: [0.0, 0.0],
        steering_angle: 0.0,
        angular_velocity: 0.0,
    };
    let object = |x| ExecObject {
        track: 7,
        kind: "vehicle".to_owned(),
        x,
        y: 0.2,
        heading: 0.01,
        length: 4.6,
        width: 1.9,
        velocity: [6.0, 0.0],
    };
    let ring = |x0: f64, x1: f64, y0: f64, y1: f64| vec![[x0, y0], [x1, y0], [x1, y1], [x0, y1]];
    let light = || ExecLight {
        lane: 4,
        status: "red".to_owned(),
    };
    let initialization = ExecRequest::Initialize(Box::new(ExecInitialization {
        version: 1,
        step_s: STEP_S,
        vehicle: ExecVehicle {
            width: PACIFICA.width,
            front_length: PACIFICA.front_length,
            rear_length: PACIFICA.rear_length,
            wheel_base: PACIFICA.wheel_base,
        },
        map: ExecMap {
            lanes: vec![ExecLane {
                id: 0,
                connector: false,
                centerline: vec![[0.0, 0.0], [100.0, 0.0]],
                polygon: ring(0.0, 100.0, -1.8, 1.8),
                incoming: vec![],
                outgoing: vec![4],
                left: vec![1],
                right: vec![],
                roadblock: 0,
                speed_limit: Some(13.4),
            }],
            stop_lines: vec![ExecStopLine {
                polygon: ring(99.0, 100.0, -1.8, 1.8),
                lanes: vec![4],
                stop_sign: false,
            }],
            intersections: vec![ring(100.0, 120.0, -8.0, 8.0)],
            crosswalks: vec![ring(96.0, 98.0, -4.0, 4.0)],
            drivable: vec![ring(0.0, 100.0, -2.0, 6.0)],
        },
        route: ExecRoute {
            roadblocks: vec![0, 2],
            lanes: vec![0, 1, 4],
            goal: Some([180.0, 0.0, 0.0]),
            goal_lane: None,
        },
    }));
    let step = ExecRequest::Step(Box::new(ExecStep {
        iteration: 0,
        ego: ego(2_000_000, 20.0),
        objects: vec![object(45.0)],
        lights: vec![light()],
        history: vec![ExecSample {
            ego: ego(1_900_000, 19.2),
            objects: vec![object(44.4)],
        }],
    }));
    let agents = ExecRequest::Agents(Box::new(ExecAgentsStep {
        iteration: 1,
        dt_s: 0.1,
        ego: ego(2_000_000, 20.0),
        objects: vec![object(45.0)],
        lights: vec![light()],
        logged: vec![object(45.6)],
    }));
    let shown = documented();
    assert_eq!(shown.len(), 7);
    for (request, place) in [(initialization, 0), (step, 2), (agents, 4)] {
        assert_eq!(serde_json::to_value(&request).unwrap(), shown[place]);
    }
    for (place, kind) in [(1, "ready"), (3, "trajectory"), (5, "agents"), (6, "error")] {
        let reply: ExecReply = serde_json::from_value(shown[place].clone()).unwrap();
        assert_eq!(shown[place]["type"], kind);
        if let ExecReply::Trajectory { states } = reply {
            let ego = EgoState::from_log(
                2_000_000,
                Pose::new(20.0, 0.0, 0.0),
                Vector::new(8.0, 0.0),
                Vector::new(0.0, 0.0),
            );
            trajectory(&states, &ego).unwrap();
        }
    }
}

#[test]
fn a_plan_has_two_states_and_starts_at_the_ego() {
    for plan_states in [
        &[(0.0, 1000.0), (8.0, 1000.0)][..],
        &[(0.1, 1000.2), (0.2, 1000.4)],
        &[(0.0, 1004.9), (1.0, 1100.0)],
        &[(-1.0, 980.0), (1.0, 1020.0)],
    ] {
        assert!(
            plan(plan_states).is_ok(),
            "{plan_states:?}: {:?}",
            plan(plan_states)
        );
    }
    for (states, expected) in [
        (&[][..], "at least 2 states, got 0"),
        (&[(0.5, 1001.0)], "at least 2 states, got 1"),
        (&[(0.0, 0.0), (1.0, 10.0)], "1000.0 m away from the ego now"),
        (&[(0.1, 5.0), (0.2, 6.0)], "jumps 995.0 m in 0.10 s"),
        (
            &[(0.0, 1000.0), (0.5, 1002.0), (1.0, 2000.0)],
            "jumps 998.0 m in 0.50 s to its state at 1.00 s",
        ),
        (&[(1e9, 1000.0), (2e9, 1000.0)], "the time of state 0"),
        (&[(10.0, 1000.0), (10.1, 1000.0)], "begins 10.0 s from now"),
        (&[(0.0, 1000.0), (0.0, 1000.0)], "not after"),
    ] {
        let error = plan(states).unwrap_err();
        assert!(error.contains(expected), "{states:?}: {error}");
    }
}
