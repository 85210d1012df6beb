//! Sequences of numbers as whole multiples of a unit. Each number is stored as its difference from
//! the previous one, which is short as text and compresses well.

use planagent_world::geometry::Point;
use serde::{Deserialize, Serialize};

/// Unit of lengths, meters.
pub(super) const LENGTH: f64 = 0.01;

/// A sequence: its first number, then the differences, in whole units.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(transparent)]
pub(super) struct Deltas(Vec<i64>);

impl Deltas {
    /// The numbers, rounded to multiples of `unit`.
    pub(super) fn from_values(values: impl IntoIterator<Item = f64>, unit: f64) -> Self {
        let mut last = 0;
        let delta = |value: f64| {
            let whole = (value / unit).round() as i64;
            whole - std::mem::replace(&mut last, whole)
        };
        Self(values.into_iter().map(delta).collect())
    }

    /// The numbers.
    pub(super) fn values(&self, unit: f64) -> impl Iterator<Item = f64> + '_ {
        self.0.iter().scan(0i64, move |sum, delta| {
            *sum = sum.saturating_add(*delta);
            Some(*sum as f64 * unit)
        })
    }
}

/// Points in order, map frame, whole centimeters.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
pub(super) struct Points {
    x: Deltas,
    y: Deltas,
}

impl Points {
    /// The points, rounded.
    pub(super) fn from_points(points: &[Point]) -> Self {
        let along = |axis: fn(&Point) -> f64| Deltas::from_values(points.iter().map(axis), LENGTH);
        Self {
            x: along(|p| p.x),
            y: along(|p| p.y),
        }
    }

    /// The points.
    pub(super) fn points(&self) -> impl Iterator<Item = Point> + '_ {
        self.x
            .values(LENGTH)
            .zip(self.y.values(LENGTH))
            .map(|(x, y)| Point::new(x, y))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_come_back_rounded_and_errors_do_not_add_up() {
        let values: Vec<f64> = (0..1000).map(|i| f64::from(i) * 0.0333 - 7.0).collect();
        let deltas = Deltas::from_values(values.iter().copied(), 0.01);
        assert!(
            deltas
                .values(0.01)
                .zip(&values)
                .all(|(got, want)| (got - want).abs() <= 0.005 + 1e-9)
        );
        assert_eq!(
            serde_json::to_string(&Deltas::from_values([1.0, 1.5, 1.25], 0.01)).unwrap(),
            "[100,50,-25]"
        );
        let wild: Deltas =
            serde_json::from_str("[9223372036854775807,9223372036854775807]").unwrap();
        assert_eq!(wild.values(1.0).count(), 2);
    }
}
