//! Velocities and accelerations from samples: slopes of straight lines fitted to them.

/// Samples to either side over which a slope is fitted.
const SLOPE_REACH: usize = 2;

/// Slope at sample `i` of the straight line fitted by least squares to the samples up to two before and two after it: a central
/// difference that is smooth under measurement noise, one-sided at the ends. 0 where there is one sample only.
///
/// `times` in seconds, as many as `values`; the slope has the values' unit per second.
pub(in crate::scenario) fn slope(times: &[f64], values: &[f64], i: usize) -> f64 {
    let (from, to) = (i.saturating_sub(SLOPE_REACH), (i + SLOPE_REACH).min(times.len() - 1));
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
}
