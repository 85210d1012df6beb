//! Velocity and curvature along a reference of poses, fitted by regularized least squares (devkit
//! `tracker_utils.py`).
//!
//! nuPlan solves both fits for an initial value and its rates with the pseudo-inverse of a dense
//! normal matrix. Written for the velocities and curvatures themselves, the same problems have a
//! banded matrix that does not depend on the headings: an elimination of O(M) gives the same
//! solution, better conditioned, at a cost of microseconds.

use crate::STEP_S;
use crate::geometry::{Pose, wrap_angle};

/// Weight of the jerk penalty in the velocity fit.
const JERK_PENALTY: f64 = 1e-4;
/// Weight of the curvature-rate penalty in the curvature fit.
const CURVATURE_RATE_PENALTY: f64 = 1e-2;
/// Weight of the initial curvature, which makes a standing reference well-posed.
const INITIAL_CURVATURE_PENALTY: f64 = 1e-10;

/// The penalty of the velocity fit.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum JerkPenalty {
    /// Differences of neighboring accelerations: nuPlan's tracker.
    #[default]
    AccelerationDifferences,
    /// The batch tracker of PDM-Closed (and NAVSIM): an overwritten assignment upstream leaves the
    /// accelerations themselves in all rows but the last. Needed for parity with PDM's scores.
    PdmClosed,
}

/// Speed and curvature at the start of each of the M displacements between M + 1 poses, 0.1 s
/// apart.
#[derive(Debug, Clone, PartialEq)]
pub struct MotionProfile {
    velocity: Vec<f64>,
    curvature: Vec<f64>,
}

impl MotionProfile {
    /// Fits a profile to rear-axle poses 0.1 s apart; `None` for fewer than two.
    pub fn fit(poses: &[Pose], penalty: JerkPenalty) -> Option<Self> {
        if poses.len() < 2 {
            return None;
        }
        let velocity = fit_velocity(poses, penalty);
        let curvature = fit_curvature(poses, &velocity);
        Some(Self {
            velocity,
            curvature,
        })
    }

    /// Speeds, m/s.
    #[inline]
    pub fn velocity(&self) -> &[f64] {
        &self.velocity
    }

    /// Curvatures, 1/m.
    #[inline]
    pub fn curvature(&self) -> &[f64] {
        &self.curvature
    }

    /// Speed `steps` steps of 0.1 s after the first pose, linear in between, clamped at both ends,
    /// m/s.
    #[inline]
    pub(crate) fn velocity_at(&self, steps: f64) -> f64 {
        interpolate(&self.velocity, steps)
    }

    /// Curvature `steps` steps of 0.1 s after the first pose, linear in between, clamped at both
    /// ends, 1/m.
    #[inline]
    pub fn curvature_at(&self, steps: f64) -> f64 {
        interpolate(&self.curvature, steps)
    }
}

fn interpolate(values: &[f64], place: f64) -> f64 {
    let last = values.len() - 1;
    let place = place.clamp(0.0, last as f64);
    let before = place.floor() as usize;
    let after = (before + 1).min(last);
    values[before] + (values[after] - values[before]) * (place - before as f64)
}

/// Speeds v that minimize `Σ (dt·v_k − p_k)² + λ·‖R a‖²`, where `p_k` is the displacement k along
/// the heading at its start, `a_k = (v_{k+1} − v_k)/dt`, and `penalty` names R.
fn fit_velocity(poses: &[Pose], penalty: JerkPenalty) -> Vec<f64> {
    let along = |w: &[Pose]| {
        let (sin, cos) = w[0].heading.sin_cos();
        STEP_S * (cos * (w[1].x - w[0].x) + sin * (w[1].y - w[0].y))
    };
    let rhs: Vec<f64> = poses.windows(2).map(along).collect();
    let count = rhs.len();
    let mut normal = Pentadiagonal::identity(count, STEP_S * STEP_S);
    let weight = JERK_PENALTY / (STEP_S * STEP_S);
    let differences = count.saturating_sub(2);
    for row in 0..differences {
        match penalty {
            JerkPenalty::PdmClosed if row + 1 < differences => {
                normal.add_square(row, &[-1.0, 1.0], weight);
            }
            JerkPenalty::PdmClosed | JerkPenalty::AccelerationDifferences => {
                normal.add_square(row, &[1.0, -2.0, 1.0], weight);
            }
        }
    }
    normal.solve(rhs)
}

/// Curvatures κ that minimize `Σ (v_k·dt·κ_k − Δθ_k)² + λ_c·Σ ((κ_{k+1} − κ_k)/dt)² + ε·κ_0²`.
///
/// The matrix is a chain Laplacian plus a non-negative diagonal. Eliminating the diagonal's excess
/// instead of the diagonal needs no subtraction, so that a nearly standing reference loses no
/// digits.
fn fit_curvature(poses: &[Pose], velocity: &[f64]) -> Vec<f64> {
    let coupling = CURVATURE_RATE_PENALTY / (STEP_S * STEP_S);
    let count = velocity.len();
    let mut excess: Vec<f64> = velocity.iter().map(|v| (v * STEP_S).powi(2)).collect();
    excess[0] += INITIAL_CURVATURE_PENALTY;
    let mut solution: Vec<f64> = poses
        .windows(2)
        .zip(velocity)
        .map(|(w, v)| v * STEP_S * wrap_angle(w[1].heading - w[0].heading))
        .collect();
    for k in 1..count {
        let passed = coupling / (excess[k - 1] + coupling);
        excess[k] += passed * excess[k - 1];
        solution[k] += passed * solution[k - 1];
    }
    solution[count - 1] /= excess[count - 1];
    for k in (0..count - 1).rev() {
        solution[k] = (solution[k] + coupling * solution[k + 1]) / (excess[k] + coupling);
    }
    solution
}

/// A symmetric positive-definite matrix with two bands above the diagonal.
struct Pentadiagonal {
    diagonal: Vec<f64>,
    first: Vec<f64>,
    second: Vec<f64>,
}

impl Pentadiagonal {
    fn identity(size: usize, scale: f64) -> Self {
        Self {
            diagonal: vec![scale; size],
            first: vec![0.0; size],
            second: vec![0.0; size],
        }
    }

    /// Adds weight·rᵀr for a row r that is zero but for at most three coefficients from column
    /// `start` on.
    fn add_square(&mut self, start: usize, coefficients: &[f64], weight: f64) {
        for (i, a) in coefficients.iter().enumerate() {
            for (j, b) in coefficients.iter().enumerate().skip(i) {
                let band = match j - i {
                    0 => &mut self.diagonal,
                    1 => &mut self.first,
                    _ => &mut self.second,
                };
                band[start + i] += weight * a * b;
            }
        }
    }

    /// Solves for `rhs` by an `LDLᵀ` factorization within the bands.
    fn solve(mut self, mut rhs: Vec<f64>) -> Vec<f64> {
        let size = rhs.len();
        for i in 0..size {
            let pivot = self.diagonal[i];
            let (to_next, to_second) = (self.first[i] / pivot, self.second[i] / pivot);
            if i + 1 < size {
                self.diagonal[i + 1] -= to_next * self.first[i];
                self.first[i + 1] -= to_next * self.second[i];
                rhs[i + 1] -= to_next * rhs[i];
            }
            if i + 2 < size {
                self.diagonal[i + 2] -= to_second * self.second[i];
                rhs[i + 2] -= to_second * rhs[i];
            }
            (self.first[i], self.second[i]) = (to_next, to_second);
        }
        for i in (0..size).rev() {
            let mut value = rhs[i] / self.diagonal[i];
            if i + 1 < size {
                value -= self.first[i] * rhs[i + 1];
            }
            if i + 2 < size {
                value -= self.second[i] * rhs[i + 2];
            }
            rhs[i] = value;
        }
        rhs
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, DVector};
    use proptest::prelude::*;

    /// The velocity fit as nuPlan states it: dense, for `[v0, a_0, …]`, by the pseudo-inverse.
    fn dense_velocity(poses: &[Pose], penalty: JerkPenalty) -> Vec<f64> {
        let m = poses.len() - 1;
        let mut a = DMatrix::zeros(2 * m, m);
        let mut y = DVector::zeros(2 * m);
        for k in 0..m {
            let (sin, cos) = poses[k].heading.sin_cos();
            for (row, share, difference) in [
                (2 * k, cos, poses[k + 1].x - poses[k].x),
                (2 * k + 1, sin, poses[k + 1].y - poses[k].y),
            ] {
                y[row] = difference;
                a[(row, 0)] = STEP_S * share;
                for j in 1..=k {
                    a[(row, j)] = STEP_S * STEP_S * share;
                }
            }
        }
        let rows = m.saturating_sub(2);
        let mut r = DMatrix::zeros(rows, m);
        for i in 0..rows {
            let last = i + 1 == rows;
            r[(i, 1 + i)] = -1.0;
            if penalty == JerkPenalty::AccelerationDifferences || last {
                r[(i, 2 + i)] = 1.0;
            }
        }
        let normal = a.transpose() * &a + r.transpose() * &r * JERK_PENALTY;
        let x = normal.pseudo_inverse(1e-18).unwrap() * a.transpose() * y;
        (0..m)
            .map(|k| x[0] + STEP_S * (1..=k).map(|j| x[j]).sum::<f64>())
            .collect()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]
        #[test]
        fn the_banded_fit_is_the_dense_one(
            turns in prop::collection::vec(-0.2..0.2f64, 1..14), speeds in prop::collection::vec(-0.1..15.0f64, 14),
        ) {
            let mut poses = vec![Pose::new(3.0, -4.0, 3.0)];
            for (turn, speed) in turns.iter().zip(&speeds) {
                let last = poses[poses.len() - 1];
                let moved = last.translated(speed * STEP_S, 0.01);
                poses.push(Pose::new(moved.x, moved.y, wrap_angle(last.heading + turn)));
            }
            for penalty in [JerkPenalty::AccelerationDifferences, JerkPenalty::PdmClosed] {
                let fitted = MotionProfile::fit(&poses, penalty).unwrap();
                for (fast, dense) in fitted.velocity().iter().zip(dense_velocity(&poses, penalty)) {
                    prop_assert!((fast - dense).abs() < 1e-6, "{fast} {dense}");
                }
            }
        }
    }

    #[test]
    fn a_circle_has_its_curvature_and_a_standing_reference_none() {
        let circle: Vec<Pose> = (0..41)
            .map(|i| {
                let a = f64::from(i) * 0.04;
                Pose::new(20.0 * a.sin(), 20.0 * (1.0 - a.cos()), a)
            })
            .collect();
        let profile = MotionProfile::fit(&circle, JerkPenalty::default()).unwrap();
        assert!((profile.velocity_at(20.0) - 8.0).abs() < 0.01);
        assert!((profile.curvature_at(20.5) - 0.05).abs() < 1e-3);
        let standing =
            MotionProfile::fit(&[Pose::new(1.0, 2.0, 0.5); 41], JerkPenalty::default()).unwrap();
        assert!(
            standing
                .velocity()
                .iter()
                .chain(standing.curvature())
                .all(|v| v.abs() < 1e-12)
        );
    }

    #[test]
    fn one_pose_has_no_profile() {
        assert_eq!(
            MotionProfile::fit(&[Pose::default()], JerkPenalty::default()),
            None
        );
    }
}
