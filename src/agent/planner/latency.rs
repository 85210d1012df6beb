//! How long a planning call lasts in simulated time.

use serde::de::{Error, Visitor};
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use std::fmt;
use std::time::Duration;

/// How long a planning call lasts in simulated time. Written `"none"`, `"measured"` or a number of
/// milliseconds.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub enum Latency {
    /// No time passes: nuPlan's simulation waits for the planner.
    #[default]
    None,
    /// As long as it took. The result depends on the machine.
    Measured,
    /// Always this long.
    Fixed(Duration),
}

impl Latency {
    /// The simulated time that a call lasts which took `call_ms` milliseconds of wall time, µs.
    pub(super) fn micros(self, call_ms: f64) -> i64 {
        match self {
            Self::None => 0,
            Self::Measured => (call_ms * 1e3).round() as i64,
            Self::Fixed(duration) => duration.as_micros() as i64,
        }
    }
}

impl Serialize for Latency {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::None => serializer.serialize_str("none"),
            Self::Measured => serializer.serialize_str("measured"),
            Self::Fixed(duration) => serializer.serialize_u64(duration.as_millis() as u64),
        }
    }
}

impl<'de> Deserialize<'de> for Latency {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(LatencyVisitor)
    }
}

struct LatencyVisitor;

impl Visitor<'_> for LatencyVisitor {
    type Value = Latency;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("\"none\", \"measured\" or a whole number of milliseconds")
    }

    fn visit_str<E: Error>(self, word: &str) -> Result<Latency, E> {
        match word {
            "none" => Ok(Latency::None),
            "measured" => Ok(Latency::Measured),
            other => Err(E::invalid_value(serde::de::Unexpected::Str(other), &self)),
        }
    }

    fn visit_u64<E: Error>(self, milliseconds: u64) -> Result<Latency, E> {
        Ok(Latency::Fixed(Duration::from_millis(milliseconds)))
    }

    fn visit_i64<E: Error>(self, milliseconds: i64) -> Result<Latency, E> {
        let unexpected = || E::invalid_value(serde::de::Unexpected::Signed(milliseconds), &self);
        u64::try_from(milliseconds)
            .map_err(|_| unexpected())
            .and_then(|milliseconds| self.visit_u64(milliseconds))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    struct Held {
        latency: Latency,
    }

    #[test]
    fn it_is_read_and_written() {
        for (text, latency) in [
            ("latency = \"none\"\n", Latency::None),
            ("latency = \"measured\"\n", Latency::Measured),
            (
                "latency = 5568\n",
                Latency::Fixed(Duration::from_millis(5568)),
            ),
        ] {
            let held: Held = toml::from_str(text).unwrap();
            assert_eq!(held, Held { latency });
            assert_eq!(toml::to_string(&held).unwrap(), text);
        }
        for wrong in ["latency = \"slow\"", "latency = -1", "latency = true"] {
            let error = toml::from_str::<Held>(wrong).unwrap_err().to_string();
            assert!(
                error.contains("a whole number of milliseconds"),
                "{wrong}: {error}"
            );
        }
    }

    #[test]
    fn a_measured_call_lasts_its_wall_time() {
        let fixed = Latency::Fixed(Duration::from_millis(5568));
        let lasts = [Latency::None, Latency::Measured, fixed].map(|latency| latency.micros(230.5));
        assert_eq!(lasts, [0, 230_500, 5_568_000]);
    }
}
