//! Angles in radians.

use std::f64::consts::{PI, TAU};

/// The principal value of an angle, in [−π, π).
#[inline]
pub fn wrap_angle(angle: f64) -> f64 {
    let wrapped = (angle + PI).rem_euclid(TAU) - PI;
    // rem_euclid may round up to TAU itself for tiny negative inputs.
    if wrapped >= PI { -PI } else { wrapped }
}

/// Removes jumps of more than π between neighbors, as `numpy.unwrap` does.
pub fn unwrap_angles(angles: &[f64]) -> Vec<f64> {
    let mut unwrapped: Vec<f64> = Vec::with_capacity(angles.len());
    for &angle in angles {
        let next = match unwrapped.last() {
            None => angle,
            Some(&last) => {
                let step = wrap_angle(angle - last);
                // numpy keeps a jump of exactly +π positive.
                let step = if (step + PI).abs() < f64::EPSILON && angle - last > 0.0 {
                    PI
                } else {
                    step
                };
                last + step
            }
        };
        unwrapped.push(next);
    }
    unwrapped
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn wrap_is_half_open() {
        assert!((wrap_angle(PI) + PI).abs() < 1e-15);
        assert!((wrap_angle(-PI) + PI).abs() < 1e-15);
        assert!((wrap_angle(3.0 * PI / 2.0) + PI / 2.0).abs() < 1e-12);
    }

    #[test]
    fn unwrap_follows_a_full_turn() {
        let turn: Vec<f64> = (0..20).map(|i| wrap_angle(f64::from(i) * 0.5)).collect();
        let unwrapped = unwrap_angles(&turn);
        assert!((unwrapped[19] - 9.5).abs() < 1e-9);
    }

    proptest! {
        #[test]
        fn wrapped_angles_stay_in_range(angle in -1e6..1e6f64) {
            let wrapped = wrap_angle(angle);
            prop_assert!((-PI..PI).contains(&wrapped));
            prop_assert!(((angle - wrapped) / TAU - ((angle - wrapped) / TAU).round()).abs() < 1e-6);
        }
    }
}
