//! Every fault of a log is an error that names the place.

use super::fixture::{DataSet, LOCATION};
use planagent_scenario::nuplan::{Exclusion, NuPlanError, ScenarioFault, ScenarioFilter};
use std::io::{Seek, SeekFrom, Write};

/// SQL for the time at which the window of the scenario begins: 3 s before the tag.
const START: &str = "(SELECT p.timestamp - 3000000 FROM lidar_pc AS p, scenario_tag AS t WHERE t.lidar_pc_token = p.token)";

#[test]
fn the_unspoilt_data_set_opens() {
    let scenario = DataSet::new().open().unwrap();
    assert_eq!(scenario.iterations(), 151);
    assert_eq!(scenario.scenario_type, "changing_lane");
}

#[test]
fn files_that_are_no_database() {
    let set = DataSet::new();
    std::fs::write(&set.log, "<html>404: not found</html>").unwrap();
    set.assert_error_has(&[".db: not an SQLite database"]);
    std::fs::write(&set.log, "").unwrap();
    set.assert_error_has(&[".db: not an SQLite database"]);
    std::fs::write(&set.log, "SQLite format 3\0").unwrap();
    set.assert_error_has(&[".db: not an SQLite database"]);
}

#[test]
fn damaged_pages_and_cut_files() {
    let set = DataSet::new();
    let length = std::fs::metadata(&set.log).unwrap().len();
    let mut file = std::fs::OpenOptions::new()
        .write(true)
        .open(&set.log)
        .unwrap();
    for page in 20..length / 4096 {
        file.seek(SeekFrom::Start(page * 4096)).unwrap();
        file.write_all(&[0xA5; 4096]).unwrap();
    }
    set.assert_error_has(&[
        ".db: damaged",
        "when reading table",
        "copy or download it again",
    ]);
    let set = DataSet::new();
    std::fs::OpenOptions::new()
        .write(true)
        .open(&set.log)
        .unwrap()
        .set_len(length / 2)
        .unwrap();
    set.assert_error_has(&[".db: damaged"]);
}

#[test]
fn a_log_that_another_program_is_writing() {
    let set = DataSet::new();
    let beside = format!("{}-wal", set.log.display());
    std::fs::write(&beside, "changes").unwrap();
    set.assert_error_has(&[".db: changes that are not part of it yet lie in", "-wal"]);
}

#[test]
fn missing_tables_and_columns() {
    DataSet::log_with("DROP TABLE scenario_tag")
        .assert_error_has(&["no table scenario_tag; is it a nuPlan log?"]);
    DataSet::log_with("ALTER TABLE ego_pose DROP COLUMN acceleration_x")
        .assert_error_has(&["table ego_pose has no column acceleration_x"]);
}

#[test]
fn cells_that_cannot_be_used() {
    for (sql, parts) in [
        (
            "UPDATE scenario_tag SET type = hex(zeroblob(2049))",
            [
                "table scenario_tag, row ",
                "column type holds a text of 4098 bytes",
            ],
        ),
        (
            "UPDATE lidar_box SET x = NULL",
            ["table lidar_box, row ", "column x is NULL"],
        ),
        (
            "UPDATE lidar_box SET yaw = 9e999",
            ["column yaw holds inf", "expected a finite number"],
        ),
        (
            "UPDATE lidar_box SET width = 0",
            ["column width holds 0", "expected meters above 0"],
        ),
        (
            "UPDATE lidar_box SET length = 'long'",
            ["column length holds a text", "expected a number"],
        ),
        (
            "UPDATE lidar_box SET track_token = x'0102030405060708'",
            ["column track_token names 0102030405060708", "table track"],
        ),
        (
            "UPDATE track SET category_token = x'0102030405060708'",
            [
                "table track",
                "names 0102030405060708, which table category",
            ],
        ),
        (
            "UPDATE category SET name = 'boat'",
            ["table category", "column name holds 'boat'"],
        ),
        (
            "UPDATE ego_pose SET qw = 0, qx = 0, qy = 0, qz = 0",
            ["table ego_pose", "column qw holds 0"],
        ),
        (
            "UPDATE ego_pose SET vx = NULL",
            ["table ego_pose", "column vx is NULL"],
        ),
        (
            "UPDATE lidar_pc SET ego_pose_token = x'0102'",
            [
                "table lidar_pc",
                "column ego_pose_token holds a token of 2 bytes, expected 8",
            ],
        ),
        (
            "UPDATE lidar_pc SET ego_pose_token = x'0102030405060708'",
            [
                "table lidar_pc",
                "names 0102030405060708, which table ego_pose",
            ],
        ),
        (
            "UPDATE lidar_pc SET timestamp = 'now' WHERE token IN (SELECT lidar_pc_token FROM scenario_tag)",
            ["table lidar_pc", "column timestamp holds a text"],
        ),
        (
            "UPDATE traffic_light_status SET lane_connector_id = 'left'; INSERT INTO traffic_light_status SELECT randomblob(8), token, 'left', 'red' FROM lidar_pc",
            ["table traffic_light_status", "expected an id"],
        ),
    ] {
        DataSet::log_with(sql).assert_error_has(&parts);
    }
}

#[test]
fn routes_that_cannot_be_driven() {
    for (route, part) in [
        ("''", "its route is empty"),
        ("NULL", "its route is empty"),
        ("'12,34'", "its route holds '12,34'"),
        ("'None'", "its route holds 'None'"),
        (
            "'987654321'",
            "its route holds roadblock 987654321, which the map test-town",
        ),
    ] {
        DataSet::log_with(&format!("UPDATE scene SET roadblock_ids = {route}"))
            .assert_error_has(&["scenario ", ": scene ", part]);
    }
    DataSet::log_with("UPDATE log SET map_version = 'atlantis'")
        .assert_error_has(&["no map of 'atlantis'", LOCATION]);
}

#[test]
fn windows_that_the_log_does_not_hold() {
    // The window of a type outside the mapping starts at the tagged row.
    let short = DataSet::log_with(&format!(
        "DELETE FROM lidar_pc WHERE timestamp > {START} + 5500000; UPDATE scenario_tag SET type = 'unlisted'"
    ));
    short.assert_error_has(&["its window holds 2.", "at least 3 s are needed"]);
    DataSet::log_with(&format!("DELETE FROM lidar_pc WHERE timestamp < {START}"))
        .assert_error_has(&["its window begins at the first row of the log"]);
    DataSet::log_with("UPDATE lidar SET channel = 'TopLidar'")
        .assert_error_has(&["no row with channel `MergedPointCloud`"]);
    DataSet::log_with(&format!(
        "UPDATE lidar_pc SET timestamp = (SELECT MIN(timestamp) FROM lidar_pc WHERE timestamp >= {START}) \
         WHERE timestamp IN (SELECT timestamp FROM lidar_pc WHERE timestamp >= {START} ORDER BY timestamp LIMIT 2)"
    ))
    .assert_error_has(&["have the same timestamp"]);
}

#[test]
fn a_window_that_reaches_over_the_end_is_cut_as_the_devkit_cuts_it() {
    let set = DataSet::log_with(&format!(
        "DELETE FROM lidar_pc WHERE timestamp > {START} + 8000000"
    ));
    assert_eq!(set.open().unwrap().iterations(), 81);
}

#[test]
fn tokens_that_are_no_scenario_have_their_reason() {
    let set = DataSet::log_with(
        "DELETE FROM scene WHERE rowid NOT IN (SELECT rowid FROM scene ORDER BY name LIMIT 4)",
    );
    let filter = ScenarioFilter {
        scenario_tokens: Some(vec!["00000000000000aa".parse().unwrap(), set.token]),
        ..ScenarioFilter::default()
    };
    let findings = set.find(&filter).unwrap();
    assert_eq!(findings.scenarios, []);
    assert_eq!(findings.absent, ["00000000000000aa".parse().unwrap()]);
    assert_eq!(findings.excluded, [(set.token, Exclusion::SceneAtEdge)]);
    let refusal = |set: &DataSet, filter: ScenarioFilter| {
        let filter = ScenarioFilter {
            scenario_tokens: Some(vec![set.token]),
            ..filter
        };
        set.find(&filter).unwrap().excluded[0].1
    };
    let names = |name: &str| Some(vec![name.to_owned()]);
    let set = DataSet::log_with("UPDATE scene SET goal_ego_pose_token = NULL");
    assert_eq!(
        refusal(
            &set,
            ScenarioFilter {
                remove_invalid_goals: true,
                ..Default::default()
            }
        ),
        Exclusion::NoGoal
    );
    assert_eq!(
        refusal(
            &set,
            ScenarioFilter {
                map_names: names("other"),
                ..Default::default()
            }
        ),
        Exclusion::OtherMap
    );
    assert_eq!(
        refusal(
            &set,
            ScenarioFilter {
                log_names: names("other"),
                ..Default::default()
            }
        ),
        Exclusion::OtherLog
    );
    assert_eq!(
        refusal(
            &set,
            ScenarioFilter {
                scenario_types: names("other"),
                ..Default::default()
            }
        ),
        Exclusion::OtherType
    );
    let still = ScenarioFilter {
        ego_displacement_minimum_m: Some(1e6),
        ..Default::default()
    };
    assert_eq!(
        refusal(&set, still),
        Exclusion::Filtered("ego_displacement_minimum_m")
    );
    assert_eq!(set.open().unwrap().route.goal, None);
}

#[test]
fn one_token_in_two_logs() {
    let set = DataSet::new();
    std::fs::copy(&set.log, set.folder.path().join("data/other.db")).unwrap();
    set.assert_error_has(&["is in two logs", "other.db"]);
}

#[test]
fn a_token_that_is_not_in_the_log() {
    let set = DataSet::new();
    let mut found = set.found().unwrap();
    found.token = "00000000000000aa".parse().unwrap();
    match planagent_scenario::nuplan::open(&set.maps(), &found) {
        Err(NuPlanError::Scenario {
            fault: ScenarioFault::NotInLog,
            ..
        }) => {}
        other => panic!("{other:?}"),
    }
}
