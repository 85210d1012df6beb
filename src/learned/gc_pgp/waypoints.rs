//! From places to poses (`pgp/utils.py`).

/// Places less far ahead are put at the ego, meters.
const STATIONARY: f32 = 0.2;
/// Pieces of a step in which headings are measured.
const PIECES: usize = 100;
/// A pose nearer than this to the one before repeats it, meters.
const MIN_DISTANCE: f32 = 0.5;

/// The poses of places half a second apart, in the frame of the ego, which has this speed, m/s. A
/// cubic spline over the number of the step gives the headings. As upstream, its first slope is the
/// speed, although a step lasts half a second.
pub fn poses(places: &[[f32; 2]], speed: f32) -> Vec<[f32; 3]> {
    let standing: Vec<bool> = places.iter().map(|[x, _]| *x < STATIONARY).collect();
    let kept = places
        .iter()
        .zip(&standing)
        .map(|(&place, &standing)| if standing { [0.0; 2] } else { place });
    let knots: Vec<[f32; 2]> = std::iter::once([0.0; 2]).chain(kept).collect();
    let spline = |axis: usize, slope: f32| {
        Spline::new(
            knots.iter().map(|knot| f64::from(knot[axis])).collect(),
            f64::from(slope),
        )
    };
    let (x, y) = (spline(0, speed), spline(1, 0.0));
    // The grid is one of f32.
    let at = |i: usize| f64::from((i as f64 * (1.0 / PIECES as f64)) as f32);
    let heading = |step: usize| {
        let (now, before) = (at(step * PIECES), at(step * PIECES - 1));
        (y.at(now) - y.at(before)).atan2(x.at(now) - x.at(before)) as f32
    };
    let mut last = [0.0f32; 3];
    let mut poses = Vec::with_capacity(places.len());
    for (step, &[x, y]) in knots.iter().enumerate().skip(1) {
        if (last[0] - x).hypot(last[1] - y) > MIN_DISTANCE {
            last = [x, y, heading(step)];
        }
        poses.push(if standing[step - 1] { [0.0; 3] } else { last });
    }
    poses
}

/// A cubic spline over 0, 1, 2 and so on, with a slope at its start and without curvature at its
/// end.
struct Spline {
    values: Vec<f64>,
    /// Slopes at the knots.
    slopes: Vec<f64>,
}

impl Spline {
    fn new(values: Vec<f64>, slope: f64) -> Self {
        let last = values.len() - 1;
        // slopes[i − 1] + 4 slopes[i] + slopes[i + 1] = 3 (values[i + 1] − values[i − 1]), by
        // elimination down and up.
        let (mut upper, mut slopes) = (vec![0.0; last + 1], vec![slope; last + 1]);
        for i in 1..last {
            let pivot = 4.0 - upper[i - 1];
            upper[i] = 1.0 / pivot;
            slopes[i] = (3.0 * (values[i + 1] - values[i - 1]) - slopes[i - 1]) / pivot;
        }
        if last > 0 {
            // slopes[n − 1] + 2 slopes[n] = 3 (values[n] − values[n − 1]).
            slopes[last] = (3.0 * (values[last] - values[last - 1]) - slopes[last - 1])
                / (2.0 - upper[last - 1]);
        }
        for i in (1..last).rev() {
            slopes[i] -= upper[i] * slopes[i + 1];
        }
        Self { values, slopes }
    }

    fn at(&self, place: f64) -> f64 {
        let piece = (place as usize).min(self.values.len().saturating_sub(2));
        let u = place - piece as f64;
        let (from, to) = (self.values[piece], self.values[piece + 1]);
        let (a, b) = (self.slopes[piece], self.slopes[piece + 1]);
        let rise = to - from;
        from + u * (a + u * (3.0 * rise - 2.0 * a - b + u * (a + b - 2.0 * rise)))
    }
}
