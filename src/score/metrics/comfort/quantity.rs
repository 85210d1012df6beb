//! The quantities of comfort with nuPlan's names, filters and bounds (devkit
//! `ego_*acceleration.py`, `ego_*jerk.py`, `ego_yaw_*.py`, `within_bound_metric_base.py`,
//! `state_extractors.py`).

use super::savgol::{SavitzkyGolay, differentiated, mean_step_s, smoothed};
use crate::metrics::{
    MetricCategory, MetricError, MetricInput, MetricList, MetricResult, MetricSpec, Statistic,
    TimeSeries,
};
use planagent_world::EgoState;
use planagent_world::geometry::unwrap_angles;

/// Window of the acceleration filter, samples. It is even, which shifts the signal by half a
/// sample; nuPlan's value.
pub(crate) const ACCELERATION_WINDOW: usize = 8;
/// Window of the jerk filter, samples.
const JERK_WINDOW: usize = 15;
/// Window of the yaw filters, samples. The devkit declares 15 but never passes it on.
pub(crate) const YAW_WINDOW: usize = 5;

/// Open bounds: a value must lie strictly between them.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bound {
    /// Lower bound, in the unit of the quantity.
    pub min: f64,
    /// Upper bound, in the unit of the quantity.
    pub max: f64,
}

impl Bound {
    /// Bounds on the magnitude.
    pub const fn magnitude(limit: f64) -> Self {
        Self {
            min: -limit,
            max: limit,
        }
    }

    /// Whether all values lie strictly within.
    pub fn holds(&self, values: &[f64]) -> bool {
        values.iter().all(|&v| v > self.min && v < self.max)
    }
}

/// A signal of the ego's motion that nuPlan filters and reports.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ComfortQuantity {
    /// Norm of the rear-axle acceleration; unbounded.
    Acceleration,
    /// Forward acceleration of the center.
    LonAcceleration,
    /// Sideways acceleration of the center.
    LatAcceleration,
    /// Derivative of the norm of the rear-axle acceleration.
    Jerk,
    /// Derivative of the forward acceleration.
    LonJerk,
    /// Derivative of the sideways acceleration; unbounded.
    LatJerk,
    /// Derivative of the heading.
    YawRate,
    /// Second derivative of the heading.
    YawAcceleration,
}

impl ComfortQuantity {
    /// All, in nuPlan's order.
    pub const ALL: [Self; 8] = [
        Self::Jerk,
        Self::LatJerk,
        Self::LonJerk,
        Self::Acceleration,
        Self::LatAcceleration,
        Self::LonAcceleration,
        Self::YawAcceleration,
        Self::YawRate,
    ];

    /// nuPlan's name of the metric.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Acceleration => "ego_acceleration",
            Self::LonAcceleration => "ego_lon_acceleration",
            Self::LatAcceleration => "ego_lat_acceleration",
            Self::Jerk => "ego_jerk",
            Self::LonJerk => "ego_lon_jerk",
            Self::LatJerk => "ego_lat_jerk",
            Self::YawRate => "ego_yaw_rate",
            Self::YawAcceleration => "ego_yaw_acceleration",
        }
    }

    /// nuPlan's name of its unit.
    pub const fn unit(self) -> &'static str {
        match self {
            Self::Acceleration | Self::LonAcceleration | Self::LatAcceleration => {
                "meters_per_second_squared"
            }
            Self::Jerk | Self::LonJerk | Self::LatJerk => "meters_per_second_cubed",
            Self::YawRate => "radians_per_second",
            Self::YawAcceleration => "radians_per_second_squared",
        }
    }

    /// The bounds of comfort, SI units (devkit `simulation_metric/low_level/*.yaml`); `None` for
    /// quantities that are only reported.
    pub const fn bound(self) -> Option<Bound> {
        match self {
            Self::LonAcceleration => Some(Bound {
                min: -4.05,
                max: 2.40,
            }),
            Self::LatAcceleration => Some(Bound::magnitude(4.89)),
            Self::Jerk => Some(Bound::magnitude(8.37)),
            Self::LonJerk => Some(Bound::magnitude(4.13)),
            Self::YawRate => Some(Bound::magnitude(0.95)),
            Self::YawAcceleration => Some(Bound::magnitude(1.93)),
            Self::Acceleration | Self::LatJerk => None,
        }
    }

    /// The filtered signal along a sequence of states.
    pub fn signal(self, states: &[EgoState]) -> Result<Vec<f64>, MetricError> {
        let of = |read: fn(&EgoState) -> f64| states.iter().map(read).collect::<Vec<f64>>();
        let step = mean_step_s(states);
        // nuPlan differentiates the acceleration that is already smoothed, so its jerk is filtered
        // twice.
        let jerk_of = |acceleration: Self| {
            let filter = SavitzkyGolay {
                window: JERK_WINDOW,
                order: 2,
                derivative: 1,
            };
            differentiated(&acceleration.signal(states)?, step, filter)
        };
        let heading = || unwrap_angles(&of(|s| s.rear_axle.heading));
        match self {
            Self::Acceleration => smoothed(&of(|s| s.acceleration.norm()), ACCELERATION_WINDOW),
            Self::LonAcceleration => {
                smoothed(&of(|s| s.center_acceleration().x), ACCELERATION_WINDOW)
            }
            Self::LatAcceleration => {
                smoothed(&of(|s| s.center_acceleration().y), ACCELERATION_WINDOW)
            }
            Self::Jerk => jerk_of(Self::Acceleration),
            Self::LonJerk => jerk_of(Self::LonAcceleration),
            Self::LatJerk => jerk_of(Self::LatAcceleration),
            Self::YawRate => differentiated(
                &heading(),
                step,
                SavitzkyGolay {
                    window: YAW_WINDOW,
                    order: 2,
                    derivative: 1,
                },
            ),
            Self::YawAcceleration => differentiated(
                &heading(),
                step,
                SavitzkyGolay {
                    window: YAW_WINDOW,
                    order: 3,
                    derivative: 2,
                },
            ),
        }
    }

    /// The quantity as a metric without score: its statistics, and whether it stays within its
    /// bounds.
    pub fn evaluate(self, states: &[EgoState]) -> Result<MetricResult, MetricError> {
        let name = self.name();
        let series = TimeSeries::of_states(self.unit(), states, self.signal(states)?);
        let mut statistics = series.statistics(name);
        if let Some(bound) = self.bound() {
            statistics.push(Statistic::boolean(
                format!("abs_{name}_within_bounds"),
                bound.holds(&series.values),
            ));
        }
        Ok(MetricResult::unscored(name, MetricCategory::Dynamics, statistics).with_series(series))
    }
}

const fn spec(
    quantity: ComfortQuantity,
    compute: fn(&MetricInput<'_>) -> Result<Option<MetricResult>, MetricError>,
) -> MetricSpec {
    let spec = MetricSpec::new(quantity.name(), compute)
        .only(MetricList::ClosedLoop)
        .category(MetricCategory::Dynamics);
    match quantity.bound() {
        Some(bound) => spec.bounds(Some(bound.min), Some(bound.max)),
        None => spec,
    }
}

macro_rules! specs {
    ($($name:ident $quantity:ident),* $(,)?) => {
        $(pub(in crate::metrics) const $name: MetricSpec = spec(ComfortQuantity::$quantity, |input| {
            ComfortQuantity::$quantity.evaluate(input.states()).map(Some)
        });)*
    };
}

specs! {
    JERK Jerk,
    LAT_JERK LatJerk,
    LON_JERK LonJerk,
    ACCELERATION Acceleration,
    LAT_ACCELERATION LatAcceleration,
    LON_ACCELERATION LonAcceleration,
    YAW_ACCELERATION YawAcceleration,
    YAW_RATE YawRate,
}
