//! Smallest, middle and largest of measurements.

use serde::Serialize;

/// Median and extremes.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Spread {
    /// For an even number of values the mean of the middle two.
    pub median: f64,
    /// Smallest value.
    pub min: f64,
    /// Largest value.
    pub max: f64,
}

impl Spread {
    /// `None` without values.
    pub fn from_values(mut values: Vec<f64>) -> Option<Self> {
        values.sort_by(f64::total_cmp);
        let (min, max) = (*values.first()?, *values.last()?);
        let middle = |place: usize| values.get(place).copied().unwrap_or(max);
        let median = f64::midpoint(middle((values.len() - 1) / 2), middle(values.len() / 2));
        Some(Self { median, min, max })
    }
}
