//! The tables of a log database, as the devkit's queries and its own minimal database have them.

/// All tables, the camera's empty ones included, with the indices that make queries quick.
pub(super) const TABLES: &str = "
CREATE TABLE log (
    token BLOB NOT NULL PRIMARY KEY,
    vehicle_name VARCHAR(64),
    date VARCHAR(64),
    timestamp INTEGER,
    logfile VARCHAR(64),
    location VARCHAR(64),
    map_version VARCHAR(64)
);
CREATE TABLE ego_pose (
    token BLOB NOT NULL PRIMARY KEY,
    timestamp INTEGER,
    x FLOAT, y FLOAT, z FLOAT,
    qw FLOAT, qx FLOAT, qy FLOAT, qz FLOAT,
    vx FLOAT, vy FLOAT, vz FLOAT,
    acceleration_x FLOAT, acceleration_y FLOAT, acceleration_z FLOAT,
    angular_rate_x FLOAT, angular_rate_y FLOAT, angular_rate_z FLOAT,
    epsg INTEGER,
    log_token BLOB NOT NULL
);
CREATE TABLE lidar (
    token BLOB NOT NULL PRIMARY KEY,
    log_token BLOB NOT NULL,
    channel VARCHAR(64),
    model VARCHAR(64),
    translation BLOB,
    rotation BLOB
);
CREATE TABLE lidar_pc (
    token BLOB NOT NULL PRIMARY KEY,
    next_token BLOB,
    prev_token BLOB,
    ego_pose_token BLOB NOT NULL,
    lidar_token BLOB NOT NULL,
    scene_token BLOB,
    filename VARCHAR(128),
    timestamp INTEGER
);
CREATE TABLE lidar_box (
    token BLOB NOT NULL PRIMARY KEY,
    lidar_pc_token BLOB NOT NULL,
    track_token BLOB NOT NULL,
    next_token BLOB,
    prev_token BLOB,
    x FLOAT, y FLOAT, z FLOAT,
    width FLOAT, length FLOAT, height FLOAT,
    vx FLOAT, vy FLOAT, vz FLOAT,
    yaw FLOAT,
    confidence FLOAT
);
CREATE TABLE track (
    token BLOB NOT NULL PRIMARY KEY,
    category_token BLOB NOT NULL,
    width FLOAT, length FLOAT, height FLOAT
);
CREATE TABLE category (
    token BLOB NOT NULL PRIMARY KEY,
    name VARCHAR(64),
    description TEXT
);
CREATE TABLE scene (
    token BLOB NOT NULL PRIMARY KEY,
    log_token BLOB NOT NULL,
    name TEXT,
    goal_ego_pose_token BLOB,
    roadblock_ids TEXT
);
CREATE TABLE scenario_tag (
    token BLOB NOT NULL PRIMARY KEY,
    lidar_pc_token BLOB NOT NULL,
    type TEXT,
    agent_track_token BLOB
);
CREATE TABLE traffic_light_status (
    token BLOB NOT NULL PRIMARY KEY,
    lidar_pc_token BLOB NOT NULL,
    lane_connector_id INTEGER,
    status VARCHAR(8)
);
CREATE TABLE camera (
    token BLOB NOT NULL PRIMARY KEY,
    log_token BLOB NOT NULL,
    channel VARCHAR(64),
    model VARCHAR(64),
    translation BLOB,
    rotation BLOB,
    intrinsic BLOB,
    distortion BLOB,
    width INTEGER,
    height INTEGER
);
CREATE TABLE image (
    token BLOB NOT NULL PRIMARY KEY,
    next_token BLOB,
    prev_token BLOB,
    ego_pose_token BLOB NOT NULL,
    camera_token BLOB NOT NULL,
    filename_jpg VARCHAR(128),
    timestamp INTEGER
);
CREATE INDEX lidar_pc_timestamp ON lidar_pc (timestamp);
CREATE INDEX lidar_box_lidar_pc ON lidar_box (lidar_pc_token);
CREATE INDEX lidar_box_track ON lidar_box (track_token);
CREATE INDEX scenario_tag_lidar_pc ON scenario_tag (lidar_pc_token);
CREATE INDEX traffic_light_status_lidar_pc ON traffic_light_status (lidar_pc_token);
";

/// Inserts a log.
pub(super) const LOG: &str = "INSERT INTO log (token, vehicle_name, date, timestamp, logfile, location, map_version) \
    VALUES (?, ?, ?, ?, ?, ?, ?)";
/// Inserts the lidar.
pub(super) const LIDAR: &str =
    "INSERT INTO lidar (token, log_token, channel, model, translation, rotation) VALUES (?, ?, ?, ?, ?, ?)";
/// Inserts a category.
pub(super) const CATEGORY: &str = "INSERT INTO category (token, name, description) VALUES (?, ?, ?)";
/// Inserts a scene.
pub(super) const SCENE: &str =
    "INSERT INTO scene (token, log_token, name, goal_ego_pose_token, roadblock_ids) VALUES (?, ?, ?, ?, ?)";
/// Inserts a track.
pub(super) const TRACK: &str =
    "INSERT INTO track (token, category_token, width, length, height) VALUES (?, ?, ?, ?, ?)";
/// Inserts an ego pose.
pub(super) const EGO_POSE: &str = "INSERT INTO ego_pose (token, timestamp, x, y, z, qw, qx, qy, qz, vx, vy, vz, \
    acceleration_x, acceleration_y, acceleration_z, angular_rate_x, angular_rate_y, angular_rate_z, epsg, log_token) \
    VALUES (?, ?, ?, ?, 0.0, ?, 0.0, 0.0, ?, ?, ?, 0.0, ?, ?, 0.0, 0.0, 0.0, ?, ?, ?)";
/// Inserts a row of the timeline.
pub(super) const LIDAR_PC: &str = "INSERT INTO lidar_pc (token, next_token, prev_token, ego_pose_token, lidar_token, \
    scene_token, filename, timestamp) VALUES (?, ?, ?, ?, ?, ?, ?, ?)";
/// Inserts a box.
pub(super) const LIDAR_BOX: &str = "INSERT INTO lidar_box (token, lidar_pc_token, track_token, next_token, prev_token, \
    x, y, z, width, length, height, vx, vy, vz, yaw, confidence) VALUES (?, ?, ?, NULL, NULL, ?, ?, ?, ?, ?, ?, ?, ?, 0.0, ?, 1.0)";
/// Inserts a light.
pub(super) const LIGHT: &str =
    "INSERT INTO traffic_light_status (token, lidar_pc_token, lane_connector_id, status) VALUES (?, ?, ?, ?)";
/// Inserts a tag.
pub(super) const TAG: &str =
    "INSERT INTO scenario_tag (token, lidar_pc_token, type, agent_track_token) VALUES (?, ?, ?, NULL)";
