//! The rows of a log that make up a scenario.

use super::database::Database;
use super::error::{NuPlanError, ScenarioFault};
use super::extraction::{Extraction, ROWS_PER_STEP};
use super::schema::{CHANNEL, LIDAR, LIDAR_PC};
use super::search::LogScenario;
use super::token::Token;
use crate::scenario::FUTURE_FRAMES;
use crate::world::{HISTORY_SAMPLES, MICROS_PER_SECOND};

/// A scenario spans at least this, s; a shorter one is over before the look-ahead of the metrics ends.
const MIN_DURATION_S: f64 = 3.0;

/// Rows that belong to the sensor of the scenarios.
const OF_SENSOR: &str = "lidar_token IN (SELECT token FROM lidar WHERE channel = 'MergedPointCloud')";

/// A row of `lidar_pc`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Sweep {
    pub(super) token: Token,
    pub(super) time_us: i64,
    pub(super) ego_pose: Token,
}

/// The rows of a scenario, 20 Hz, in order of time.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Rows {
    /// Those of the window; the first is iteration 0.
    pub(super) window: Vec<Sweep>,
    /// Those that the history is sampled from: every second one back from iteration 0, oldest first.
    pub(super) past: Vec<Sweep>,
    /// Every second row after the last iteration, eight seconds at most.
    pub(super) future: Vec<Sweep>,
}

impl Rows {
    /// Reads the rows of a scenario. Where the log ends within the window, so does the scenario, as the devkit has it.
    pub(super) fn read(database: &Database, found: &LogScenario) -> Result<Self, NuPlanError> {
        let failed = |fault| NuPlanError::Scenario { path: database.path.clone(), token: found.token, fault };
        let (start, end) = Extraction::of(&found.scenario_type).window(found.timestamp_us);
        let mut window = Vec::new();
        let inside =
            format!("WHERE timestamp >= ?1 AND timestamp <= ?2 AND {OF_SENSOR} ORDER BY timestamp, lidar_pc.rowid");
        read(database, &inside, (start, end), &mut window)?;
        let (Some(first), Some(last)) = (window.first().copied(), window.last().copied()) else {
            let sensor = database.first(LIDAR, "WHERE channel = ?1", [CHANNEL], |_| Ok(()))?;
            let fault = match sensor {
                Some(()) => ScenarioFault::TooShort { seconds: 0.0, needed: MIN_DURATION_S },
                None => ScenarioFault::NoSensor,
            };
            return Err(failed(fault));
        };
        let seconds = (last.time_us - first.time_us) as f64 / MICROS_PER_SECOND;
        if seconds < MIN_DURATION_S {
            return Err(failed(ScenarioFault::TooShort { seconds, needed: MIN_DURATION_S }));
        }
        let mut before = Vec::new();
        let earlier =
            format!("WHERE timestamp < ?1 AND {OF_SENSOR} ORDER BY timestamp DESC, lidar_pc.rowid DESC LIMIT ?2");
        let limit = (ROWS_PER_STEP * HISTORY_SAMPLES) as i64;
        read(database, &earlier, (first.time_us, limit), &mut before)?;
        let mut past: Vec<Sweep> = before.into_iter().skip(ROWS_PER_STEP - 1).step_by(ROWS_PER_STEP).collect();
        past.reverse();
        if past.is_empty() {
            return Err(failed(ScenarioFault::NoHistory));
        }
        if let Some(pair) = window.windows(2).find(|pair| pair[0].time_us == pair[1].time_us) {
            let (before, after, time_us) = (pair[0].token, pair[1].token, pair[0].time_us);
            return Err(failed(ScenarioFault::SameTime { before, after, time_us }));
        }
        let mut after = Vec::new();
        let last = window.iter().step_by(ROWS_PER_STEP).next_back().map_or(last.time_us, |row| row.time_us);
        let later = format!("WHERE timestamp > ?1 AND {OF_SENSOR} ORDER BY timestamp, lidar_pc.rowid LIMIT ?2");
        let limit = (ROWS_PER_STEP * FUTURE_FRAMES) as i64;
        read(database, &later, (last, limit), &mut after)?;
        after.dedup_by_key(|sweep| sweep.time_us);
        let future = after.into_iter().skip(ROWS_PER_STEP - 1).step_by(ROWS_PER_STEP).collect();
        Ok(Self { window, past, future })
    }

    /// First and last time of all rows, µs.
    pub(super) fn times(&self) -> (i64, i64) {
        let first = self.past.first().or(self.window.first()).map_or(0, |row| row.time_us);
        (first, self.window.last().map_or(0, |row| row.time_us))
    }

    /// The rows of the iterations.
    pub(super) fn iterations(&self) -> impl Iterator<Item = &Sweep> {
        self.window.iter().step_by(ROWS_PER_STEP)
    }
}

fn read(database: &Database, rest: &str, params: (i64, i64), sweeps: &mut Vec<Sweep>) -> Result<(), NuPlanError> {
    database.each(LIDAR_PC, rest, params, |record| {
        sweeps.push(Sweep {
            token: record.token("token")?,
            time_us: record.integer("timestamp")?,
            ego_pose: record.token("ego_pose_token")?,
        });
        Ok(())
    })
}
