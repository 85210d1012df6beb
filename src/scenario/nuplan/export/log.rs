//! The log database of one scenario.

use super::naming::Tokens;
use super::timeline::{Row, Timeline};
use crate::Scenario;
use crate::nuplan::schema::{
    CATEGORY, CHANNEL, EGO_POSE, LIDAR, LIDAR_BOX, LIDAR_PC, LOG, LOG_INDICES, LOG_TABLES,
    SCENARIO_TAG, SCENE, TRACK, TRAFFIC_LIGHT_STATUS,
};
use crate::nuplan::token::{TOKEN_BYTES, Token};
use jiff::Timestamp;
use planagent_world::geometry::{Point, Pose};
use planagent_world::{EgoState, LaneId, MICROS_PER_SECOND, ObjectKind, TrackToken, TrackedObject};
use rusqlite::types::Null;
use rusqlite::{Connection, Transaction, params};
use std::collections::BTreeMap;
use std::path::Path;

/// Python pickle (protocol 0) of `[0.0, 0.0, 0.0]`: the lidar sits at the ego's origin.
const NO_TRANSLATION: &[u8] = b"(lp0\nF0.0\naF0.0\naF0.0\na.";
/// Python pickle (protocol 0) of `[1.0, 0.0, 0.0, 0.0]`: a quaternion without rotation.
const NO_ROTATION: &[u8] = b"(lp0\nF1.0\naF0.0\naF0.0\naF0.0\na.";
/// Written where a row has no neighbor: the devkit fails on NULL there (`lidar_pc.py`,
/// `from_db_row`).
const NO_TOKEN: Token = Token::new([0; TOKEN_BYTES]);
/// Categories in the order of the devkit's enumeration, with nominal heights, m, which nothing
/// reads.
const CATEGORIES: [(ObjectKind, f64); 7] = [
    (ObjectKind::Vehicle, 1.7),
    (ObjectKind::Pedestrian, 1.7),
    (ObjectKind::Bicycle, 1.7),
    (ObjectKind::TrafficCone, 0.7),
    (ObjectKind::Barrier, 1.0),
    (ObjectKind::CzoneSign, 1.5),
    (ObjectKind::GenericObject, 1.0),
];
/// Names of the scenes, in order of time. The devkit takes scenarios only from scenes with two
/// scenes on either side.
const SCENES: [&str; 5] = [
    "scene-000",
    "scene-001",
    "scene-002",
    "scene-003",
    "scene-004",
];
/// The scene of the tagged row alone, so that a log gives one scenario.
const ANCHOR_SCENE: usize = 2;

/// The contents of a log besides its rows.
#[derive(Debug, Clone)]
pub(super) struct LogHeader<'a> {
    /// Name of the log: the stem of its file.
    pub(super) log: &'a str,
    pub(super) location: &'a str,
    pub(super) epsg: u32,
    /// Easting and northing of the scenario's origin, m.
    pub(super) origin: Point,
    /// Fids of the lane connectors by lane.
    pub(super) connectors: &'a BTreeMap<LaneId, Vec<i64>>,
    /// Fids of the roadblocks of the route.
    pub(super) route: &'a [i64],
}

/// Token of the tagged row, which names the scenario.
pub(super) fn anchor_token(log: &str, timeline: &Timeline) -> Token {
    Tokens::new(log).token("lidar_pc", timeline.anchor as u64)
}

/// Writes a new database.
pub(super) fn write_log(
    path: &Path,
    facts: &LogHeader<'_>,
    scenario: &Scenario,
    timeline: &Timeline,
) -> rusqlite::Result<()> {
    let mut connection = Connection::open(path)?;
    // No journal: the file lies in a folder that only a whole export makes visible.
    connection.execute_batch("PRAGMA journal_mode = OFF; PRAGMA synchronous = OFF;")?;
    let transaction = connection.transaction()?;
    for table in LOG_TABLES {
        transaction.execute(&table.created(), [])?;
    }
    for (table, column) in LOG_INDICES {
        transaction.execute(
            &format!("CREATE INDEX {table}_{column} ON {table} ({column})"),
            [],
        )?;
    }
    let writer = Writer {
        transaction: &transaction,
        facts,
        tokens: Tokens::new(facts.log),
        timeline,
    };
    writer.write_header(scenario)?;
    writer.write_tracks()?;
    let mut boxes = 0;
    for (number, row) in timeline.rows.iter().enumerate() {
        writer.write_row(number, row, &mut boxes)?;
    }
    let anchor = anchor_token(facts.log, timeline);
    transaction.execute(
        &SCENARIO_TAG.insert(),
        params![
            writer.tokens.token("scenario_tag", 0),
            anchor,
            scenario.scenario_type,
            Null
        ],
    )?;
    transaction.commit()?;
    connection.close().map_err(|(_, error)| error)
}

struct Writer<'a> {
    transaction: &'a Transaction<'a>,
    facts: &'a LogHeader<'a>,
    tokens: Tokens<'a>,
    timeline: &'a Timeline,
}

impl Writer<'_> {
    /// Writes log, lidar, categories, scenes and goal.
    fn write_header(&self, scenario: &Scenario) -> rusqlite::Result<()> {
        let log = self.tokens.token("log", 0);
        let first_us = self
            .timeline
            .rows
            .first()
            .expect("a timeline has its anchor")
            .ego
            .time_us;
        self.transaction.execute(
            &LOG.insert(),
            params![
                log,
                "planagent",
                date(first_us),
                first_us,
                self.facts.log,
                self.facts.location,
                self.facts.location
            ],
        )?;
        let lidar = self.tokens.token("lidar", 0);
        self.transaction.execute(
            &LIDAR.insert(),
            params![lidar, log, CHANNEL, "none", NO_TRANSLATION, NO_ROTATION],
        )?;
        for (kind, _) in CATEGORIES {
            self.transaction.execute(
                &CATEGORY.insert(),
                params![self.category(kind), kind.to_string(), ""],
            )?;
        }
        // Every scene gets the goal and the route, because nuPlan reads those of the row's own
        // scene.
        let goal = scenario
            .route
            .goal
            .map(|goal| self.write_goal(goal))
            .transpose()?;
        let route: Vec<String> = self.facts.route.iter().map(ToString::to_string).collect();
        for (number, name) in SCENES.into_iter().enumerate() {
            let token = self.tokens.token("scene", number as u64);
            self.transaction.execute(
                &SCENE.insert(),
                params![token, log, name, goal, route.join(" ")],
            )?;
        }
        Ok(())
    }

    /// Writes the goal as an ego pose after the last row; no row uses it.
    fn write_goal(&self, goal: Pose) -> rusqlite::Result<Token> {
        let after_us = self
            .timeline
            .rows
            .last()
            .expect("a timeline has its anchor")
            .ego
            .time_us
            + MICROS_PER_SECOND as i64;
        let state = EgoState::from_log(
            after_us,
            goal,
            planagent_world::geometry::Vector::zeros(),
            planagent_world::geometry::Vector::zeros(),
        );
        self.write_ego(self.timeline.rows.len(), &state)
    }

    /// Writes a track for each object, in order of tracks, with the size of its first box.
    fn write_tracks(&self) -> rusqlite::Result<()> {
        let mut first: BTreeMap<TrackToken, &TrackedObject> = BTreeMap::new();
        for object in self.timeline.rows.iter().flat_map(|row| row.objects.iter()) {
            first.entry(object.token).or_insert(object);
        }
        let mut insert = self.transaction.prepare_cached(&TRACK.insert())?;
        for (track, object) in first {
            let shape = object.shape;
            let (token, category) = (self.track(track), self.category(object.kind));
            insert.execute(params![
                token,
                category,
                shape.width,
                shape.length,
                height(object.kind)
            ])?;
        }
        Ok(())
    }

    /// Writes a row with its ego, boxes and lights; `boxes` counts the boxes of the log.
    fn write_row(&self, number: usize, row: &Row, boxes: &mut u64) -> rusqlite::Result<()> {
        let time = |number: usize| self.tokens.token("lidar_pc", number as u64);
        let token = time(number);
        let ego = self.write_ego(number, &row.ego)?;
        let next = if number + 1 < self.timeline.rows.len() {
            time(number + 1)
        } else {
            NO_TOKEN
        };
        let previous = number.checked_sub(1).map_or(NO_TOKEN, time);
        let scene = self.tokens.token("scene", self.scene_of(number) as u64);
        let file = format!("{}/{CHANNEL}/{token}.pcd", self.facts.log);
        let lidar = self.tokens.token("lidar", 0);
        let mut insert = self.transaction.prepare_cached(&LIDAR_PC.insert())?;
        insert.execute(params![
            token,
            next,
            previous,
            ego,
            lidar,
            scene,
            file,
            row.ego.time_us
        ])?;
        let mut insert = self.transaction.prepare_cached(&LIDAR_BOX.insert())?;
        for object in row.objects.iter() {
            let own = self.tokens.token("lidar_box", *boxes);
            *boxes += 1;
            let (shape, at) = (object.shape, self.projected(object.shape.center));
            let (tall, velocity) = (height(object.kind), object.velocity);
            let (track, yaw) = (self.track(object.token), shape.center.heading);
            let (length, width, z) = (shape.length, shape.width, tall / 2.0);
            insert.execute(params![
                own, token, track, Null, Null, at.x, at.y, z, width, length, tall, velocity.x,
                velocity.y, 0.0, yaw, 1.0
            ])?;
        }
        let mut insert = self
            .transaction
            .prepare_cached(&TRAFFIC_LIGHT_STATUS.insert())?;
        // One lane may have become several connectors; nuPlan looks a light up by connector.
        let lights = row.lights.iter().flat_map(|(lane, status)| {
            self.facts
                .connectors
                .get(&lane)
                .into_iter()
                .flatten()
                .map(move |&connector| (connector, status))
        });
        for (connector, status) in lights {
            let own = self
                .tokens
                .token(&format!("traffic_light_status/{number}"), connector as u64);
            insert.execute(params![own, token, connector, status.to_string()])?;
        }
        Ok(())
    }

    fn write_ego(&self, number: usize, ego: &EgoState) -> rusqlite::Result<Token> {
        let token = self.tokens.token("ego_pose", number as u64);
        let at = self.projected(ego.rear_axle);
        let (sin, cos) = (ego.rear_axle.heading / 2.0).sin_cos();
        let mut insert = self.transaction.prepare_cached(&EGO_POSE.insert())?;
        let (v, a, yaw_rate) = (ego.velocity, ego.acceleration, ego.angular_velocity);
        let log = self.tokens.token("log", 0);
        // nuPlan's planar state needs yaw only, so roll, pitch and height are 0.
        insert.execute(params![
            token,
            ego.time_us,
            at.x,
            at.y,
            0.0,
            cos,
            0.0,
            0.0,
            sin,
            v.x,
            v.y,
            0.0,
            a.x,
            a.y,
            0.0,
            0.0,
            0.0,
            yaw_rate,
            self.facts.epsg,
            log
        ])?;
        Ok(token)
    }

    /// The scene of a row: before, at or after the tagged row. The first row is the first scene;
    /// the row of the last frame and all after it are the last.
    fn scene_of(&self, number: usize) -> usize {
        let last = self.timeline.scenario_rows - 1;
        match number.cmp(&self.timeline.anchor) {
            std::cmp::Ordering::Equal => ANCHOR_SCENE,
            std::cmp::Ordering::Less => usize::from(number > 0),
            std::cmp::Ordering::Greater => ANCHOR_SCENE + if number < last { 1 } else { 2 },
        }
    }

    fn projected(&self, pose: Pose) -> Point {
        pose.position() + self.facts.origin.coords
    }

    fn track(&self, track: TrackToken) -> Token {
        self.tokens.token("track", u64::from(track.0))
    }

    fn category(&self, kind: ObjectKind) -> Token {
        self.tokens.token(&format!("category/{kind}"), 0)
    }
}

fn height(kind: ObjectKind) -> f64 {
    CATEGORIES
        .iter()
        .find(|(listed, _)| *listed == kind)
        .expect("CATEGORIES lists every kind")
        .1
}

/// The day of a Unix time, `YYYY-MM-DD`.
fn date(time_us: i64) -> String {
    Timestamp::from_microsecond(time_us)
        .map_or_else(|_| String::new(), |time| time.strftime("%F").to_string())
}
