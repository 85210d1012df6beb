//! Numbers of a modification: fixed, or drawn for each scene.

use super::draws::Draws;
use super::fault::Fault;
use serde::de::{Error, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer};
use std::fmt;
use std::ops::RangeInclusive;

/// A number, or the bounds between which each scene draws one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Number {
    low: f64,
    high: f64,
}

impl Number {
    pub(super) const fn fixed(value: f64) -> Self {
        Self {
            low: value,
            high: value,
        }
    }

    pub(super) const fn between(low: f64, high: f64) -> Self {
        Self { low, high }
    }

    /// The number of a scene. A fixed one draws nothing.
    pub(super) fn draw(self, draws: &mut Draws) -> f64 {
        if self.low < self.high {
            draws.uniform(self.low, self.high)
        } else {
            self.low
        }
    }

    /// A whole number of a scene, both bounds included.
    pub(super) fn draw_whole(self, draws: &mut Draws) -> i32 {
        let (low, high) = (self.low.round() as i32, self.high.round() as i32);
        if low < high {
            draws.whole(low, high)
        } else {
            low
        }
    }

    /// Refuses a number outside the bounds of its field.
    pub(super) fn check(
        self,
        field: &'static str,
        bounds: RangeInclusive<f64>,
    ) -> Result<(), Fault> {
        if bounds.contains(&self.low) && bounds.contains(&self.high) {
            return Ok(());
        }
        let (least, most) = (bounds.start(), bounds.end());
        Err(Fault::new(
            field,
            format!("{self} must be from {least} to {most}"),
        ))
    }
}

impl fmt::Display for Number {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if self.low < self.high {
            write!(f, "[{}, {}]", self.low, self.high)
        } else {
            write!(f, "{}", self.low)
        }
    }
}

impl<'de> Deserialize<'de> for Number {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        // A visitor, because serde's untagged enums would only say that no variant fits.
        struct Reader;

        impl<'de> Visitor<'de> for Reader {
            type Value = Number;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a number, or [LOW, HIGH]")
            }

            fn visit_f64<E: Error>(self, value: f64) -> Result<Number, E> {
                if value.is_finite() {
                    Ok(Number::fixed(value))
                } else {
                    Err(E::custom("the number is not finite"))
                }
            }

            fn visit_i64<E: Error>(self, value: i64) -> Result<Number, E> {
                self.visit_f64(value as f64)
            }

            fn visit_u64<E: Error>(self, value: u64) -> Result<Number, E> {
                self.visit_f64(value as f64)
            }

            fn visit_seq<A: SeqAccess<'de>>(self, mut sequence: A) -> Result<Number, A::Error> {
                let mut next = || sequence.next_element::<Number>();
                match (next()?, next()?, next()?) {
                    (Some(low), Some(high), None) if low.low <= high.high => {
                        Ok(Number::between(low.low, high.high))
                    }
                    _ => Err(A::Error::custom(
                        "expected two numbers, the lower one first",
                    )),
                }
            }
        }

        deserializer.deserialize_any(Reader)
    }
}
