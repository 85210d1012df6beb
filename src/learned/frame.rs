//! Poses as the originals' features have them.

use planagent_world::geometry::{Pose, wrap_angle};

/// A number as f32 holds it.
pub(super) fn single(value: f64) -> f64 {
    f64::from(value as f32)
}

/// A pose of the map as the originals hold it: in f32.
pub(super) fn rounded(pose: Pose) -> Pose {
    Pose::new(single(pose.x), single(pose.y), single(pose.heading))
}

/// A pose in the frame of another: x, y (meters), heading (radians).
pub(super) fn relative(frame: Pose, pose: Pose) -> [f32; 3] {
    let local = frame.to_local(pose.position());
    [
        local.x as f32,
        local.y as f32,
        wrap_angle(pose.heading - frame.heading) as f32,
    ]
}
