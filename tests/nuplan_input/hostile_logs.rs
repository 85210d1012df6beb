//! Logs that were made to harm: what is no table, what never ends, and how the logs beside them
//! fare.

use super::fixture::{DataSet, run};
use crate::cli;
use planagent_scenario::nuplan::ScenarioFilter;
use std::fs;
use std::time::{Duration, Instant};

/// Time in which a hostile log of some hundred kilobytes is refused, on a busy machine.
const PATIENCE: Duration = Duration::from_mins(1);

/// Puts a view without end in the place of a table.
fn endless_view() -> String {
    let endless = "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n)";
    format!(
        "ALTER TABLE lidar_pc RENAME TO old; CREATE VIEW lidar_pc AS {endless} SELECT old.* FROM old, n"
    )
}

#[test]
fn views_and_virtual_tables_are_no_tables() {
    for (sql, parts) in [
        (
            endless_view(),
            ["lidar_pc is a view and no table", ".db"],
        ),
        (
            "DROP TABLE scenario_tag; CREATE VIRTUAL TABLE scenario_tag USING fts5(token, lidar_pc_token, type)"
                .to_owned(),
            ["scenario_tag is a virtual table and no table", ".db"],
        ),
    ] {
        let begun = Instant::now();
        DataSet::log_with(&sql).assert_error_has(&parts);
        assert!(begun.elapsed() < PATIENCE, "{sql}");
    }
    DataSet::map_with(
        "ALTER TABLE lanes_polygons RENAME TO old; CREATE VIEW lanes_polygons AS SELECT * FROM old",
    )
    .assert_error_has(&["lanes_polygons is a view and no table", "map.gpkg"]);
}

#[test]
fn a_computed_column_cannot_stand_for_one_of_a_table() {
    let set = DataSet::log_with(
        "ALTER TABLE category DROP COLUMN name; ALTER TABLE category ADD COLUMN name TEXT AS (hex(zeroblob(900000000)))",
    );
    let begun = Instant::now();
    set.assert_error_has(&["table category has no column name"]);
    assert!(begun.elapsed() < PATIENCE);
}

/// A B-tree whose inner pages all lead to the same page below them has more rows than any file.
#[test]
fn a_table_that_never_ends_is_given_up() {
    let set = DataSet::log_with("UPDATE scenario_tag SET type = type");
    run(
        &set.log,
        "WITH RECURSIVE n(i) AS (SELECT 1 UNION ALL SELECT i + 1 FROM n LIMIT 60000)
         INSERT INTO scenario_tag SELECT randomblob(8), randomblob(8), 'behind_bike', NULL FROM n; VACUUM",
    );
    let length = knot(&set.log);
    let begun = Instant::now();
    let error = set
        .find(&ScenarioFilter::default())
        .unwrap_err()
        .to_string();
    assert!(error.contains("more steps than its size allows"), "{error}");
    assert!(
        begun.elapsed() < PATIENCE,
        "{length} bytes took {:?}",
        begun.elapsed()
    );
}

/// Lets every cell of the first inner page of the tags lead to one page, again and again; gives the
/// length of the file.
fn knot(log: &std::path::Path) -> usize {
    let root = rusqlite::Connection::open(log)
        .unwrap()
        .query_row(
            "SELECT rootpage FROM sqlite_schema WHERE name = 'scenario_tag'",
            [],
            |row| row.get::<_, i64>(0),
        )
        .unwrap();
    let root = usize::try_from(root).unwrap();
    let mut bytes = fs::read(log).unwrap();
    let page_size = match usize::from(u16::from_be_bytes([bytes[16], bytes[17]])) {
        1 => 65536,
        size => size,
    };
    let first = bytes.len() / page_size + 1;
    // Levels of inner pages, each of which leads many times to the page of the level below.
    let (levels, children) = (5, page_size / 16);
    let leaf = {
        let start = (root - 1) * page_size;
        assert_eq!(bytes[start], 5, "the tags fill more than a page");
        u32::from_be_bytes(bytes[start + 8..start + 12].try_into().unwrap())
    };
    for level in 0..levels {
        let below = if level + 1 == levels {
            leaf
        } else {
            u32::try_from(first + level + 1).unwrap()
        };
        bytes.extend(inner_page(page_size, children, below));
    }
    let start = (root - 1) * page_size;
    bytes[start..start + page_size].copy_from_slice(&inner_page(
        page_size,
        children,
        u32::try_from(first).unwrap(),
    ));
    let pages = u32::try_from(bytes.len() / page_size).unwrap();
    bytes[28..32].copy_from_slice(&pages.to_be_bytes());
    fs::write(log, &bytes).unwrap();
    bytes.len()
}

/// An inner page of a table whose children are all the same page.
fn inner_page(page_size: usize, children: usize, child: u32) -> Vec<u8> {
    let mut page = vec![0; page_size];
    page[0] = 5;
    page[3..5].copy_from_slice(&u16::try_from(children).unwrap().to_be_bytes());
    page[8..12].copy_from_slice(&child.to_be_bytes());
    let mut content = page_size;
    for cell in 0..children {
        // A cell is a page and a row number of one to nine bytes.
        content -= 5;
        page[content..content + 4].copy_from_slice(&child.to_be_bytes());
        page[content + 4] = u8::try_from(cell % 120 + 1).unwrap();
        page[12 + 2 * cell..14 + 2 * cell]
            .copy_from_slice(&u16::try_from(content).unwrap().to_be_bytes());
    }
    page[5..7].copy_from_slice(&u16::try_from(content).unwrap().to_be_bytes());
    page
}

#[test]
fn a_bad_log_hides_no_log_beside_it() {
    hides_no_log(&DataSet::new());
}

#[test]
fn an_endless_log_hides_no_log_beside_it() {
    let endless = DataSet::log_with(&endless_view());
    let set = DataSet::new();
    fs::copy(&endless.log, set.log.with_file_name("endless.db")).unwrap();
    hides_no_log(&set);
}

/// The log of the set is listed beside bad ones, of which each is an error.
fn hides_no_log(set: &DataSet) {
    let folder = set.log.parent().unwrap();
    for (name, bytes) in [
        ("empty.db", &b""[..]),
        ("page.db", &b"<html>"[..]),
        ("cut.db", &fs::read(&set.log).unwrap()[..5000]),
    ] {
        fs::write(folder.join(name), bytes).unwrap();
    }
    let begun = Instant::now();
    let (code, stdout, stderr) = cli::run(&["scenarios", "list", folder.to_str().unwrap()]);
    assert!(begun.elapsed() < PATIENCE);
    assert_eq!(code, 1, "{stderr}");
    assert!(stdout.contains(&set.token.to_string()), "{stdout}");
    let bad = fs::read_dir(folder).unwrap().count() - 1;
    assert_eq!(stderr.matches("error:").count(), bad, "{stderr}");
}
