//! The fields of the `Scenario` message that are read, with the numbers of the published
//! descriptors. Others (laser and camera data, prediction tasks) are skipped as unknown.
//!
//! Meters, radians, m/s; speed limits in miles per hour; 10 Hz.

use prost::{Enumeration, Message, Oneof};

/// A recording.
#[allow(clippy::struct_field_names)] // The field is named as in the published message.
#[derive(Clone, PartialEq, Message)]
pub(super) struct Scenario {
    #[prost(string, tag = "5")]
    pub scenario_id: String,
    /// Time of each step, s.
    #[prost(double, repeated, tag = "1")]
    pub timestamps_seconds: Vec<f64>,
    /// All objects, the recording car among them.
    #[prost(message, repeated, tag = "2")]
    pub tracks: Vec<Track>,
    /// Traffic lights, one entry per step.
    #[prost(message, repeated, tag = "7")]
    pub dynamic_map_states: Vec<DynamicMapState>,
    #[prost(message, repeated, tag = "8")]
    pub map_features: Vec<MapFeature>,
    /// Index of the recording car's track. Its absence is not 0: writers of proto3 leave it out.
    #[prost(int32, optional, tag = "6")]
    pub sdc_track_index: Option<i32>,
}

/// An object over time.
#[derive(Clone, PartialEq, Message)]
pub(super) struct Track {
    /// Unique within the recording.
    #[prost(int32, tag = "1")]
    pub id: i32,
    #[prost(enumeration = "ObjectType", tag = "2")]
    pub object_type: i32,
    /// One entry per step.
    #[prost(message, repeated, tag = "3")]
    pub states: Vec<ObjectState>,
}

/// `Track.ObjectType`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Enumeration)]
#[repr(i32)]
pub(super) enum ObjectType {
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

/// An object at one step; `center_*` is the center of its box.
#[derive(Clone, Copy, PartialEq, Message)]
pub(super) struct ObjectState {
    #[prost(double, optional, tag = "2")]
    pub center_x: Option<f64>,
    #[prost(double, optional, tag = "3")]
    pub center_y: Option<f64>,
    #[prost(double, tag = "4")]
    pub center_z: f64,
    #[prost(float, tag = "5")]
    pub length: f32,
    #[prost(float, tag = "6")]
    pub width: f32,
    /// Heading, radians counter-clockwise from east.
    #[prost(float, tag = "8")]
    pub heading: f32,
    #[prost(float, optional, tag = "9")]
    pub velocity_x: Option<f32>,
    #[prost(float, optional, tag = "10")]
    pub velocity_y: Option<f32>,
    /// True if the object was observed at this step.
    #[prost(bool, tag = "11")]
    pub valid: bool,
}

/// Lights at one step.
#[derive(Clone, PartialEq, Message)]
pub(super) struct DynamicMapState {
    /// One entry per controlled lane.
    #[prost(message, repeated, tag = "1")]
    pub lane_states: Vec<TrafficSignalLaneState>,
}

/// The light of a lane.
#[derive(Clone, PartialEq, Message)]
pub(super) struct TrafficSignalLaneState {
    #[prost(int64, tag = "1")]
    pub lane: i64,
    #[prost(enumeration = "SignalState", tag = "2")]
    pub state: i32,
    #[prost(message, optional, tag = "3")]
    pub stop_point: Option<MapPoint>,
}

/// `TrafficSignalLaneState.State`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Enumeration)]
#[repr(i32)]
pub(super) enum SignalState {
    Unknown = 0,
    ArrowStop = 1,
    ArrowCaution = 2,
    ArrowGo = 3,
    Stop = 4,
    Caution = 5,
    Go = 6,
    FlashingStop = 7,
    FlashingCaution = 8,
}

/// A point of the map, m.
#[derive(Clone, Copy, PartialEq, Message)]
pub(super) struct MapPoint {
    #[prost(double, tag = "1")]
    pub x: f64,
    #[prost(double, tag = "2")]
    pub y: f64,
    #[prost(double, tag = "3")]
    pub z: f64,
}

/// A part of the map.
#[derive(Clone, PartialEq, Message)]
pub(super) struct MapFeature {
    /// Unique within the recording.
    #[prost(int64, tag = "1")]
    pub id: i64,
    #[prost(oneof = "FeatureData", tags = "3, 4, 5, 7, 8, 10")]
    pub feature_data: Option<FeatureData>,
}

/// The kinds of map features.
#[derive(Clone, PartialEq, Oneof)]
pub(super) enum FeatureData {
    #[prost(message, tag = "3")]
    Lane(LaneCenter),
    #[prost(message, tag = "4")]
    RoadLine(Line),
    /// A curb or median.
    #[prost(message, tag = "5")]
    RoadEdge(Line),
    #[prost(message, tag = "7")]
    StopSign(StopSign),
    #[prost(message, tag = "8")]
    Crosswalk(Area),
    #[prost(message, tag = "10")]
    Driveway(Area),
}

/// A lane.
#[derive(Clone, PartialEq, Message)]
pub(super) struct LaneCenter {
    /// Miles per hour; 0 when unknown.
    #[prost(double, tag = "1")]
    pub speed_limit_mph: f64,
    #[prost(enumeration = "LaneType", tag = "2")]
    pub r#type: i32,
    /// True if it only joins two other lanes.
    #[prost(bool, tag = "3")]
    pub interpolating: bool,
    /// In driving direction.
    #[prost(message, repeated, tag = "8")]
    pub polyline: Vec<MapPoint>,
    #[prost(int64, repeated, tag = "9")]
    pub entry_lanes: Vec<i64>,
    #[prost(int64, repeated, tag = "10")]
    pub exit_lanes: Vec<i64>,
    #[prost(message, repeated, tag = "13")]
    pub left_boundaries: Vec<BoundarySegment>,
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
    Undefined = 0,
    Freeway = 1,
    SurfaceStreet = 2,
    BikeLane = 3,
}

/// A part of a lane with its boundary line; indices count the lane's points.
#[derive(Clone, Copy, PartialEq, Message)]
pub(super) struct BoundarySegment {
    #[prost(int32, tag = "1")]
    pub lane_start_index: i32,
    #[prost(int32, tag = "2")]
    pub lane_end_index: i32,
    #[prost(int64, tag = "3")]
    pub boundary_feature_id: i64,
}

/// A neighboring lane; indices count the points of this lane.
#[derive(Clone, Copy, PartialEq, Message)]
pub(super) struct LaneNeighbor {
    #[prost(int64, tag = "1")]
    pub feature_id: i64,
    #[prost(int32, tag = "2")]
    pub self_start_index: i32,
    #[prost(int32, tag = "3")]
    pub self_end_index: i32,
}

/// A road line or a road edge; its type is not used.
#[derive(Clone, PartialEq, Message)]
pub(super) struct Line {
    #[prost(message, repeated, tag = "2")]
    pub polyline: Vec<MapPoint>,
}

/// A stop sign.
#[derive(Clone, PartialEq, Message)]
pub(super) struct StopSign {
    /// The lanes that it governs.
    #[prost(int64, repeated, tag = "1")]
    pub lane: Vec<i64>,
}

/// A crosswalk, speed bump or driveway.
#[derive(Clone, PartialEq, Message)]
pub(super) struct Area {
    #[prost(message, repeated, tag = "1")]
    pub polygon: Vec<MapPoint>,
}
