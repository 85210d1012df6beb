//! Trajectories along a path with a cubic speed profile (`spline_planner.py`); in f32, as upstream.

use super::network::COLUMNS;
use crate::lattice::{Course, ROW};

/// A step: x, y, heading, speed, acceleration, curvature.
pub type Step = [f32; COLUMNS];

/// Steps of a second.
pub(super) const STEPS_PER_S: f32 = 10.0;
/// Lengths of both stages, seconds.
pub(super) const FIRST_S: f32 = 3.0;
pub(super) const SECOND_S: f32 = 5.0;
/// Speeds that a stage may end with.
const FIRST_SPEEDS: usize = 10;
const SECOND_SPEEDS: usize = 5;
/// Bounds of the acceleration and deceleration in the mean of the first stage, and of the second,
/// m/s².
const FIRST_BOUNDS: [f32; 2] = [4.0, 2.4];
const SECOND_BOUNDS: [f32; 2] = [1.0, 1.0];
/// Ends nearer than this to one before are left out, meters.
const MIN_DISTANCE: f32 = 0.5;
/// A path passes through a place when it is at most this far away, meters.
const ON_PATH: f32 = 0.1;

/// Why upstream makes no plan and stays where it is: an exception of its program.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NoTrajectory;

/// The steps after the first instant along a path. They follow from the speed and acceleration now,
/// the speed at the end and the duration of the stage. `None` where the path is too short.
pub fn profile(
    path: &Course,
    [v0, a0, end]: [f32; 3],
    seconds: f32,
    offset: f32,
) -> Result<Option<Vec<Step>>, NoTrajectory> {
    let count = (seconds * STEPS_PER_S) as usize;
    let (two, three) = (seconds * seconds, seconds * seconds * seconds);
    let c2 = -2.0 * a0 / seconds - 3.0 * v0 / two + 3.0 * end / two;
    let c3 = a0 / two + 2.0 * v0 / three - 2.0 * end / three;
    // PyTorch adds up in f64.
    let mut place = 0.0f64;
    let mut steps = Vec::with_capacity(count + 1);
    for i in 0..=count {
        let t = i as f32 * seconds / count as f32;
        let speed = v0 + a0 * t + c2 * t * t + c3 * t * t * t;
        let acceleration = a0 + 2.0 * c2 * t + 3.0 * c3 * t * t;
        steps.push((
            ((place as f32 + offset) / ROW as f32) as i64,
            speed,
            acceleration,
        ));
        place += f64::from(speed * seconds / count as f32);
    }
    if steps
        .last()
        .is_some_and(|&(row, ..)| row > path.len() as i64 - 1)
    {
        return Ok(None);
    }
    let step = |&(row, speed, acceleration): &(i64, f32, f32)| {
        // Behind the path's start PyTorch counts from its end.
        let row = if row < 0 {
            row + path.len() as i64
        } else {
            row
        };
        let row = usize::try_from(row)
            .ok()
            .and_then(|row| path.get(row))
            .ok_or(NoTrajectory)?;
        let [x, y, heading, curvature] = row.map(|value| value as f32);
        Ok([x, y, heading, speed, acceleration, curvature])
    };
    let steps = steps
        .iter()
        .skip(1)
        .map(step)
        .collect::<Result<Vec<Step>, NoTrajectory>>()?;
    Ok(Some(steps))
}

/// The trajectories of the first three seconds from rest at the origin with a speed and an
/// acceleration.
pub fn first_stage(
    paths: &[Course],
    [v0, a0]: [f32; 2],
    limit: f32,
) -> Result<Vec<Vec<Step>>, NoTrajectory> {
    let speeds = speeds::<FIRST_SPEEDS>(v0, limit, FIRST_BOUNDS.map(|bound| bound * FIRST_S));
    let starts: Vec<(&Course, f32)> = paths.iter().map(|path| (path, 0.0)).collect();
    stage(&starts, [v0, a0], &speeds, FIRST_S)
}

/// The trajectories of the next five seconds from the end of one of the first stage, on each path
/// that passes through it.
pub fn second_stage(
    paths: &[Course],
    from: &Step,
    limit: f32,
) -> Result<Vec<Vec<Step>>, NoTrajectory> {
    let &[x, y, _, v0, a0, _] = from;
    let speeds = speeds::<SECOND_SPEEDS>(v0, limit, SECOND_BOUNDS.map(|bound| bound * SECOND_S));
    let start = |path| {
        let distance = |row: &[f64; 4]| (row[0] as f32 - x).hypot(row[1] as f32 - y);
        let rows: &Course = path;
        let (row, distance) = rows
            .iter()
            .map(distance)
            .enumerate()
            .min_by(|a, b| a.1.total_cmp(&b.1))?;
        (distance <= ON_PATH).then_some((path, row as f32 * ROW as f32))
    };
    let starts: Vec<(&Course, f32)> = paths.iter().filter_map(start).collect();
    stage(&starts, [v0, a0], &speeds, SECOND_S)
}

fn stage(
    starts: &[(&Course, f32)],
    [v0, a0]: [f32; 2],
    speeds: &[f32],
    seconds: f32,
) -> Result<Vec<Vec<Step>>, NoTrajectory> {
    let mut found: Vec<Vec<Step>> = Vec::new();
    for &(path, offset) in starts {
        for &end in speeds {
            let Some(steps) = profile(path, [v0, a0, end], seconds, offset)? else {
                continue;
            };
            let Some(&[x, y, ..]) = steps.last() else {
                continue;
            };
            // Of trajectories that end close together the first is kept, so the order of the loops
            // matters.
            let near = |other: &Vec<Step>| {
                other
                    .last()
                    .is_some_and(|&[u, v, ..]| (x - u).hypot(y - v) < MIN_DISTANCE)
            };
            if !found.iter().any(near) {
                found.push(steps);
            }
        }
    }
    if found.is_empty() {
        Err(NoTrajectory)
    } else {
        Ok(found)
    }
}

/// Equally spaced speeds around the present one (PyTorch's `linspace`).
fn speeds<const N: usize>(v0: f32, limit: f32, [down, up]: [f32; 2]) -> [f32; N] {
    let (from, to) = ((v0 - down).max(0.0), (v0 + up).min(limit));
    let step = (to - from) / (N - 1) as f32;
    std::array::from_fn(|i| {
        if i < N / 2 {
            from + step * i as f32
        } else {
            to - step * (N - 1 - i) as f32
        }
    })
}
