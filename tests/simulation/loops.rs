//! The loop itself: times, lights, samples, and the challenge without a loop.

use super::{car, ego};
use crate::road::Road;
use planagent_agent::planner::{
    IdmPlanner, LogReplay, Planner, PlannerError, PlannerInitialization, PlannerInput,
    SimplePlanner,
};
use planagent_agent::simulation::{
    AGENT_POLICIES, AgentPolicy, AgentPolicyError, Challenge, simulate, simulate_with_agents,
};
use planagent_scenario::{FUTURE_FRAMES, Frame, Scenario};
use planagent_world::geometry::Pose;
use planagent_world::{EgoState, LaneId, LaneKind, Route, SignalStatus, TrackedObject, Trajectory};
use std::sync::{Arc, Mutex};

const PAST: usize = 21;

/// A lane of 400 m with a connector before it; the ego is recorded at `speed`, frames at the given
/// times (µs), the light of the connector green at even iterations and red at odd ones, a car 40 m
/// ahead at the ego's speed.
fn drive(times: &[i64], speed: f64, future: usize) -> Scenario {
    let mut road = Road::default();
    let connector = road.dense(LaneKind::Connector, (-60.0, 0.0), (0.0, 0.0), None);
    let lane = road.dense(LaneKind::Lane, (0.0, 0.0), (400.0, 0.0), Some(12.0));
    road.link(connector, lane);
    let map = Arc::new(road.build());
    let recorded = |time_us: i64| {
        let x = 20.0 + speed * time_us as f64 * 1e-6;
        EgoState {
            time_us,
            ..ego(Pose::new(x, 0.0, 0.0), speed)
        }
    };
    let frame = |(i, &time_us): (usize, &i64)| Frame {
        ego: recorded(time_us),
        objects: [car(
            1,
            Pose::new(60.0 + speed * time_us as f64 * 1e-6, 0.0, 0.0),
            speed,
        )]
        .into(),
        lights: Arc::new(super::lights(
            connector,
            if (i + PAST).is_multiple_of(2) {
                SignalStatus::Green
            } else {
                SignalStatus::Red
            },
        )),
    };
    let last = times[times.len() - 1];
    Scenario {
        id: "loop".into(),
        scenario_type: "unknown".into(),
        log_name: "test".into(),
        route: Route {
            roadblocks: map.roadblocks().iter().map(|block| block.id).collect(),
            goal: None,
            goal_lane: None,
        },
        map,
        frames: times.iter().enumerate().map(frame).collect(),
        start: PAST,
        future: (1..=future as i64)
            .map(|k| recorded(last + 100_000 * k))
            .collect(),
        interaction: None,
    }
}

fn regular(iterations: usize) -> Vec<i64> {
    (0..PAST + iterations)
        .map(|i| (i as i64 - PAST as i64) * 100_000)
        .collect()
}

fn log_replay(scenario: &Scenario) -> LogReplay {
    LogReplay::new(scenario.recorded().copied().collect())
}

#[test]
fn ego_and_traffic_move_in_the_logs_own_time() {
    let mut times = regular(60);
    for (i, time) in times.iter_mut().enumerate().skip(PAST + 1) {
        *time += [7_000, -9_000, 0][i % 3];
    }
    let scenario = drive(&times, 6.0, 0);
    let log = simulate(&scenario, &mut log_replay(&scenario), Challenge::Reactive).unwrap();
    assert_eq!(log.samples.len(), 59);
    for (k, pair) in log.samples.windows(2).enumerate() {
        assert_eq!(pair[1].ego.time_us, times[PAST + k + 1]);
        let dt = (times[PAST + k + 1] - times[PAST + k]) as f64 * 1e-6;
        let moved = pair[1].objects[0].shape.center.x - pair[0].objects[0].shape.center.x;
        assert!(
            (moved - dt * pair[0].objects[0].speed()).abs() < 1e-9,
            "{k}: {moved}"
        );
        let own = pair[1].ego.rear_axle.x - pair[0].ego.rear_axle.x;
        assert!(
            (own - dt * pair[0].ego.velocity.x).abs() < 1e-9,
            "{k}: {own}"
        );
    }
}

/// Replays the log and writes down what it is shown.
struct Recorder(LogReplay, Seen);

/// Iterations and the lights of the connector.
type Seen = Arc<Mutex<Vec<(usize, Option<SignalStatus>)>>>;

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
    fn compute_trajectory(&mut self, input: &PlannerInput<'_>) -> Result<Trajectory, PlannerError> {
        self.1
            .lock()
            .unwrap()
            .push((input.iteration, input.scene.lights.status(LaneId(0))));
        self.0.compute_trajectory(input)
    }
}

#[test]
fn the_planner_sees_the_logged_lights_of_its_iteration() {
    let scenario = drive(&regular(60), 6.0, 0);
    let seen = Seen::default();
    let mut recorder = Recorder(log_replay(&scenario), seen.clone());
    simulate(&scenario, &mut recorder, Challenge::NonReactive).unwrap();
    for &(k, status) in seen.lock().unwrap().iter() {
        assert_eq!(
            status,
            Some(if k % 2 == 0 {
                SignalStatus::Green
            } else {
                SignalStatus::Red
            })
        );
    }
}

#[test]
fn in_open_loop_the_ego_does_what_was_recorded_whatever_is_planned() {
    let scenario = drive(&regular(151), 8.0, FUTURE_FRAMES);
    let log = simulate(
        &scenario,
        &mut SimplePlanner::default(),
        Challenge::OpenLoop,
    )
    .unwrap();
    assert_eq!((log.samples.len(), log.trajectories.len()), (150, 150));
    for (k, sample) in log.samples.iter().enumerate() {
        assert_eq!(
            (&sample.ego, &sample.objects),
            (
                &scenario.frames[PAST + k].ego,
                &scenario.frames[PAST + k].objects
            )
        );
    }
    // Each plan starts at 8 m/s and falls towards 5: v = 5 + 3·0.75^i after i quarters of a second,
    // the positions by Euler.
    let lag = |seconds: usize| -> f64 {
        (0..4 * seconds)
            .map(|i| 0.25 * (3.0 - 3.0 * 0.75f64.powi(i as i32)))
            .sum()
    };
    let lags: Vec<f64> = (1..=8).map(lag).collect();
    let mean = |list: &[f64]| list.iter().sum::<f64>() / list.len() as f64;
    let evaluation = log.evaluate(&scenario).unwrap();
    let result = evaluation
        .metric("planner_expert_average_l2_error_within_bound")
        .unwrap();
    for (horizon, statistic) in [3usize, 5].into_iter().zip(&result.statistics) {
        // The last second is counted twice (below), which these horizons see at two seconds of
        // fifteen each.
        assert!(
            (statistic.value - mean(&lags[..horizon])).abs() < 0.5,
            "{horizon}: {statistic:?}"
        );
    }
    // 0 s has no such second before it: its three horizons by hand.
    let first = [3, 5, 8].map(|horizon| mean(&lags[..horizon]));
    let series = result.time_series.as_ref().unwrap();
    assert!((series.values[0] - mean(&first)).abs() < 1e-9);
    assert_eq!(
        series.selected_frames.as_deref(),
        Some(&(0..15).map(|i| 10 * i).collect::<Vec<_>>()[..])
    );
    // 151 states: the one at 15 s ends the scenario and begins its future. At 14 s the eight
    // seconds compared are therefore 15, 15, 16 … 21.
    let doubled: Vec<f64> = std::iter::once(lags[0])
        .chain(lags[..7].iter().copied())
        .collect();
    let last = [3, 5, 8].map(|horizon| mean(&doubled[..horizon]));
    assert!(
        (series.values[14] - mean(&last)).abs() < 1e-9,
        "{} {}",
        series.values[14],
        mean(&last)
    );
    // The plan strays by more than 8 m within 5 s and by more than 16 m within 8 s: a miss.
    assert!(lags[4] > 8.0 && lags[7] > 16.0);
    assert_eq!(
        evaluation.score.metric("planner_miss_rate_within_bound"),
        Some(0.0)
    );
    assert!(evaluation.score.value.abs() < 1e-12);
}

#[test]
fn log_replay_is_perfect_in_open_loop_and_idm_is_judged() {
    let scenario = drive(&regular(150), 8.0, FUTURE_FRAMES);
    let replay = simulate(&scenario, &mut log_replay(&scenario), Challenge::OpenLoop).unwrap();
    let evaluation = replay.evaluate(&scenario).unwrap();
    assert!(
        (evaluation.score.value - 1.0).abs() < 1e-9,
        "{:?}",
        evaluation.score
    );
    assert_eq!(
        evaluation
            .metric("ego_expert_L2_error")
            .unwrap()
            .statistic("max_ego_expert_L2_error"),
        Some(0.0)
    );
    let idm = simulate(&scenario, &mut IdmPlanner::default(), Challenge::OpenLoop).unwrap();
    let score = idm.evaluate(&scenario).unwrap().score;
    assert!(
        score.value < 1.0
            && score.metric("planner_expert_average_heading_error_within_bound") == Some(1.0)
    );
}

#[test]
fn seconds_without_a_recorded_future_are_left_out_and_none_is_an_error() {
    // 101 states: eight seconds are recorded at 0, 1 and 2 s; at 3 s nuPlan compares 4, 5 … 10 and
    // 10 once more (above).
    let scenario = drive(&regular(101), 8.0, 0);
    let log = simulate(&scenario, &mut log_replay(&scenario), Challenge::OpenLoop).unwrap();
    let evaluation = log.evaluate(&scenario).unwrap();
    let series = evaluation
        .metrics
        .last()
        .unwrap()
        .time_series
        .clone()
        .unwrap();
    assert_eq!(
        series.selected_frames.as_deref(),
        Some(&[0, 10, 20, 30][..])
    );
    let short = drive(&regular(80), 8.0, 0);
    let log = simulate(&short, &mut SimplePlanner::default(), Challenge::OpenLoop).unwrap();
    assert_eq!(
        log.evaluate(&short).unwrap_err().to_string(),
        "the recording has 7 s from the start of the scenario; the open-loop metrics need 8 s"
    );
}

#[test]
fn a_plan_that_ends_early_is_compared_at_its_end_or_refused() {
    let scenario = drive(&regular(101), 4.0, 0);
    let planned = |horizon_us: i64| {
        let mut planner = SimplePlanner {
            horizon_us,
            ..SimplePlanner::default()
        };
        let log = simulate(&scenario, &mut planner, Challenge::OpenLoop).unwrap();
        log.evaluate(&scenario)
    };
    // Straight on at 4 m/s is what was recorded, also at 7.5 s.
    assert!((planned(7_500_000).unwrap().score.value - 1.0).abs() < 1e-9);
    let error = planned(6_500_000).unwrap_err().to_string();
    assert_eq!(
        error,
        "the trajectory of sample 0 ends 6.5 s ahead; the open-loop metrics need more than 7 s"
    );
}

/// Agents of a user: everything stands where it was recorded at the start, and hides from an ego
/// that is near.
#[derive(Debug, Clone)]
struct Statues {
    objects: Arc<[TrackedObject]>,
    hidden: bool,
}

impl AgentPolicy for Statues {
    fn objects(&self, _: &Frame) -> Arc<[TrackedObject]> {
        if self.hidden {
            [].into()
        } else {
            Arc::clone(&self.objects)
        }
    }

    fn step(&mut self, ego: &EgoState, _: &Frame, _: f64) -> Result<(), AgentPolicyError> {
        let near = |object: &TrackedObject| object.shape.center.distance(&ego.center()) < 20.0;
        self.hidden = self.objects.iter().any(near);
        Ok(())
    }

    fn boxed_clone(&self) -> Box<dyn AgentPolicy> {
        Box::new(self.clone())
    }
}

#[test]
fn an_own_policy_controls_the_agents() {
    let scenario = drive(&regular(60), 10.0, 0);
    let statues = |first: &Frame| {
        Box::new(Statues {
            objects: first.objects.clone(),
            hidden: false,
        }) as Box<_>
    };
    let log = simulate_with_agents(
        &scenario,
        &mut log_replay(&scenario),
        Challenge::NonReactive,
        statues,
    )
    .unwrap();
    let first = scenario.frame(0).unwrap().objects[0];
    for sample in &log.samples {
        // The ego starts 40 m behind; the policy saw it one iteration ago.
        let gap = first.shape.center.x - sample.ego.center().x;
        match sample.objects.first() {
            Some(object) => assert!(*object == first && gap > 18.0, "{gap}"),
            None => assert!(gap < 20.0, "{gap}"),
        }
    }
    assert!(log.samples.iter().any(|sample| sample.objects.is_empty()));
}

#[test]
fn the_policies_of_the_table_are_those_of_the_challenges() {
    let scenario = drive(&regular(30), 10.0, 0);
    for (policy, challenge) in AGENT_POLICIES.into_iter().zip(Challenge::CLOSED_LOOP) {
        let (mut one, mut other) = (log_replay(&scenario), log_replay(&scenario));
        let named = simulate_with_agents(&scenario, &mut one, challenge, |first| {
            (policy.new)(&scenario, first)
        });
        assert_eq!(
            named.unwrap().samples,
            simulate(&scenario, &mut other, challenge).unwrap().samples,
            "{challenge}"
        );
    }
}
