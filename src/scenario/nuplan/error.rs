//! Why a log, a map or a scenario of nuPlan's cannot be read: what is wrong, where it stands, and what to do.

use super::geometry_blob::BlobError;
use super::projection::ProjectionError;
use super::{RouteFault, Token};
use crate::geometry::GeometryError;
use crate::world::MapError;
use std::fmt;
use std::path::PathBuf;

/// A row, as its table knows it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RowName {
    /// By its token.
    Token(Token),
    /// By its feature id.
    Fid(i64),
    /// By `SQLite`'s own number: its token or id cannot be read.
    Number(i64),
}

impl fmt::Display for RowName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Token(token) => write!(f, "row {token}"),
            Self::Fid(fid) => write!(f, "fid {fid}"),
            Self::Number(number) => write!(f, "row number {number}"),
        }
    }
}

/// A cell of a table.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CellPlace {
    /// The file.
    pub path: PathBuf,
    /// The table or layer.
    pub table: String,
    /// The column.
    pub column: &'static str,
    /// The row.
    pub row: RowName,
}

impl fmt::Display for CellPlace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: table {}, {}, column {}", self.path.display(), self.table, self.row, self.column)
    }
}

/// What is wrong with the content of a cell.
#[derive(Debug, thiserror::Error)]
pub enum CellFault {
    /// Nothing there.
    #[error("is NULL")]
    Null,
    /// Not of the type that the format says.
    #[error("holds {got}, expected {expected}")]
    Type {
        /// What it should hold.
        expected: &'static str,
        /// What it holds.
        got: &'static str,
    },
    /// NaN, infinite, or out of the range that makes sense.
    #[error("holds {got}, expected {expected}")]
    Number {
        /// The value.
        got: f64,
        /// What makes sense.
        expected: &'static str,
    },
    /// A token of another length.
    #[error("holds a token of {0} bytes, expected 8")]
    TokenLength(usize),
    /// A word that the format does not know.
    #[error("holds `{got}`, expected {expected}")]
    Word {
        /// The word.
        got: String,
        /// What is known.
        expected: &'static str,
    },
    /// Names a row that does not exist.
    #[error("names {target}, which table {table} does not hold")]
    Dangling {
        /// The missing row, by its token or id.
        target: String,
        /// Where it should be.
        table: &'static str,
    },
    /// Says again what another row says.
    #[error("holds {0} for the second time")]
    Twice(i64),
    /// The geometry's bytes cannot be read.
    #[error("{0}")]
    Blob(#[from] BlobError),
    /// The geometry makes no shape.
    #[error("{0}")]
    Shape(#[from] GeometryError),
    /// The geometry lies outside the map's projection.
    #[error("{0}")]
    Projection(#[from] ProjectionError),
}

/// Why a sound log does not hold a scenario that can be driven.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ScenarioFault {
    /// No such row.
    #[error("the log holds no lidar_pc row of this token")]
    NotInLog,
    /// No row of the sensor that nuPlan reads.
    #[error("table lidar has no row with channel `MergedPointCloud`, so no row belongs to the scenario")]
    NoSensor,
    /// Less than 3 s of rows.
    #[error("its window holds {seconds:.1} s of the log; at least {needed} s are needed")]
    TooShort {
        /// What there is, s.
        seconds: f64,
        /// What is needed, s.
        needed: f64,
    },
    /// Nothing before iteration 0.
    #[error(
        "its window begins at the first row of the log: no row before it could be the history; take a later row as scenario"
    )]
    NoHistory,
    /// Two rows of one time.
    #[error("lidar_pc rows {before} and {after} have the same timestamp {time_us}")]
    SameTime {
        /// The one row.
        before: Token,
        /// The other row.
        after: Token,
        /// Their time, µs.
        time_us: i64,
    },
    /// The route cannot be used.
    #[error("scene {scene}: {fault}")]
    Route {
        /// The scene of the tagged row.
        scene: Token,
        /// What is wrong.
        fault: RouteFault,
    },
}

/// Why nuPlan data cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum NuPlanError {
    /// Nobody said where the logs are.
    #[error(
        "where nuPlan's logs are is not known: give --data-root or set NUPLAN_DATA_ROOT to the folder that holds them"
    )]
    NoDataRoot,
    /// Nobody said where the maps are.
    #[error(
        "where nuPlan's maps are is not known: give --maps-root or set NUPLAN_MAPS_ROOT to the folder that holds {}",
        super::MAPS_INDEX
    )]
    NoMapsRoot,
    /// The folder that should hold the logs cannot be used.
    #[error("nuPlan's logs (--data-root or NUPLAN_DATA_ROOT): {0}")]
    DataRoot(#[source] Box<NuPlanError>),
    /// The list of maps cannot be opened.
    #[error(
        "{}: cannot open: {source}; --maps-root or NUPLAN_MAPS_ROOT must name the folder that holds it",
        path.display()
    )]
    NoMapsIndex {
        /// Where it should be.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A file or folder cannot be opened or listed.
    #[error("{}: cannot {doing}: {source}", path.display())]
    Io {
        /// Which.
        path: PathBuf,
        /// What was tried: `open`, `list`.
        doing: &'static str,
        /// Why.
        source: std::io::Error,
    },
    /// No log below the folder.
    #[error("{}: no *.db file in it or in the folders below", .0.display())]
    NoLogs(PathBuf),
    /// Another program has not finished writing it.
    #[error(
        "{}: changes that are not part of it yet lie in {}; open it once with `sqlite3` to take them in",
        path.display(), beside.display()
    )]
    Unfinished {
        /// The database.
        path: PathBuf,
        /// The file beside it.
        beside: PathBuf,
    },
    /// Not an `SQLite` file.
    #[error("{}: not an SQLite database", .0.display())]
    NotADatabase(PathBuf),
    /// `SQLite` finds it damaged.
    #[error("{}: damaged, found when reading {reading} ({source}); copy or download it again", path.display())]
    Damaged {
        /// Which file.
        path: PathBuf,
        /// Which table.
        reading: String,
        /// What `SQLite` says.
        source: rusqlite::Error,
    },
    /// `SQLite` cannot read it for another reason.
    #[error("{}: cannot read {reading}: {source}", path.display())]
    Sqlite {
        /// Which file.
        path: PathBuf,
        /// Which table.
        reading: String,
        /// What `SQLite` says.
        source: rusqlite::Error,
    },
    /// A table or layer is missing.
    #[error("{}: no table {table}; is it {kind}?", path.display())]
    MissingTable {
        /// Which file.
        path: PathBuf,
        /// Which table.
        table: &'static str,
        /// What it should be.
        kind: &'static str,
    },
    /// A column is missing.
    #[error("{}: table {table} has no column {column}", path.display())]
    MissingColumn {
        /// Which file.
        path: PathBuf,
        /// Which table.
        table: &'static str,
        /// Which column.
        column: &'static str,
    },
    /// A cell holds something that cannot be used.
    #[error("{place} {fault}")]
    Cell {
        /// Where.
        place: Box<CellPlace>,
        /// What.
        fault: Box<CellFault>,
    },
    /// The log is sound, the scenario is not.
    #[error("{}: scenario {token}: {fault}", path.display())]
    Scenario {
        /// Which log.
        path: PathBuf,
        /// Which scenario.
        token: Token,
        /// What is wrong.
        fault: ScenarioFault,
    },
    /// Two logs hold one token.
    #[error("scenario {token} is in two logs: {} and {}", first.display(), second.display())]
    TwoLogs {
        /// The token.
        token: Token,
        /// One log.
        first: PathBuf,
        /// The other.
        second: PathBuf,
    },
    /// The list of maps cannot be read.
    #[error("{}: {reason}", path.display())]
    MapsIndex {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// The list of maps does not know the location.
    #[error("{}: no map of `{location}`; there are {}", path.display(), known.join(", "))]
    UnknownLocation {
        /// The list of maps.
        path: PathBuf,
        /// What the log asks for.
        location: String,
        /// What there is.
        known: Vec<String>,
    },
    /// The map's file is not where the list says.
    #[error("{}: missing; {}", path.display(), versions(found))]
    MissingMap {
        /// Where it should be.
        path: PathBuf,
        /// Versions of the location that there are.
        found: Vec<String>,
    },
    /// The map does not name its projection.
    #[error("{}: layer meta: {reason}", path.display())]
    MapMeta {
        /// Which map.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// The layers do not make a map.
    #[error("{}: {source}", path.display())]
    Map {
        /// Which map.
        path: PathBuf,
        /// Why.
        source: MapError,
    },
    /// The file of a token set cannot be used.
    #[error("{}: a token set is a JSON list of tokens: {reason}", path.display())]
    TokenSet {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
}

fn versions(found: &[String]) -> String {
    if found.is_empty() {
        "its location has no version there: is this the maps folder, fully unpacked?".to_owned()
    } else {
        format!("its location has version {} there", found.join(", "))
    }
}
