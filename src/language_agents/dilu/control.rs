//! The controller whose set-points the actions move: a target lane and a speed of a ladder.

use planagent_agent::environment::GraphedScene;
use planagent_agent::reasoning::DrivingAction;
use planagent_world::geometry::{Pose, wrap_angle};
use planagent_world::{
    EgoState, LaneId, LanePath, PACIFICA, STEP_S, STEP_US, SceneView, Trajectory, TrajectoryError,
    TrajectoryState,
};

/// Speeds of the ladder are multiples of this, m/s,
const RUNG: f64 = 2.5;
/// up to this multiple: 30 m/s.
const TOP_RUNG: u32 = 12;
/// Time constant of the speed controller, seconds: the original's.
const SPEED_TIME: f64 = 0.6;
/// Bounds of acceleration, m/s²: those of nuPlan's comfort metric.
const DECELERATION: f64 = -4.05;
const ACCELERATION: f64 = 2.4;
/// Time constant with which the ego moves to the target lane's centerline, seconds,
const ASIDE_TIME: f64 = 1.5;
/// the speed aside, m/s,
const ASIDE_SPEED: f64 = 1.0;
/// and the largest share of the speed that may go aside.
const ASIDE_SHARE: f64 = 0.3;
/// Length of a trajectory, steps of 0.1 s.
const STEPS: usize = 80;
/// Lane ahead of the ego that a path has, meters: 8 s at the top speed.
const AHEAD: f64 = 260.0;
/// Below this speed the heading is that of the lane, m/s.
const STANDSTILL: f64 = 0.2;

/// What the controller drives at.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct SetPoints {
    /// The lane.
    pub(super) lane: LaneId,
    /// The speed, as a multiple of [`RUNG`].
    rung: u32,
}

impl SetPoints {
    /// Those of an ego that goes on as it is.
    pub(super) fn at(GraphedScene { scene, graph }: GraphedScene<'_>) -> Self {
        let lane = graph.ego_lane();
        Self {
            lane: lane.path.lane_at(lane.ego_s),
            rung: nearest_rung(scene.ego),
        }
    }

    /// The set speed, m/s.
    pub(super) fn speed(self) -> f64 {
        f64::from(self.rung) * RUNG
    }

    /// The same where the ego has driven on: the target lane is the one beside it.
    pub(crate) fn tracked(self, scene: &SceneView<'_>) -> Self {
        let path = self.path(scene);
        let s = path.centerline.project(scene.ego.center().position()).s;
        Self {
            lane: path.lane_at(s),
            ..self
        }
    }

    /// The actions that change something here: keeping comes first, then lane changes, then speeds.
    pub(crate) fn offered(self, scene: &SceneView<'_>) -> Vec<DrivingAction> {
        use DrivingAction::{Faster, Idle, Left, Right, Slower};
        let rung = nearest_rung(scene.ego);
        [
            (Idle, true),
            (Left, self.beside(scene, 1).is_some()),
            (Right, self.beside(scene, -1).is_some()),
            (Faster, rung < TOP_RUNG),
            (Slower, rung > 0),
        ]
        .into_iter()
        .filter_map(|(action, offered)| offered.then_some(action))
        .collect()
    }

    /// The set-points after an action. A change of lane starts from the target lane, a change of
    /// speed from the present speed.
    pub(crate) fn moved(self, action: DrivingAction, scene: &SceneView<'_>) -> Self {
        let rung = nearest_rung(scene.ego);
        let to_lane = |lanes| Self {
            lane: self.beside(scene, lanes).unwrap_or(self.lane),
            ..self
        };
        match action {
            DrivingAction::Idle => self,
            DrivingAction::Left => to_lane(1),
            DrivingAction::Right => to_lane(-1),
            DrivingAction::Faster => Self {
                rung: (rung + 1).min(TOP_RUNG),
                ..self
            },
            DrivingAction::Slower => Self {
                rung: rung.saturating_sub(1),
                ..self
            },
        }
    }

    /// The lane beside the target lane, positive to the left.
    fn beside(self, scene: &SceneView<'_>, lanes: i32) -> Option<LaneId> {
        let ego = scene.ego.center().position();
        let (lane, pose) = scene.map.beside(self.lane, ego, lanes)?;
        let own = scene.map[self.lane].centerline.project(ego).heading;
        let same_way = wrap_angle(pose.heading - own).abs() < std::f64::consts::FRAC_PI_2;
        (same_way && lane != self.lane).then_some(lane)
    }

    fn path(self, scene: &SceneView<'_>) -> LanePath {
        let on_lane = scene.map[self.lane].centerline.length();
        LanePath::along(scene.map, scene.route, self.lane, on_lane + AHEAD)
    }

    /// The controller's way from the present on.
    ///
    /// # Errors
    /// When the ego's state is not finite.
    pub(crate) fn trajectory(self, scene: &SceneView<'_>) -> Result<Trajectory, TrajectoryError> {
        let ego = scene.ego;
        let path = self.path(scene);
        let line = &path.centerline;
        let on = line.project(ego.center().position());
        let (mut s, mut aside, mut speed) = (on.s, on.lateral, ego.velocity.x.max(0.0));
        let mut states = vec![TrajectoryState::from(ego)];
        for step in 1..=STEPS {
            let acceleration =
                ((self.speed() - speed) / SPEED_TIME).clamp(DECELERATION, ACCELERATION);
            let next = (speed + acceleration * STEP_S).max(0.0);
            // A share of the speed, since a car that hardly moves on cannot move sideways.
            let most = ASIDE_SPEED.min(ASIDE_SHARE * next);
            let aside_speed = (-aside / ASIDE_TIME).clamp(-most, most);
            (s, aside) = (s + next * STEP_S, aside + aside_speed * STEP_S);
            let beyond = (s - line.length()).max(0.0);
            let on_line = s - beyond;
            let turn = if next > STANDSTILL {
                aside_speed.atan2(next)
            } else {
                0.0
            };
            let heading = wrap_angle(line.heading_at(on_line) + turn);
            let place = line.pose_at(on_line).translated(beyond, aside).position();
            let rear_axle = PACIFICA.rear_axle_of(Pose::at(place, heading));
            let time_us = ego.time_us + step as i64 * STEP_US;
            states.push(TrajectoryState::moving(
                time_us,
                rear_axle,
                next,
                (next - speed) / STEP_S,
            ));
            speed = next;
        }
        Trajectory::new(states)
    }
}

/// The rung nearest to the present speed.
fn nearest_rung(ego: &EgoState) -> u32 {
    let rung = (ego.speed() / RUNG).round();
    if rung >= f64::from(TOP_RUNG) {
        TOP_RUNG
    } else {
        rung.max(0.0) as u32
    }
}
