//! Why a log, a map or a scenario of nuPlan cannot be read: what is wrong, where, and what to do.

use super::Token;
use super::geometry_blob::BlobError;
use super::projection::ProjectionError;
use planagent_world::MapError;
use planagent_world::geometry::GeometryError;
use std::fmt;
use std::path::PathBuf;

/// A row, by what its table knows it by.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RowName {
    Token(Token),
    /// Feature id.
    Fid(i64),
    /// `SQLite`'s own number, for a row whose token or id cannot be read.
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

/// A cell of a table or layer.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct CellPlace {
    pub path: PathBuf,
    pub table: &'static str,
    pub column: &'static str,
    pub row: RowName,
}

impl fmt::Display for CellPlace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{}: table {}, {}, column {}",
            self.path.display(),
            self.table,
            self.row,
            self.column
        )
    }
}

/// What is wrong with the content of a cell.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message of a variant says what it is")]
pub enum CellFault {
    #[error("is NULL")]
    Null,
    #[error("holds {got}, expected {expected}")]
    Type {
        expected: &'static str,
        got: &'static str,
    },
    /// NaN, infinite, or out of range.
    #[error("holds {got}, expected {expected}")]
    Number { got: f64, expected: &'static str },
    #[error("holds a text of {bytes} bytes; it may have {most}")]
    LongText { bytes: usize, most: usize },
    #[error("holds a token of {0} bytes, expected 8")]
    TokenLength(usize),
    #[error("holds '{got}', expected {expected}")]
    Word { got: String, expected: &'static str },
    /// Names a row that does not exist.
    #[error("names {target}, which table {table} does not hold")]
    Dangling { target: String, table: &'static str },
    #[error("holds {0} for the second time")]
    Twice(i64),
    #[error(transparent)]
    Blob(#[from] BlobError),
    #[error(transparent)]
    Shape(#[from] GeometryError),
    #[error(transparent)]
    Projection(#[from] ProjectionError),
}

/// Why an intact log does not hold a scenario that can be simulated.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the message of a variant says what it is")]
pub enum ScenarioFault {
    #[error("the log holds no lidar_pc row of this token")]
    NotInLog,
    #[error(
        "table lidar has no row with channel `MergedPointCloud`, so no row belongs to the scenario"
    )]
    NoSensor,
    #[error("its window holds {seconds:.1} s of the log; at least {needed} s are needed")]
    TooShort { seconds: f64, needed: f64 },
    #[error(
        "its window begins at the first row of the log: no row before it could be the history; take a later row as scenario"
    )]
    NoHistory,
    #[error("lidar_pc rows {before} and {after} have the same timestamp {time_us}")]
    SameTime {
        before: Token,
        after: Token,
        time_us: i64,
    },
    #[error("scene {scene}: {fault}")]
    Route { scene: Token, fault: RouteFault },
}

/// Why the route of a scene cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[allow(missing_docs, reason = "the message of a variant says what it is")]
pub enum RouteFault {
    #[error("its route is empty (column roadblock_ids)")]
    Empty,
    #[error("its route holds '{0}' in column roadblock_ids, expected ids separated by spaces")]
    Word(String),
    #[error(
        "its route holds roadblock {id}, which the map {map} does not have; do log and map belong together?"
    )]
    Unknown { id: i64, map: String },
}

/// What is wrong with a file or folder.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message of a variant says what it is")]
pub enum FileFault {
    #[error("cannot open: {0}")]
    Open(#[source] std::io::Error),
    #[error("cannot list: {0}")]
    List(#[source] std::io::Error),
    #[error("no *.db file in it or in the folders below{}", .0.as_ref().map_or(String::new(), |note| format!("; {note}")))]
    NoLogs(
        /// What was passed over.
        Option<String>,
    ),
    #[error("changes that are not part of it yet lie in {}; open it once with `sqlite3` to merge them", .0.display())]
    Unfinished(PathBuf),
    #[error("not an SQLite database{}", .0.map_or(String::new(), |kind| format!(": it is {kind}")))]
    NotADatabase(
        /// What it is instead.
        Option<&'static str>,
    ),
    #[error("damaged, found when reading {reading} ({source}); copy or download it again")]
    Damaged {
        reading: String,
        source: rusqlite::Error,
    },
    #[error("cannot read {reading}: {source}")]
    Sqlite {
        reading: String,
        source: rusqlite::Error,
    },
    #[error("no table {table}; is it {kind}?")]
    MissingTable {
        table: &'static str,
        kind: &'static str,
    },
    #[error("{table} is {kind} and no table; is it a nuPlan file?")]
    NoRealTable {
        table: &'static str,
        kind: &'static str,
    },
    #[error(
        "reading {reading} takes more steps than its size allows; the file is damaged, or made to never end"
    )]
    TooManySteps { reading: String },
    #[error("table {table} has no column {column}")]
    MissingColumn {
        table: &'static str,
        column: &'static str,
    },
    /// The list of maps.
    #[error("cannot open: {0}; --maps-root or NUPLAN_MAPS_ROOT must name the folder that holds it")]
    NoMapsIndex(#[source] std::io::Error),
    /// The list of maps.
    #[error("{0}")]
    MapsIndex(String),
    #[error("no map of '{location}'; there are {}", known.join(", "))]
    UnknownLocation {
        location: String,
        known: Vec<String>,
    },
    #[error("missing; {}", versions(found))]
    MissingMap { found: Vec<String> },
    /// The map does not name its projection.
    #[error("layer meta: {0}")]
    MapMeta(String),
    #[error(transparent)]
    Map(#[from] MapError),
    #[error("a token set is a JSON list of tokens: {0}")]
    TokenSet(String),
}

fn versions(found: &[String]) -> String {
    if found.is_empty() {
        "its location has no version there: is this the maps folder, fully unpacked?".to_owned()
    } else {
        format!("its location has version {} there", found.join(", "))
    }
}

/// Why nuPlan data cannot be read.
#[derive(Debug, thiserror::Error)]
#[allow(missing_docs, reason = "the message of a variant says what it is")]
pub enum NuPlanError {
    #[error(
        "the folder of nuPlan's logs is not known: give --data-root or set NUPLAN_DATA_ROOT to the folder that holds them"
    )]
    NoDataRoot,
    #[error(
        "the folder of nuPlan's maps is not known: give --maps-root or set NUPLAN_MAPS_ROOT to the folder that holds {}",
        super::schema::MAPS_INDEX
    )]
    NoMapsRoot,
    #[error("nuPlan's logs (--data-root or NUPLAN_DATA_ROOT): {0}")]
    DataRoot(#[source] Box<NuPlanError>),
    #[error("{}: {fault}", path.display())]
    File {
        path: PathBuf,
        fault: Box<FileFault>,
    },
    #[error("{place} {fault}")]
    Cell {
        place: Box<CellPlace>,
        fault: Box<CellFault>,
    },
    /// The log is intact, the scenario is not.
    #[error("{}: scenario {token}: {fault}", path.display())]
    Scenario {
        path: PathBuf,
        token: Token,
        fault: ScenarioFault,
    },
    #[error("scenario {token} is in two logs: {} and {}", first.display(), second.display())]
    TwoLogs {
        token: Token,
        first: PathBuf,
        second: PathBuf,
    },
}

impl NuPlanError {
    pub(super) fn file(path: impl Into<PathBuf>, fault: FileFault) -> Self {
        Self::File {
            path: path.into(),
            fault: Box::new(fault),
        }
    }

    pub(super) fn cell(place: CellPlace, fault: impl Into<CellFault>) -> Self {
        Self::Cell {
            place: Box::new(place),
            fault: Box::new(fault.into()),
        }
    }
}
