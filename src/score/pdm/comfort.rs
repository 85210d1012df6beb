//! The comfort term of a proposal: nuPlan's bounds on differently filtered signals (`tuplan_garage`
//! `pdm_comfort_metrics.py`).

use crate::metrics::{
    ACCELERATION_WINDOW, ComfortQuantity, MetricError, SavitzkyGolay, YAW_WINDOW, mean_step_s,
};
use planagent_world::EgoState;
use planagent_world::geometry::unwrap_angles;
use std::collections::HashMap;
use std::sync::{Arc, LazyLock, PoisonError, RwLock};

/// Whether the six bounded quantities stay strictly within nuPlan's bounds. Accelerations are those
/// of the rear axle, smoothed by a single quadratic over all states. Jerks are the derivative of a
/// single quadratic over the acceleration smoothed with nuPlan's window.
///
/// # Errors
/// When there are fewer than 4 states.
pub(crate) fn is_comfortable(states: &[EgoState]) -> Result<bool, MetricError> {
    Filters::of_length(states.len()).map(|filters| filters.is_comfortable(states))
}

/// The filters of all quantities for a number of states.
struct Filters {
    smooth: Filter,
    short: Filter,
    slope: Filter,
    yaw_rate: Filter,
    yaw_acceleration: Filter,
}

impl Filters {
    /// Those of a number of states, made once, since making them takes longer than all the rest of a
    /// score.
    fn of_length(states: usize) -> Result<Arc<Self>, MetricError> {
        static MADE: LazyLock<RwLock<HashMap<usize, Arc<Filters>>>> =
            LazyLock::new(RwLock::default);
        let made = MADE.read().unwrap_or_else(PoisonError::into_inner);
        if let Some(filters) = made.get(&states) {
            return Ok(Arc::clone(filters));
        }
        drop(made);
        let filters = Arc::new(Self::new(states)?);
        let mut made = MADE.write().unwrap_or_else(PoisonError::into_inner);
        Ok(Arc::clone(made.entry(states).or_insert(filters)))
    }

    fn new(states: usize) -> Result<Self, MetricError> {
        let filter = |window, order, derivative| {
            Filter::new(
                SavitzkyGolay {
                    window,
                    order,
                    derivative,
                },
                states,
            )
        };
        Ok(Self {
            yaw_acceleration: filter(YAW_WINDOW, 3, 2)?,
            yaw_rate: filter(YAW_WINDOW, 2, 1)?,
            slope: filter(states, 2, 1)?,
            short: filter(ACCELERATION_WINDOW, 2, 0)?,
            smooth: filter(states, 2, 0)?,
        })
    }

    fn is_comfortable(&self, states: &[EgoState]) -> bool {
        let of = |read: fn(&EgoState) -> f64| states.iter().map(read).collect::<Vec<f64>>();
        let step = mean_step_s(states);
        let jerk = |acceleration: &[f64]| {
            self.slope
                .apply(&self.short.apply(acceleration, step), step)
        };
        let holds = |quantity: ComfortQuantity, values: &[f64]| {
            quantity.bound().is_none_or(|b| b.holds(values))
        };
        let (forward, headings) = (
            of(|s| s.acceleration.x),
            unwrap_angles(&of(|s| s.rear_axle.heading)),
        );
        // `&&` spares the filters behind the first bound that is exceeded.
        holds(
            ComfortQuantity::LonAcceleration,
            &self.smooth.apply(&forward, step),
        ) && holds(
            ComfortQuantity::LatAcceleration,
            &self.smooth.apply(&of(|s| s.acceleration.y), step),
        ) && holds(ComfortQuantity::Jerk, &jerk(&of(|s| s.acceleration.norm())))
            && holds(ComfortQuantity::LonJerk, &jerk(&forward))
            && holds(
                ComfortQuantity::YawRate,
                &self.yaw_rate.apply(&headings, step),
            )
            && holds(
                ComfortQuantity::YawAcceleration,
                &self.yaw_acceleration.apply(&headings, step),
            )
    }
}

/// A Savitzky-Golay filter as the weights of each of its outputs.
struct Filter {
    /// For each output the first input that counts, and the weights from it on, for steps of one
    /// second.
    rows: Vec<(usize, Vec<f64>)>,
    derivative: i32,
}

impl Filter {
    /// Reads the weights off the answers to impulses.
    fn new(filter: SavitzkyGolay, samples: usize) -> Result<Self, MetricError> {
        let answers = (0..samples.max(1)).map(|sample| {
            let impulse: Vec<f64> = (0..samples)
                .map(|i| f64::from(u8::from(i == sample)))
                .collect();
            filter.apply(&impulse, 1.0)
        });
        let answers: Vec<Vec<f64>> = answers.collect::<Result<_, _>>()?;
        let rows = (0..samples).map(|output| {
            let weights: Vec<f64> = answers.iter().map(|answer| answer[output]).collect();
            let first = weights.iter().position(|&w| w != 0.0).unwrap_or(0);
            let end = weights
                .iter()
                .rposition(|&w| w != 0.0)
                .map_or(first, |last| last + 1);
            (first, weights[first..end].to_vec())
        });
        Ok(Self {
            rows: rows.collect(),
            derivative: filter.derivative as i32,
        })
    }

    /// The filtered signal, sampled every `step` seconds, rounded to 8 decimals as nuPlan rounds.
    fn apply(&self, values: &[f64], step: f64) -> Vec<f64> {
        /// 8 decimals.
        const SCALE: f64 = 1e8;
        let unit = step.powi(self.derivative);
        let output = |(first, weights): &(usize, Vec<f64>)| {
            let sum: f64 = weights
                .iter()
                .zip(&values[*first..])
                .map(|(w, v)| w * v)
                .sum();
            (sum / unit * SCALE).round_ties_even() / SCALE
        };
        self.rows.iter().map(output).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metrics::{differentiated, smoothed};

    #[test]
    fn the_filters_of_each_length_are_made_once() {
        for states in [41, 81] {
            let [first, second] = [(); 2].map(|()| Filters::of_length(states).unwrap());
            assert!(Arc::ptr_eq(&first, &second), "{states}");
            assert_eq!(first.smooth.rows.len(), states);
        }
        assert!(Filters::of_length(3).is_err());
    }

    #[test]
    fn the_weights_are_those_of_the_general_filter() {
        let values: Vec<f64> = (0..41).map(|i| (f64::from(i) * 0.37).sin() * 3.0).collect();
        let filters = Filters::new(41).unwrap();
        let same = |a: Vec<f64>, b: Vec<f64>| {
            a.iter().zip(&b).all(|(a, b)| (a - b).abs() < 1e-7) && a.len() == b.len()
        };
        assert!(same(
            filters.smooth.apply(&values, 0.1),
            smoothed(&values, 41).unwrap()
        ));
        assert!(same(
            filters.short.apply(&values, 0.1),
            smoothed(&values, ACCELERATION_WINDOW).unwrap()
        ));
        let bend = SavitzkyGolay {
            window: YAW_WINDOW,
            order: 3,
            derivative: 2,
        };
        assert!(same(
            filters.yaw_acceleration.apply(&values, 0.1),
            differentiated(&values, 0.1, bend).unwrap()
        ));
        assert!(Filters::new(3).is_err());
    }
}
