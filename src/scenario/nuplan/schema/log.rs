//! The tables of a log, as the devkit's queries and its own minimal database have them.

use super::Table;

/// The channel whose rows make up scenarios.
pub(in super::super) const CHANNEL: &str = "MergedPointCloud";

pub(in super::super) const LOG: Table = Table::new(
    "log",
    "*token BLOB NOT NULL PRIMARY KEY, vehicle_name VARCHAR(64), date VARCHAR(64), timestamp INTEGER, logfile VARCHAR(64),
    location VARCHAR(64), *map_version VARCHAR(64)",
);
pub(in super::super) const EGO_POSE: Table = Table::new(
    "ego_pose",
    "*token BLOB NOT NULL PRIMARY KEY, timestamp INTEGER, *x FLOAT, *y FLOAT, z FLOAT,
    *qw FLOAT, *qx FLOAT, *qy FLOAT, *qz FLOAT, *vx FLOAT, *vy FLOAT, vz FLOAT,
    *acceleration_x FLOAT, *acceleration_y FLOAT, acceleration_z FLOAT,
    angular_rate_x FLOAT, angular_rate_y FLOAT, angular_rate_z FLOAT, epsg INTEGER, log_token BLOB NOT NULL",
);
pub(in super::super) const LIDAR: Table = Table::new(
    "lidar",
    "*token BLOB NOT NULL PRIMARY KEY, *log_token BLOB NOT NULL, *channel VARCHAR(64), model VARCHAR(64),
    translation BLOB, rotation BLOB",
);
pub(in super::super) const LIDAR_PC: Table = Table::new(
    "lidar_pc",
    "*token BLOB NOT NULL PRIMARY KEY, next_token BLOB, prev_token BLOB, *ego_pose_token BLOB NOT NULL,
    *lidar_token BLOB NOT NULL, *scene_token BLOB, filename VARCHAR(128), *timestamp INTEGER",
);
pub(in super::super) const LIDAR_BOX: Table = Table::new(
    "lidar_box",
    "*token BLOB NOT NULL PRIMARY KEY, *lidar_pc_token BLOB NOT NULL, *track_token BLOB NOT NULL, next_token BLOB,
    prev_token BLOB, *x FLOAT, *y FLOAT, z FLOAT, *width FLOAT, *length FLOAT, height FLOAT, *vx FLOAT, *vy FLOAT, vz FLOAT,
    *yaw FLOAT, confidence FLOAT",
);
pub(in super::super) const TRACK: Table = Table::new(
    "track",
    "*token BLOB NOT NULL PRIMARY KEY, *category_token BLOB NOT NULL, width FLOAT, length FLOAT, height FLOAT",
);
pub(in super::super) const CATEGORY: Table = Table::new(
    "category",
    "*token BLOB NOT NULL PRIMARY KEY, *name VARCHAR(64), description TEXT",
);
pub(in super::super) const SCENE: Table = Table::new(
    "scene",
    "*token BLOB NOT NULL PRIMARY KEY, log_token BLOB NOT NULL, *name TEXT, *goal_ego_pose_token BLOB, *roadblock_ids TEXT",
);
pub(in super::super) const SCENARIO_TAG: Table = Table::new(
    "scenario_tag",
    "*token BLOB NOT NULL PRIMARY KEY, *lidar_pc_token BLOB NOT NULL, *type TEXT, agent_track_token BLOB",
);
pub(in super::super) const TRAFFIC_LIGHT_STATUS: Table = Table::new(
    "traffic_light_status",
    "*token BLOB NOT NULL PRIMARY KEY, *lidar_pc_token BLOB NOT NULL, *lane_connector_id INTEGER, *status VARCHAR(8)",
);
const CAMERA: Table = Table::new(
    "camera",
    "token BLOB NOT NULL PRIMARY KEY, log_token BLOB NOT NULL, channel VARCHAR(64), model VARCHAR(64), translation BLOB,
    rotation BLOB, intrinsic BLOB, distortion BLOB, width INTEGER, height INTEGER",
);
const IMAGE: Table = Table::new(
    "image",
    "token BLOB NOT NULL PRIMARY KEY, next_token BLOB, prev_token BLOB, ego_pose_token BLOB NOT NULL,
    camera_token BLOB NOT NULL, filename_jpg VARCHAR(128), timestamp INTEGER",
);

/// All tables; those of the camera are written empty and not read.
pub(in super::super) const LOG_TABLES: [Table; 12] = [
    LOG,
    EGO_POSE,
    LIDAR,
    LIDAR_PC,
    LIDAR_BOX,
    TRACK,
    CATEGORY,
    SCENE,
    SCENARIO_TAG,
    TRAFFIC_LIGHT_STATUS,
    CAMERA,
    IMAGE,
];

/// Tables and columns of the indices that a written log has.
pub(in super::super) const LOG_INDICES: [(&str, &str); 5] = [
    ("lidar_pc", "timestamp"),
    ("lidar_box", "lidar_pc_token"),
    ("lidar_box", "track_token"),
    ("scenario_tag", "lidar_pc_token"),
    ("traffic_light_status", "lidar_pc_token"),
];
