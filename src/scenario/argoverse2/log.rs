//! Poses, objects and a map to a drive.

use super::error::LogFault;
use crate::geometry::{Pose, Vector};
use crate::scenario::recording::motion::slope;
use crate::scenario::recording::route::route;
use crate::scenario::recording::window::{step_times, window};
use crate::scenario::{FUTURE_FRAMES, Frame, Scenario, UNKNOWN_TYPE};
use crate::world::{EgoState, LaneMap, Route, TrackedObject, TrafficLights};
use std::sync::Arc;

/// A recording in the map's coordinates; the n-th of each list belongs to the n-th step.
#[derive(Debug)]
pub(super) struct Log {
    /// Name of the log's folder.
    pub(super) id: String,
    /// Seconds from the first step.
    pub(super) seconds: Vec<f64>,
    /// Poses of the ego's rear axle.
    pub(super) rear_axles: Vec<Pose>,
    /// Its velocities, map frame, m/s.
    pub(super) velocities: Vec<Vector>,
    pub(super) objects: Vec<Vec<TrackedObject>>,
    pub(super) map: LaneMap,
}

impl Log {
    /// Cuts the window and finds the route; there are no lights.
    ///
    /// # Errors
    /// When the steps are too few or not a tenth of a second apart.
    pub(super) fn scenario(self) -> Result<Scenario, LogFault> {
        let times_us = step_times(&self.seconds)?;
        let window = window(&times_us);
        let egos = ego_states(&times_us, &self.seconds, &self.rear_axles, &self.velocities);
        let centers: Vec<Pose> = egos.iter().skip(window.start).map(EgoState::center).collect();
        let route = Route { roadblocks: route(&self.map, &centers), goal: self.rear_axles.last().copied() };
        let lights = Arc::new(TrafficLights::default());
        let future = egos.iter().copied().skip(window.end).take(FUTURE_FRAMES).collect();
        let frames = egos.into_iter().zip(self.objects).take(window.end);
        let frames = frames.map(|(ego, objects)| Frame { ego, objects: objects.into(), lights: lights.clone() });
        Ok(Scenario {
            log_name: self.id.clone(),
            id: self.id,
            scenario_type: UNKNOWN_TYPE.to_owned(),
            map: Arc::new(self.map),
            route,
            frames: frames.collect(),
            start: window.start,
            future,
        })
    }
}

/// Velocities from poses: slopes over five steps (`recording::motion`), map frame.
pub(super) fn velocities_of(seconds: &[f64], poses: &[Pose]) -> Vec<Vector> {
    let east: Vec<f64> = poses.iter().map(|pose| pose.x).collect();
    let north: Vec<f64> = poses.iter().map(|pose| pose.y).collect();
    slopes(seconds, &east, &north)
}

fn slopes(seconds: &[f64], east: &[f64], north: &[f64]) -> Vec<Vector> {
    (0..seconds.len()).map(|i| Vector::new(slope(seconds, east, i), slope(seconds, north, i))).collect()
}

/// The recorded ego: its accelerations are slopes of the velocities over five steps. nuPlan's vehicle stands in for the
/// recording car, its rear axle in the same place.
fn ego_states(times_us: &[i64], seconds: &[f64], rear_axles: &[Pose], velocities: &[Vector]) -> Vec<EgoState> {
    let east: Vec<f64> = velocities.iter().map(|v| v.x).collect();
    let north: Vec<f64> = velocities.iter().map(|v| v.y).collect();
    let accelerations = slopes(seconds, &east, &north);
    let states = rear_axles.iter().zip(times_us).zip(velocities.iter().zip(accelerations));
    let states = states.map(|((&rear_axle, &time_us), (&velocity, acceleration))| {
        let into_body = Pose::new(0.0, 0.0, -rear_axle.heading);
        EgoState::from_log(time_us, rear_axle, into_body.rotate(velocity), into_body.rotate(acceleration))
    });
    states.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_circle_has_its_speed_and_its_centripetal_acceleration() {
        let seconds: Vec<f64> = (0..100).map(|i| f64::from(i) * 0.1).collect();
        let times_us: Vec<i64> = (0..100).map(|i| i * 100_000).collect();
        let poses: Vec<Pose> = seconds
            .iter()
            .map(|t| {
                let angle = 0.25 * t;
                Pose::new(20.0 * angle.cos(), 20.0 * angle.sin(), angle + std::f64::consts::FRAC_PI_2)
            })
            .collect();
        for state in &ego_states(&times_us, &seconds, &poses, &velocities_of(&seconds, &poses))[4..96] {
            assert!((state.velocity - Vector::new(5.0, 0.0)).norm() < 5e-3, "{state:?}");
            assert!((state.acceleration - Vector::new(0.0, 1.25)).norm() < 5e-3, "{state:?}");
        }
    }
}
