use super::run::simulate_with_progress;
use super::*;
use crate::planner::{LogReplay, Planner, PlannerError, PlannerInitialization, PlannerInput};
use crate::test_road::{Stretch, ego_at, object, straight_road, whole_route};
use planagent_scenario::{Frame, Scenario};
use planagent_world::geometry::Pose;
use planagent_world::{
    HISTORY_SAMPLES, ObjectKind, STEP_S, STEP_US, TrackedObject, TrafficLights, Trajectory,
    TrajectoryState,
};
use std::sync::Arc;

const PAST: usize = 21;
const ITERATIONS: usize = 151;

/// A scenario along a straight road at constant speed with `objects` at each iteration (negative:
/// past).
fn straight_drive(speed: f64, objects: impl Fn(i64) -> Vec<TrackedObject>) -> Scenario {
    let map = straight_road(
        &[
            Stretch::Lane(100.0),
            Stretch::Connector(30.0),
            Stretch::Lane(300.0),
        ],
        Some(15.0),
    );
    let frame = |i: usize| {
        let k = i as i64 - PAST as i64;
        Frame {
            ego: ego_at(
                1_000_000_000 + k * STEP_US,
                40.0 + speed * STEP_S * k as f64,
                speed,
            ),
            objects: objects(k).into(),
            lights: Arc::new(TrafficLights::default()),
        }
    };
    Scenario {
        id: "straight".into(),
        scenario_type: "unknown".into(),
        log_name: "test".into(),
        route: whole_route(&map),
        map: Arc::new(map),
        frames: (0..PAST + ITERATIONS).map(frame).collect(),
        start: PAST,
        future: vec![],
        interaction: None,
    }
}

fn log_replay(scenario: &Scenario) -> LogReplay {
    LogReplay::new(scenario.recorded().copied().collect())
}

#[test]
fn log_replay_tracks_the_recorded_drive() {
    let scenario = straight_drive(8.0, |_| vec![]);
    for challenge in Challenge::ALL {
        let log = simulate(&scenario, &mut log_replay(&scenario), challenge).unwrap();
        assert_eq!(log.samples.len(), ITERATIONS - 1);
        assert_eq!(
            (log.trajectories.len(), log.runtimes_s.len()),
            (ITERATIONS - 1, ITERATIONS - 1)
        );
        for (sample, expert) in log.samples.iter().zip(scenario.expert()) {
            assert_eq!(sample.ego.time_us, expert.time_us);
            assert!(sample.ego.rear_axle.distance(&expert.rear_axle) < 0.02);
        }
    }
}

#[test]
fn replayed_objects_are_those_of_the_iteration() {
    let scenario = straight_drive(8.0, |k| {
        vec![object(1, ObjectKind::Bicycle, 60.0 + k as f64, 1.0, 10.0)]
    });
    let log = simulate(
        &scenario,
        &mut log_replay(&scenario),
        Challenge::NonReactive,
    )
    .unwrap();
    for (k, sample) in log.samples.iter().enumerate() {
        assert_eq!(sample.objects, scenario.frame(k).unwrap().objects);
    }
    let reactive = simulate(&scenario, &mut log_replay(&scenario), Challenge::Reactive).unwrap();
    assert!(
        reactive
            .samples
            .iter()
            .all(|sample| sample.objects.is_empty()),
        "bicycles do not exist there"
    );
}

#[test]
fn reactive_traffic_stops_behind_a_standing_ego() {
    let behind = |_: i64| vec![object(1, ObjectKind::Vehicle, 15.0, 0.0, 6.0)];
    let scenario = straight_drive(0.0, behind);
    let log = simulate(&scenario, &mut log_replay(&scenario), Challenge::Reactive).unwrap();
    let last = log.samples.last().unwrap();
    assert!(last.objects[0].shape.center.x > 25.0 && last.objects[0].speed() < 0.5);
    for sample in &log.samples {
        assert!(!sample.objects[0].shape.overlaps(&sample.ego.footprint()));
    }
}

#[test]
fn the_same_drive_twice_is_the_same() {
    let around = |k: i64| {
        let vehicles =
            (0..6u32).map(|i| object(i, ObjectKind::Vehicle, 5.0 + 18.0 * f64::from(i), 0.2, 4.0));
        vehicles
            .chain([object(
                9,
                ObjectKind::Pedestrian,
                170.0,
                3.0 - 0.1 * k as f64,
                1.0,
            )])
            .collect()
    };
    let scenario = straight_drive(5.0, around);
    let run = || simulate(&scenario, &mut log_replay(&scenario), Challenge::Reactive).unwrap();
    let (first, second) = (run(), run());
    assert_eq!(first.samples, second.samples);
    assert_eq!(first.trajectories, second.trajectories);
}

#[test]
fn the_history_is_full_from_the_first_iteration_on() {
    struct Recorder(LogReplay, Vec<(usize, usize, i64)>);
    impl Planner for Recorder {
        fn name(&self) -> &'static str {
            "recorder"
        }
        fn initialize(
            &mut self,
            initialization: &PlannerInitialization<'_>,
        ) -> Result<(), PlannerError> {
            self.0.initialize(initialization)
        }
        fn compute_trajectory(
            &mut self,
            input: &PlannerInput<'_>,
        ) -> Result<Trajectory, PlannerError> {
            let history = input.scene.history;
            let newest = history.latest().unwrap();
            assert_eq!(&newest.ego, input.scene.ego);
            let age = newest.ego.time_us - history.samples().next().unwrap().ego.time_us;
            self.1.push((input.iteration, history.samples().len(), age));
            self.0.compute_trajectory(input)
        }
    }
    let scenario = straight_drive(8.0, |_| vec![]);
    let mut recorder = Recorder(log_replay(&scenario), vec![]);
    simulate(&scenario, &mut recorder, Challenge::NonReactive).unwrap();
    let expected: Vec<_> = (0..ITERATIONS - 1)
        .map(|k| (k, HISTORY_SAMPLES, 21 * STEP_US))
        .collect();
    assert_eq!(recorder.1, expected);
}

#[test]
fn progress_is_told_after_every_iteration() {
    let scenario = straight_drive(8.0, |_| vec![]);
    let mut told = vec![];
    let challenge = Challenge::NonReactive;
    simulate_with_progress(&scenario, &mut log_replay(&scenario), challenge, &mut |p| {
        told.push(p);
    })
    .unwrap();
    assert_eq!(told.len(), ITERATIONS - 1);
    assert_eq!(
        told.last(),
        Some(&Progress {
            done: ITERATIONS - 1,
            total: ITERATIONS - 1
        })
    );
}

#[test]
fn a_drive_can_be_forked() {
    let scenario = straight_drive(8.0, |_| {
        vec![object(1, ObjectKind::Vehicle, 15.0, 0.0, 6.0)]
    });
    let mut planner = log_replay(&scenario);
    let mut main = ClosedLoop::new(&scenario, Challenge::Reactive).unwrap();
    main.initialize(&mut planner).unwrap();
    for _ in 0..10 {
        let trajectory = main.plan(&mut planner).unwrap();
        main.advance(&trajectory, "log-replay").unwrap();
    }
    let mut fork = main.clone();
    let trajectory = main.plan(&mut planner).unwrap();
    fork.advance(&trajectory, "log-replay").unwrap();
    assert_eq!((main.iteration(), fork.iteration()), (10, 11));
    main.advance(&trajectory, "log-replay").unwrap();
    assert_eq!(main.present(), fork.present());
}

/// A planner that returns a given trajectory.
struct Scripted(Box<Script>);

type Script = dyn FnMut(&PlannerInput<'_>) -> Result<Trajectory, PlannerError> + Send;

impl Planner for Scripted {
    fn name(&self) -> &'static str {
        "scripted"
    }
    fn initialize(&mut self, _: &PlannerInitialization<'_>) -> Result<(), PlannerError> {
        Ok(())
    }
    fn compute_trajectory(&mut self, input: &PlannerInput<'_>) -> Result<Trajectory, PlannerError> {
        (self.0)(input)
    }
}

#[test]
fn failures_say_who_and_when() {
    let scenario = straight_drive(8.0, |_| vec![]);
    let drive = |planner: Scripted| {
        let mut planner = planner;
        simulate(&scenario, &mut planner, Challenge::NonReactive).unwrap_err()
    };
    let mut replay = log_replay(&scenario);
    let refusing = Scripted(Box::new(move |input| {
        if input.iteration == 7 {
            Err(PlannerError::EmptyRoute)
        } else {
            replay.compute_trajectory(input)
        }
    }));
    assert!(matches!(
        drive(refusing),
        SimulationError::Planner { iteration: 7, source, .. } if matches!(*source, PlannerError::EmptyRoute)
    ));

    let stale = Scripted(Box::new(|_| {
        let states = (0..20).map(|i| {
            TrajectoryState::moving(i * STEP_US, Pose::new(i as f64, 0.0, 0.0), 10.0, 0.0)
        });
        Ok(Trajectory::new(states.collect())?)
    }));
    let error = drive(stale);
    assert!(matches!(
        error,
        SimulationError::Tracking { iteration: 0, .. }
    ));
    assert!(error.to_string().contains("scripted") && error.to_string().contains("straight"));

    let wild = Scripted(Box::new(|input| {
        let now = input.scene.ego.time_us;
        let states = (0..20).map(|i| {
            TrajectoryState::moving(
                now + i * STEP_US,
                Pose::new(i as f64 * 1e308, 0.0, 0.0),
                10.0,
                0.0,
            )
        });
        Ok(Trajectory::new(states.take(2).collect())?)
    }));
    assert!(matches!(
        drive(wild),
        SimulationError::NotFinite { iteration: 0, .. }
    ));
}

#[test]
fn a_single_frame_cannot_be_driven() {
    let mut scenario = straight_drive(8.0, |_| vec![]);
    scenario.frames.truncate(PAST + 1);
    let error = simulate(
        &scenario,
        &mut log_replay(&scenario),
        Challenge::NonReactive,
    )
    .unwrap_err();
    assert!(matches!(
        error,
        SimulationError::TooShort { iterations: 1, .. }
    ));
    let mut scenario = straight_drive(8.0, |_| vec![]);
    scenario.frames[PAST + 5].ego.time_us = scenario.frames[PAST + 4].ego.time_us;
    let error = simulate(
        &scenario,
        &mut log_replay(&scenario),
        Challenge::NonReactive,
    )
    .unwrap_err();
    assert!(matches!(
        error,
        SimulationError::TimeNotIncreasing { iteration: 5, .. }
    ));
}
