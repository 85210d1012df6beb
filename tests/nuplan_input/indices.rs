//! Logs without indices: an index is written to a file of its own, never to the log.

use super::fixture::{DataSet, run};
use planagent_scenario::nuplan::{MapStore, open};
use rusqlite::Connection;
use std::path::{Path, PathBuf};

/// A data set whose log has no index.
fn without_indices() -> DataSet {
    let set = DataSet::new();
    let names: Vec<String> = {
        let connection = Connection::open(&set.log).unwrap();
        let mut statement = connection
            .prepare("SELECT name FROM sqlite_master WHERE type = 'index' AND sql IS NOT NULL")
            .unwrap();
        statement
            .query_map([], |row| row.get(0))
            .unwrap()
            .map(Result::unwrap)
            .collect()
    };
    for name in names {
        run(&set.log, &format!("DROP INDEX \"{name}\""));
    }
    // A table without a primary key has no index on the token.
    run(
        &set.log,
        "CREATE TABLE t AS SELECT * FROM ego_pose; DROP TABLE ego_pose; ALTER TABLE t RENAME TO ego_pose",
    );
    set
}

fn files(folder: &Path) -> Vec<PathBuf> {
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder)
        .into_iter()
        .flatten()
        .map(|entry| entry.unwrap().path())
        .collect();
    files.sort();
    files
}

#[test]
fn an_index_is_made_once_beside_nothing_of_the_users() {
    let set = without_indices();
    let data = set.folder.path().join("data");
    let (before, bytes) = (files(&data), std::fs::read(&set.log).unwrap());
    let indexed = DataSet::new().open().unwrap();
    let first = set.open().unwrap();
    assert_eq!(first.frames, indexed.frames);
    assert_eq!(
        (files(&data), std::fs::read(&set.log).unwrap()),
        (before, bytes),
        "the user's data is as it was"
    );
    let index = files(&set.folder.path().join("cache"));
    assert_eq!(index.len(), 1, "{index:?}");
    let made = std::fs::metadata(&index[0]).unwrap().modified().unwrap();
    assert_eq!(set.open().unwrap().frames, first.frames);
    assert_eq!(
        std::fs::metadata(&index[0]).unwrap().modified().unwrap(),
        made,
        "used, not made again"
    );
}

#[test]
fn a_changed_log_gets_a_new_index() {
    let set = without_indices();
    let objects = set.open().unwrap().frames[0].objects.len();
    let stale = files(&set.folder.path().join("cache"));
    run(&set.log, "DELETE FROM lidar_box");
    assert!(objects > 0);
    assert!(
        set.open()
            .unwrap()
            .frames
            .iter()
            .all(|frame| frame.objects.is_empty())
    );
    let fresh = files(&set.folder.path().join("cache"));
    assert_eq!(fresh.len(), 1);
    assert_ne!(fresh, stale);
}

#[test]
fn a_damaged_index_is_made_again() {
    let set = without_indices();
    let frames = set.open().unwrap().frames;
    let index = files(&set.folder.path().join("cache")).remove(0);
    let whole = std::fs::metadata(&index).unwrap().len();
    for content in [
        std::fs::read(&index).unwrap()[..whole as usize / 2].to_vec(),
        b"no database".to_vec(),
        Vec::new(),
    ] {
        std::fs::write(&index, content).unwrap();
        assert_eq!(set.open().unwrap().frames, frames);
        assert_eq!(std::fs::metadata(&index).unwrap().len(), whole);
    }
}

#[test]
fn without_a_cache_it_says_so_and_goes_on() {
    let set = without_indices();
    let frames = set.open().unwrap().frames;
    let blocked = set.folder.path().join("blocked");
    std::fs::write(&blocked, "a file where the folder should be").unwrap();
    for cache in [None, Some(blocked)] {
        let maps = MapStore::with_cache(set.roots().maps, cache);
        assert_eq!(open(&maps, &set.found().unwrap()).unwrap().frames, frames);
        let notes = maps.take_notes();
        assert!(
            notes[0].contains("no index of logs can be written"),
            "{notes:?}"
        );
    }
}
