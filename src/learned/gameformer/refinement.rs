//! GameFormer's refinement: speeds along the reference path by Gauss-Newton (`refinement.py`;
//! theseus).

use super::occupancy::{CELLS, Occupancy, STEPS};
use nalgebra::{Cholesky, DMatrix, DVector};

/// Speeds that are sought, 0.1 s apart.
pub(crate) const SPEEDS: usize = 80;
const STEP_S: f64 = 0.1;
/// Room in front of the rear axle, meters.
const FRONT: f64 = 4.049;
/// Bounds of an acceptable acceleration, m/s².
const MIN_ACCELERATION: f64 = -4.0;
const MAX_ACCELERATION: f64 = 2.4;
/// Deviation from the network's last place that is free, meters.
const FREE_END: f64 = 3.0;
/// Steps at which occupied cells are avoided.
const CHECKED: [usize; 8] = [1, 3, 6, 9, 14, 19, 24, 29];
/// Factors of the residuals.
const HARD: f64 = 100.0;
const ACCELERATION: f64 = 0.1;
const LIMIT: f64 = 0.3;
const SOFT: f64 = 10.0;
const JERK: f64 = 1.0;
const END: f64 = 3.0;
/// Maximum number of iterations, share of a step that is taken, and changes of the objective that
/// end the search.
const ITERATIONS: usize = 20;
const DAMPING: f64 = 0.3;
const RELATIVE_CHANGE: f64 = 1e-3;
const CHANGE: f64 = 1e-10;

/// What the speeds are refined with.
#[derive(Debug, Clone, PartialEq)]
pub struct Refinement {
    /// The network's speeds, m/s.
    pub speeds: Vec<f64>,
    /// The network's distances along the path after each step, meters.
    pub places: Vec<f64>,
    /// Occupied cells of each step.
    pub occupancy: Occupancy,
    /// The ego's speed, m/s, and acceleration, m/s², forward.
    pub current: [f64; 2],
    /// Speed limits of the rows of the path, m/s.
    pub limits: Vec<f64>,
}

/// One residual: its value and the speeds that it depends on, with derivatives.
struct Residual {
    value: f64,
    derivatives: Vec<(usize, f64)>,
}

impl Refinement {
    /// The refined speeds; the best of all iterations, the first ones included.
    pub fn solve(&self) -> Vec<f64> {
        let (mut best, mut least) = (Vec::new(), f64::INFINITY);
        for (speeds, objective) in self.iterates() {
            if objective < least {
                (best, least) = (speeds, objective);
            }
        }
        best.into_iter().map(|speed| speed.max(0.0)).collect()
    }

    /// The speeds before the search and after each iteration, with the objective.
    pub fn iterates(&self) -> Vec<(Vec<f64>, f64)> {
        let mut speeds = self
            .speeds
            .iter()
            .map(|speed| speed.max(0.0))
            .collect::<Vec<f64>>();
        let occupied = self.cleared();
        let mut residuals = self.residuals(&speeds, &occupied);
        let mut iterates = vec![(speeds.clone(), objective(&residuals))];
        for _ in 0..ITERATIONS {
            let Some(step) = newton_step(&residuals) else {
                break;
            };
            // A step is taken even where the objective grows, as in theseus; the caller keeps the
            // best iterate.
            for (speed, step) in speeds.iter_mut().zip(step.iter()) {
                *speed += DAMPING * step;
            }
            residuals = self.residuals(&speeds, &occupied);
            let (before, now) = (
                iterates
                    .last()
                    .expect("the search begins with an iterate")
                    .1,
                objective(&residuals),
            );
            iterates.push((speeds.clone(), now));
            let change = (before - now).abs();
            if change / before < RELATIVE_CHANGE || change < CHANGE {
                break;
            }
        }
        iterates
    }

    /// The occupied cells ahead of the network's place at each checked step.
    fn cleared(&self) -> Vec<Vec<f64>> {
        let cells = |&step: &usize| -> Vec<f64> {
            let place = self
                .places
                .get(step)
                .copied()
                .expect("the plan is longer than the checked steps")
                .max(0.0);
            let occupied = self.occupancy.get(step).into_iter().flatten();
            let cells = occupied
                .enumerate()
                .filter(|&(cell, &occupied)| occupied && cell as f64 > place);
            cells.map(|(cell, _)| cell as f64).collect()
        };
        debug_assert!(CHECKED.iter().all(|&step| step < STEPS) && CELLS > 0);
        CHECKED.iter().map(cells).collect()
    }

    fn residuals(&self, speeds: &[f64], occupied: &[Vec<f64>]) -> Vec<Residual> {
        let [speed, acceleration] = self.current;
        let count = speeds.len();
        let places: Vec<f64> = speeds
            .iter()
            .scan(0.0, |place, speed| {
                *place += speed * STEP_S;
                Some(*place)
            })
            .collect();
        // An acceleration or jerk with its derivatives; the present state stands before the first
        // speed.
        let accelerations: Vec<f64> = (0..count)
            .map(|i| (speeds[i] - if i == 0 { speed } else { speeds[i - 1] }) / STEP_S)
            .collect();
        let of_acceleration = |i: usize, factor: f64| {
            let mut derivatives = vec![(i, factor / STEP_S)];
            derivatives.extend((i > 0).then(|| (i - 1, -factor / STEP_S)));
            derivatives
        };
        let mut residuals = Vec::with_capacity(5 * count + CHECKED.len() + 1);
        for (i, &speed) in speeds.iter().enumerate() {
            let negative = if speed < 0.0 { HARD } else { 0.0 };
            residuals.push(Residual {
                value: negative * speed,
                derivatives: vec![(i, negative)],
            });
            let a = accelerations[i];
            residuals.push(Residual {
                value: ACCELERATION * a,
                derivatives: of_acceleration(i, ACCELERATION),
            });
            let row = (self
                .places
                .get(i)
                .copied()
                .expect("a place stands beside every speed")
                .max(0.0) as f32
                * 10.0) as usize;
            let limit = self
                .limits
                .get(row.min(self.limits.len().saturating_sub(1)))
                .copied()
                .expect("a reference path has one row at least");
            residuals.push(Residual {
                value: LIMIT * (speed - limit),
                derivatives: vec![(i, LIMIT)],
            });
            let hard = if (MIN_ACCELERATION..=MAX_ACCELERATION).contains(&a) {
                0.0
            } else {
                SOFT
            };
            residuals.push(Residual {
                value: hard * a,
                derivatives: of_acceleration(i, hard),
            });
            let before = if i == 0 {
                acceleration
            } else {
                accelerations[i - 1]
            };
            let mut derivatives = of_acceleration(i, JERK / STEP_S);
            if i > 0 {
                derivatives.extend(of_acceleration(i - 1, -JERK / STEP_S));
            }
            residuals.push(Residual {
                value: JERK * (a - before) / STEP_S,
                derivatives,
            });
        }
        for (&step, cells) in CHECKED.iter().zip(occupied) {
            let front = places
                .get(step)
                .copied()
                .expect("the plan is longer than the checked steps")
                + FRONT;
            let over: Vec<f64> = cells
                .iter()
                .map(|cell| front - cell)
                .filter(|&over| over > 0.0)
                .collect();
            let derivative = HARD * over.len() as f64 * STEP_S;
            residuals.push(Residual {
                value: HARD * over.iter().sum::<f64>(),
                derivatives: (0..=step).map(|i| (i, derivative)).collect(),
            });
        }
        let (own, predicted) = places
            .last()
            .zip(self.places.last())
            .expect("a plan has one step at least");
        let end = own - predicted.max(0.0);
        let factor = if end.abs() > FREE_END { END } else { 0.0 };
        let derivatives = (0..count).map(|i| (i, factor * STEP_S)).collect();
        residuals.push(Residual {
            value: factor * end,
            derivatives,
        });
        residuals
    }
}

fn objective(residuals: &[Residual]) -> f64 {
    residuals
        .iter()
        .map(|residual| residual.value * residual.value)
        .sum::<f64>()
        / 2.0
}

/// The step of Gauss and Newton; `None` where its matrix is singular.
fn newton_step(residuals: &[Residual]) -> Option<DVector<f64>> {
    let (mut matrix, mut right) = (DMatrix::zeros(SPEEDS, SPEEDS), DVector::zeros(SPEEDS));
    for Residual { value, derivatives } in residuals {
        let moving = || {
            derivatives
                .iter()
                .filter(|&&(i, derivative)| derivative != 0.0 && i < SPEEDS)
        };
        for &(i, a) in moving() {
            right[i] -= a * value;
            for &(j, b) in moving() {
                matrix[(i, j)] += a * b;
            }
        }
    }
    Some(Cholesky::new(matrix)?.solve(&right))
}
