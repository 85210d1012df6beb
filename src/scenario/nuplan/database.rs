//! Read-only access to an `SQLite` file, with checks of its contents.
//!
//! Files are opened as immutable: nothing is locked, and no journal or shared-memory file is
//! created beside the user's data.

use super::error::{CellFault, CellPlace, FileFault, NuPlanError, RowName};
use super::schema::Table;
use super::token::{TOKEN_BYTES, Token};
use crate::reader::MAX_NAME_BYTES;
use planagent_files::{KIND_BYTES, kind_of};
use rusqlite::config::DbConfig;
use rusqlite::limits::Limit;
use rusqlite::types::ValueRef;
use rusqlite::{Connection, ErrorCode, OpenFlags, Params, Row};
use std::io::Read;
use std::path::{Path, PathBuf};

/// First bytes of every `SQLite` file.
const MAGIC: &[u8; 16] = b"SQLite format 3\0";

#[derive(Debug)]
pub(super) struct Database {
    pub(super) path: PathBuf,
    pub(super) connection: Connection,
}

impl Database {
    pub(super) fn open(path: &Path) -> Result<Self, NuPlanError> {
        check_bytes(path)?;
        check_finished(path)?;
        let flags = OpenFlags::SQLITE_OPEN_READ_ONLY
            | OpenFlags::SQLITE_OPEN_URI
            | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let failed = |source| {
            NuPlanError::file(
                path,
                FileFault::Sqlite {
                    reading: "the file".to_owned(),
                    source,
                },
            )
        };
        let mut connection =
            Connection::open_with_flags(immutable_uri(path), flags).map_err(failed)?;
        let bytes = std::fs::metadata(path)
            .map_err(|source| NuPlanError::file(path, FileFault::Open(source)))?
            .len();
        harden(&mut connection, bytes).map_err(failed)?;
        Ok(Self {
            path: path.to_owned(),
            connection,
        })
    }

    /// Checks that a table has its columns; `kind` says what the file should be.
    pub(super) fn require(&self, table: Table, kind: &'static str) -> Result<(), NuPlanError> {
        self.require_real(table)?;
        let present = self.columns(table.name)?;
        if present.is_empty() {
            return Err(NuPlanError::file(
                &self.path,
                FileFault::MissingTable {
                    table: table.name,
                    kind,
                },
            ));
        }
        match table
            .read_columns()
            .into_iter()
            .find(|&column| !present.iter().any(|p| p == column))
        {
            Some(column) => Err(NuPlanError::file(
                &self.path,
                FileFault::MissingColumn {
                    table: table.name,
                    column,
                },
            )),
            None => Ok(()),
        }
    }

    /// Refuses a view or a virtual table of this name, which are programs: reading one may never
    /// end.
    fn require_real(&self, table: Table) -> Result<(), NuPlanError> {
        let read = || {
            let query = "SELECT type, rootpage FROM sqlite_schema WHERE name = ?1 COLLATE NOCASE AND type IN ('table', 'view')";
            let mut statement = self.connection.prepare(query)?;
            let found = statement.query_map([table.name], |row| {
                Ok((row.get::<_, String>(0)?, row.get::<_, i64>(1)?))
            })?;
            found.collect::<rusqlite::Result<Vec<_>>>()
        };
        let found = read().map_err(|source| self.failed("the list of tables", source))?;
        for (kind, first_page) in found {
            let kind = match (kind.as_str(), first_page) {
                ("view", _) => "a view",
                (_, 0) => "a virtual table",
                _ => continue,
            };
            return Err(NuPlanError::file(
                &self.path,
                FileFault::NoRealTable {
                    table: table.name,
                    kind,
                },
            ));
        }
        Ok(())
    }

    /// Whether there is no such table.
    pub(super) fn lacks(&self, table: &str) -> bool {
        self.columns(table).is_ok_and(|columns| columns.is_empty())
    }

    fn columns(&self, table: &str) -> Result<Vec<String>, NuPlanError> {
        let read = || {
            let mut statement = self
                .connection
                .prepare("SELECT name FROM pragma_table_info(?1)")?;
            let names = statement.query_map([table], |row| row.get::<_, String>(0))?;
            names.collect::<rusqlite::Result<Vec<_>>>()
        };
        read().map_err(|source| self.failed("the list of tables", source))
    }

    /// Whether an index starts with this column.
    pub(super) fn is_indexed(&self, table: &str, column: &str) -> Result<bool, NuPlanError> {
        let found = self.connection.query_row(
            "SELECT EXISTS(SELECT 1 FROM pragma_index_list(?1) AS l, pragma_index_info(l.name) AS i \
             WHERE i.seqno = 0 AND i.name = ?2 AND l.partial = 0)",
            [table, column],
            |row| row.get(0),
        );
        found.map_err(|source| self.failed(table, source))
    }

    /// Calls `take` with each row of a table; `rest` is the query after the name of the table.
    pub(super) fn each(
        &self,
        table: Table,
        rest: &str,
        params: impl Params,
        mut take: impl FnMut(&Record<'_>) -> Result<(), NuPlanError>,
    ) -> Result<(), NuPlanError> {
        let query = format!("{} FROM {} {rest}", table.select(), table.name);
        self.each_of(table, &query, params, &mut take)
    }

    /// Calls `take` with each row of a query that selects the table's columns, then its rowid.
    pub(super) fn each_of(
        &self,
        table: Table,
        query: &str,
        params: impl Params,
        take: &mut dyn FnMut(&Record<'_>) -> Result<(), NuPlanError>,
    ) -> Result<(), NuPlanError> {
        let failed = |source| self.failed(table.name, source);
        let mut statement = self.connection.prepare_cached(query).map_err(failed)?;
        let mut rows = statement.query(params).map_err(failed)?;
        let columns = table.read_columns();
        while let Some(row) = rows.next().map_err(failed)? {
            take(&Record {
                database: self,
                table,
                columns: &columns,
                row,
            })?;
        }
        Ok(())
    }

    /// The first row of a query, if there is one.
    pub(super) fn first<T>(
        &self,
        table: Table,
        rest: &str,
        params: impl Params,
        mut take: impl FnMut(&Record<'_>) -> Result<T, NuPlanError>,
    ) -> Result<Option<T>, NuPlanError> {
        let mut found = None;
        self.each(table, &format!("{rest} LIMIT 1"), params, |record| {
            found = Some(take(record)?);
            Ok(())
        })?;
        Ok(found)
    }

    /// The error of `SQLite` when reading a table.
    pub(super) fn failed(&self, reading: &str, source: rusqlite::Error) -> NuPlanError {
        let reading = format!("table {reading}");
        let fault = match source.sqlite_error_code() {
            Some(ErrorCode::NotADatabase) => FileFault::NotADatabase(None),
            Some(ErrorCode::OperationInterrupted) => FileFault::TooManySteps { reading },
            Some(ErrorCode::DatabaseCorrupt | ErrorCode::SystemIoFailure) => {
                FileFault::Damaged { reading, source }
            }
            _ => FileFault::Sqlite { reading, source },
        };
        NuPlanError::file(&self.path, fault)
    }
}

/// Steps of `SQLite`'s machine between two looks at the budget.
const STEPS_A_LOOK: i32 = 10_000;
/// Steps that every file may take.
const MIN_STEPS: u64 = 20_000_000;
/// Steps for each byte of a file. Reading a table of a log takes about one for four bytes, and a
/// log is read a few times.
const STEPS_A_BYTE: u64 = 20;
/// Longest text or blob, bytes. The outlines of the largest map features have less than a megabyte.
const MAX_VALUE_BYTES: i32 = 64 << 20;

/// Prepares a connection for a file of this size that anyone may have written: its schema runs no
/// functions, its views are not read, and reading ends after as many steps as honest tables of that
/// size never take.
pub(super) fn harden(connection: &mut Connection, bytes: u64) -> rusqlite::Result<()> {
    connection.set_db_config(DbConfig::SQLITE_DBCONFIG_DEFENSIVE, true)?;
    for off in [
        DbConfig::SQLITE_DBCONFIG_TRUSTED_SCHEMA,
        DbConfig::SQLITE_DBCONFIG_ENABLE_VIEW,
        DbConfig::SQLITE_DBCONFIG_ENABLE_TRIGGER,
    ] {
        connection.set_db_config(off, false)?;
    }
    connection.set_limit(Limit::SQLITE_LIMIT_LENGTH, MAX_VALUE_BYTES)?;
    let budget = MIN_STEPS.saturating_add(bytes.saturating_mul(STEPS_A_BYTE));
    let mut steps = 0;
    connection.progress_handler(
        STEPS_A_LOOK,
        Some(move || {
            steps += u64::from(STEPS_A_LOOK.unsigned_abs());
            steps > budget
        }),
    )
}

/// `SQLite` takes an empty file for an empty database; neither is nuPlan data.
fn check_bytes(path: &Path) -> Result<(), NuPlanError> {
    let io = |source| NuPlanError::file(path, FileFault::Open(source));
    let start = beginning(path).map_err(io)?;
    if start.starts_with(MAGIC) {
        Ok(())
    } else {
        let kind = if start.is_empty() {
            Some("empty")
        } else {
            kind_of(&start)
        };
        Err(NuPlanError::file(path, FileFault::NotADatabase(kind)))
    }
}

/// What a file is instead of a database; `None` for a database, and where nothing is known.
pub(super) fn other_kind(path: &Path) -> Option<&'static str> {
    let start = beginning(path).ok()?;
    if start.starts_with(MAGIC) {
        None
    } else {
        kind_of(&start)
    }
}

fn beginning(path: &Path) -> std::io::Result<Vec<u8>> {
    let mut start = Vec::with_capacity(KIND_BYTES);
    planagent_files::open(path)?
        .take(KIND_BYTES as u64)
        .read_to_end(&mut start)?;
    Ok(start)
}

/// Rejects a database whose last changes lie in a file beside it: ignoring them would be wrong, and
/// merging them would write.
fn check_finished(path: &Path) -> Result<(), NuPlanError> {
    for ending in ["-wal", "-journal"] {
        let mut name = path.as_os_str().to_owned();
        name.push(ending);
        let beside = PathBuf::from(name);
        if std::fs::metadata(&beside).is_ok_and(|file| file.len() > 0) {
            return Err(NuPlanError::file(path, FileFault::Unfinished(beside)));
        }
    }
    Ok(())
}

/// The name by which `SQLite` opens a file without writing to it or beside it.
pub(super) fn immutable_uri(path: &Path) -> String {
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || b"/-._~".contains(&byte);
    let bytes = path.as_os_str().as_encoded_bytes().iter();
    let name = bytes.map(|&byte| {
        if plain(byte) {
            char::from(byte).to_string()
        } else {
            format!("%{byte:02X}")
        }
    });
    format!(
        "file:{}?mode=ro&immutable=1",
        name.collect::<Vec<_>>().concat()
    )
}

/// One row. The error of every getter names the cell.
pub(super) struct Record<'a> {
    database: &'a Database,
    table: Table,
    /// The columns that are read; the first names the row.
    columns: &'a [&'static str],
    row: &'a Row<'a>,
}

impl Record<'_> {
    fn value(&self, column: &'static str) -> ValueRef<'_> {
        let place = self.columns.iter().position(|&c| c == column);
        place
            .and_then(|place| self.row.get_ref(place).ok())
            .unwrap_or(ValueRef::Null)
    }

    fn name(&self) -> RowName {
        let number = self
            .row
            .get::<_, i64>(self.columns.len())
            .unwrap_or_default();
        let key = self
            .columns
            .first()
            .copied()
            .expect("a query reads one column at least");
        match (key, self.value(key)) {
            (_, ValueRef::Blob(bytes)) => match <[u8; TOKEN_BYTES]>::try_from(bytes) {
                Ok(bytes) => RowName::Token(Token::new(bytes)),
                Err(_) => RowName::Number(number),
            },
            ("fid", ValueRef::Integer(fid)) => RowName::Fid(fid),
            _ => RowName::Number(number),
        }
    }

    /// An error about a cell of this row.
    pub(super) fn fault(&self, column: &'static str, fault: impl Into<CellFault>) -> NuPlanError {
        let place = CellPlace {
            path: self.database.path.clone(),
            table: self.table.name,
            column,
            row: self.name(),
        };
        NuPlanError::cell(place, fault)
    }

    fn wrong(&self, column: &'static str, expected: &'static str) -> NuPlanError {
        let got = match self.value(column) {
            ValueRef::Null => return self.fault(column, CellFault::Null),
            ValueRef::Integer(_) => "an integer",
            ValueRef::Real(_) => "a number",
            ValueRef::Text(_) => "a text",
            ValueRef::Blob(_) => "bytes",
        };
        self.fault(column, CellFault::Type { expected, got })
    }

    /// `None` for NULL, which is also how `SQLite` stores NaN.
    pub(super) fn maybe_float(&self, column: &'static str) -> Result<Option<f64>, NuPlanError> {
        match self.value(column) {
            ValueRef::Null => Ok(None),
            ValueRef::Real(number) => Ok(Some(number)),
            ValueRef::Integer(number) => Ok(Some(number as f64)),
            _ => Err(self.wrong(column, "a number")),
        }
    }

    pub(super) fn float(&self, column: &'static str) -> Result<f64, NuPlanError> {
        let number = self
            .maybe_float(column)?
            .ok_or_else(|| self.fault(column, CellFault::Null))?;
        if number.is_finite() {
            Ok(number)
        } else {
            Err(self.fault(
                column,
                CellFault::Number {
                    got: number,
                    expected: "a finite number",
                },
            ))
        }
    }

    pub(super) fn integer(&self, column: &'static str) -> Result<i64, NuPlanError> {
        match self.value(column) {
            ValueRef::Integer(number) => Ok(number),
            _ => Err(self.wrong(column, "an integer")),
        }
    }

    /// A feature id; `None` for NULL or NaN. Columns of ids with gaps hold numbers with a fraction
    /// of 0, or text.
    pub(super) fn maybe_fid(&self, column: &'static str) -> Result<Option<i64>, NuPlanError> {
        match self.value(column) {
            ValueRef::Null => Ok(None),
            ValueRef::Integer(fid) => Ok(Some(fid)),
            ValueRef::Real(fid) if fid.is_nan() => Ok(None),
            ValueRef::Real(fid) if fid.fract() == 0.0 => Ok(Some(fid as i64)),
            ValueRef::Text(text) => {
                let text = String::from_utf8_lossy(text);
                match text.trim() {
                    "" => Ok(None),
                    fid => fid
                        .parse()
                        .map(Some)
                        .map_err(|_| self.wrong(column, "an id")),
                }
            }
            _ => Err(self.wrong(column, "an id")),
        }
    }

    pub(super) fn fid(&self, column: &'static str) -> Result<i64, NuPlanError> {
        self.maybe_fid(column)?
            .ok_or_else(|| self.fault(column, CellFault::Null))
    }

    pub(super) fn maybe_text(&self, column: &'static str) -> Result<Option<String>, NuPlanError> {
        match self.value(column) {
            ValueRef::Null => Ok(None),
            ValueRef::Text(text) => Ok(Some(String::from_utf8_lossy(text).into_owned())),
            _ => Err(self.wrong(column, "a text")),
        }
    }

    /// A text that records of a run can hold.
    pub(super) fn maybe_name(&self, column: &'static str) -> Result<Option<String>, NuPlanError> {
        let name = self.maybe_text(column)?;
        match name.as_ref().map_or(0, String::len) {
            bytes if bytes > MAX_NAME_BYTES => {
                let most = MAX_NAME_BYTES;
                Err(self.fault(column, CellFault::LongText { bytes, most }))
            }
            _ => Ok(name),
        }
    }

    pub(super) fn text(&self, column: &'static str) -> Result<String, NuPlanError> {
        self.maybe_text(column)?
            .ok_or_else(|| self.fault(column, CellFault::Null))
    }

    pub(super) fn maybe_token(&self, column: &'static str) -> Result<Option<Token>, NuPlanError> {
        match self.value(column) {
            ValueRef::Null => Ok(None),
            ValueRef::Blob(bytes) => match <[u8; TOKEN_BYTES]>::try_from(bytes) {
                Ok(bytes) => Ok(Some(Token::new(bytes))),
                Err(_) => Err(self.fault(column, CellFault::TokenLength(bytes.len()))),
            },
            _ => Err(self.wrong(column, "a token of 8 bytes")),
        }
    }

    pub(super) fn token(&self, column: &'static str) -> Result<Token, NuPlanError> {
        self.maybe_token(column)?
            .ok_or_else(|| self.fault(column, CellFault::Null))
    }

    pub(super) fn blob(&self, column: &'static str) -> Result<&[u8], NuPlanError> {
        match self.value(column) {
            ValueRef::Blob(bytes) => Ok(bytes),
            _ => Err(self.wrong(column, "bytes")),
        }
    }
}
