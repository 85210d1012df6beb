//! A scene that owns its parts, and its builder: for programs that plan in a loop of their own.

use super::{
    EgoState, History, HistorySample, LaneId, LaneMap, MICROS_PER_SECOND, MapBuilder, MapError,
    ObjectKind, PACIFICA, RoadblockId, Route, SceneView, SignalStatus, TrackToken, TrackedObject,
    TrafficLights,
};
use crate::geometry::{GeometryError, OrientedBox, Point, Pose, Vector};
use std::sync::Arc;

/// Width of a lane unless the builder sets another, meters.
const DEFAULT_LANE_WIDTH: f64 = 3.5;
/// Speed limit of a lane unless the builder sets another, m/s (50 km/h).
const DEFAULT_SPEED_LIMIT: f64 = 13.9;

/// The world around the ego at one instant: map, route, ego, objects, lights, and the recent past.
///
/// ```
/// use planagent_world::Scene;
///
/// // A straight road of two lanes, and a slow car ahead.
/// let scene = Scene::builder()
///     .lanes(2, [[-50.0, 0.0], [200.0, 0.0]])
///     .ego([0.0, -3.5], 0.0, 10.0)
///     .vehicle([30.0, -3.5], 0.0, 4.0)
///     .build()?;
/// assert_eq!(scene.objects.len(), 1);
/// # Ok::<(), planagent_world::SceneError>(())
/// ```
#[derive(Debug, Clone)]
#[non_exhaustive]
pub struct Scene {
    /// The static map.
    pub map: Arc<LaneMap>,
    /// Where the ego shall go.
    pub route: Route,
    /// The ego; its time is that of the scene.
    pub ego: EgoState,
    /// The objects around it.
    pub objects: Arc<[TrackedObject]>,
    /// The traffic lights.
    pub lights: TrafficLights,
    /// The last two seconds; the newest sample is the present.
    pub history: History,
}

impl Scene {
    /// An empty builder.
    pub fn builder() -> SceneBuilder {
        SceneBuilder::default()
    }

    /// The scene that a planner sees on a map, to keep beyond its step.
    pub fn of_view(map: Arc<LaneMap>, view: &SceneView<'_>) -> Self {
        Self {
            map,
            route: view.route.clone(),
            ego: *view.ego,
            objects: Arc::from(view.objects),
            lights: view.lights.clone(),
            history: view.history.clone(),
        }
    }

    /// What a planner sees.
    pub fn view(&self) -> SceneView<'_> {
        SceneView {
            map: &self.map,
            route: &self.route,
            ego: &self.ego,
            objects: &self.objects,
            lights: &self.lights,
            history: &self.history,
        }
    }

    /// The same scene later: the ego in a new state, whose time counts, and the objects as they are
    /// then.
    pub fn advance(&mut self, ego: EgoState, objects: impl Into<Arc<[TrackedObject]>>) {
        self.ego = ego;
        self.objects = objects.into();
        self.history.push(HistorySample {
            ego,
            objects: Arc::clone(&self.objects),
        });
    }

    /// Time of the scene, seconds.
    pub fn time_s(&self) -> f64 {
        self.ego.time_us as f64 / MICROS_PER_SECOND
    }
}

/// Why a builder has no scene.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
#[allow(missing_docs, reason = "the message of a variant says what it is")]
pub enum SceneError {
    #[error("lane {lane} of the scene is no line")]
    Lane { lane: usize, source: GeometryError },
    #[error("the lanes of the scene make no map")]
    Map(#[from] MapError),
    #[error("the scene has no ego; call SceneBuilder::ego")]
    NoEgo,
    #[error("the {what} of the scene names lane {lane}, and the map has {lanes} lanes")]
    UnknownLane {
        what: &'static str,
        lane: usize,
        lanes: usize,
    },
    #[error("the {what} of the scene has a NaN or infinite value")]
    NotFinite { what: &'static str },
}

/// A lane of the builder.
#[derive(Debug, Clone)]
struct Drawn {
    points: Vec<Point>,
    width: f64,
    connector: bool,
    speed_limit: Option<f64>,
    /// Whether the lane before it is its left neighbor.
    beside: bool,
}

/// Builds an [`Scene`]. Lanes are numbered from 0 in the order of their calls. Positions are in
/// meters, headings in radians, speeds in m/s.
#[derive(Debug, Clone)]
pub struct SceneBuilder {
    map: Option<Arc<LaneMap>>,
    drawn: Vec<Drawn>,
    width: f64,
    speed_limit: Option<f64>,
    route: Option<Vec<usize>>,
    ego: Option<EgoState>,
    objects: Vec<TrackedObject>,
    lights: Vec<(usize, SignalStatus)>,
}

impl Default for SceneBuilder {
    fn default() -> Self {
        Self {
            map: None,
            drawn: vec![],
            width: DEFAULT_LANE_WIDTH,
            speed_limit: Some(DEFAULT_SPEED_LIMIT),
            route: None,
            ego: None,
            objects: vec![],
            lights: vec![],
        }
    }
}

impl SceneBuilder {
    /// A map made elsewhere, instead of lanes.
    pub fn map(mut self, map: Arc<LaneMap>) -> Self {
        self.map = Some(map);
        self
    }

    /// Speed limit of the lanes that follow; `None`: unknown.
    pub fn speed_limit(mut self, limit: impl Into<Option<f64>>) -> Self {
        self.speed_limit = limit.into();
        self
    }

    /// Width of the lanes that follow.
    pub fn lane_width(mut self, width: f64) -> Self {
        self.width = width;
        self
    }

    /// Adds a lane along its centerline. Lanes that touch end to start are connected.
    pub fn lane(self, points: impl IntoIterator<Item = [f64; 2]>) -> Self {
        self.lanes(1, points)
    }

    /// Adds lanes side by side from left to right; `points` is the centerline of the leftmost.
    pub fn lanes(mut self, count: usize, points: impl IntoIterator<Item = [f64; 2]>) -> Self {
        let line: Vec<Point> = points.into_iter().map(Point::from).collect();
        let leftmost = crate::geometry::Polyline::new(line.iter().copied());
        for i in 0..count {
            let right = -self.width * i as f64;
            let points = match &leftmost {
                Ok(leftmost) => leftmost.offset(right).vertices().to_vec(),
                // `build` reports what is wrong with it.
                Err(_) => line.clone(),
            };
            let (width, speed_limit) = (self.width, self.speed_limit);
            self.drawn.push(Drawn {
                points,
                width,
                connector: false,
                speed_limit,
                beside: i > 0,
            });
        }
        self
    }

    /// Adds a connector: a lane across an intersection, which may have a light.
    pub fn connector(mut self, points: impl IntoIterator<Item = [f64; 2]>) -> Self {
        let points = points.into_iter().map(Point::from).collect();
        self.drawn.push(Drawn {
            points,
            width: self.width,
            connector: true,
            speed_limit: None,
            beside: false,
        });
        self
    }

    /// The lanes that the ego shall follow. Without this call, the route follows the lane under the
    /// ego.
    pub fn route(mut self, lanes: impl IntoIterator<Item = usize>) -> Self {
        self.route = Some(lanes.into_iter().collect());
        self
    }

    /// The ego by the center of its box, at time 0.
    pub fn ego(self, center: [f64; 2], heading: f64, speed: f64) -> Self {
        let rear_axle = PACIFICA.rear_axle_of(Pose::new(center[0], center[1], heading));
        self.ego_state(EgoState::from_log(
            0,
            rear_axle,
            Vector::new(speed, 0.0),
            Vector::zeros(),
        ))
    }

    /// The ego with its whole state.
    pub fn ego_state(mut self, ego: EgoState) -> Self {
        self.ego = Some(ego);
        self
    }

    /// Adds a car.
    pub fn vehicle(self, center: [f64; 2], heading: f64, speed: f64) -> Self {
        self.object(ObjectKind::Vehicle, center, heading, speed)
    }

    /// Adds an object of the default size of its kind, moving along its heading.
    pub fn object(mut self, kind: ObjectKind, center: [f64; 2], heading: f64, speed: f64) -> Self {
        let center = Pose::new(center[0], center[1], heading);
        let (length, width) = kind.default_size();
        let token = TrackToken(self.objects.len() as u32);
        let (shape, velocity) = (
            OrientedBox::new(center, length, width),
            center.direction() * speed,
        );
        self.objects.push(TrackedObject {
            token,
            kind,
            shape,
            velocity,
        });
        self
    }

    /// Adds objects as they are; their tokens must differ.
    pub fn objects(mut self, objects: impl IntoIterator<Item = TrackedObject>) -> Self {
        self.objects.extend(objects);
        self
    }

    /// The light of a connector.
    pub fn light(mut self, connector: usize, status: SignalStatus) -> Self {
        self.lights.push((connector, status));
        self
    }

    /// The scene.
    ///
    /// # Errors
    /// When there is no ego, a lane is no line, a light or route names no lane, or a value is NaN
    /// or infinite.
    pub fn build(self) -> Result<Scene, SceneError> {
        let ego = self.ego.ok_or(SceneError::NoEgo)?;
        // Before a map is made of it: its fault would have another name.
        if !(ego.rear_axle.is_finite()
            && ego.velocity.norm().is_finite()
            && ego.acceleration.norm().is_finite())
        {
            return Err(SceneError::NotFinite { what: "ego" });
        }
        if !self
            .objects
            .iter()
            .all(|o| o.shape.center.is_finite() && o.velocity.norm().is_finite())
        {
            return Err(SceneError::NotFinite { what: "objects" });
        }
        let map = match self.map {
            Some(map) => map,
            None => Arc::new(map_of(&self.drawn, &self.lights)?),
        };
        let lane = |what, lane: usize| {
            let lanes = map.lanes().len();
            if lane < lanes {
                Ok(LaneId(lane as u32))
            } else {
                Err(SceneError::UnknownLane { what, lane, lanes })
            }
        };
        let lights = self
            .lights
            .iter()
            .map(|&(at, status)| Ok((lane("light", at)?, status)));
        let lights: TrafficLights = lights.collect::<Result<_, SceneError>>()?;
        let roadblocks = match self.route {
            Some(lanes) => {
                let blocks = lanes
                    .into_iter()
                    .map(|at| Ok(map[lane("route", at)?].roadblock));
                let mut blocks = blocks.collect::<Result<Vec<RoadblockId>, SceneError>>()?;
                blocks.dedup();
                blocks
            }
            None => ahead(&map, ego.center()),
        };
        let objects: Arc<[TrackedObject]> = self.objects.into();
        let mut history = History::default();
        history.push(HistorySample {
            ego,
            objects: Arc::clone(&objects),
        });
        let route = Route {
            roadblocks,
            goal: None,
            goal_lane: None,
        };
        Ok(Scene {
            map,
            route,
            ego,
            objects,
            lights,
            history,
        })
    }
}

fn map_of(drawn: &[Drawn], lights: &[(usize, SignalStatus)]) -> Result<LaneMap, SceneError> {
    let mut map = MapBuilder::default();
    let mut abreast: Vec<LaneId> = vec![];
    // Every lane is added, in order, so a lane's id is its place in `drawn`; lights rely on that.
    for (number, lane) in drawn.iter().enumerate() {
        let points = lane.points.iter().copied();
        let added = if lane.connector {
            map.connector(points, lane.width)
        } else {
            map.lane(points, lane.width, lane.speed_limit)
        };
        let id = added.map_err(|source| SceneError::Lane {
            lane: number,
            source,
        })?;
        if !lane.beside && !abreast.is_empty() {
            map.abreast(&std::mem::take(&mut abreast));
        }
        abreast.push(id);
        if lane.connector {
            let polygon = map.parts.lanes[id.index()].polygon.clone();
            map.parts.intersections.push(polygon);
        }
    }
    map.abreast(&abreast);
    map.connect_touching();
    for &(connector, _) in lights {
        if let Some(lane) = drawn.get(connector) {
            map.stop_line(LaneId(connector as u32), lane.width);
        }
    }
    Ok(map.finish()?)
}

/// The roadblocks from the lane under the ego on, at forks along the first successor.
fn ahead(map: &LaneMap, ego: Pose) -> Vec<RoadblockId> {
    let mut blocks = vec![];
    let mut next = map.best_fit(&map.lanes_at(ego.position()), ego);
    while let Some(lane) = next.filter(|&lane| !blocks.contains(&map[lane].roadblock)) {
        blocks.push(map[lane].roadblock);
        next = map[lane].outgoing.first().copied();
    }
    blocks
}

#[cfg(test)]
mod tests {
    use super::*;

    fn crossing() -> SceneBuilder {
        Scene::builder()
            .lanes(2, [[0.0, 0.0], [100.0, 0.0]])
            .connector([[100.0, -3.5], [120.0, -3.5]])
            .lane([[120.0, -3.5], [200.0, -3.5]])
            .ego([10.0, -3.5], 0.0, 8.0)
    }

    #[test]
    fn lanes_are_connected_by_their_ends_and_neighbors_by_their_call() {
        let scene = crossing().light(2, SignalStatus::Red).build().unwrap();
        let map = &scene.map;
        assert_eq!(map.lanes().len(), 4);
        assert_eq!(
            (map[LaneId(0)].right[0].lane, map[LaneId(1)].left[0].lane),
            (LaneId(1), LaneId(0))
        );
        assert_eq!(map[LaneId(1)].outgoing, [LaneId(2)]);
        assert_eq!(map[LaneId(2)].outgoing, [LaneId(3)]);
        assert!(
            map[LaneId(2)].has_traffic_lights
                && scene.lights.status(LaneId(2)) == Some(SignalStatus::Red)
        );
        let blocks: Vec<_> = [1, 2, 3].map(|lane| map[LaneId(lane)].roadblock).into();
        assert_eq!(scene.route.roadblocks, blocks);
        assert!((scene.ego.center().y + 3.5).abs() < 1e-12);
    }

    #[test]
    fn baselines_are_dense() {
        let scene = crossing().build().unwrap();
        for lane in scene.map.lanes() {
            let steps = lane
                .centerline
                .vertices()
                .windows(2)
                .map(|pair| (pair[1] - pair[0]).norm());
            assert!(
                steps.fold(0.0, f64::max) < crate::BASELINE_SPACING + 1e-6,
                "{:?}",
                lane.id
            );
        }
    }

    #[test]
    fn what_is_wrong_is_named() {
        assert_eq!(
            Scene::builder()
                .lane([[0.0, 0.0], [9.0, 0.0]])
                .build()
                .unwrap_err(),
            SceneError::NoEgo
        );
        let no_map = Scene::builder()
            .ego([0.0, 0.0], 0.0, 0.0)
            .build()
            .unwrap_err();
        assert_eq!(no_map, SceneError::Map(MapError::NoLanes));
        let point = crossing().lane([[0.0, 0.0]]).build().unwrap_err();
        assert!(matches!(point, SceneError::Lane { lane: 4, .. }), "{point}");
        let light = crossing().light(7, SignalStatus::Red).build().unwrap_err();
        assert_eq!(
            light,
            SceneError::UnknownLane {
                what: "light",
                lane: 7,
                lanes: 4
            }
        );
        assert!(matches!(
            crossing().route([9]).build(),
            Err(SceneError::UnknownLane { what: "route", .. })
        ));
        let lost = crossing()
            .vehicle([f64::NAN, 0.0], 0.0, 0.0)
            .build()
            .unwrap_err();
        assert_eq!(lost, SceneError::NotFinite { what: "objects" });
    }

    #[test]
    fn a_later_scene_remembers_the_present() {
        let mut scene = crossing().vehicle([40.0, -3.5], 0.0, 5.0).build().unwrap();
        let later = EgoState {
            time_us: 50_000,
            ..scene.ego
        };
        scene.advance(later, vec![]);
        assert!(scene.objects.is_empty() && (scene.time_s() - 0.05).abs() < 1e-12);
        assert_eq!(scene.history.samples().len(), 2);
    }
}
