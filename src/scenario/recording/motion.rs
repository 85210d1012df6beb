//! Velocities and accelerations from samples, and bounds of plausible measurements.

use planagent_world::EgoState;
use planagent_world::geometry::{Pose, Vector};

/// Coordinates beyond this are no place on Earth, meters.
pub(crate) const MAX_COORDINATE: f64 = 1e8;
/// Speeds beyond this are no road user's, m/s.
pub(crate) const MAX_SPEED: f64 = 200.0;
/// Boxes beyond this are no road user's, meters.
pub(crate) const MAX_BOX: f64 = 100.0;
/// Samples to each side over which a slope is fitted.
const SLOPE_REACH: usize = 2;

/// Slope at sample `i` of the straight line fitted by least squares to the samples up to two before
/// and two after it: a central difference that is smooth under measurement noise, one-sided at the
/// ends. 0 if there is only one sample.
///
/// `times` in seconds, as many as `values`; the slope has the values' unit per second.
pub(crate) fn slope(times: &[f64], values: &[f64], i: usize) -> f64 {
    let (from, to) = (
        i.saturating_sub(SLOPE_REACH),
        (i + SLOPE_REACH).min(times.len() - 1),
    );
    let count = (to - from + 1) as f64;
    let mean = |list: &[f64]| list[from..=to].iter().sum::<f64>() / count;
    let (mean_time, mean_value) = (mean(times), mean(values));
    let (mut rise, mut run) = (0.0, 0.0);
    for (time, value) in times[from..=to].iter().zip(&values[from..=to]) {
        rise += (time - mean_time) * (value - mean_value);
        run += (time - mean_time).powi(2);
    }
    if run > 0.0 { rise / run } else { 0.0 }
}

/// The [slopes](slope) of vectors at all samples.
pub(crate) fn slopes(times: &[f64], vectors: impl Iterator<Item = Vector>) -> Vec<Vector> {
    let (east, north): (Vec<f64>, Vec<f64>) = vectors.map(|vector| (vector.x, vector.y)).unzip();
    (0..times.len())
        .map(|i| Vector::new(slope(times, &east, i), slope(times, &north, i)))
        .collect()
}

/// The recorded ego from its rear axles and their velocities in the map frame. Accelerations are
/// the slopes of the velocities. nuPlan's vehicle replaces the recording car, with the rear axle in
/// the same place.
pub(crate) fn ego_states(
    times_us: &[i64],
    seconds: &[f64],
    rear_axles: &[Pose],
    velocities: &[Vector],
) -> Vec<EgoState> {
    let accelerations = slopes(seconds, velocities.iter().copied());
    let states = rear_axles
        .iter()
        .zip(times_us)
        .zip(velocities.iter().zip(accelerations));
    let states = states.map(|((&rear_axle, &time_us), (&velocity, acceleration))| {
        let into_body = Pose::new(0.0, 0.0, -rear_axle.heading);
        EgoState::from_log(
            time_us,
            rear_axle,
            into_body.rotate(velocity),
            into_body.rotate(acceleration),
        )
    });
    states.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn slopes_are_central_inside_and_one_sided_at_the_ends() {
        let times = [0.0, 0.1, 0.2, 0.3, 0.4, 0.5];
        let squares = times.map(|t: f64| t * t);
        assert!((slope(&times, &squares, 2) - 0.4).abs() < 1e-12);
        // The line through 0, 0.1, 0.2 has the slope of their middle.
        assert!((slope(&times, &squares, 0) - 0.2).abs() < 1e-12);
        assert!(slope(&times[..1], &squares[..1], 0).abs() < 1e-12);
    }

    #[test]
    fn a_circle_has_its_speed_and_its_centripetal_acceleration() {
        let seconds: Vec<f64> = (0..100).map(|i| f64::from(i) * 0.1).collect();
        let times_us: Vec<i64> = (0..100).map(|i| i * 100_000).collect();
        let poses: Vec<Pose> = seconds
            .iter()
            .map(|t| {
                let angle = 0.25 * t;
                Pose::new(
                    20.0 * angle.cos(),
                    20.0 * angle.sin(),
                    angle + std::f64::consts::FRAC_PI_2,
                )
            })
            .collect();
        let velocities = slopes(&seconds, poses.iter().map(|pose| pose.position().coords));
        for state in &ego_states(&times_us, &seconds, &poses, &velocities)[4..96] {
            assert!(
                (state.velocity - Vector::new(5.0, 0.0)).norm() < 5e-3,
                "{state:?}"
            );
            assert!(
                (state.acceleration - Vector::new(0.0, 1.25)).norm() < 5e-3,
                "{state:?}"
            );
        }
    }
}
