//! The `Scenario` message, as far as it is read. Field numbers are those of the published descriptors; what is not listed
//! (laser and camera data, predictions asked of the challenge) is skipped as unknown fields.
//!
//! Metres, radians, m/s; speed limits in miles per hour; 10 Hz.

use prost::{Enumeration, Message, Oneof};

/// A recording.
#[allow(clippy::struct_field_names)] // The field is named as in the published message.
#[derive(Clone, PartialEq, Message)]
pub(super) struct Scenario {
    /// Unique name.
    #[prost(string, tag = "5")]
    pub scenario_id: String,
    /// Time of each step, s.
    #[prost(double, repeated, tag = "1")]
    pub timestamps_seconds: Vec<f64>,
    /// The step that the prediction challenge calls now.
    #[prost(int32, tag = "10")]
    pub current_time_index: i32,
    /// All objects, the recording car among them.
    #[prost(message, repeated, tag = "2")]
    pub tracks: Vec<Track>,
    /// Traffic lights, an entry a step.
    #[prost(message, repeated, tag = "7")]
    pub dynamic_map_states: Vec<DynamicMapState>,
    /// The map.
    #[prost(message, repeated, tag = "8")]
    pub map_features: Vec<MapFeature>,
    /// Which track is the recording car.
    #[prost(int32, tag = "6")]
    pub sdc_track_index: i32,
}

/// An object over time.
#[derive(Clone, PartialEq, Message)]
pub(super) struct Track {
    /// Unique within the recording.
    #[prost(int32, tag = "1")]
    pub id: i32,
    /// What it is.
    #[prost(enumeration = "ObjectType", tag = "2")]
    pub object_type: i32,
    /// An entry a step.
    #[prost(message, repeated, tag = "3")]
    pub states: Vec<ObjectState>,
}

/// `Track.ObjectType`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Enumeration)]
#[repr(i32)]
pub(super) enum ObjectType {
    /// Not set.
    Unset = 0,
    /// Car, truck, bus, motorcycle.
    Vehicle = 1,
    /// Person on foot.
    Pedestrian = 2,
    /// Bicycle with its rider.
    Cyclist = 3,
    /// Anything else.
    Other = 4,
}

/// An object at one step; `center_*` is the centre of its box.
#[derive(Clone, Copy, PartialEq, Message)]
pub(super) struct ObjectState {
    /// East, m.
    #[prost(double, tag = "2")]
    pub center_x: f64,
    /// North, m.
    #[prost(double, tag = "3")]
    pub center_y: f64,
    /// Up, m.
    #[prost(double, tag = "4")]
    pub center_z: f64,
    /// Box length, m.
    #[prost(float, tag = "5")]
    pub length: f32,
    /// Box width, m.
    #[prost(float, tag = "6")]
    pub width: f32,
    /// Heading, radians counter-clockwise from east.
    #[prost(float, tag = "8")]
    pub heading: f32,
    /// Velocity to the east, m/s.
    #[prost(float, tag = "9")]
    pub velocity_x: f32,
    /// Velocity to the north, m/s.
    #[prost(float, tag = "10")]
    pub velocity_y: f32,
    /// Whether the object was seen at this step.
    #[prost(bool, tag = "11")]
    pub valid: bool,
}

/// Lights at one step.
#[derive(Clone, PartialEq, Message)]
pub(super) struct DynamicMapState {
    /// An entry a controlled lane.
    #[prost(message, repeated, tag = "1")]
    pub lane_states: Vec<TrafficSignalLaneState>,
}

/// The light of a lane.
#[derive(Clone, PartialEq, Message)]
pub(super) struct TrafficSignalLaneState {
    /// The lane that it controls.
    #[prost(int64, tag = "1")]
    pub lane: i64,
    /// What it shows.
    #[prost(enumeration = "SignalState", tag = "2")]
    pub state: i32,
    /// Where to stop for it.
    #[prost(message, optional, tag = "3")]
    pub stop_point: Option<MapPoint>,
}

/// `TrafficSignalLaneState.State`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Enumeration)]
#[repr(i32)]
pub(super) enum SignalState {
    /// Not known.
    Unknown = 0,
    /// Red arrow.
    ArrowStop = 1,
    /// Yellow arrow.
    ArrowCaution = 2,
    /// Green arrow.
    ArrowGo = 3,
    /// Red.
    Stop = 4,
    /// Yellow.
    Caution = 5,
    /// Green.
    Go = 6,
    /// Flashing red.
    FlashingStop = 7,
    /// Flashing yellow.
    FlashingCaution = 8,
}

/// A point of the map, m.
#[derive(Clone, Copy, PartialEq, Message)]
pub(super) struct MapPoint {
    /// East.
    #[prost(double, tag = "1")]
    pub x: f64,
    /// North.
    #[prost(double, tag = "2")]
    pub y: f64,
    /// Up.
    #[prost(double, tag = "3")]
    pub z: f64,
}

/// A part of the map.
#[derive(Clone, PartialEq, Message)]
pub(super) struct MapFeature {
    /// Unique within the recording.
    #[prost(int64, tag = "1")]
    pub id: i64,
    /// What it is.
    #[prost(oneof = "FeatureData", tags = "3, 4, 5, 7, 8, 9, 10")]
    pub feature_data: Option<FeatureData>,
}

/// The kinds of map features.
#[derive(Clone, PartialEq, Oneof)]
pub(super) enum FeatureData {
    /// A lane's centreline.
    #[prost(message, tag = "3")]
    Lane(LaneCenter),
    /// A painted line.
    #[prost(message, tag = "4")]
    RoadLine(Line),
    /// A kerb or median.
    #[prost(message, tag = "5")]
    RoadEdge(Line),
    /// A stop sign.
    #[prost(message, tag = "7")]
    StopSign(StopSign),
    /// A crosswalk.
    #[prost(message, tag = "8")]
    Crosswalk(Area),
    /// A speed bump.
    #[prost(message, tag = "9")]
    SpeedBump(Area),
    /// A driveway.
    #[prost(message, tag = "10")]
    Driveway(Area),
}

/// A lane.
#[derive(Clone, PartialEq, Message)]
pub(super) struct LaneCenter {
    /// Miles per hour; 0 when unknown.
    #[prost(double, tag = "1")]
    pub speed_limit_mph: f64,
    /// What it is for.
    #[prost(enumeration = "LaneType", tag = "2")]
    pub r#type: i32,
    /// Whether it only joins two other lanes.
    #[prost(bool, tag = "3")]
    pub interpolating: bool,
    /// Centreline in driving direction.
    #[prost(message, repeated, tag = "8")]
    pub polyline: Vec<MapPoint>,
    /// Lanes that lead into it.
    #[prost(int64, repeated, tag = "9")]
    pub entry_lanes: Vec<i64>,
    /// Lanes that it leads to.
    #[prost(int64, repeated, tag = "10")]
    pub exit_lanes: Vec<i64>,
    /// What bounds it on the left.
    #[prost(message, repeated, tag = "13")]
    pub left_boundaries: Vec<BoundarySegment>,
    /// What bounds it on the right.
    #[prost(message, repeated, tag = "14")]
    pub right_boundaries: Vec<BoundarySegment>,
    /// Lanes of the same direction on the left.
    #[prost(message, repeated, tag = "11")]
    pub left_neighbors: Vec<LaneNeighbor>,
    /// Lanes of the same direction on the right.
    #[prost(message, repeated, tag = "12")]
    pub right_neighbors: Vec<LaneNeighbor>,
}

/// `LaneCenter.LaneType`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Enumeration)]
#[repr(i32)]
pub(super) enum LaneType {
    /// Not set.
    Undefined = 0,
    /// A lane of a freeway.
    Freeway = 1,
    /// A lane of a street.
    SurfaceStreet = 2,
    /// A bicycle lane.
    BikeLane = 3,
}

/// A stretch of a lane with the line that bounds it; indices count the lane's points.
#[derive(Clone, Copy, PartialEq, Message)]
pub(super) struct BoundarySegment {
    /// First point.
    #[prost(int32, tag = "1")]
    pub lane_start_index: i32,
    /// Last point.
    #[prost(int32, tag = "2")]
    pub lane_end_index: i32,
    /// A road line or road edge.
    #[prost(int64, tag = "3")]
    pub boundary_feature_id: i64,
}

/// A neighbouring lane and where; indices count the points of this lane and of the other.
#[derive(Clone, Copy, PartialEq, Message)]
pub(super) struct LaneNeighbor {
    /// The other lane.
    #[prost(int64, tag = "1")]
    pub feature_id: i64,
    /// First point of this lane.
    #[prost(int32, tag = "2")]
    pub self_start_index: i32,
    /// Last point of this lane.
    #[prost(int32, tag = "3")]
    pub self_end_index: i32,
    /// First point of the other lane.
    #[prost(int32, tag = "4")]
    pub neighbor_start_index: i32,
    /// Last point of the other lane.
    #[prost(int32, tag = "5")]
    pub neighbor_end_index: i32,
}

/// A road line or a road edge; its type is not used.
#[derive(Clone, PartialEq, Message)]
pub(super) struct Line {
    /// Its points.
    #[prost(message, repeated, tag = "2")]
    pub polyline: Vec<MapPoint>,
}

/// A stop sign.
#[derive(Clone, PartialEq, Message)]
pub(super) struct StopSign {
    /// The lanes that it governs.
    #[prost(int64, repeated, tag = "1")]
    pub lane: Vec<i64>,
    /// Where it stands.
    #[prost(message, optional, tag = "2")]
    pub position: Option<MapPoint>,
}

/// A crosswalk, speed bump or driveway.
#[derive(Clone, PartialEq, Message)]
pub(super) struct Area {
    /// Its outline.
    #[prost(message, repeated, tag = "1")]
    pub polygon: Vec<MapPoint>,
}
