//! The rows of a log that make up a scenario.

use super::database::{Database, Record};
use super::error::{CellFault, NuPlanError, ScenarioFault};
use super::extraction::{Extraction, ROWS_PER_STEP};
use super::logs::LogScenario;
use super::schema::{CHANNEL, LIDAR, LIDAR_PC};
use super::token::Token;
use crate::FUTURE_FRAMES;
use planagent_world::geometry::{Pose, Vector};
use planagent_world::{EgoState, HISTORY_SAMPLES, MICROS_PER_SECOND};

/// Shorter scenarios end before the look-ahead of the metrics, s.
const MIN_DURATION_S: f64 = 3.0;

/// Condition: the row belongs to the sensor of the scenarios.
const OF_SENSOR: &str =
    "lidar_token IN (SELECT token FROM lidar WHERE channel = 'MergedPointCloud')";

/// A row of `lidar_pc`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Sweep {
    pub(super) token: Token,
    pub(super) time_us: i64,
    pub(super) ego_pose: Token,
}

/// The rows of a scenario at 20 Hz, in order of time.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Rows {
    /// The window; its first row is iteration 0.
    pub(super) window: Vec<Sweep>,
    /// The rows of the history: every second row before iteration 0, oldest first.
    pub(super) past: Vec<Sweep>,
    /// Every second row after the last iteration, up to eight seconds.
    pub(super) future: Vec<Sweep>,
}

impl Rows {
    /// Reads the rows of a scenario. A log that ends within the window ends the scenario, as in the
    /// devkit.
    pub(super) fn read(database: &Database, found: &LogScenario) -> Result<Self, NuPlanError> {
        let failed = |fault| NuPlanError::Scenario {
            path: database.path.clone(),
            token: found.token,
            fault,
        };
        let (start, end) = Extraction::for_type(&found.scenario_type).window(found.timestamp_us);
        let mut window = Vec::new();
        let inside = format!(
            "WHERE timestamp >= ?1 AND timestamp <= ?2 AND {OF_SENSOR} ORDER BY timestamp, lidar_pc.rowid"
        );
        read(database, &inside, (start, end), &mut window)?;
        let (Some(first), Some(last)) = (window.first().copied(), window.last().copied()) else {
            let sensor = database.first(LIDAR, "WHERE channel = ?1", [CHANNEL], |_| Ok(()))?;
            let fault = match sensor {
                Some(()) => ScenarioFault::TooShort {
                    seconds: 0.0,
                    needed: MIN_DURATION_S,
                },
                None => ScenarioFault::NoSensor,
            };
            return Err(failed(fault));
        };
        let seconds = (last.time_us - first.time_us) as f64 / MICROS_PER_SECOND;
        if seconds < MIN_DURATION_S {
            return Err(failed(ScenarioFault::TooShort {
                seconds,
                needed: MIN_DURATION_S,
            }));
        }
        let mut before = Vec::new();
        let earlier = format!(
            "WHERE timestamp < ?1 AND {OF_SENSOR} ORDER BY timestamp DESC, lidar_pc.rowid DESC LIMIT ?2"
        );
        let limit = (ROWS_PER_STEP * HISTORY_SAMPLES) as i64;
        read(database, &earlier, (first.time_us, limit), &mut before)?;
        let mut past: Vec<Sweep> = before
            .into_iter()
            .skip(ROWS_PER_STEP - 1)
            .step_by(ROWS_PER_STEP)
            .collect();
        past.reverse();
        if past.is_empty() {
            return Err(failed(ScenarioFault::NoHistory));
        }
        // Speeds are differences over the time between two rows.
        if let Some(pair) = window
            .windows(2)
            .find(|pair| pair[0].time_us == pair[1].time_us)
        {
            let (before, after, time_us) = (pair[0].token, pair[1].token, pair[0].time_us);
            return Err(failed(ScenarioFault::SameTime {
                before,
                after,
                time_us,
            }));
        }
        let mut after = Vec::new();
        let last = window
            .iter()
            .step_by(ROWS_PER_STEP)
            .next_back()
            .map_or(last.time_us, |row| row.time_us);
        let later = format!(
            "WHERE timestamp > ?1 AND {OF_SENSOR} ORDER BY timestamp, lidar_pc.rowid LIMIT ?2"
        );
        let limit = (ROWS_PER_STEP * FUTURE_FRAMES) as i64;
        read(database, &later, (last, limit), &mut after)?;
        after.dedup_by_key(|sweep| sweep.time_us);
        let future = after
            .into_iter()
            .skip(ROWS_PER_STEP - 1)
            .step_by(ROWS_PER_STEP)
            .collect();
        Ok(Self {
            window,
            past,
            future,
        })
    }

    /// First and last time of all rows, µs.
    pub(super) fn times(&self) -> (i64, i64) {
        let first = self
            .past
            .first()
            .or(self.window.first())
            .expect("a window has rows on both ends")
            .time_us;
        (
            first,
            self.window
                .last()
                .expect("a window has rows on both ends")
                .time_us,
        )
    }

    /// The rows of the iterations.
    pub(super) fn iterations(&self) -> impl Iterator<Item = &Sweep> {
        self.window.iter().step_by(ROWS_PER_STEP)
    }
}

fn read(
    database: &Database,
    rest: &str,
    params: (i64, i64),
    sweeps: &mut Vec<Sweep>,
) -> Result<(), NuPlanError> {
    database.each(LIDAR_PC, rest, params, |record| {
        sweeps.push(Sweep {
            token: record.token("token")?,
            time_us: record.integer("timestamp")?,
            ego_pose: record.token("ego_pose_token")?,
        });
        Ok(())
    })
}

/// The pose of an `ego_pose` row in the projection of the map.
pub(super) fn pose_of(record: &Record<'_>) -> Result<Pose, NuPlanError> {
    let q = [
        record.float("qw")?,
        record.float("qx")?,
        record.float("qy")?,
        record.float("qz")?,
    ];
    let heading = yaw(q).ok_or_else(|| {
        record.fault(
            "qw",
            CellFault::Number {
                got: q[0],
                expected: "the first part of a rotation that is not zero",
            },
        )
    })?;
    Ok(Pose::new(record.float("x")?, record.float("y")?, heading))
}

/// Yaw of a quaternion (w, x, y, z) as in pyquaternion's `yaw_pitch_roll`, which the devkit uses:
/// intrinsic rotations about z, y and x. `None` when it is no rotation.
fn yaw(q: [f64; 4]) -> Option<f64> {
    let norm = q.iter().map(|c| c * c).sum::<f64>().sqrt();
    let [w, x, y, z] = q.map(|c| c / norm);
    let angle = (2.0 * (w * z - x * y)).atan2(1.0 - 2.0 * (y * y + z * z));
    (norm > 0.0 && norm.is_finite() && angle.is_finite()).then_some(angle)
}

/// The ego of an `ego_pose` row at the time of its sweep, in the projection of the map.
pub(super) fn ego_of(record: &Record<'_>, time_us: i64) -> Result<EgoState, NuPlanError> {
    let velocity = Vector::new(record.float("vx")?, record.float("vy")?);
    let acceleration = Vector::new(
        record.float("acceleration_x")?,
        record.float("acceleration_y")?,
    );
    Ok(EgoState::from_log(
        time_us,
        pose_of(record)?,
        velocity,
        acceleration,
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn yaw_is_that_of_pyquaternion() {
        // Rotations about z alone, then pyquaternion 0.9.9's value for a tilted one that is not
        // normalized.
        for angle in [-3.0_f64, -0.5, 0.0, 1.2, 3.1] {
            let half = angle / 2.0;
            assert!((yaw([half.cos(), 0.0, 0.0, half.sin()]).unwrap() - angle).abs() < 1e-12);
        }
        assert!((yaw([0.9, 0.05, -0.02, 0.4]).unwrap() - TILTED).abs() < 1e-12);
        assert_eq!(yaw([0.0; 4]), None);
        assert_eq!(yaw([f64::MAX; 4]), None);
    }

    /// `Quaternion(0.9, 0.05, -0.02, 0.4).yaw_pitch_roll[0]`.
    const TILTED: f64 = 0.836_224_012_689_028;
}
