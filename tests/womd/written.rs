//! Generated scenes as files of Waymo: recordings that every clone has. The bytes are written here,
//! so that the program's reader is checked against the published format and not against itself.

use geo::orient::Direction;
use geo::{Area, Distance, Euclidean, LineString, Orient};
use planagent_scenario::generator::{self, Spec};
use planagent_scenario::{Frame, Scenario};
use planagent_world::geometry::{Point, Pose, Vector};
use planagent_world::{
    EgoState, Lane, LaneId, LaneMap, Neighbor, ObjectKind, PACIFICA, SignalStatus, TrackToken,
};
use std::collections::BTreeSet;
use std::path::Path;

/// Where the origin of a generated map lies in the file, m: recordings have coordinates of a city.
const CITY: Vector = Vector::new(1_000.0, -500.0);
/// Ids of features that are no lanes.
const FIRST_OTHER_ID: i64 = 1_000_000;

/// A message of protobuf, field by field.
#[derive(Default)]
struct Message(Vec<u8>);

impl Message {
    fn number(mut self, field: u8, value: i64) -> Self {
        self.0.push(field << 3);
        self.varint(value.cast_unsigned())
    }

    fn varint(mut self, mut value: u64) -> Self {
        while value >= 0x80 {
            self.0.push((value & 0x7f) as u8 | 0x80);
            value >>= 7;
        }
        self.0.push(value as u8);
        self
    }

    fn double(mut self, field: u8, value: f64) -> Self {
        self.0.push(field << 3 | 1);
        self.0.extend(value.to_le_bytes());
        self
    }

    fn float(mut self, field: u8, value: f64) -> Self {
        self.0.push(field << 3 | 5);
        self.0.extend((value as f32).to_le_bytes());
        self
    }

    fn bytes(mut self, field: u8, bytes: &[u8]) -> Self {
        self.0.push(field << 3 | 2);
        let mut message = self.varint(bytes.len() as u64);
        message.0.extend(bytes);
        message
    }

    /// One field for each message.
    fn all(self, field: u8, messages: impl IntoIterator<Item = Self>) -> Self {
        let add = |message: Self, part: Self| message.bytes(field, &part.0);
        messages.into_iter().fold(self, add)
    }
}

fn point(point: Point) -> Message {
    let place = point + CITY;
    Message::default()
        .double(1, place.x)
        .double(2, place.y)
        .double(3, 0.0)
}

/// A vertex of a centerline at an arc length.
fn vertex_at(lane: &Lane, s: f64) -> i64 {
    let lengths = lane.centerline.arc_lengths();
    let index = lengths.partition_point(|&length| length < s - 1e-6);
    index.min(lengths.len() - 1) as i64
}

fn lane(map: &LaneMap, lane: &Lane) -> Message {
    /// m/s of a mile per hour.
    const MILE_PER_HOUR: f64 = 0.447_04;
    const SURFACE_STREET: i64 = 2;
    let ids = |message: Message, field: u8, lanes: &[LaneId]| {
        let add = |message: Message, &id: &LaneId| message.number(field, map[id].source_id);
        lanes.iter().fold(message, add)
    };
    let beside = |neighbor: &Neighbor| {
        Message::default()
            .number(1, map[neighbor.lane].source_id)
            .number(2, vertex_at(lane, neighbor.from_s))
            .number(3, vertex_at(lane, neighbor.to_s))
    };
    let limit = lane.speed_limit.unwrap_or(0.0) / MILE_PER_HOUR;
    let vertices = lane.centerline.vertices().iter().copied();
    let message = Message::default()
        .double(1, limit)
        .number(2, SURFACE_STREET)
        .number(3, lane.is_connector().into())
        .all(8, vertices.map(point));
    let message = ids(message, 9, &lane.incoming);
    ids(message, 10, &lane.outgoing)
        .all(11, lane.left.iter().map(beside))
        .all(12, lane.right.iter().map(beside))
}

/// The outlines of the drivable area without the ends of roads, across which no edge is recorded.
fn road_edges(map: &LaneMap) -> Vec<Vec<Point>> {
    /// Maximum distance of the end of a road from the line across it, m.
    const AT_END: f64 = 1.0;
    /// Smaller gaps between areas are rounding, m².
    const GAP: f64 = 1.0;
    let ring = |points: &[Point]| points.iter().map(|p| (p.x, p.y)).collect::<LineString>();
    let drivable = map
        .roadblocks()
        .iter()
        .flat_map(|block| &block.areas)
        .chain(map.intersections())
        .chain(map.road_segments())
        .chain(map.generic_drivable())
        .chain(map.carparks());
    let drivable: Vec<geo::Polygon> = drivable
        .map(|area| {
            let holes = area.holes().iter().map(|hole| ring(hole)).collect();
            geo::Polygon::new(ring(area.ring()), holes).orient(Direction::Default)
        })
        .collect();
    let ends: Vec<geo::Point> = map
        .lanes()
        .iter()
        .flat_map(|lane| {
            let start = lane.incoming.is_empty().then(|| lane.centerline.start());
            let end = lane.outgoing.is_empty().then(|| lane.centerline.end());
            start.into_iter().chain(end)
        })
        .map(|end| geo::Point::new(end.x, end.y))
        .collect();
    let is_edge = |line: &geo::Line| {
        ends.iter()
            .all(|end| Euclidean.distance(end, line) > AT_END)
    };
    let mut edges = Vec::new();
    for area in geo::unary_union(&drivable) {
        let (outer, holes) = area.into_inner();
        let gaps =
            |hole: &LineString| geo::Polygon::new(hole.clone(), Vec::new()).unsigned_area() > GAP;
        for outline in std::iter::once(outer).chain(holes.into_iter().filter(gaps)) {
            let lines: Vec<geo::Line> = outline.lines().collect();
            for chain in lines.chunk_by(|one, next| is_edge(one) == is_edge(next)) {
                if is_edge(&chain[0]) {
                    let places = std::iter::once(chain[0].start).chain(chain.iter().map(|l| l.end));
                    edges.push(places.map(|place| Point::new(place.x, place.y)).collect());
                }
            }
        }
    }
    edges
}

/// Lanes, road edges, stop signs and crosswalks.
fn map_features(map: &LaneMap) -> Vec<Message> {
    const LANE: u8 = 3;
    const ROAD_EDGE: u8 = 5;
    const STOP_SIGN: u8 = 7;
    const CROSSWALK: u8 = 8;
    let lanes = map.lanes().iter().map(|own| {
        let id = Message::default().number(1, own.source_id);
        id.bytes(LANE, &lane(map, own).0)
    });
    let mut others: Vec<(u8, Message)> = Vec::new();
    for edge in road_edges(map) {
        others.push((
            ROAD_EDGE,
            Message::default().all(2, edge.into_iter().map(point)),
        ));
    }
    for line in map.stop_lines().iter().filter(|line| line.stop_sign) {
        let lanes = line.lanes.iter().map(|&id| map[id].source_id);
        let sign = lanes.fold(Message::default(), |sign, id| sign.number(1, id));
        others.push((STOP_SIGN, sign));
    }
    for area in map.crosswalks() {
        let corners = area.ring().iter().copied().map(point);
        others.push((CROSSWALK, Message::default().all(1, corners)));
    }
    let others = others.into_iter().enumerate().map(|(place, (kind, data))| {
        let id = Message::default().number(1, FIRST_OTHER_ID + place as i64);
        id.bytes(kind, &data.0)
    });
    lanes.chain(others).collect()
}

/// A box at a step.
fn state(center: Pose, length: f64, width: f64, velocity: Vector) -> Message {
    let place = center.position() + CITY;
    Message::default()
        .double(2, place.x)
        .double(3, place.y)
        .double(4, 0.0)
        .float(5, length)
        .float(6, width)
        .float(8, center.heading)
        .float(9, velocity.x)
        .float(10, velocity.y)
        .number(11, 1)
}

/// The center of a turning car moves sideways with its yaw rate.
fn ego_state(ego: &EgoState) -> Message {
    let sideways = PACIFICA.rear_axle_to_center() * ego.angular_velocity;
    let velocity = ego.velocity + Vector::new(0.0, sideways);
    let (length, width) = (PACIFICA.length(), PACIFICA.width);
    let velocity = ego.rear_axle.rotate(velocity);
    state(ego.center(), length, width, velocity)
}

/// The track of an object; a step in which it is not seen has no valid state.
fn track(frames: &[Frame], token: TrackToken) -> Message {
    let seen = frames
        .iter()
        .map(|frame| frame.objects.iter().find(|object| object.token == token));
    let kind = seen.clone().flatten().next().map(|object| object.kind);
    let kind = match kind {
        Some(ObjectKind::Vehicle) => 1,
        Some(ObjectKind::Pedestrian) => 2,
        Some(ObjectKind::Bicycle) => 3,
        _ => 4,
    };
    let states = seen.map(|object| {
        object.map_or_else(Message::default, |object| {
            let shape = object.shape;
            state(shape.center, shape.length, shape.width, object.velocity)
        })
    });
    Message::default()
        .number(1, i64::from(token.0) + 1)
        .number(2, kind)
        .all(3, states)
}

/// The lights of a step.
fn lights(map: &LaneMap, frame: &Frame) -> Message {
    let shown = frame.lights.iter().map(|(lane, status)| {
        let state = match status {
            SignalStatus::Unknown => 0,
            SignalStatus::Red => 4,
            SignalStatus::Yellow => 5,
            SignalStatus::Green => 6,
        };
        let stop = point(map[lane].centerline.start());
        Message::default()
            .number(1, map[lane].source_id)
            .number(2, state)
            .bytes(3, &stop.0)
    });
    Message::default().all(1, shown)
}

/// A scene as a `Scenario` message.
fn message(scenario: &Scenario) -> Vec<u8> {
    let Scenario { map, frames, .. } = scenario;
    let seconds = frames
        .iter()
        .map(|frame| 3.0 + frame.ego.time_us as f64 / 1e6);
    let ego = Message::default()
        .number(1, 0)
        .number(2, 1)
        .all(3, frames.iter().map(|frame| ego_state(&frame.ego)));
    let tokens: BTreeSet<TrackToken> = frames
        .iter()
        .flat_map(|frame| frame.objects.iter().map(|object| object.token))
        .collect();
    let tracks = tokens.into_iter().map(|token| track(frames, token));
    seconds
        .fold(Message::default(), |message, time| message.double(1, time))
        .all(2, std::iter::once(ego).chain(tracks))
        .bytes(5, scenario.id.as_bytes())
        .number(6, 0)
        .all(7, frames.iter().map(|frame| lights(map, frame)))
        .all(8, map_features(map))
        .0
}

/// A record of TFRecord: length and payload, each with its checksum.
fn record(payload: &[u8]) -> Vec<u8> {
    let checksum = |bytes: &[u8]| {
        crc32c::crc32c(bytes)
            .rotate_right(15)
            .wrapping_add(0xa282_ead8)
            .to_le_bytes()
    };
    let length = (payload.len() as u64).to_le_bytes();
    [&length[..], &checksum(&length), payload, &checksum(payload)].concat()
}

/// The bytes of a file with one recording.
pub(crate) fn bytes(scenario: &Scenario) -> Vec<u8> {
    record(&message(scenario))
}

/// A file with a recording of a named scene.
pub(crate) fn write(path: &Path, name: &str) {
    let spec: Spec = name.parse().unwrap();
    let scenario = generator::generate(&spec).unwrap();
    std::fs::write(path, bytes(&scenario)).unwrap();
}
