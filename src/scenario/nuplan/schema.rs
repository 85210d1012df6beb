//! The tables of a log and the columns that are read from them.

use super::database::{Database, Table};
use super::error::NuPlanError;
use super::logs::Log;

/// The channel whose rows make up scenarios.
pub(super) const CHANNEL: &str = "MergedPointCloud";

pub(super) const LOG: Table = Table { name: "log", columns: &["token", "map_version"] };
pub(super) const LIDAR: Table = Table { name: "lidar", columns: &["token", "log_token", "channel"] };
pub(super) const LIDAR_PC: Table =
    Table { name: "lidar_pc", columns: &["token", "ego_pose_token", "lidar_token", "scene_token", "timestamp"] };
pub(super) const EGO_POSE: Table = Table {
    name: "ego_pose",
    columns: &["token", "x", "y", "qw", "qx", "qy", "qz", "vx", "vy", "acceleration_x", "acceleration_y"],
};
pub(super) const LIDAR_BOX: Table = Table {
    name: "lidar_box",
    columns: &["token", "lidar_pc_token", "track_token", "x", "y", "width", "length", "vx", "vy", "yaw"],
};
pub(super) const TRACK: Table = Table { name: "track", columns: &["token", "category_token"] };
pub(super) const CATEGORY: Table = Table { name: "category", columns: &["token", "name"] };
pub(super) const SCENE: Table =
    Table { name: "scene", columns: &["token", "name", "goal_ego_pose_token", "roadblock_ids"] };
pub(super) const SCENARIO_TAG: Table = Table { name: "scenario_tag", columns: &["token", "lidar_pc_token", "type"] };
pub(super) const TRAFFIC_LIGHT_STATUS: Table =
    Table { name: "traffic_light_status", columns: &["token", "lidar_pc_token", "lane_connector_id", "status"] };

const ALL: [Table; 10] =
    [LOG, LIDAR, LIDAR_PC, EGO_POSE, LIDAR_BOX, TRACK, CATEGORY, SCENE, SCENARIO_TAG, TRAFFIC_LIGHT_STATUS];

/// Opens a log and checks that it has every table and column that nuPlan's queries read.
pub(super) fn open_log(log: &Log) -> Result<Database, NuPlanError> {
    let database = Database::open(&log.path)?;
    for table in ALL {
        database.require(table, "a nuPlan log")?;
    }
    Ok(database)
}
