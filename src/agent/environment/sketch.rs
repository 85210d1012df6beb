//! Hand-drawn roads for the tests of this stage. Right-hand traffic, lanes 3.5 m wide, limit 13.4
//! m/s.

use planagent_world::geometry::{OrientedBox, Point, Polygon, Pose, Vector};
use planagent_world::{
    EgoState, History, LaneId, LaneMap, MapBuilder, MapParts, ObjectKind, PACIFICA, Route,
    SceneView, SignalStatus, TrackToken, TrackedObject, TrafficLights,
};
use std::f64::consts::{FRAC_PI_2, TAU};

pub(super) const WIDTH: f64 = 3.5;
const LIMIT: f64 = 13.4;

/// A map under construction with the width and limit of these tests.
#[derive(Default)]
pub(super) struct Sketch {
    map: MapBuilder,
}

impl Sketch {
    pub(super) fn lane(&mut self, points: Vec<Point>) -> LaneId {
        self.map.lane(points, WIDTH, Some(LIMIT)).unwrap()
    }

    fn join(&mut self, from: LaneId, to: LaneId) -> LaneId {
        self.map.join(from, to, WIDTH).unwrap()
    }

    fn finish(self) -> LaneMap {
        self.map.finish().unwrap()
    }
}

/// A scene that owns its parts.
pub(super) struct Drawn {
    pub(super) map: LaneMap,
    pub(super) route: Route,
    pub(super) ego: EgoState,
    pub(super) objects: Vec<TrackedObject>,
    pub(super) lights: TrafficLights,
    history: History,
}

impl Drawn {
    fn new(map: LaneMap, center: Pose, speed: f64) -> Self {
        let ego = EgoState::from_log(
            0,
            PACIFICA.rear_axle_of(center),
            Vector::new(speed, 0.0),
            Vector::zeros(),
        );
        let (route, lights) = (Route::default(), TrafficLights::default());
        Self {
            map,
            route,
            ego,
            objects: vec![],
            lights,
            history: History::default(),
        }
    }

    pub(super) fn scene(&self) -> SceneView<'_> {
        SceneView {
            map: &self.map,
            route: &self.route,
            ego: &self.ego,
            objects: &self.objects,
            lights: &self.lights,
            history: &self.history,
        }
    }

    /// Puts an object `forward` and `left` of the ego's box center, turned by `turn`, moving along
    /// its heading.
    pub(super) fn put(
        mut self,
        kind: ObjectKind,
        forward: f64,
        left: f64,
        turn: f64,
        speed: f64,
    ) -> Self {
        let (length, width) = kind.default_size();
        let mut center = self.ego.center().translated(forward, left);
        center.heading += turn;
        let token = TrackToken(self.objects.len() as u32);
        let shape = OrientedBox::new(center, length, width);
        self.objects.push(TrackedObject {
            token,
            kind,
            shape,
            velocity: center.direction() * speed,
        });
        self
    }

    pub(super) fn route_through(mut self, lanes: &[LaneId]) -> Self {
        self.route.roadblocks = lanes.iter().map(|&lane| self.map[lane].roadblock).collect();
        self
    }

    pub(super) fn all_lights(mut self, status: SignalStatus) -> Self {
        self.lights = self
            .map
            .lanes()
            .iter()
            .filter(|l| l.has_traffic_lights)
            .map(|lane| (lane.id, status))
            .collect();
        self
    }

    /// The same with these areas of intersections in place of its own.
    pub(super) fn with_intersections(mut self, intersections: Vec<Polygon>) -> Self {
        let map = &self.map;
        self.map = LaneMap::new(MapParts {
            lanes: map.lanes().to_vec(),
            roadblocks: map.roadblocks().to_vec(),
            stop_lines: map.stop_lines().to_vec(),
            crosswalks: map.crosswalks().to_vec(),
            intersections,
            road_segments: map.road_segments().to_vec(),
            ..MapParts::default()
        })
        .unwrap();
        self
    }

    /// The lane or connector that leads from a lane to another.
    pub(super) fn between(&self, from: LaneId, to: LaneId) -> LaneId {
        let onward = &self.map[from].outgoing;
        *onward
            .iter()
            .find(|&&lane| self.map[lane].outgoing.contains(&to))
            .unwrap()
    }
}

fn line(frame: Pose, from: f64, to: f64, left: f64) -> Vec<Point> {
    vec![
        frame.to_map(Point::new(from, left)),
        frame.to_map(Point::new(to, left)),
    ]
}

/// A straight road along x with `own` lanes (number 0 on the left, at y = 0) and `oncoming` ones
/// left of them, each of two pieces that meet at x = 40; the ego's box center at x = 0 on lane
/// `ego_lane`, with `speed`.
pub(super) fn straight(own: u32, oncoming: u32, ego_lane: u32, speed: f64) -> Drawn {
    let mut sketch = Sketch::default();
    let east = Pose::new(0.0, 0.0, 0.0);
    let west = Pose::new(40.0, 0.0, std::f64::consts::PI);
    let mut road = |frame: Pose, spans: [(f64, f64); 2], offsets: Vec<f64>| {
        let pieces = spans.map(|(from, to)| {
            let lanes: Vec<LaneId> = offsets
                .iter()
                .map(|&left| sketch.lane(line(frame, from, to, left)))
                .collect();
            sketch.map.abreast(&lanes);
            lanes
        });
        for (&from, &to) in pieces[0].iter().zip(&pieces[1]) {
            sketch.map.connect(from, to);
        }
    };
    road(
        east,
        [(-100.0, 40.0), (40.0, 200.0)],
        (0..own).map(|i| -WIDTH * f64::from(i)).collect(),
    );
    if oncoming > 0 {
        road(
            west,
            [(-160.0, 0.0), (0.0, 140.0)],
            (0..oncoming).map(|i| -WIDTH * f64::from(i + 1)).collect(),
        );
    }
    Drawn::new(
        sketch.finish(),
        Pose::new(0.0, -WIDTH * f64::from(ego_lane), 0.0),
        speed,
    )
}

/// A single lane that runs straight for 100 m, then bends with `radius` meters (positive: left) for
/// a quarter circle; the ego's box center `before` meters in front of the bend.
pub(super) fn curve(radius: f64, before: f64, speed: f64) -> Drawn {
    let mut sketch = Sketch::default();
    let bend = (0..=40).map(|i| {
        let a = f64::from(i) / 40.0 * FRAC_PI_2;
        Point::new(radius.abs() * a.sin(), radius * (1.0 - a.cos()))
    });
    sketch.lane(
        std::iter::once(Point::new(-100.0, 0.0))
            .chain(bend)
            .collect(),
    );
    Drawn::new(sketch.finish(), Pose::new(-before, 0.0, 0.0), speed)
}

/// Half the width of the crossing's middle, meters.
pub(super) const MIDDLE: f64 = 14.0;

/// The lanes of a crossing: `inbound[arm][k]` and `outbound[arm][k]`, k from the left; arm 0 drives
/// along +x, then by quarter turns to the left.
pub(super) struct Arms {
    pub(super) inbound: Vec<Vec<LaneId>>,
    pub(super) outbound: Vec<Vec<LaneId>>,
}

/// A four-armed signalled crossing around the origin, `lanes` each way, crosswalks over every arm;
/// the ego drives along +x on inbound lane `ego_lane`, its box center `before` meters from the
/// middle's edge. All lights are unset.
pub(super) fn crossing(lanes: u32, ego_lane: u32, before: f64, speed: f64) -> (Drawn, Arms) {
    let mut sketch = Sketch::default();
    let right = |k: u32| -WIDTH * (f64::from(k) + 0.5);
    let mut arms = Arms {
        inbound: vec![],
        outbound: vec![],
    };
    for arm in 0..4 {
        let frame = Pose::new(0.0, 0.0, FRAC_PI_2 * f64::from(arm));
        let mut both = |from, to| {
            let road: Vec<LaneId> = (0..lanes)
                .map(|k| sketch.lane(line(frame, from, to, right(k))))
                .collect();
            sketch.map.abreast(&road);
            road
        };
        arms.inbound.push(both(-120.0, -MIDDLE));
        arms.outbound.push(both(MIDDLE, 120.0));
        let across = OrientedBox::new(
            frame.translated(-MIDDLE + 2.0, 0.0),
            3.0,
            2.0 * WIDTH * f64::from(lanes),
        );
        sketch.map.parts.crosswalks.push(across.to_polygon());
    }
    for arm in 0..4 {
        let last = lanes as usize - 1;
        let straight: Vec<LaneId> = (0..=last)
            .map(|k| sketch.join(arms.inbound[arm][k], arms.outbound[arm][k]))
            .collect();
        sketch.map.abreast(&straight);
        let left = sketch.join(arms.inbound[arm][0], arms.outbound[(arm + 1) % 4][0]);
        let right = sketch.join(arms.inbound[arm][last], arms.outbound[(arm + 3) % 4][last]);
        for connector in straight.into_iter().chain([left, right]) {
            sketch.map.stop_line(connector, WIDTH);
        }
    }
    let side = 2.0 * MIDDLE;
    sketch
        .map
        .parts
        .intersections
        .push(OrientedBox::new(Pose::default(), side, side).to_polygon());
    (
        Drawn::new(
            sketch.finish(),
            Pose::new(-MIDDLE - before, right(ego_lane), 0.0),
            speed,
        ),
        arms,
    )
}

/// A roundabout of `radius` meters around the origin with four arms; the ego drives along +x
/// towards it, its box center `before` meters from the end of its lane.
pub(super) fn roundabout(radius: f64, before: f64, speed: f64) -> Drawn {
    /// Half the angle between exit and entry of an arm.
    const OPENING: f64 = 0.45;
    let mut sketch = Sketch::default();
    let mut arc = |from: f64, to: f64| {
        let points = (0..=12).map(|i| {
            let a = from + (to - from) * f64::from(i) / 12.0;
            Point::new(radius * a.cos(), radius * a.sin())
        });
        sketch.lane(points.collect())
    };
    let arm_angle = |arm: usize| TAU / 2.0 + FRAC_PI_2 * arm as f64;
    let gates: Vec<LaneId> = (0..4)
        .map(|a| arc(arm_angle(a) - OPENING, arm_angle(a) + OPENING))
        .collect();
    let sides: Vec<LaneId> = (0..4)
        .map(|a| arc(arm_angle(a) + OPENING, arm_angle(a + 1) - OPENING))
        .collect();
    for arm in 0..4 {
        sketch.map.connect(gates[arm], sides[arm]);
        sketch.map.connect(sides[arm], gates[(arm + 1) % 4]);
        let frame = Pose::new(0.0, 0.0, FRAC_PI_2 * arm as f64);
        let end = -radius - 10.0;
        let inbound = sketch.lane(line(frame, end - 80.0, end, -WIDTH / 2.0));
        let back = Pose::new(0.0, 0.0, frame.heading + TAU / 2.0);
        let outbound = sketch.lane(line(back, -end, 80.0 - end, -WIDTH / 2.0));
        sketch.join(inbound, sides[arm]);
        sketch.join(sides[(arm + 3) % 4], outbound);
    }
    Drawn::new(
        sketch.finish(),
        Pose::new(-radius - 10.0 - before, -WIDTH / 2.0, 0.0),
        speed,
    )
}
