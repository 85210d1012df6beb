//! The vector map of a log: `log_map_archive_*.json`, as Argoverse 2 writes it.

use super::error::Argoverse2Error;
use crate::recording::trace::Place;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::io::Read;
use std::path::Path;

#[derive(Debug, Deserialize)]
pub(super) struct MapFile {
    /// The key repeats the id.
    pub(super) lane_segments: BTreeMap<String, LaneSegment>,
    pub(super) pedestrian_crossings: BTreeMap<String, PedestrianCrossing>,
    pub(super) drivable_areas: BTreeMap<String, DrivableArea>,
}

/// A lane segment. Its markings and the centerline that some maps add are not read.
#[derive(Debug, Clone, Deserialize)]
pub(super) struct LaneSegment {
    pub(super) id: i64,
    pub(super) is_intersection: bool,
    pub(super) lane_type: LaneType,
    pub(super) left_lane_boundary: Vec<Waypoint>,
    pub(super) right_lane_boundary: Vec<Waypoint>,
    pub(super) predecessors: Vec<i64>,
    pub(super) successors: Vec<i64>,
    pub(super) left_neighbor_id: Option<i64>,
    pub(super) right_neighbor_id: Option<i64>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "UPPERCASE")]
pub(super) enum LaneType {
    Vehicle,
    Bike,
    Bus,
}

/// A crosswalk between two edges in walking direction.
#[derive(Debug, Deserialize)]
pub(super) struct PedestrianCrossing {
    pub(super) id: i64,
    pub(super) edge1: Vec<Waypoint>,
    pub(super) edge2: Vec<Waypoint>,
}

#[derive(Debug, Deserialize)]
pub(super) struct DrivableArea {
    pub(super) id: i64,
    pub(super) area_boundary: Vec<Waypoint>,
}

/// A point in the city frame, meters.
#[derive(Debug, Clone, Copy, Deserialize)]
pub(super) struct Waypoint {
    pub(super) x: f64,
    pub(super) y: f64,
    pub(super) z: f64,
}

pub(super) fn places(points: &[Waypoint]) -> Vec<Place> {
    points.iter().map(|p| Place::new(p.x, p.y, p.z)).collect()
}

impl MapFile {
    pub(super) fn read(path: &Path) -> Result<Self, Argoverse2Error> {
        let mut bytes = Vec::new();
        let read = planagent_files::open(path).and_then(|mut file| file.read_to_end(&mut bytes));
        read.map_err(Argoverse2Error::at(path))?;
        serde_json::from_slice(&bytes).map_err(Argoverse2Error::at(path))
    }
}
