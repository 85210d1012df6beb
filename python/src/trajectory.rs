//! Trajectories, and numbers as bytes.

use crate::errors::{Failure, Outcome, Raise};
use planagent::planning::TrajectoryState;
use planagent::road::{Pose, Vector};
use planagent::{EgoState, Trajectory as Planned};
use pyo3::prelude::*;
use pyo3::types::{PyByteArray, PyBytes};

const MICROS_PER_SECOND: f64 = 1e6;
/// Numbers of a pose: x, y (meters), heading (radians).
const POSE: usize = 3;
/// Fewest poses of a plan, as for a command: one says neither how fast to drive nor where to turn.
const MIN_POSES: usize = 2;

/// Longest time between the present and the last pose, seconds: thirty years. The clock of a scene
/// counts microseconds in 64 bits.
const MAX_S: f64 = 1e9;

/// A path in time of the ego's rear axle.
#[pyclass(frozen, module = "planagent._core")]
pub(crate) struct Trajectory(pub(crate) Planned);

/// The numbers of packed native doubles.
pub(crate) fn numbers(bytes: &[u8]) -> Outcome<Vec<f64>> {
    let (chunks, rest) = bytes.as_chunks::<8>();
    if !rest.is_empty() {
        return Err(Failure::argument(
            "packed numbers have a length that is no multiple of 8 bytes",
        ));
    }
    Ok(chunks
        .iter()
        .map(|chunk| f64::from_ne_bytes(*chunk))
        .collect())
}

/// Packs numbers.
pub(crate) fn packed(numbers: impl IntoIterator<Item = f64>) -> Vec<u8> {
    numbers.into_iter().flat_map(f64::to_ne_bytes).collect()
}

/// Bytes that numpy can write to.
pub(crate) fn array<'py>(py: Python<'py>, bytes: &[u8]) -> Bound<'py, PyByteArray> {
    PyByteArray::new(py, bytes)
}

/// The poses of packed numbers.
pub(crate) fn poses(bytes: &[u8]) -> Outcome<Vec<Pose>> {
    let numbers = numbers(bytes)?;
    let (poses, rest) = numbers.as_chunks::<POSE>();
    if !rest.is_empty() {
        return Err(Failure::argument("a pose has three numbers: x, y, heading"));
    }
    Ok(poses
        .iter()
        .map(|&[x, y, heading]| Pose { x, y, heading })
        .collect())
}

/// The plan of a planner from the ego's present state through poses at equal steps after it.
pub(crate) fn planned(ego: &EgoState, poses: &[Pose], dt_s: f64) -> Outcome<Planned> {
    if poses.len() < MIN_POSES {
        return Err(Failure::argument(format!(
            "a plan has at least {MIN_POSES} poses, got {}",
            poses.len()
        )));
    }
    through(ego, poses, dt_s)
}

/// A trajectory from the ego's present state through poses at equal steps after it.
pub(crate) fn through(ego: &EgoState, poses: &[Pose], dt_s: f64) -> Outcome<Planned> {
    if !(dt_s > 0.0 && dt_s * poses.len() as f64 <= MAX_S) {
        return Err(Failure::argument(format!(
            "dt is {dt_s:e}; it must be greater than 0 s, and the last of {} poses at most {MAX_S:e} s away",
            poses.len()
        )));
    }
    let mut states = vec![TrajectoryState::from(ego)];
    for (i, &pose) in poses.iter().enumerate() {
        let before = states.last().map_or(ego.rear_axle, |state| state.rear_axle);
        let time_us = ego.time_us + ((i + 1) as f64 * dt_s * MICROS_PER_SECOND).round() as i64;
        // The controller follows poses alone; the speed is for readers of the trajectory.
        let forward = before.to_local(pose.position()).x.signum();
        let speed = before.distance(&pose) / dt_s * forward;
        states.push(TrajectoryState::moving(time_us, pose, speed, 0.0));
    }
    Planned::new(states).map_err(|error| Failure::argument(error.to_string()))
}

#[pymethods]
impl Trajectory {
    /// A trajectory of packed poses at packed times (µs).
    #[staticmethod]
    fn of_times(py: Python<'_>, times_us: Vec<i64>, poses: &[u8]) -> PyResult<Self> {
        let made = || {
            let poses = crate::trajectory::poses(poses)?;
            if poses.len() != times_us.len() {
                let (times, poses) = (times_us.len(), poses.len());
                return Err(Failure::argument(format!(
                    "{times} times and {poses} poses; there must be as many"
                )));
            }
            let mut states: Vec<TrajectoryState> = Vec::with_capacity(poses.len());
            for (&time_us, &pose) in times_us.iter().zip(&poses) {
                let speed = states.last().map_or(0.0, |before| {
                    let seconds = time_us.saturating_sub(before.time_us) as f64 / MICROS_PER_SECOND;
                    if seconds > 0.0 {
                        before.rear_axle.distance(&pose) / seconds
                    } else {
                        0.0
                    }
                });
                states.push(TrajectoryState::moving(time_us, pose, speed, 0.0));
            }
            Planned::new(states).map_err(|error| Failure::argument(error.to_string()))
        };
        made().map(Self).or_raise(py)
    }

    /// Times, µs.
    fn times_us(&self) -> Vec<i64> {
        self.0.states().iter().map(|state| state.time_us).collect()
    }

    /// Packed x, y, heading, vx, vy, ax, ay, steering angle of each state.
    fn states<'py>(&self, py: Python<'py>) -> Bound<'py, PyByteArray> {
        let of = |vector: Vector| [vector.x, vector.y];
        let rows = self.0.states().iter().flat_map(|state| {
            let Pose { x, y, heading } = state.rear_axle;
            let ([vx, vy], [ax, ay]) = (of(state.velocity), of(state.acceleration));
            [x, y, heading, vx, vy, ax, ay, state.steering_angle]
        });
        array(py, &packed(rows))
    }

    /// Packed x, y, heading at a time (µs).
    fn at<'py>(&self, py: Python<'py>, time_us: i64) -> PyResult<Bound<'py, PyBytes>> {
        let state = self
            .0
            .at(time_us)
            .map_err(|error| Failure::argument(error.to_string()).raised(py))?;
        let Pose { x, y, heading } = state.rear_axle;
        Ok(PyBytes::new(py, &packed([x, y, heading])))
    }
}
