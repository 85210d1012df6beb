//! The container of a map: a `GeoPackage`, that is a SQLite database with the tables of the OGC
//! standard 12-128.

use crate::nuplan::projection::WGS84;
use crate::nuplan::schema::{META, Table};
use rusqlite::types::Value;
use rusqlite::{Connection, Transaction, params, params_from_iter};
use std::path::Path;

/// `GPKG` as SQLite's application id.
const APPLICATION_ID: i64 = 0x4750_4B47;
/// Version of the standard, 1.3, as SQLite's user version.
const USER_VERSION: i64 = 10_300;
/// Time of the last change of every layer; constant, so that the same map gives the same file.
const LAST_CHANGE: &str = "1970-01-01T00:00:00.000Z";
/// WGS 84 in the well-known text that the standard requires.
const WGS84_WKT: &str = "GEOGCS[\"WGS 84\",DATUM[\"WGS_1984\",SPHEROID[\"WGS 84\",6378137,298.257223563,\
    AUTHORITY[\"EPSG\",\"7030\"]],AUTHORITY[\"EPSG\",\"6326\"]],PRIMEM[\"Greenwich\",0,AUTHORITY[\"EPSG\",\"8901\"]],\
    UNIT[\"degree\",0.0174532925199433,AUTHORITY[\"EPSG\",\"9122\"]],AUTHORITY[\"EPSG\",\"4326\"]]";
/// Tables of the standard.
const TABLES: &str = "
CREATE TABLE gpkg_spatial_ref_sys (
    srs_name TEXT NOT NULL,
    srs_id INTEGER NOT NULL PRIMARY KEY,
    organization TEXT NOT NULL,
    organization_coordsys_id INTEGER NOT NULL,
    definition TEXT NOT NULL,
    description TEXT
);
CREATE TABLE gpkg_contents (
    table_name TEXT NOT NULL PRIMARY KEY,
    data_type TEXT NOT NULL,
    identifier TEXT UNIQUE,
    description TEXT DEFAULT '',
    last_change DATETIME NOT NULL,
    min_x DOUBLE, min_y DOUBLE, max_x DOUBLE, max_y DOUBLE,
    srs_id INTEGER,
    CONSTRAINT fk_gc_r_srs_id FOREIGN KEY (srs_id) REFERENCES gpkg_spatial_ref_sys (srs_id)
);
CREATE TABLE gpkg_geometry_columns (
    table_name TEXT NOT NULL,
    column_name TEXT NOT NULL,
    geometry_type_name TEXT NOT NULL,
    srs_id INTEGER NOT NULL,
    z TINYINT NOT NULL,
    m TINYINT NOT NULL,
    CONSTRAINT pk_geom_cols PRIMARY KEY (table_name, column_name),
    CONSTRAINT uk_gc_table_name UNIQUE (table_name),
    CONSTRAINT fk_gc_tn FOREIGN KEY (table_name) REFERENCES gpkg_contents (table_name),
    CONSTRAINT fk_gc_srs FOREIGN KEY (srs_id) REFERENCES gpkg_spatial_ref_sys (srs_id)
);
";

/// One row of a layer. Columns without a value are NULL.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Feature {
    pub(super) fid: i64,
    /// The geometry as a `GeoPackage` stores it.
    pub(super) geometry: Vec<u8>,
    pub(super) values: Vec<(&'static str, Value)>,
}

/// A layer with its rows.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct LayerRows {
    pub(super) layer: Table,
    pub(super) features: Vec<Feature>,
    /// Extent in degrees: west, south, east, north; `None` without rows.
    pub(super) bounds: Option<[f64; 4]>,
}

/// Writes a new package.
pub(super) fn write_package(
    path: &Path,
    meta: &[(&str, String)],
    layers: &[LayerRows],
) -> rusqlite::Result<()> {
    let mut connection = Connection::open(path)?;
    connection.execute_batch("PRAGMA journal_mode = OFF; PRAGMA synchronous = OFF;")?;
    connection.pragma_update(None, "application_id", APPLICATION_ID)?;
    connection.pragma_update(None, "user_version", USER_VERSION)?;
    let transaction = connection.transaction()?;
    write_reference_systems(&transaction)?;
    for (key, value) in meta {
        transaction.execute(&META.insert_into(&["key", "value"]), params![key, value])?;
    }
    for filled in layers {
        write_layer(&transaction, filled)?;
    }
    transaction.commit()?;
    connection.close().map_err(|(_, error)| error)
}

/// Writes the tables of the standard and the three reference systems that it requires.
fn write_reference_systems(transaction: &Transaction<'_>) -> rusqlite::Result<()> {
    transaction.execute_batch(TABLES)?;
    transaction.execute(&META.created(), [])?;
    let systems = [
        ("Undefined Cartesian SRS", -1, "NONE", -1, "undefined"),
        ("Undefined geographic SRS", 0, "NONE", 0, "undefined"),
        ("WGS 84 geodetic", WGS84, "EPSG", WGS84, WGS84_WKT),
    ];
    for (name, id, organization, number, definition) in systems {
        transaction.execute(
            "INSERT INTO gpkg_spatial_ref_sys (srs_name, srs_id, organization, organization_coordsys_id, definition) \
             VALUES (?, ?, ?, ?, ?)",
            params![name, id, organization, number, definition],
        )?;
    }
    transaction.execute(
        "INSERT INTO gpkg_contents (table_name, data_type, identifier, last_change, srs_id) \
         VALUES ('meta', 'attributes', 'meta', ?, 0)",
        params![LAST_CHANGE],
    )?;
    Ok(())
}

fn write_layer(transaction: &Transaction<'_>, filled: &LayerRows) -> rusqlite::Result<()> {
    let Table { name, .. } = filled.layer;
    // Readers such as GDAL list a layer only where both tables of the standard name it.
    transaction.execute(&filled.layer.created(), [])?;
    let bound = |i: usize| filled.bounds.map(|bounds| bounds[i]);
    transaction.execute(
        "INSERT INTO gpkg_contents (table_name, data_type, identifier, last_change, min_x, min_y, max_x, max_y, srs_id) \
         VALUES (?, 'features', ?, ?, ?, ?, ?, ?, ?)",
        params![name, name, LAST_CHANGE, bound(0), bound(1), bound(2), bound(3), WGS84],
    )?;
    transaction.execute(
        "INSERT INTO gpkg_geometry_columns (table_name, column_name, geometry_type_name, srs_id, z, m) \
         VALUES (?, 'geom', ?, ?, 0, 0)",
        params![name, filled.layer.kind("geom"), WGS84],
    )?;
    for feature in &filled.features {
        let named: Vec<&str> = ["fid", "geom"]
            .into_iter()
            .chain(feature.values.iter().map(|&(column, _)| column))
            .collect();
        let mut insert = transaction.prepare_cached(&filled.layer.insert_into(&named))?;
        let own = [
            Value::Integer(feature.fid),
            Value::Blob(feature.geometry.clone()),
        ];
        insert.execute(params_from_iter(
            own.iter()
                .chain(feature.values.iter().map(|(_, value)| value)),
        ))?;
    }
    Ok(())
}
