//! A scenario of a log as [`Scenario`].
//!
//! The time of the ego is that of the `lidar_pc` row, its pose that of the rear axle. Positions are
//! relative to the map's origin.

use super::database::{Database, Record};
use super::error::{CellFault, NuPlanError, ScenarioFault};
use super::lane_map::NuPlanMap;
use super::logs::LogScenario;
use super::map_store::MapStore;
use super::route;
use super::rows::{Rows, Sweep, ego_of};
use super::schema::{CATEGORY, EGO_POSE, LIDAR_BOX, LIDAR_PC, TRACK, TRAFFIC_LIGHT_STATUS};
use super::side_index;
use super::token::Token;
use super::velocity;
use crate::{Frame, Scenario};
use planagent_world::geometry::{OrientedBox, Pose, Vector};
use planagent_world::{
    EgoState, ObjectKind, SignalStatus, TrackToken, TrackedObject, TrafficLights,
};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Opens a scenario: its rows, its route, and the map around it.
pub fn open(maps: &MapStore, found: &LogScenario) -> Result<Scenario, NuPlanError> {
    let database = found.log.open()?;
    let rows = Rows::read(&database, found)?;
    let indices = maps.attach_index(&database, rows.times())?;
    let map = maps.map(&found.map_name)?;
    let route = route::read(&database, found, &map)?;
    let mut reader = Reader {
        database: &database,
        indices: &indices,
        map: &map,
        tracks: Tracks::default(),
    };
    let frames = rows
        .past
        .iter()
        .chain(rows.iterations())
        .map(|sweep| reader.frame(sweep));
    let mut frames: Vec<Frame> = frames.collect::<Result<_, _>>()?;
    // Over all frames at once, because a missing velocity comes from the frames before and after.
    maps.count_without_velocity(&found.log.path, velocity::derive_missing(&mut frames));
    Ok(Scenario {
        frames,
        start: rows.past.len(),
        future: rows
            .future
            .iter()
            .map(|sweep| reader.ego(sweep))
            .collect::<Result<_, _>>()?,
        id: found.token.to_string(),
        scenario_type: found.scenario_type.clone(),
        log_name: found.log.name.clone(),
        map: map.lanes.clone(),
        route,
        interaction: None,
    })
}

/// The number and kind of each known track, by its token.
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
        Ok(Frame {
            ego: self.ego(sweep)?,
            objects: self.objects(sweep)?,
            lights: self.lights(sweep)?,
        })
    }

    fn ego(&self, sweep: &Sweep) -> Result<EgoState, NuPlanError> {
        let mut ego = None;
        let query = self.indices.search(EGO_POSE, "token");
        self.database
            .each_of(EGO_POSE, &query, [sweep.ego_pose], &mut |record| {
                let state = ego_of(record, sweep.time_us)?;
                ego = Some(EgoState {
                    rear_axle: self.map.to_local(state.rear_axle),
                    ..state
                });
                Ok(())
            })?;
        match ego {
            Some(ego) => Ok(ego),
            None => self.dangling(sweep),
        }
    }

    fn dangling<T>(&self, sweep: &Sweep) -> Result<T, NuPlanError> {
        let target = sweep.ego_pose.to_string();
        let told = self
            .database
            .first(LIDAR_PC, "WHERE token = ?1", [sweep.token], |record| {
                Ok(record.fault(
                    "ego_pose_token",
                    CellFault::Dangling {
                        target: target.clone(),
                        table: "ego_pose",
                    },
                ))
            })?;
        let (path, token) = (self.database.path.clone(), sweep.token);
        Err(told.unwrap_or(NuPlanError::Scenario {
            path,
            token,
            fault: ScenarioFault::NotInLog,
        }))
    }

    /// The boxes of a sweep, in the order of the log.
    fn objects(&mut self, sweep: &Sweep) -> Result<Arc<[TrackedObject]>, NuPlanError> {
        let mut objects = Vec::new();
        let (database, map) = (self.database, self.map);
        let query = self.indices.search(LIDAR_BOX, "lidar_pc_token");
        database.each_of(LIDAR_BOX, &query, [sweep.token], &mut |record| {
            let (token, kind) = self.track(record)?;
            let center = Pose::new(record.float("x")?, record.float("y")?, record.float("yaw")?);
            let shape = OrientedBox::new(
                map.to_local(center),
                extent(record, "length")?,
                extent(record, "width")?,
            );
            let velocity = if kind.is_agent() {
                logged_velocity(record)?
            } else {
                Vector::zeros()
            };
            objects.push(TrackedObject {
                token,
                kind,
                shape,
                velocity,
            });
            Ok(())
        })?;
        Ok(objects.into())
    }

    /// Number and kind of the track of a box. Tracks are numbered in order of appearance.
    fn track(&mut self, record: &Record<'_>) -> Result<(TrackToken, ObjectKind), NuPlanError> {
        let token = record.token("track_token")?;
        if let Some(&known) = self.tracks.known.get(&token) {
            return Ok(known);
        }
        let mut kind = None;
        let query = self.indices.search(TRACK, "token");
        self.database
            .each_of(TRACK, &query, [token], &mut |track| {
                kind = Some(self.tracks.category(self.database, track)?);
                Ok(())
            })?;
        let missing = || CellFault::Dangling {
            target: token.to_string(),
            table: "track",
        };
        let kind = kind.ok_or_else(|| record.fault("track_token", missing()))?;
        let known = (TrackToken(self.tracks.known.len() as u32), kind);
        self.tracks.known.insert(token, known);
        Ok(known)
    }

    /// The lights of a sweep, without those of connectors that the map does not have.
    fn lights(&self, sweep: &Sweep) -> Result<Arc<TrafficLights>, NuPlanError> {
        let mut lights = TrafficLights::default();
        let query = self.indices.search(TRAFFIC_LIGHT_STATUS, "lidar_pc_token");
        self.database
            .each_of(TRAFFIC_LIGHT_STATUS, &query, [sweep.token], &mut |record| {
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
    fn category(
        &mut self,
        database: &Database,
        track: &Record<'_>,
    ) -> Result<ObjectKind, NuPlanError> {
        let token = track.token("category_token")?;
        if let Some(&kind) = self.categories.get(&token) {
            return Ok(kind);
        }
        let kind = database.first(CATEGORY, "WHERE token = ?1", [token], |record| {
            let name = record.text("name")?;
            object_kind(&name).ok_or_else(|| {
                record.fault(
                    "name",
                    CellFault::Word {
                        got: name.clone(),
                        expected: "one of nuPlan's seven categories",
                    },
                )
            })
        })?;
        let missing = || CellFault::Dangling {
            target: token.to_string(),
            table: "category",
        };
        let kind = kind.ok_or_else(|| track.fault("category_token", missing()))?;
        self.categories.insert(token, kind);
        Ok(kind)
    }
}

/// The kind of one of nuPlan's category names.
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
    let meters = record.float(column)?;
    if meters > 0.0 {
        Ok(meters)
    } else {
        Err(record.fault(
            column,
            CellFault::Number {
                got: meters,
                expected: "meters above 0",
            },
        ))
    }
}

/// Velocity of an agent, map frame; NaN where the log has none, for [`velocity::derive_missing`].
fn logged_velocity(record: &Record<'_>) -> Result<Vector, NuPlanError> {
    let part = |column| {
        record
            .maybe_float(column)
            .map(|speed| speed.unwrap_or(f64::NAN))
    };
    Ok(Vector::new(part("vx")?, part("vy")?))
}
