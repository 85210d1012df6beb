//! A scenario of a log as [`Scenario`].
//!
//! The ego's time is that of the `lidar_pc` row, its pose the rear axle; positions are moved by the map's origin, headings stay.

use super::database::{Database, Record};
use super::error::{CellFault, NuPlanError, ScenarioFault};
use super::map_store::{MapStore, NuPlanMap};
use super::rows::{Rows, Sweep};
use super::schema::{CATEGORY, EGO_POSE, LIDAR_BOX, LIDAR_PC, SCENE, TRACK, TRAFFIC_LIGHT_STATUS, open_log};
use super::search::LogScenario;
use super::side_index;
use super::token::Token;
use super::{RouteFault, route};
use crate::geometry::{OrientedBox, Pose, Vector};
use crate::scenario::{Frame, Scenario};
use crate::world::{EgoState, ObjectKind, Route, SignalStatus, TrackToken, TrackedObject, TrafficLights};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Opens a scenario: its rows, its route, and the map around it.
///
/// # Errors
/// When the log, the map or the scenario is unsound; the error names the place.
pub fn open(maps: &MapStore, found: &LogScenario) -> Result<Scenario, NuPlanError> {
    let database = open_log(&found.log)?;
    let rows = Rows::read(&database, found)?;
    let indices = maps.attach_index(&database, rows.times())?;
    let map = maps.map(&found.map_name)?;
    let route = read_route(&database, found, &map)?;
    let mut reader = Reader { database: &database, indices: &indices, map: &map, tracks: Tracks::default() };
    let frames = rows.past.iter().chain(rows.iterations()).map(|sweep| reader.frame(sweep));
    let frames = frames.collect::<Result<_, _>>()?;
    Ok(Scenario {
        frames,
        start: rows.past.len(),
        future: rows.future.iter().map(|sweep| reader.ego(sweep)).collect::<Result<_, _>>()?,
        id: found.token.to_string(),
        scenario_type: found.scenario_type.clone(),
        log_name: found.log.name.clone(),
        map: map.lanes.clone(),
        route,
    })
}

/// The route ids of the scene of a scenario's tagged row.
pub(super) fn route_ids(database: &Database, token: Token) -> Result<(Token, Option<Token>, Vec<i64>), NuPlanError> {
    let failed = |fault| NuPlanError::Scenario { path: database.path.clone(), token, fault };
    let scene = database.first(LIDAR_PC, "WHERE token = ?1", [token], |record| record.token("scene_token"))?;
    let scene = scene.ok_or_else(|| failed(ScenarioFault::NotInLog))?;
    let found = database.first(SCENE, "WHERE token = ?1", [scene], |record| {
        Ok((record.maybe_token("goal_ego_pose_token")?, record.maybe_text("roadblock_ids")?))
    })?;
    let Some((goal, text)) = found else {
        return Err(failed(ScenarioFault::Route { scene, fault: RouteFault::Empty }));
    };
    let ids = route::ids(text.as_deref()).map_err(|fault| failed(ScenarioFault::Route { scene, fault }))?;
    Ok((scene, goal, ids))
}

fn read_route(database: &Database, found: &LogScenario, map: &NuPlanMap) -> Result<Route, NuPlanError> {
    let (scene, goal, ids) = route_ids(database, found.token)?;
    let roadblocks = route::roadblocks(&ids, map).map_err(|fault| NuPlanError::Scenario {
        path: database.path.clone(),
        token: found.token,
        fault: ScenarioFault::Route { scene, fault },
    })?;
    let goal = match goal {
        Some(pose) => database.first(EGO_POSE, "WHERE token = ?1", [pose], pose_of)?,
        None => None,
    };
    Ok(Route { roadblocks, goal: goal.map(|goal| map.to_local(goal)) })
}

/// The pose of an `ego_pose` row, in the map's projection.
fn pose_of(record: &Record<'_>) -> Result<Pose, NuPlanError> {
    let q = [record.float("qw")?, record.float("qx")?, record.float("qy")?, record.float("qz")?];
    let heading = yaw(q).ok_or_else(|| {
        record.fault("qw", CellFault::Number { got: q[0], expected: "the first part of a rotation that is not zero" })
    })?;
    Ok(Pose::new(record.float("x")?, record.float("y")?, heading))
}

/// Yaw of a quaternion (w, x, y, z) as pyquaternion's `yaw_pitch_roll` has it, which the devkit reads: of the intrinsic rotations
/// about z, y and x. `None` when it is no rotation.
fn yaw(q: [f64; 4]) -> Option<f64> {
    let norm = q.iter().map(|c| c * c).sum::<f64>().sqrt();
    let [w, x, y, z] = q.map(|c| c / norm);
    let angle = (2.0 * (w * z - x * y)).atan2(1.0 - 2.0 * (y * y + z * z));
    (norm > 0.0 && norm.is_finite() && angle.is_finite()).then_some(angle)
}

/// The ego of an `ego_pose` row at the time of its sweep, in the map's projection.
pub(super) fn ego_of(record: &Record<'_>, time_us: i64) -> Result<EgoState, NuPlanError> {
    let velocity = Vector::new(record.float("vx")?, record.float("vy")?);
    let acceleration = Vector::new(record.float("acceleration_x")?, record.float("acceleration_y")?);
    Ok(EgoState::from_log(time_us, pose_of(record)?, velocity, acceleration))
}

/// The number and kind of each track that was seen, by its token.
#[derive(Default)]
struct Tracks {
    known: BTreeMap<Token, (TrackToken, ObjectKind)>,
    categories: BTreeMap<Token, ObjectKind>,
}

struct Reader<'a> {
    database: &'a Database,
    indices: &'a side_index::LogIndex,
    map: &'a NuPlanMap,
    tracks: Tracks,
}

impl Reader<'_> {
    fn frame(&mut self, sweep: &Sweep) -> Result<Frame, NuPlanError> {
        Ok(Frame { ego: self.ego(sweep)?, objects: self.objects(sweep)?, lights: self.lights(sweep)? })
    }

    fn ego(&self, sweep: &Sweep) -> Result<EgoState, NuPlanError> {
        let mut ego = None;
        let query = self.indices.search(EGO_POSE, "token");
        self.database.each_of(EGO_POSE, &query, [sweep.ego_pose], &mut |record| {
            let state = ego_of(record, sweep.time_us)?;
            ego = Some(EgoState { rear_axle: self.map.to_local(state.rear_axle), ..state });
            Ok(())
        })?;
        match ego {
            Some(ego) => Ok(ego),
            None => self.dangling(sweep),
        }
    }

    fn dangling<T>(&self, sweep: &Sweep) -> Result<T, NuPlanError> {
        let target = sweep.ego_pose.to_string();
        let told = self.database.first(LIDAR_PC, "WHERE token = ?1", [sweep.token], |record| {
            Ok(record.fault("ego_pose_token", CellFault::Dangling { target: target.clone(), table: "ego_pose" }))
        })?;
        let (path, token) = (self.database.path.clone(), sweep.token);
        Err(told.unwrap_or(NuPlanError::Scenario { path, token, fault: ScenarioFault::NotInLog }))
    }

    /// The boxes of a sweep in the order in which the log holds them.
    fn objects(&mut self, sweep: &Sweep) -> Result<Arc<[TrackedObject]>, NuPlanError> {
        let mut objects = Vec::new();
        let (database, map) = (self.database, self.map);
        let query = self.indices.search(LIDAR_BOX, "lidar_pc_token");
        database.each_of(LIDAR_BOX, &query, [sweep.token], &mut |record| {
            let (token, kind) = self.track(record)?;
            let center = Pose::new(record.float("x")?, record.float("y")?, record.float("yaw")?);
            let shape = OrientedBox::new(map.to_local(center), extent(record, "length")?, extent(record, "width")?);
            let velocity = if kind.is_agent() { velocity(record)? } else { Vector::zeros() };
            objects.push(TrackedObject { token, kind, shape, velocity });
            Ok(())
        })?;
        Ok(objects.into())
    }

    /// Number and kind of the track of a box. Tracks are numbered as they appear.
    fn track(&mut self, record: &Record<'_>) -> Result<(TrackToken, ObjectKind), NuPlanError> {
        let token = record.token("track_token")?;
        if let Some(&known) = self.tracks.known.get(&token) {
            return Ok(known);
        }
        let mut kind = None;
        let query = self.indices.search(TRACK, "token");
        self.database.each_of(TRACK, &query, [token], &mut |track| {
            kind = Some(self.tracks.category(self.database, track)?);
            Ok(())
        })?;
        let missing = || CellFault::Dangling { target: token.to_string(), table: "track" };
        let kind = kind.ok_or_else(|| record.fault("track_token", missing()))?;
        let known = (TrackToken(self.tracks.known.len() as u32), kind);
        self.tracks.known.insert(token, known);
        Ok(known)
    }

    /// The lights of a sweep. A light of a connector that the map does not have governs nothing and is left out.
    fn lights(&self, sweep: &Sweep) -> Result<Arc<TrafficLights>, NuPlanError> {
        let mut lights = TrafficLights::default();
        let query = self.indices.search(TRAFFIC_LIGHT_STATUS, "lidar_pc_token");
        self.database.each_of(TRAFFIC_LIGHT_STATUS, &query, [sweep.token], &mut |record| {
            let connector = self.map.connector(record.fid("lane_connector_id")?);
            let status = match record.maybe_text("status")?.as_deref() {
                Some("green") => SignalStatus::Green,
                Some("yellow") => SignalStatus::Yellow,
                Some("red") => SignalStatus::Red,
                _ => SignalStatus::Unknown,
            };
            if let Some(connector) = connector {
                lights.set(connector, status);
            }
            Ok(())
        })?;
        Ok(Arc::new(lights))
    }
}

impl Tracks {
    fn category(&mut self, database: &Database, track: &Record<'_>) -> Result<ObjectKind, NuPlanError> {
        let token = track.token("category_token")?;
        if let Some(&kind) = self.categories.get(&token) {
            return Ok(kind);
        }
        let kind = database.first(CATEGORY, "WHERE token = ?1", [token], |record| {
            let name = record.text("name")?;
            object_kind(&name).ok_or_else(|| {
                record
                    .fault("name", CellFault::Word { got: name.clone(), expected: "one of nuPlan's seven categories" })
            })
        })?;
        let missing = || CellFault::Dangling { target: token.to_string(), table: "category" };
        let kind = kind.ok_or_else(|| track.fault("category_token", missing()))?;
        self.categories.insert(token, kind);
        Ok(kind)
    }
}

/// The kind with one of nuPlan's category names.
fn object_kind(name: &str) -> Option<ObjectKind> {
    Some(match name {
        "vehicle" => ObjectKind::Vehicle,
        "pedestrian" => ObjectKind::Pedestrian,
        "bicycle" => ObjectKind::Bicycle,
        "traffic_cone" => ObjectKind::TrafficCone,
        "barrier" => ObjectKind::Barrier,
        "czone_sign" => ObjectKind::CzoneSign,
        "generic_object" => ObjectKind::GenericObject,
        _ => return None,
    })
}

fn extent(record: &Record<'_>, column: &'static str) -> Result<f64, NuPlanError> {
    let metres = record.float(column)?;
    if metres > 0.0 {
        Ok(metres)
    } else {
        Err(record.fault(column, CellFault::Number { got: metres, expected: "metres above 0" }))
    }
}

/// Velocity of an agent, map frame. Where the log has none it is NaN, as in the devkit: reactive traffic then takes the ego's speed.
fn velocity(record: &Record<'_>) -> Result<Vector, NuPlanError> {
    let part = |column| record.maybe_float(column).map(|speed| speed.unwrap_or(f64::NAN));
    Ok(Vector::new(part("vx")?, part("vy")?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn yaw_is_that_of_pyquaternion() {
        // Rotations about z alone, then the numbers of pyquaternion 0.9.9 for a tilted one that is not normalised.
        for angle in [-3.0_f64, -0.5, 0.0, 1.2, 3.1] {
            let half = angle / 2.0;
            assert!((yaw([half.cos(), 0.0, 0.0, half.sin()]).unwrap() - angle).abs() < 1e-12);
        }
        assert!((yaw([0.9, 0.05, -0.02, 0.4]).unwrap() - TILTED).abs() < 1e-12);
        assert_eq!(yaw([0.0; 4]), None);
        assert_eq!(yaw([f64::MAX; 4]), None);
    }

    /// `Quaternion(0.9, 0.05, -0.02, 0.4).yaw_pitch_roll[0]`.
    const TILTED: f64 = 0.836_224_012_689_028;
}
