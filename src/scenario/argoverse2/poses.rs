//! Ego poses of a sensor log: `city_SE3_egovehicle.feather`.
//!
//! The ego frame of Argoverse 2 has its origin on the rear axle (x forward, y left, z up). A test
//! on a log shows it: the lateral velocity of the origin in a bend is zero. The table has poses at
//! the times of all sensors.

use super::error::LogFault;
use super::table::Table;
use nalgebra::{Isometry3, Quaternion, Translation3, UnitQuaternion, Vector3};

/// Maximum deviation of a quaternion's norm from 1.
const MAX_ROUNDING: f64 = 1e-2;
/// Maximum distance of poses for interpolation, ns: one and a half sweeps.
const MAX_GAP_NS: i64 = 150_000_000;

/// Poses of the ego frame in the city frame, by time.
#[derive(Debug)]
pub(super) struct EgoPoses {
    /// In order of time, ns.
    poses: Vec<(i64, Isometry3<f64>)>,
}

impl EgoPoses {
    pub(super) fn read(table: &Table) -> Result<Self, LogFault> {
        let times = table.integers("timestamp_ns")?;
        let mut poses: Vec<(i64, Isometry3<f64>)> =
            times.into_iter().zip(isometries(table)?).collect();
        poses.sort_by_key(|&(time, _)| time);
        Ok(Self { poses })
    }

    /// The pose at a time, interpolated between neighbors within [`MAX_GAP_NS`] of each other.
    pub(super) fn at(&self, timestamp_ns: i64) -> Result<Isometry3<f64>, LogFault> {
        let after = self.poses.partition_point(|&(time, _)| time < timestamp_ns);
        let missing = LogFault::NoPose { timestamp_ns };
        let Some(&(to, second)) = self.poses.get(after) else {
            return Err(missing);
        };
        if to == timestamp_ns {
            return Ok(second);
        }
        let Some(&(from, first)) = after
            .checked_sub(1)
            .and_then(|before| self.poses.get(before))
        else {
            return Err(missing);
        };
        let gap = to
            .checked_sub(from)
            .filter(|&gap| gap <= MAX_GAP_NS)
            .ok_or(missing)?;
        let share = (timestamp_ns - from) as f64 / gap as f64;
        let place = first
            .translation
            .vector
            .lerp(&second.translation.vector, share);
        let turn = first.rotation.nlerp(&second.rotation, share);
        Ok(Isometry3::from_parts(Translation3::from(place), turn))
    }
}

/// Poses from the columns `tx_m` to `tz_m` and `qw` to `qz`, which Argoverse 2 uses everywhere.
pub(super) fn isometries(table: &Table) -> Result<Vec<Isometry3<f64>>, LogFault> {
    let [x, y, z] = [
        table.numbers("tx_m")?,
        table.numbers("ty_m")?,
        table.numbers("tz_m")?,
    ];
    let [w, i, j, k] = [
        table.numbers("qw")?,
        table.numbers("qx")?,
        table.numbers("qy")?,
        table.numbers("qz")?,
    ];
    (0..x.len())
        .map(|row| {
            let quaternion = Quaternion::new(w[row], i[row], j[row], k[row]);
            let norm = quaternion.norm();
            if (norm - 1.0).abs() > MAX_ROUNDING {
                return Err(LogFault::NoRotation { row, norm });
            }
            let rotation = UnitQuaternion::from_quaternion(quaternion);
            Ok(Isometry3::from_parts(
                Translation3::new(x[row], y[row], z[row]),
                rotation,
            ))
        })
        .collect()
}

/// Heading of the forward axis in the plane, radians.
pub(super) fn heading(pose: &Isometry3<f64>) -> f64 {
    let forward = pose.rotation * Vector3::x();
    forward.y.atan2(forward.x)
}
