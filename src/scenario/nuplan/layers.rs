//! The layers of a `map.gpkg`, decoded: shapes in local meters, ids unchanged.

use super::database::{Database, Record};
use super::error::{CellFault, FileFault, NuPlanError};
use super::geometry_blob::{decode_line, decode_polygons};
use super::projection::{ProjectionError, Utm, WGS84};
use super::schema::{
    BASELINE_PATHS, CARPARK_AREAS, CONNECTOR_AREAS, CROSSWALKS, GENERIC_DRIVABLE_AREAS,
    INTERSECTIONS, LANE_CONNECTORS, LANE_GROUP_CONNECTORS, LANE_GROUPS, LANES, META,
    PROJECTION_KEY, READ_LAYERS, ROAD_SEGMENTS, STOP_POLYGONS, Table,
};
use geo::{Coord, LineString};
use planagent_world::geometry::{Point, Polygon, Polyline, Vector};
use std::collections::BTreeMap;
use std::path::Path;

/// Grid of map origins, m.
const ORIGIN_GRID: f64 = 1000.0;

/// A row of `lanes_polygons`.
pub(super) struct LaneRow {
    pub(super) fid: i64,
    pub(super) group: i64,
    pub(super) index: i64,
    pub(super) speed_limit: Option<f64>,
    pub(super) areas: Vec<Polygon>,
}

/// A row of `lane_connectors`.
pub(super) struct ConnectorRow {
    pub(super) fid: i64,
    /// `exit_lane_fid`: the lane before the connector.
    pub(super) from: i64,
    /// `entry_lane_fid`: the lane behind the connector.
    pub(super) into: i64,
    pub(super) group: i64,
    pub(super) speed_limit: Option<f64>,
    pub(super) stops: Vec<i64>,
}

/// A row of `lane_group_connectors`.
pub(super) struct GroupConnectorRow {
    pub(super) fid: i64,
    pub(super) from: i64,
    pub(super) to: i64,
    pub(super) areas: Vec<Polygon>,
}

/// A row of `stop_polygons`.
pub(super) struct StopRow {
    pub(super) fid: i64,
    pub(super) kind: i64,
    pub(super) connectors: Vec<i64>,
    pub(super) area: Polygon,
}

/// The layers that make up the lane map, each in order of its fids.
pub(super) struct Layers {
    pub(super) epsg: u32,
    pub(super) origin: Vector,
    pub(super) lanes: Vec<LaneRow>,
    pub(super) connectors: Vec<ConnectorRow>,
    pub(super) connector_areas: BTreeMap<i64, Vec<Polygon>>,
    pub(super) lane_baselines: BTreeMap<i64, Polyline>,
    pub(super) connector_baselines: BTreeMap<i64, Polyline>,
    pub(super) lane_groups: Vec<(i64, Vec<Polygon>)>,
    pub(super) group_connectors: Vec<GroupConnectorRow>,
    pub(super) stops: Vec<StopRow>,
    pub(super) intersections: Vec<Polygon>,
    pub(super) crosswalks: Vec<Polygon>,
    pub(super) road_segments: Vec<Polygon>,
    pub(super) generic_drivable: Vec<Polygon>,
    pub(super) carparks: Vec<Polygon>,
}

impl Layers {
    /// Reads a map file. The layers are decoded in parallel, not on rayon's threads: the caller
    /// holds a lock that they may wait for.
    pub(super) fn read(path: &Path) -> Result<Self, NuPlanError> {
        let database = Database::open(path)?;
        for table in READ_LAYERS {
            database.require(table, "a nuPlan map")?;
        }
        let projection = projection(&database)?;
        let origin = origin(&database, &projection)?;
        let source = Source {
            path,
            projection: &projection,
            origin,
        };
        std::thread::scope(|scope| {
            let lanes = scope.spawn(|| source.each(LANES, Source::lane));
            let connector_areas =
                scope.spawn(|| source.each(CONNECTOR_AREAS, Source::connector_area));
            let baselines = scope.spawn(|| source.each(BASELINE_PATHS, Source::baseline));
            let lane_groups = scope.spawn(|| {
                source.each(LANE_GROUPS, |source, r| {
                    Ok((r.fid("fid")?, source.areas(r)?))
                })
            });
            let group_connectors =
                scope.spawn(|| source.each(LANE_GROUP_CONNECTORS, Source::group_connector));
            let drivable = scope.spawn(|| {
                let of = |table| source.each(table, Source::areas).map(|rows| rows.concat());
                Ok([
                    of(ROAD_SEGMENTS)?,
                    of(GENERIC_DRIVABLE_AREAS)?,
                    of(CARPARK_AREAS)?,
                    of(INTERSECTIONS)?,
                    of(CROSSWALKS)?,
                ])
            });
            // The smallest layers, on this thread while the others decode.
            let stops = source.each(STOP_POLYGONS, Source::stop)?;
            let connectors = source.each(LANE_CONNECTORS, |_, record| connector(record))?;
            let [
                road_segments,
                generic_drivable,
                carparks,
                intersections,
                crosswalks,
            ] = joined(drivable)?;
            let (lane_baselines, connector_baselines) = split(joined(baselines)?);
            Ok(Self {
                epsg: projection.epsg(),
                origin,
                lanes: joined(lanes)?,
                connectors,
                connector_areas: joined(connector_areas)?.into_iter().collect(),
                lane_baselines,
                connector_baselines,
                lane_groups: joined(lane_groups)?,
                group_connectors: joined(group_connectors)?,
                stops,
                intersections,
                crosswalks,
                road_segments,
                generic_drivable,
                carparks,
            })
        })
    }
}

/// The result of a thread; its panic continues here.
fn joined<T>(thread: std::thread::ScopedJoinHandle<'_, T>) -> T {
    thread
        .join()
        .unwrap_or_else(|panic| std::panic::resume_unwind(panic))
}

/// A baseline with the fid of its lane or connector.
enum Baseline {
    Lane(i64, Polyline),
    Connector(i64, Polyline),
}

fn split(baselines: Vec<Baseline>) -> (BTreeMap<i64, Polyline>, BTreeMap<i64, Polyline>) {
    let mut of_lanes = BTreeMap::new();
    let mut of_connectors = BTreeMap::new();
    for baseline in baselines {
        match baseline {
            Baseline::Lane(fid, line) => of_lanes.insert(fid, line),
            Baseline::Connector(fid, line) => of_connectors.insert(fid, line),
        };
    }
    (of_lanes, of_connectors)
}

fn projection(database: &Database) -> Result<Utm, NuPlanError> {
    let failed = |reason: String| NuPlanError::file(&database.path, FileFault::MapMeta(reason));
    let name = database.first(META, "WHERE key = ?1", [PROJECTION_KEY], |record| {
        record.text("value")
    })?;
    let name = name.ok_or_else(|| {
        failed(format!(
            "no row with key `{PROJECTION_KEY}` names the projection"
        ))
    })?;
    Utm::from_name(&name).map_err(|error| failed(format!("key `{PROJECTION_KEY}`: {error}")))
}

/// The grid point nearest to the start of the first baseline, m.
fn origin(database: &Database, projection: &Utm) -> Result<Vector, NuPlanError> {
    let source = Source {
        path: &database.path,
        projection,
        origin: Vector::zeros(),
    };
    let start = database.first(BASELINE_PATHS, "ORDER BY fid", [], |record| {
        Ok(source.line(record)?.start())
    })?;
    let start = start.map_or_else(Vector::zeros, |start| start.coords);
    Ok(start.map(|meters| (meters / ORIGIN_GRID).round() * ORIGIN_GRID))
}

/// A map file, and its projection from degrees to local meters.
struct Source<'a> {
    path: &'a Path,
    projection: &'a Utm,
    origin: Vector,
}

impl Source<'_> {
    /// All rows of a layer in order of fids, over a connection of its own.
    fn each<T>(
        &self,
        table: Table,
        take: impl Fn(&Self, &Record<'_>) -> Result<T, NuPlanError>,
    ) -> Result<Vec<T>, NuPlanError> {
        let mut rows = Vec::new();
        Database::open(self.path)?.each(table, "ORDER BY fid", [], |record| {
            rows.push(take(self, record)?);
            Ok(())
        })?;
        Ok(rows)
    }

    fn lane(&self, record: &Record<'_>) -> Result<LaneRow, NuPlanError> {
        let fid = record.fid("fid")?;
        Ok(LaneRow {
            fid: record.maybe_fid("lane_fid")?.unwrap_or(fid),
            group: record.fid("lane_group_fid")?,
            index: record.fid("lane_index")?,
            speed_limit: speed_limit(record)?,
            areas: self.areas(record)?,
        })
    }

    fn connector_area(&self, record: &Record<'_>) -> Result<(i64, Vec<Polygon>), NuPlanError> {
        Ok((record.fid("lane_connector_fid")?, self.areas(record)?))
    }

    fn baseline(&self, record: &Record<'_>) -> Result<Baseline, NuPlanError> {
        let line = self.line(record)?;
        match (
            record.maybe_fid("lane_fid")?,
            record.maybe_fid("lane_connector_fid")?,
        ) {
            (Some(lane), _) => Ok(Baseline::Lane(lane, line)),
            (None, Some(connector)) => Ok(Baseline::Connector(connector, line)),
            (None, None) => Err(record.fault("lane_fid", CellFault::Null)),
        }
    }

    fn group_connector(&self, record: &Record<'_>) -> Result<GroupConnectorRow, NuPlanError> {
        Ok(GroupConnectorRow {
            fid: record.fid("fid")?,
            from: record.fid("from_lane_group_fid")?,
            to: record.fid("to_lane_group_fid")?,
            areas: self.areas(record)?,
        })
    }

    fn stop(&self, record: &Record<'_>) -> Result<StopRow, NuPlanError> {
        let fid = record.fid("fid")?;
        let area =
            largest(self.areas(record)?).ok_or_else(|| record.fault("geom", CellFault::Null))?;
        let connectors = fids(record, "lane_connector_fids")?;
        Ok(StopRow {
            fid,
            kind: record.fid("stop_polygon_type_fid")?,
            connectors,
            area,
        })
    }

    fn line(&self, record: &Record<'_>) -> Result<Polyline, NuPlanError> {
        let line = decode_line(record.blob("geom")?, WGS84)
            .map_err(|fault| record.fault("geom", fault))?;
        let vertices = self
            .vertices(&line)
            .map_err(|fault| record.fault("geom", fault))?;
        Polyline::new(vertices).map_err(|fault| record.fault("geom", fault))
    }

    /// The parts of a polygon.
    fn areas(&self, record: &Record<'_>) -> Result<Vec<Polygon>, NuPlanError> {
        let parts = decode_polygons(record.blob("geom")?, WGS84)
            .map_err(|fault| record.fault("geom", fault))?;
        parts
            .iter()
            .map(|part| self.area(part).map_err(|fault| record.fault("geom", fault)))
            .collect()
    }

    fn area(&self, part: &geo::Polygon<f64>) -> Result<Polygon, CellFault> {
        let mut area = Polygon::new(self.vertices(part.exterior())?)?;
        for hole in part.interiors() {
            area = area.with_hole(self.vertices(hole)?)?;
        }
        Ok(area)
    }

    fn vertices(&self, line: &LineString<f64>) -> Result<Vec<Point>, ProjectionError> {
        line.coords().map(|&degrees| self.point(degrees)).collect()
    }

    fn point(&self, degrees: Coord<f64>) -> Result<Point, ProjectionError> {
        let (x, y) = self.projection.to_utm(degrees.x, degrees.y)?;
        Ok(Point::new(x - self.origin.x, y - self.origin.y))
    }
}

fn connector(record: &Record<'_>) -> Result<ConnectorRow, NuPlanError> {
    Ok(ConnectorRow {
        fid: record.fid("fid")?,
        from: record.fid("exit_lane_fid")?,
        into: record.fid("entry_lane_fid")?,
        group: record.fid("lane_group_connector_fid")?,
        speed_limit: speed_limit(record)?,
        stops: fids(record, "traffic_light_stop_line_fids")?,
    })
}

/// A speed limit, m/s; NULL and NaN both mean none.
fn speed_limit(record: &Record<'_>) -> Result<Option<f64>, NuPlanError> {
    match record.maybe_float("speed_limit_mps")? {
        Some(limit) if limit.is_infinite() || limit < 0.0 => Err(record.fault(
            "speed_limit_mps",
            CellFault::Number {
                got: limit,
                expected: "m/s from 0 on",
            },
        )),
        limit => Ok(limit.filter(|limit| !limit.is_nan())),
    }
}

/// Ids in a text, separated by commas.
fn fids(record: &Record<'_>, column: &'static str) -> Result<Vec<i64>, NuPlanError> {
    let text = record.maybe_text(column)?.unwrap_or_default();
    let words = text
        .split(',')
        .map(str::trim)
        .filter(|word| !word.is_empty());
    let unknown = |word: &str| CellFault::Word {
        got: word.to_owned(),
        expected: "ids separated by commas",
    };
    words
        .map(|word| {
            word.parse()
                .map_err(|_| record.fault(column, unknown(word)))
        })
        .collect()
}

/// The largest part of an area that should have one part only.
pub(super) fn largest(areas: Vec<Polygon>) -> Option<Polygon> {
    if areas.len() == 1 {
        return areas.into_iter().next();
    }
    areas
        .into_iter()
        .max_by(|a, b| a.area().total_cmp(&b.area()))
}
