//! What happened after a moment: targets that several planners share.

use super::{HORIZON, Moment};
use planagent_scenario::Frame;
use planagent_world::TrackToken;
use planagent_world::geometry::{Pose, wrap_angle};

/// Frames between two poses half a second apart.
const HALF_SECOND: usize = 5;

/// A pose in another's frame: x, y (meters), heading (radians).
fn local(frame: Pose, pose: Pose) -> [f32; 3] {
    let place = frame.to_local(pose.position());
    [
        place.x as f32,
        place.y as f32,
        wrap_angle(pose.heading - frame.heading) as f32,
    ]
}

/// The ego's next sixteen poses, half a second apart (16, 3).
pub(super) fn half_seconds(moment: &Moment<'_>) -> Vec<f32> {
    let poses = moment
        .future
        .iter()
        .skip(HALF_SECOND - 1)
        .step_by(HALF_SECOND);
    poses
        .flat_map(|ego| local(moment.scene.ego.rear_axle, ego.rear_axle))
        .collect()
}

/// The ego's next eighty poses (80, 3).
pub(super) fn tenths(moment: &Moment<'_>) -> Vec<f32> {
    moment
        .future
        .iter()
        .flat_map(|ego| local(moment.scene.ego.rear_axle, ego.rear_axle))
        .collect()
}

/// An agent's next eighty poses in the ego's frame (80, 3); from where it is lost on, zeros, as
/// upstream.
pub(super) fn of_agent(moment: &Moment<'_>, token: TrackToken) -> Vec<f32> {
    let mut poses = vec![0f32; 3 * HORIZON];
    for (frame, row) in moment.frames.iter().zip(poses.chunks_exact_mut(3)) {
        let Some(pose) = pose_in(frame, token) else {
            break;
        };
        row.copy_from_slice(&local(moment.scene.ego.rear_axle, pose));
    }
    poses
}

/// Where an agent is in a frame.
pub(super) fn pose_in(frame: &Frame, token: TrackToken) -> Option<Pose> {
    frame
        .objects
        .iter()
        .find(|object| object.token == token)
        .map(|object| object.shape.center)
}
