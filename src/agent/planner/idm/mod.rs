//! nuPlan's IDM planner: along the route's centerline behind the nearest obstacle (devkit
//! `idm_planner.py`, `abstract_idm_planner.py`).

mod route;

use self::route::Road;
use super::{Planner, PlannerError, PlannerInitialization, PlannerInput};
use planagent_world::dynamics::{IdmParameters, Lead, ProgressPath};
use planagent_world::geometry::{Corridor, OrientedBox, Polyline, wrap_angle};
use planagent_world::{
    EgoState, LaneId, LaneMap, PACIFICA, SceneView, TrackedObject, Trajectory, TrajectoryState,
};
use std::sync::Arc;

/// nuPlan's parameters; the target velocity is that of a lane without a limit.
const LAW: IdmParameters = IdmParameters {
    target_velocity: 10.0,
    min_gap: 1.0,
    headway: 1.5,
    accel_max: 1.0,
    decel_max: 3.0,
    exponent: 4,
};
/// Samples of a trajectory after the first.
const SAMPLES: usize = 16;
/// Time between samples, µs.
const SAMPLE_US: i64 = 500_000;
/// Time between samples, seconds.
const SAMPLE_S: f64 = 0.5;
/// Maximum distance between the centers of an obstacle and the ego, meters.
const RADIUS: f64 = 40.0;

/// The IDM planner. It chooses its path and its target velocity at the first iteration and keeps
/// them. Where the map does not join the roadblocks of the route (an unmapped U-turn), the path
/// ends before the gap and the ego stops there, as in nuPlan.
#[derive(Debug, Clone, Default)]
pub struct IdmPlanner {
    road: Option<Road>,
    path: Option<IdmPath>,
}

impl IdmPlanner {
    /// A planner before its initialization.
    pub fn new() -> Self {
        Self::default()
    }
}

/// The path with its IDM.
#[derive(Debug, Clone)]
struct IdmPath {
    /// What the ego follows and what ends ahead of it: without its last pose, as in nuPlan.
    path: ProgressPath,
    /// The baselines in full; the ego is projected on it.
    line: Polyline,
    law: IdmParameters,
}

/// The ego's progress along its path.
#[derive(Debug, Clone, Copy)]
struct Progress {
    s: f64,
    speed: f64,
}

impl Planner for IdmPlanner {
    fn name(&self) -> &'static str {
        "idm"
    }

    fn initialize(
        &mut self,
        initialization: &PlannerInitialization<'_>,
    ) -> Result<(), PlannerError> {
        let lanes = initialization.route.lanes(initialization.map);
        if lanes.is_empty() {
            return Err(PlannerError::EmptyRoute);
        }
        let (map, route) = (Arc::clone(initialization.map), initialization.route.clone());
        *self = Self {
            road: Some(Road { map, route, lanes }),
            path: None,
        };
        Ok(())
    }

    fn compute_trajectory(&mut self, input: &PlannerInput<'_>) -> Result<Trajectory, PlannerError> {
        let road = self.road.as_ref().ok_or(PlannerError::NotInitialized)?;
        let scene = &input.scene;
        let path = match &mut self.path {
            Some(path) => path,
            none => none.insert(road.path(scene.ego)?),
        };
        let obstacles = Obstacles::seen(scene, road);
        path.roll_out(scene.ego, &obstacles)
    }
}

impl Road {
    /// The path from the ego's lane to the end of the route. Its target velocity is the limit of
    /// the first lane, or the ego's speed if that is higher.
    fn path(&self, ego: &EgoState) -> Result<IdmPath, PlannerError> {
        self.path_from(
            self.starting_lane(ego).ok_or(PlannerError::EmptyRoute)?,
            ego,
        )
    }

    /// The path from a lane.
    fn path_from(&self, start: LaneId, ego: &EgoState) -> Result<IdmPath, PlannerError> {
        let lanes = self.route_plan(start);
        let poses: Vec<_> = lanes
            .iter()
            .flat_map(|&lane| self.map[lane].centerline.vertex_poses())
            .collect();
        let path = ProgressPath::new(&poses).ok_or(PlannerError::EmptyRoute)?;
        let points = lanes
            .iter()
            .flat_map(|&lane| self.map[lane].centerline.vertices())
            .copied();
        let line = Polyline::new(points).map_err(|_| PlannerError::EmptyRoute)?;
        let limit = self.map[start]
            .speed_limit
            .filter(|&limit| limit > 0.0)
            .unwrap_or(LAW.target_velocity);
        Ok(IdmPath {
            path,
            line,
            law: IdmParameters {
                target_velocity: limit.max(ego.speed()),
                ..LAW
            },
        })
    }
}

/// The obstacles near the ego, frozen at the present.
struct Obstacles<'a> {
    objects: Vec<&'a TrackedObject>,
    red: Vec<LaneId>,
    map: &'a LaneMap,
}

impl<'a> Obstacles<'a> {
    fn seen(scene: &SceneView<'a>, road: &Road) -> Self {
        let center = scene.ego.center();
        let near = |object: &&TrackedObject| object.shape.center.distance(&center) < RADIUS;
        Self {
            objects: scene.objects.iter().filter(near).collect(),
            red: scene
                .lights
                .red()
                .filter(|lane| road.lanes.contains(lane))
                .collect(),
            map: scene.map,
        }
    }

    /// The nearest obstacle to an ego box that meets it or the corridor ahead of it.
    fn nearest(&self, ego: &OrientedBox, corridor: Option<&Corridor>) -> Option<Lead> {
        let objects = self.objects.iter().filter(|object| {
            ego.overlaps(&object.shape)
                || corridor.is_some_and(|corridor| corridor.meets_box(&object.shape))
        });
        let leads = objects.map(|object| {
            let along = wrap_angle(object.shape.center.heading - ego.center.heading).cos();
            let speed = if object.kind.is_agent() {
                object.speed() * along
            } else {
                0.0
            };
            Lead {
                gap: ego.distance(&object.shape),
                speed,
            }
        });
        let polygons = self
            .red
            .iter()
            .map(|&lane| &self.map[lane].polygon)
            .filter(|polygon| {
                polygon.meets_box(ego)
                    || corridor.is_some_and(|corridor| corridor.meets_polygon(polygon))
            });
        // A red light is a standing obstacle of the connector's size, as in nuPlan.
        let lights = polygons.map(|polygon| Lead {
            gap: polygon.distance_to_box(ego),
            speed: 0.0,
        });
        leads.chain(lights).min_by(|a, b| a.gap.total_cmp(&b.gap))
    }
}

impl IdmPath {
    /// The trajectory from the projection of the ego on the path, by forward Euler at 0.5 s.
    fn roll_out(
        &self,
        ego: &EgoState,
        obstacles: &Obstacles<'_>,
    ) -> Result<Trajectory, PlannerError> {
        let mut at = self.progress(ego);
        let mut states = vec![self.state(at, ego.time_us)];
        // The first search is around the ego itself, the later ones around the samples on the path,
        // as in nuPlan.
        let mut footprint = ego.footprint();
        for sample in 1..=SAMPLES {
            let lead = obstacles.nearest(&footprint, self.corridor(at).as_ref());
            at = self.propagate(at, lead);
            let state = self.state(at, ego.time_us + sample as i64 * SAMPLE_US);
            footprint = PACIFICA.footprint(state.rear_axle);
            states.push(state);
        }
        Ok(Trajectory::new(states)?)
    }

    /// Where the ego is; beyond the end of the path if it is there.
    fn progress(&self, ego: &EgoState) -> Progress {
        Progress {
            s: self.line.project(ego.center().position()).s,
            speed: ego.center_velocity().x,
        }
    }

    /// The strip that the ego sweeps at its target velocity.
    fn corridor(&self, at: Progress) -> Option<Corridor> {
        let reach = self.law.target_velocity.abs() * SAMPLES as f64 * SAMPLE_S;
        let ahead = self
            .path
            .between(at.s, at.s + reach)
            .into_iter()
            .map(|pose| pose.position());
        Polyline::new(ahead)
            .ok()
            .map(|line| Corridor::with_square_caps(&line, PACIFICA.width / 2.0))
    }

    /// The next sample; without a lead object the end of the path is a standing obstacle.
    fn propagate(&self, at: Progress, lead: Option<Lead>) -> Progress {
        let path_end = Lead {
            gap: self.path.length() - at.s - PACIFICA.length() / 2.0,
            speed: 0.0,
        };
        let acceleration = self
            .law
            .acceleration(at.speed, Some(lead.unwrap_or(path_end)));
        Progress {
            s: at.s + SAMPLE_S * at.speed,
            speed: (at.speed + SAMPLE_S * acceleration).max(0.0),
        }
    }

    fn state(&self, at: Progress, time_us: i64) -> TrajectoryState {
        TrajectoryState::moving(
            time_us,
            PACIFICA.rear_axle_of(self.path.pose_at(at.s)),
            at.speed,
            0.0,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_road::{Stretch, ego_at, object, straight_road, whole_route};
    use planagent_world::geometry::Pose;
    use planagent_world::{History, ObjectKind, Route, SignalStatus, TrafficLights};

    const ROAD: [Stretch; 3] = [
        Stretch::Lane(60.0),
        Stretch::Signal(20.0),
        Stretch::Lane(150.0),
    ];

    fn plan(ego: &EgoState, objects: &[TrackedObject], light: SignalStatus) -> Trajectory {
        let map = Arc::new(straight_road(&ROAD, Some(12.0)));
        let route = whole_route(&map);
        let lights: TrafficLights = [(LaneId(1), light)].into_iter().collect();
        let mut planner = IdmPlanner::new();
        planner
            .initialize(&PlannerInitialization {
                map: &map,
                route: &route,
            })
            .unwrap();
        let history = History::default();
        let scene = SceneView {
            map: &map,
            route: &route,
            ego,
            objects,
            lights: &lights,
            history: &history,
        };
        planner
            .compute_trajectory(&PlannerInput {
                iteration: 0,
                scene,
            })
            .unwrap()
    }

    fn end(trajectory: &Trajectory) -> TrajectoryState {
        trajectory.states()[SAMPLES]
    }

    #[test]
    fn a_free_road_is_driven_towards_the_limit() {
        let trajectory = plan(&ego_at(7, 5.0, 8.0), &[], SignalStatus::Green);
        assert_eq!(trajectory.states().len(), SAMPLES + 1);
        assert_eq!(
            (trajectory.start_us(), trajectory.end_us()),
            (7, 7 + 8_000_000)
        );
        assert!((trajectory.states()[0].rear_axle.x - 5.0).abs() < 1e-9);
        // The first sample by hand: the end of the path (the last vertex dropped) is the lead.
        let gap = 229.5 - (5.0 + PACIFICA.rear_axle_to_center()) - PACIFICA.length() / 2.0;
        let desired: f64 = 1.0 + 8.0 * 1.5 + 64.0 / (2.0 * 3.0f64.sqrt());
        let acceleration = 1.0 - (8.0f64 / 12.0).powi(4) - (desired / gap).powi(2);
        let first = trajectory.states()[1];
        assert!((first.velocity.x - (8.0 + 0.5 * acceleration)).abs() < 1e-9);
        assert!((first.rear_axle.x - 9.0).abs() < 1e-9);
        assert!(end(&trajectory).velocity.x > 9.0);
    }

    #[test]
    fn stops_for_a_red_light_and_a_standing_vehicle() {
        let red = end(&plan(&ego_at(0, 5.0, 8.0), &[], SignalStatus::Red));
        assert!(red.rear_axle.x + PACIFICA.front_length < 60.0 && red.velocity.x < 1.5);
        let parked = [object(1, ObjectKind::Vehicle, 42.0, 0.0, 0.0)];
        let behind = end(&plan(&ego_at(0, 5.0, 8.0), &parked, SignalStatus::Green));
        assert!(behind.rear_axle.x + PACIFICA.front_length < 39.7);
        let beside = [object(1, ObjectKind::Vehicle, 42.0, 3.6, 0.0)];
        let past = end(&plan(&ego_at(0, 5.0, 8.0), &beside, SignalStatus::Green));
        assert!(past.rear_axle.x > 60.0);
    }

    /// Speed after a sample of the free gap to a standing object, m/s.
    fn next_speed(speed: f64, limit: f64, gap: f64) -> f64 {
        let desired = 1.0 + speed * 1.5 + speed * speed / (2.0 * 3.0f64.sqrt());
        speed + 0.5 * (1.0 - (speed / limit).powi(4) - (desired / gap).powi(2)).max(-3.0)
    }

    /// An ego 0.8 m left of its path and turned away from it: its own box counts in the first
    /// sample, its box on the path from the second on.
    #[test]
    fn the_first_gap_is_that_of_the_ego_itself() {
        let mut ego = ego_at(0, 5.0, 8.0);
        ego.rear_axle = Pose::new(5.0, 0.8, 0.15);
        let parked = [object(1, ObjectKind::Vehicle, 30.0, 0.0, 0.0)];
        let trajectory = plan(&ego, &parked, SignalStatus::Green);
        assert!((trajectory.states()[0].rear_axle.y).abs() < 1e-9);
        let rear = 30.0 - parked[0].shape.length / 2.0;
        let [front_left, _, _, front_right] = ego.footprint().corners();
        let gap = rear - front_left.x.max(front_right.x);
        let (first, second) = (
            trajectory.states()[1].velocity.x,
            trajectory.states()[2].velocity.x,
        );
        assert!((first - next_speed(8.0, 12.0, gap)).abs() < 1e-9);
        let s = 5.0 + PACIFICA.rear_axle_to_center() * 0.15f64.cos() + 0.5 * 8.0;
        assert!(
            (second - next_speed(first, 12.0, rear - (s + PACIFICA.length() / 2.0))).abs() < 1e-9
        );
    }

    /// A pedestrian whom only the box of the real ego touches stops it; one whom only the box on
    /// the path would touch does not.
    #[test]
    fn beside_the_path_the_ego_itself_meets_objects_in_the_first_sample() {
        let mut ego = ego_at(0, 5.0, 8.0);
        ego.rear_axle = Pose::new(5.0, 3.0, 0.0);
        let touched = [object(1, ObjectKind::Pedestrian, 7.0, 4.0, 0.0)];
        let speed = plan(&ego, &touched, SignalStatus::Green).states()[1]
            .velocity
            .x;
        assert!((speed - (8.0 - 0.5 * 3.0)).abs() < 1e-9, "{speed}");
        // The corridor begins at the ego's center; what is behind it lies in no strip.
        let behind = [object(1, ObjectKind::Pedestrian, 4.6, -0.9, 0.0)];
        let free = plan(&ego, &[], SignalStatus::Green).states()[1].velocity.x;
        let speed = plan(&ego, &behind, SignalStatus::Green).states()[1]
            .velocity
            .x;
        assert!((speed - free).abs() < 1e-12, "{speed} against {free}");
    }

    /// The heading of an object counts relative to the real ego in the first sample.
    #[test]
    fn the_first_relative_heading_is_that_of_the_ego_itself() {
        let mut ego = ego_at(0, 5.0, 8.0);
        ego.rear_axle = Pose::new(5.0, 0.0, 0.5);
        let lead = [object(1, ObjectKind::Vehicle, 30.0, 0.0, 6.0)];
        let first = plan(&ego, &lead, SignalStatus::Green).states()[1]
            .velocity
            .x;
        let [front_left, _, _, front_right] = ego.footprint().corners();
        let gap = 30.0 - lead[0].shape.length / 2.0 - front_left.x.max(front_right.x);
        let desired = 1.0 + 8.0 * 1.5 + 8.0 * (8.0 - 6.0 * 0.5f64.cos()) / (2.0 * 3.0f64.sqrt());
        let expected =
            8.0 + 0.5 * (1.0 - (8.0f64 / 12.0).powi(4) - (desired / gap).powi(2)).max(-3.0);
        assert!(
            (first - expected).abs() < 1e-9,
            "{first} against {expected}"
        );
    }

    /// Beyond the end of the path, which lacks the last pose, the ego is still projected on the
    /// whole line. The strip is that of the last two poses.
    #[test]
    fn the_ego_is_projected_on_the_whole_line() {
        let ego = ego_at(0, 229.6 - PACIFICA.rear_axle_to_center(), 8.0);
        let map = Arc::new(straight_road(&ROAD, Some(12.0)));
        let route = whole_route(&map);
        let road = Road {
            lanes: route.lanes(&map),
            map,
            route,
        };
        let path = road.path_from(LaneId(0), &ego).unwrap();
        assert!((path.path.length() - 229.5).abs() < 1e-9);
        let progress = path.progress(&ego);
        assert!((progress.s - 229.6).abs() < 1e-9, "{}", progress.s);
        let strip = path.corridor(progress).unwrap();
        let place = |x: f64| OrientedBox::new(Pose::new(x, 0.0, 0.0), 0.1, 0.1);
        let last_pose = path.path.between(progress.s, progress.s)[0].x;
        assert!(
            strip.meets_box(&place(last_pose))
                && !strip.meets_box(&place(229.5 + PACIFICA.width / 2.0 + 0.1))
        );
    }

    /// The corridor reaches the target velocity times 8 s from where the ego is, and its cap is
    /// square.
    #[test]
    fn the_corridor_ends_with_a_square_cap() {
        let along = 5.0 + PACIFICA.rear_axle_to_center();
        let reach = 1.0 * 8.0 + PACIFICA.width / 2.0;
        let law = IdmParameters {
            target_velocity: 1.0,
            ..LAW
        };
        let line = Polyline::new([
            planagent_world::geometry::Point::new(along, 0.0),
            planagent_world::geometry::Point::new(along + 8.0, 0.0),
        ]);
        let corridor = Corridor::with_square_caps(&line.unwrap(), PACIFICA.width / 2.0);
        let rear_at = |x: f64| OrientedBox::new(Pose::new(x + 2.0, 0.0, 0.0), 4.0, 2.0);
        assert!(
            corridor.meets_box(&rear_at(along + reach - 0.01))
                && !corridor.meets_box(&rear_at(along + reach + 0.01))
        );
        assert!((law.target_velocity * SAMPLES as f64 * SAMPLE_S - 8.0).abs() < 1e-12);
    }

    #[test]
    fn objects_beyond_its_radius_are_not_seen() {
        let far = [object(1, ObjectKind::Vehicle, 47.0, 0.0, 0.0)];
        let trajectory = plan(&ego_at(0, 5.0, 8.0), &far, SignalStatus::Green);
        assert!(end(&trajectory).rear_axle.x > 60.0);
    }

    #[test]
    fn the_plan_starts_in_the_second_block_too() {
        let trajectory = plan(&ego_at(0, 65.0, 8.0), &[], SignalStatus::Green);
        assert!((trajectory.states()[0].rear_axle.x - 65.0).abs() < 1e-9);
        assert!(end(&trajectory).rear_axle.x > 120.0);
    }

    #[test]
    fn says_when_it_cannot_plan() {
        let map = Arc::new(straight_road(&ROAD, None));
        let mut planner = IdmPlanner::new();
        let nowhere = planner.initialize(&PlannerInitialization {
            map: &map,
            route: &Route::default(),
        });
        assert!(matches!(nowhere, Err(PlannerError::EmptyRoute)));
        let (route, lights, history) = (
            whole_route(&map),
            TrafficLights::default(),
            History::default(),
        );
        let ego = ego_at(0, 5.0, 8.0);
        let scene = SceneView {
            map: &map,
            route: &route,
            ego: &ego,
            objects: &[],
            lights: &lights,
            history: &history,
        };
        let unprepared = planner.compute_trajectory(&PlannerInput {
            iteration: 0,
            scene,
        });
        assert!(matches!(unprepared, Err(PlannerError::NotInitialized)));
    }
}
