//! Writes scenarios as nuPlan's logs and maps.
//!
//! A folder holds `data/LOG.db`, a log for each scenario, and `maps/nuplan-maps-v1.0.json` with `maps/LOCATION/VERSION/map.gpkg`, a map
//! for each different map; `NUPLAN_DATA_ROOT` and `NUPLAN_MAPS_ROOT` can point at the two. The same scenarios give the same content.
//! A log holds one scenario: one row of it lies in a scene that nuPlan takes scenarios from, and its window is the scenario.
//! What nuPlan cannot say is counted in [`Departures`].

mod boundary;
mod features;
mod graph;
mod ids;
mod lane_order;
mod layers;
mod log;
mod log_schema;
mod naming;
mod package;
mod placement;
mod route;
mod staging;
mod stops;
#[cfg(test)]
mod tests;
mod timeline;

pub use graph::{OPEN_END, STITCH};
pub use placement::ShapeError;
pub use timeline::TimelineError;

use super::projection::{ProjectionError, Utm};
use super::token::Token;
use crate::geometry::{GeometryError, Point};
use crate::scenario::Scenario;
use crate::world::LaneMap;
use graph::Graph;
use log::LogHeader;
use package::LayerRows;
use placement::Placement;
use serde_json::json;
use staging::Staging;
use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};
use timeline::Timeline;

/// The file that lists the maps.
pub const MAP_LIST: &str = "nuplan-maps-v1.0.json";
/// Version of every map that is written.
pub const MAP_VERSION: &str = "1.0";
/// Folder of the logs.
const DATA: &str = "data";
/// Folder of the maps.
const MAPS: &str = "maps";

/// Where scenarios are put on Earth.
#[derive(Debug, Clone, PartialEq)]
pub struct ExportSettings {
    /// Name of the map; `None` names it by its content, so that scenarios on equal maps share one.
    pub location: Option<String>,
    /// EPSG code of the map's projection, a UTM zone on WGS 84.
    pub epsg: u32,
    /// Easting and northing at which the scenarios' own origin lies, metres.
    pub origin: Point,
}

impl Default for ExportSettings {
    /// Near the Las Vegas Strip, where nuPlan drives too.
    fn default() -> Self {
        Self { location: None, epsg: 32_611, origin: Point::new(664_000.0, 3_998_000.0) }
    }
}

/// How often a map was changed because nuPlan cannot say what it says.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize)]
pub struct Departures {
    /// Connectors put between lanes that follow each other directly.
    pub connectors_put_in: usize,
    /// Lanes put between connectors that follow each other.
    pub lanes_put_in: usize,
    /// Lanes put at ends of connectors that led nowhere.
    pub open_ends_closed: usize,
    /// Rows beyond the first of connectors that join several lanes.
    pub connectors_repeated: usize,
    /// Stop lines put in for connectors that have lights but no stop line.
    pub stop_lines_put_in: usize,
    /// Recorded states of the ego after the end that are left out, because nuPlan's window of the scenario's type would take them in.
    pub future_left_out: usize,
    /// Neighbourhoods that are not said, or said for the whole lane instead of a part; nuPlan has none between connectors.
    pub neighbors_changed: usize,
}

/// What was written for one scenario.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct ExportedLog {
    /// Id of the scenario.
    pub scenario: String,
    /// Its token in nuPlan, 16 hexadecimal digits.
    pub token: String,
    /// Name of the log.
    pub log: String,
    /// Name of the map.
    pub location: String,
    /// How the map departs from the scenario's.
    pub departures: Departures,
}

/// What was written.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct Exported {
    /// Folder of the logs, for `NUPLAN_DATA_ROOT`.
    pub data: PathBuf,
    /// Folder of the maps, for `NUPLAN_MAPS_ROOT`.
    pub maps: PathBuf,
    /// A log for each scenario, in their order.
    pub logs: Vec<ExportedLog>,
}

/// Why scenarios cannot be written.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// Nothing to write.
    #[error("there is no scenario to export")]
    Nothing,
    /// The target holds something.
    #[error("{} exists and is not empty; name a new folder", .0.display())]
    Exists(PathBuf),
    /// The name of the map cannot be a folder's.
    #[error("`{0}` cannot name a map: letters, digits, dots, minuses and underscores only")]
    Location(String),
    /// Two different maps under one name.
    #[error(
        "{first} and {second} have different maps, which cannot both be called `{location}`; export them one by one"
    )]
    MapsDiffer {
        /// The name.
        location: String,
        /// Scenario with the first map.
        first: String,
        /// Scenario with the other.
        second: String,
    },
    /// Two scenarios would be one log.
    #[error("two scenarios are called {0}; each must be given once")]
    SameLog(String),
    /// No UTM zone.
    #[error(transparent)]
    Zone(#[from] ProjectionError),
    /// Its frames are no part of a nuPlan log.
    #[error("{scenario}: {fault}")]
    Timeline {
        /// Which scenario.
        scenario: String,
        /// What is wrong.
        #[source]
        fault: TimelineError,
    },
    /// A piece of its map has no extent.
    #[error("{scenario}: its map does not fit nuPlan's: {fault}")]
    Graph {
        /// Which scenario.
        scenario: String,
        /// What is wrong.
        #[source]
        fault: GeometryError,
    },
    /// A shape of its map cannot be written.
    #[error("{scenario}: a shape of its map cannot be written: {fault}")]
    Shape {
        /// Which scenario.
        scenario: String,
        /// What is wrong.
        #[source]
        fault: ShapeError,
    },
    /// SQLite fails.
    #[error("cannot write {}: {fault}", path.display())]
    Database {
        /// Which file.
        path: PathBuf,
        /// What SQLite says.
        #[source]
        fault: rusqlite::Error,
    },
    /// The system fails.
    #[error("cannot write {}: {fault}", path.display())]
    Io {
        /// Which file or folder.
        path: PathBuf,
        /// What the system says.
        #[source]
        fault: io::Error,
    },
}

/// Writes one scenario; see [`write_scenarios`].
///
/// # Errors
/// As [`write_scenarios`].
pub fn write_scenario(scenario: &Scenario, folder: &Path, settings: &ExportSettings) -> Result<Exported, ExportError> {
    write_scenarios(std::slice::from_ref(scenario), folder, settings)
}

/// Writes scenarios into a new folder, which appears only when all are written.
///
/// # Errors
/// When the folder holds something, a scenario does not fit nuPlan's formats, or writing fails.
pub fn write_scenarios(
    scenarios: &[Scenario],
    folder: &Path,
    settings: &ExportSettings,
) -> Result<Exported, ExportError> {
    if scenarios.is_empty() {
        return Err(ExportError::Nothing);
    }
    if let Some(location) = settings.location.as_ref().filter(|name| !naming::is_folder_name(name)) {
        return Err(ExportError::Location(location.clone()));
    }
    let utm = Utm::from_epsg(settings.epsg)?;
    let io_failed = |fault: io::Error| match fault.kind() {
        io::ErrorKind::AlreadyExists | io::ErrorKind::DirectoryNotEmpty => ExportError::Exists(folder.to_owned()),
        _ => ExportError::Io { path: folder.to_owned(), fault },
    };
    let staging = Staging::begin(folder).map_err(io_failed)?;
    let mut writer = Writer {
        staging: &staging,
        folder,
        location: settings.location.as_deref(),
        place: Placement { utm, origin: settings.origin },
        maps: BTreeMap::new(),
        logs: Vec::with_capacity(scenarios.len()),
    };
    for scenario in scenarios {
        writer.write(scenario)?;
    }
    let logs = std::mem::take(&mut writer.logs);
    let list: serde_json::Map<String, serde_json::Value> =
        writer.maps.keys().map(|location| (location.clone(), json!({"version": MAP_VERSION, "layers": {}}))).collect();
    staging.write(&Path::new(MAPS).join(MAP_LIST), &format!("{:#}\n", json!(list))).map_err(io_failed)?;
    staging.finish().map_err(io_failed)?;
    Ok(Exported { data: folder.join(DATA), maps: folder.join(MAPS), logs })
}

/// A map that has been written.
struct WrittenMap {
    hash: blake3::Hash,
    scenario: String,
}

struct Writer<'a> {
    staging: &'a Staging,
    folder: &'a Path,
    location: Option<&'a str>,
    place: Placement,
    maps: BTreeMap<String, WrittenMap>,
    logs: Vec<ExportedLog>,
}

impl Writer<'_> {
    fn write(&mut self, scenario: &Scenario) -> Result<(), ExportError> {
        let id = || scenario.id.clone();
        let timeline = Timeline::of(scenario).map_err(|fault| ExportError::Timeline { scenario: id(), fault })?;
        let mut graph = Graph::of(&scenario.map).map_err(|fault| ExportError::Graph { scenario: id(), fault })?;
        let location = self.write_map(&scenario.map, &mut graph, &scenario.id)?;
        let log = naming::log_name(&scenario.log_name, &scenario.id);
        if self.logs.iter().any(|written| written.log == log) {
            return Err(ExportError::SameLog(id()));
        }
        let connectors = graph.connectors_by_lane();
        let route = route::route_ids(&scenario.map, &graph, &scenario.route.roadblocks);
        let facts = LogHeader {
            log: &log,
            location: &location,
            epsg: self.place.utm.epsg(),
            origin: self.place.origin,
            connectors: &connectors,
            route: &route,
        };
        self.write_database(&Path::new(DATA).join(format!("{log}.db")), |path| {
            log::write_log(path, &facts, scenario, &timeline)
        })?;
        let token: Token = log::anchor_token(&log, &timeline);
        let departures = Departures { future_left_out: timeline.future_left_out, ..graph.departures };
        self.logs.push(ExportedLog { scenario: id(), token: token.to_string(), log, location, departures });
        Ok(())
    }

    /// Writes a map unless it has been written; its name.
    fn write_map(&mut self, map: &LaneMap, graph: &mut Graph, id: &str) -> Result<String, ExportError> {
        let shape_failed = |fault| ExportError::Shape { scenario: id.to_owned(), fault };
        let layers = features::layers(map, graph, &self.place).map_err(shape_failed)?;
        let hash = content_hash(&layers, self.place.utm.epsg());
        let location = self.location.map_or_else(|| format!("planagent-{}", &hash.to_hex()[..16]), str::to_owned);
        match self.maps.get(&location) {
            Some(written) if written.hash == hash => return Ok(location),
            Some(written) => {
                let (first, second) = (written.scenario.clone(), id.to_owned());
                return Err(ExportError::MapsDiffer { location, first, second });
            }
            None => {}
        }
        let meta =
            [("geographicCoordSystem", "epsg:4326".to_owned()), ("projectedCoordSystem", self.place.utm.to_string())];
        let inside = Path::new(MAPS).join(&location).join(MAP_VERSION).join("map.gpkg");
        self.write_database(&inside, |path| package::write_package(path, &meta, &layers))?;
        self.maps.insert(location.clone(), WrittenMap { hash, scenario: id.to_owned() });
        Ok(location)
    }

    /// Writes a database into the staged folder; errors name its place in the finished one.
    fn write_database(
        &self,
        inside: &Path,
        write: impl FnOnce(&Path) -> rusqlite::Result<()>,
    ) -> Result<(), ExportError> {
        let path = self.folder.join(inside);
        let staged = self.staging.path(inside).map_err(|fault| ExportError::Io { path: path.clone(), fault })?;
        write(&staged).map_err(|fault| ExportError::Database { path, fault })
    }
}

/// A hash over every row of every layer.
fn content_hash(layers: &[LayerRows], epsg: u32) -> blake3::Hash {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&epsg.to_le_bytes());
    for filled in layers {
        hasher.update(filled.layer.name.as_bytes());
        hasher.update(&(filled.features.len() as u64).to_le_bytes());
        for feature in &filled.features {
            hasher.update(&feature.fid.to_le_bytes());
            hasher.update(&(feature.geometry.len() as u64).to_le_bytes());
            hasher.update(&feature.geometry);
            let values = format!("{:?}", feature.values);
            hasher.update(&(values.len() as u64).to_le_bytes());
            hasher.update(values.as_bytes());
        }
    }
    hasher.finalize()
}
