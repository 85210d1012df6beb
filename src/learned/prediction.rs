//! From the poses of a network to a trajectory (nuplan-devkit `ml_planner/transform_utils.py`).

use super::past;
use planagent_agent::planner::PlannerError;
use planagent_score::metrics::SavitzkyGolay;
use planagent_world::geometry::{Pose, Vector, unwrap_angles, wrap_angle};
use planagent_world::{HISTORY_SAMPLES, MICROS_PER_SECOND, SceneView, Trajectory, TrajectoryState};

/// Time between the poses of most networks, µs.
pub(super) const HALF_SECOND_US: i64 = 500_000;

/// Window and order of the filter that gives velocities and accelerations.
const WINDOW: usize = 5;
const ORDER: usize = 2;

/// x, y and unwrapped heading at a time.
type Sample = [f64; 3];

/// The trajectory through poses (x, y, heading in the frame of the rear axle), `step_us` apart, the
/// first one step from now. The present state stands before them. Velocities and accelerations come
/// from a filter over history and plan; as upstream, the lateral ones are positive to the right.
///
/// # Errors
/// When a pose is not finite.
pub fn trajectory(
    poses: &[[f32; 3]],
    step_us: i64,
    scene: &SceneView<'_>,
) -> Result<Trajectory, PlannerError> {
    let (ego, here) = (scene.ego, scene.ego.rear_axle);
    let absolute = poses.iter().map(|&[x, y, heading]| {
        let place = here.translated(f64::from(x), f64::from(y));
        Pose {
            heading: wrap_angle(here.heading + f64::from(heading)),
            ..place
        }
    });
    let plan: Vec<Pose> = std::iter::once(here).chain(absolute).collect();
    let times: Vec<i64> = (0..plan.len() as i64)
        .map(|i| ego.time_us + i * step_us)
        .collect();
    let motion = motion(&plan, &times, scene)?;
    let mut states = vec![TrajectoryState {
        // The networks predict poses and no steering, so upstream's states have none.
        steering_angle: 0.0,
        ..TrajectoryState::from(ego)
    }];
    states.extend(plan.iter().zip(&times).zip(motion).skip(1).map(
        |((&rear_axle, &time_us), [v, w, a, b])| {
            let (velocity, acceleration) = (Vector::new(v, w), Vector::new(a, b));
            TrajectoryState {
                time_us,
                rear_axle,
                velocity,
                acceleration,
                steering_angle: 0.0,
            }
        },
    ));
    Ok(Trajectory::new(states)?)
}

/// Longitudinal and lateral velocity and acceleration at each time of the plan.
fn motion(
    plan: &[Pose],
    times: &[i64],
    scene: &SceneView<'_>,
) -> Result<Vec<[f64; 4]>, PlannerError> {
    let failed = |source| PlannerError::Failed {
        doing: "filtering the plan",
        source: Box::new(source),
    };
    let history = past::samples(scene, HISTORY_SAMPLES);
    let seconds = |time_us: i64| (time_us - scene.ego.time_us) as f64 / MICROS_PER_SECOND;
    let past = history
        .iter()
        .map(|sample| (seconds(sample.ego.time_us), sample.ego.rear_axle));
    let (mut stamps, mut poses): (Vec<f64>, Vec<Pose>) = past.unzip();
    let plan_stamps: Vec<f64> = times.iter().map(|&time_us| seconds(time_us)).collect();
    let step = match stamps[..] {
        [.., before, last] => last - before,
        _ => return Ok(vec![[0.0; 4]; plan.len()]),
    };
    let end = plan_stamps
        .last()
        .copied()
        .expect("a plan begins with the present");
    let headings = unwrap_angles(&plan.iter().map(|pose| pose.heading).collect::<Vec<_>>());
    let rows: Vec<Sample> = plan
        .iter()
        .zip(headings)
        .map(|(pose, heading)| [pose.x, pose.y, heading])
        .collect();
    // The filter needs equal intervals, so the plan is sampled at those of the history.
    let count = (end / step).ceil().max(1.0) as usize - 1;
    for i in 1..=count {
        let at = i as f64 * step;
        let [x, y, heading] = interpolated(&plan_stamps, &rows, at);
        stamps.push(at);
        poses.push(Pose::new(x, y, heading));
    }
    let delta = (stamps[stamps.len() - 1] - stamps[0]) / (stamps.len() - 1) as f64;
    let derived = |derivative: usize, read: fn(&Pose) -> f64| {
        let values: Vec<f64> = poses.iter().map(read).collect();
        SavitzkyGolay {
            window: WINDOW,
            order: ORDER,
            derivative,
        }
        .apply(&values, delta)
        .map_err(failed)
    };
    let (vx, vy) = (derived(1, |pose| pose.x)?, derived(1, |pose| pose.y)?);
    let (ax, ay) = (derived(2, |pose| pose.x)?, derived(2, |pose| pose.y)?);
    let projected = |i: usize| {
        let (sin, cos) = poses[i].heading.sin_cos();
        [
            vx[i] * cos + vy[i] * sin,
            vx[i] * sin - vy[i] * cos,
            ax[i] * cos + ay[i] * sin,
            ax[i] * sin - ay[i] * cos,
        ]
    };
    let projected: Vec<[f64; 4]> = (0..poses.len()).map(projected).collect();
    Ok(plan_stamps
        .iter()
        .map(|&at| interpolated(&stamps, &projected, at))
        .collect())
}

/// Linear interpolation, and extrapolation beyond the ends.
fn interpolated<const N: usize>(stamps: &[f64], rows: &[[f64; N]], at: f64) -> [f64; N] {
    let after = stamps
        .partition_point(|&stamp| stamp < at)
        .clamp(1, stamps.len() - 1);
    let share = (at - stamps[after - 1]) / (stamps[after] - stamps[after - 1]);
    std::array::from_fn(|i| rows[after - 1][i] + (rows[after][i] - rows[after - 1][i]) * share)
}

/// The poses of a plan (1, steps, 3).
pub(super) fn poses(plan: &candle_core::Tensor) -> candle_core::Result<Vec<[f32; 3]>> {
    let rows = plan.squeeze(0)?.to_vec2::<f32>()?;
    Ok(rows
        .iter()
        .map(|row| std::array::from_fn(|i| row.get(i).copied().unwrap_or(f32::NAN)))
        .collect())
}
