//! Writes scenarios as nuPlan's logs and maps.
//!
//! The folder holds `data/LOG.db`, a log for each scenario, and `maps/nuplan-maps-v1.0.json` with
//! `maps/LOCATION/VERSION/map.gpkg`, one package for each distinct map. `NUPLAN_DATA_ROOT` and
//! `NUPLAN_MAPS_ROOT` can point at the two. The same scenarios give the same bytes. A log holds one
//! scenario: only one row lies in a scene that nuPlan takes scenarios from, and the window around
//! it is the scenario. [`ExportChanges`] counts what nuPlan's formats cannot express.

mod continuation;
mod features;
mod graph;
mod ids;
mod lane_order;
mod log;
mod naming;
mod overlap;
mod package;
mod placement;
mod route;
mod stand_in;
mod stops;
#[cfg(test)]
mod tests;
mod timeline;
mod valid_area;

pub use graph::STITCH;
pub use placement::ShapeError;
pub(crate) use stand_in::OFFICIAL_LOCATIONS;
pub use timeline::TimelineError;

use super::MAPS_INDEX;
use super::projection::{ProjectionError, Utm};
use super::token::Token;
use crate::Scenario;
use graph::Graph;
use log::LogHeader;
use package::LayerRows;
use placement::Placement;
use planagent_files::WholeFolder;
use planagent_world::LaneMap;
use planagent_world::geometry::{GeometryError, Point};
use serde_json::json;
use stand_in::{STAND_IN_KEY, STAND_IN_NOTE};
use std::collections::{BTreeMap, BTreeSet};
use std::io;
use std::path::{Path, PathBuf};
use timeline::Timeline;

/// Version of every map that is written.
pub(crate) const MAP_VERSION: &str = "1.0";
const DATA: &str = "data";
const MAPS: &str = "maps";

/// How scenarios are written: names, and their place on Earth.
#[derive(Debug, Clone, PartialEq)]
pub struct ExportSettings {
    /// Name of the map; `None` derives it from the content, so that scenarios with equal maps share
    /// one.
    pub location: Option<String>,
    /// EPSG code of the projection: a UTM zone on WGS 84.
    pub epsg: u32,
    /// Easting and northing of the scenarios' origin, m.
    pub origin: Point,
    /// Scenario type of all logs; `None` keeps that of each scenario.
    pub scenario_type: Option<String>,
    /// Also write an empty map for each of nuPlan's four locations that is not written: the devkit
    /// opens no maps folder without them.
    pub stand_in_maps: bool,
}

impl Default for ExportSettings {
    /// Near the Las Vegas Strip, one of nuPlan's locations.
    fn default() -> Self {
        Self {
            location: None,
            epsg: 32_611,
            origin: Point::new(664_000.0, 3_998_000.0),
            scenario_type: None,
            stand_in_maps: false,
        }
    }
}

/// How often a scenario was changed because nuPlan's formats cannot express it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize)]
pub struct ExportChanges {
    /// Connectors between directly successive lanes.
    pub inserted_connectors: usize,
    /// Lanes between successive connectors.
    pub inserted_lanes: usize,
    /// Lanes inserted at open ends of connectors.
    pub open_ends_closed: usize,
    /// Further rows of connectors that join several lanes.
    pub connectors_repeated: usize,
    /// Stop lines of connectors that have lights but no stop line.
    pub inserted_stop_lines: usize,
    /// Recorded ego states after the end, dropped because nuPlan's window would include them.
    pub dropped_future_states: usize,
    /// Roadblocks appended to a route of one, connectors included.
    pub appended_roadblocks: usize,
    /// Neighbor relations dropped, or extended from a part to the whole lane; nuPlan has none
    /// between connectors.
    pub neighbors_changed: usize,
}

/// The log that was written for one scenario.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct ExportedLog {
    /// Id of the scenario.
    pub scenario: String,
    /// Token of the scenario: 16 hexadecimal digits.
    pub token: String,
    /// Name of the log.
    pub log: String,
    /// Name of the map.
    pub location: String,
    pub changes: ExportChanges,
}

/// The folders that were written.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct Exported {
    /// Folder of the logs, for `NUPLAN_DATA_ROOT`.
    pub data: PathBuf,
    /// Folder of the maps, for `NUPLAN_MAPS_ROOT`.
    pub maps: PathBuf,
    /// A log for each scenario, in order.
    pub logs: Vec<ExportedLog>,
}

/// Why scenarios cannot be written.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message of a variant says what it is")]
pub enum ExportError {
    #[error("there is no scenario to export")]
    Nothing,
    #[error("{} exists and is not empty; name a new folder", .0.display())]
    Exists(PathBuf),
    #[error("'{0}' cannot name a map: letters, digits, dots, minuses and underscores only")]
    Location(String),
    #[error(
        "{first} and {second} have different maps, which cannot both be called `{location}`; export them one by one"
    )]
    MapsDiffer {
        location: String,
        first: String,
        second: String,
    },
    #[error("two scenarios are called {0}; each must be given once")]
    SameLog(String),
    #[error(transparent)]
    Zone(#[from] ProjectionError),
    #[error("{scenario}: {fault}")]
    Scenario {
        scenario: String,
        fault: ScenarioExportFault,
    },
    #[error("cannot write {}: {fault}", path.display())]
    Write { path: PathBuf, fault: WriteFault },
}

/// Why a scenario does not fit nuPlan's formats.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message of a variant says what it is")]
pub enum ScenarioExportFault {
    #[error(transparent)]
    Timeline(#[from] TimelineError),
    #[error("an inserted piece of its map has no extent: {0}")]
    Graph(#[from] GeometryError),
    #[error("a shape of its map cannot be written: {0}")]
    Shape(#[from] ShapeError),
}

/// Why a file cannot be written.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message of a variant says what it is")]
pub enum WriteFault {
    #[error(transparent)]
    Database(#[from] rusqlite::Error),
    #[error(transparent)]
    Io(#[from] io::Error),
}

/// Writes one scenario; see [`write_scenarios`].
pub fn write_scenario(
    scenario: &Scenario,
    folder: &Path,
    settings: &ExportSettings,
) -> Result<Exported, ExportError> {
    write_scenarios(std::slice::from_ref(scenario), folder, settings)
}

/// Writes scenarios into a new folder, which appears only when all are written.
pub fn write_scenarios(
    scenarios: &[Scenario],
    folder: &Path,
    settings: &ExportSettings,
) -> Result<Exported, ExportError> {
    if scenarios.is_empty() {
        return Err(ExportError::Nothing);
    }
    if let Some(location) = settings
        .location
        .as_ref()
        .filter(|name| !naming::is_folder_name(name))
    {
        return Err(ExportError::Location(location.clone()));
    }
    let utm = Utm::from_epsg(settings.epsg)?;
    let io_failed = |fault: io::Error| match fault.kind() {
        io::ErrorKind::AlreadyExists | io::ErrorKind::DirectoryNotEmpty => {
            ExportError::Exists(folder.to_owned())
        }
        _ => ExportError::Write {
            path: folder.to_owned(),
            fault: fault.into(),
        },
    };
    // Before any work: a folder that exists is refused at once. The real name comes with `finish`.
    let staging = WholeFolder::create(folder).map_err(io_failed)?;
    let mut writer = Writer {
        staging: &staging,
        folder,
        location: settings.location.as_deref(),
        place: Placement {
            utm,
            origin: settings.origin,
        },
        maps: BTreeMap::new(),
        logs: Vec::with_capacity(scenarios.len()),
    };
    for scenario in scenarios {
        match &settings.scenario_type {
            Some(kind) => writer.write(&Scenario {
                scenario_type: kind.clone(),
                ..scenario.clone()
            })?,
            None => writer.write(scenario)?,
        }
    }
    let mut locations: BTreeSet<&str> = writer.maps.keys().map(String::as_str).collect();
    if settings.stand_in_maps {
        for location in OFFICIAL_LOCATIONS
            .into_iter()
            .filter(|location| !writer.maps.contains_key(*location))
        {
            writer.write_stand_in(location)?;
            locations.insert(location);
        }
    }
    let logs = writer.logs.clone();
    let list: serde_json::Map<String, serde_json::Value> = locations
        .into_iter()
        .map(|location| {
            (
                location.to_owned(),
                json!({"version": MAP_VERSION, "layers": {}}),
            )
        })
        .collect();
    staging
        .write(
            &Path::new(MAPS).join(MAPS_INDEX),
            format!("{:#}\n", json!(list)).as_bytes(),
        )
        .map_err(io_failed)?;
    staging.finish().map_err(io_failed)?;
    Ok(Exported {
        data: folder.join(DATA),
        maps: folder.join(MAPS),
        logs,
    })
}

/// A written map and the first scenario on it.
struct WrittenMap {
    hash: blake3::Hash,
    scenario: String,
}

struct Writer<'a> {
    staging: &'a WholeFolder,
    folder: &'a Path,
    location: Option<&'a str>,
    place: Placement,
    maps: BTreeMap<String, WrittenMap>,
    logs: Vec<ExportedLog>,
}

impl Writer<'_> {
    fn write(&mut self, scenario: &Scenario) -> Result<(), ExportError> {
        let id = || scenario.id.clone();
        let failed = |fault: ScenarioExportFault| ExportError::Scenario {
            scenario: id(),
            fault,
        };
        let timeline = Timeline::from_scenario(scenario).map_err(|fault| failed(fault.into()))?;
        let mut graph = Graph::from_map(&scenario.map).map_err(|fault| failed(fault.into()))?;
        let location = self.write_map(&scenario.map, &mut graph, &scenario.id)?;
        let log = naming::log_name(&scenario.log_name, &scenario.id);
        // Names of scenarios lose letters that files do not allow, so two may become one.
        if self.logs.iter().any(|written| written.log == log) {
            return Err(ExportError::SameLog(id()));
        }
        let connectors = graph.connectors_by_lane();
        let mut route = route::route_ids(&scenario.map, &graph, &scenario.route.roadblocks);
        graph.changes.appended_roadblocks = route::extend_short(&mut route, &graph);
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
        let changes = ExportChanges {
            dropped_future_states: timeline.dropped_future_states,
            ..graph.changes
        };
        self.logs.push(ExportedLog {
            scenario: id(),
            token: token.to_string(),
            log,
            location,
            changes,
        });
        Ok(())
    }

    /// Writes a map unless it is written already; its name.
    fn write_map(
        &mut self,
        map: &LaneMap,
        graph: &mut Graph,
        id: &str,
    ) -> Result<String, ExportError> {
        let shape_failed = |fault: ShapeError| ExportError::Scenario {
            scenario: id.to_owned(),
            fault: fault.into(),
        };
        let layers = features::layers(map, graph, &self.place).map_err(shape_failed)?;
        // The hash is of what is written, and not of the map: maps that differ only in unwritten
        // parts share a package.
        let hash = content_hash(&layers, self.place.utm.epsg());
        let location = self.location.map_or_else(
            || format!("planagent-{}", &hash.to_hex()[..16]),
            str::to_owned,
        );
        match self.maps.get(&location) {
            Some(written) if written.hash == hash => return Ok(location),
            Some(written) => {
                let (first, second) = (written.scenario.clone(), id.to_owned());
                return Err(ExportError::MapsDiffer {
                    location,
                    first,
                    second,
                });
            }
            None => {}
        }
        self.write_map_package(&location, &layers, &[])?;
        self.maps.insert(
            location.clone(),
            WrittenMap {
                hash,
                scenario: id.to_owned(),
            },
        );
        Ok(location)
    }

    /// Writes an empty map under the name of one of nuPlan's locations.
    fn write_stand_in(&self, location: &str) -> Result<(), ExportError> {
        self.write_map_package(
            location,
            &features::empty_layers(),
            &[(STAND_IN_KEY, STAND_IN_NOTE.to_owned())],
        )
    }

    fn write_map_package(
        &self,
        location: &str,
        layers: &[LayerRows],
        notes: &[(&str, String)],
    ) -> Result<(), ExportError> {
        let systems = [
            ("geographicCoordSystem", "epsg:4326".to_owned()),
            ("projectedCoordSystem", self.place.utm.to_string()),
        ];
        let meta = [&systems[..], notes].concat();
        let inside = Path::new(MAPS)
            .join(location)
            .join(MAP_VERSION)
            .join("map.gpkg");
        self.write_database(&inside, |path| package::write_package(path, &meta, layers))
    }

    /// Writes a database into the staged folder; errors name its path in the finished one.
    fn write_database(
        &self,
        inside: &Path,
        write: impl FnOnce(&Path) -> rusqlite::Result<()>,
    ) -> Result<(), ExportError> {
        let path = self.folder.join(inside);
        let staged = self.staging.path_of(inside).map_err(WriteFault::from);
        staged
            .and_then(|staged| Ok(write(&staged)?))
            .map_err(|fault| ExportError::Write { path, fault })
    }
}

/// Hash over all rows of all layers.
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
