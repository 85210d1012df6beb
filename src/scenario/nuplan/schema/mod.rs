//! The tables of nuPlan's logs and the layers of its maps, stated once for reader and writer.

mod log;
mod map;

pub(super) use log::{
    CATEGORY, CHANNEL, EGO_POSE, LIDAR, LIDAR_BOX, LIDAR_PC, LOG, LOG_INDICES, LOG_TABLES,
    SCENARIO_TAG, SCENE, TRACK, TRAFFIC_LIGHT_STATUS,
};
pub use map::MAPS_INDEX;
pub(super) use map::{
    BASELINE_PATHS, BOUNDARIES, CARPARK_AREAS, CONNECTOR_AREAS, CROSSWALKS, EMPTY_LAYERS,
    GENERIC_DRIVABLE_AREAS, INTERSECTIONS, LANE_CONNECTORS, LANE_GROUP_CONNECTORS, LANE_GROUPS,
    LANES, META, PROJECTION_KEY, READ_LAYERS, ROAD_SEGMENTS, STOP_POLYGONS,
};

/// A table of a log or a layer of a map.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Table {
    pub(super) name: &'static str,
    /// Columns with their types, separated by commas. A star marks those that are read; the first
    /// of them names the row.
    columns: &'static str,
}

impl Table {
    const fn new(name: &'static str, columns: &'static str) -> Self {
        Self { name, columns }
    }

    /// Name and type of each column, and whether it is read.
    fn all(&self) -> impl Iterator<Item = (&'static str, &'static str, bool)> + use<> {
        self.columns.split(',').map(|column| {
            let column = column.trim();
            let (is_read, column) = (column.starts_with('*'), column.trim_start_matches('*'));
            let (name, kind) = column.split_once(' ').unwrap_or((column, ""));
            (name, kind, is_read)
        })
    }

    /// The columns that are read; the first names the row.
    pub(super) fn read_columns(&self) -> Vec<&'static str> {
        self.all()
            .filter(|(_, _, is_read)| *is_read)
            .map(|(name, ..)| name)
            .collect()
    }

    /// The begin of a query, up to its FROM: the columns that are read, then the rowid.
    pub(super) fn select(&self) -> String {
        let name = self.name;
        let columns: Vec<String> = self
            .read_columns()
            .iter()
            .map(|column| format!("{name}.\"{column}\""))
            .collect();
        format!("SELECT {}, {name}.rowid", columns.join(", "))
    }

    /// The type of a column.
    pub(super) fn kind(&self, column: &str) -> &'static str {
        self.all()
            .find(|(name, ..)| *name == column)
            .map_or("", |(_, kind, _)| kind)
    }

    /// The query that makes the table.
    pub(super) fn created(&self) -> String {
        let columns: Vec<String> = self
            .all()
            .map(|(name, kind, _)| format!("{name} {kind}"))
            .collect();
        format!("CREATE TABLE {} ({})", self.name, columns.join(", "))
    }

    /// The query that inserts a row with a value for each column.
    pub(super) fn insert(&self) -> String {
        let columns: Vec<&str> = self.all().map(|(name, ..)| name).collect();
        self.insert_into(&columns)
    }

    /// The query that inserts a row with values for some columns.
    pub(super) fn insert_into(&self, columns: &[&str]) -> String {
        let places = vec!["?"; columns.len()].join(", ");
        format!(
            "INSERT INTO {} ({}) VALUES ({places})",
            self.name,
            columns.join(", ")
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_says_what_is_read_and_how_it_is_made() {
        const TABLE: Table =
            Table::new("t", "*token BLOB NOT NULL PRIMARY KEY, name TEXT, *x FLOAT");
        assert_eq!(TABLE.read_columns(), ["token", "x"]);
        assert_eq!((TABLE.kind("name"), TABLE.kind("y")), ("TEXT", ""));
        assert_eq!(
            TABLE.created(),
            "CREATE TABLE t (token BLOB NOT NULL PRIMARY KEY, name TEXT, x FLOAT)"
        );
        assert_eq!(
            TABLE.insert(),
            "INSERT INTO t (token, name, x) VALUES (?, ?, ?)"
        );
    }
}
