//! Numbers and names of records, which may come from elsewhere. One beyond what a simulation can
//! give makes its record a damaged one: it costs one row, and no table or page computes with it.

use super::limits::MAX_NAME_BYTES;
use serde::de::{Deserialize, Deserializer, Error};
use std::collections::BTreeMap;

/// Largest count of a simulation. Real ones are below a thousand.
const MAX_COUNT: usize = 1_000_000_000;
/// Longest time: moments in seconds since 1970 and times of calls in milliseconds are below.
const MAX_TIME: f64 = 1e12;

/// Characters of a long name that an error shows.
const SHOWN_CHARS: usize = 40;

/// A score from 0 to 1, or none.
pub(super) fn score<'de, D: Deserializer<'de>>(source: D) -> Result<Option<f64>, D::Error> {
    let score = Option::<f64>::deserialize(source)?;
    match score {
        // Also true for NaN.
        Some(value) if !(0.0..=1.0).contains(&value) => Err(D::Error::custom(format!(
            "the score is {value:e}; it must be from 0 to 1"
        ))),
        _ => Ok(score),
    }
}

/// A count.
pub(super) fn count<'de, D: Deserializer<'de>>(source: D) -> Result<usize, D::Error> {
    checked_count(usize::deserialize(source)?)
}

/// Counts by what was counted.
pub(super) fn counts<'de, D, K>(source: D) -> Result<BTreeMap<K, usize>, D::Error>
where
    D: Deserializer<'de>,
    K: Deserialize<'de> + Ord,
{
    BTreeMap::<K, usize>::deserialize(source)?
        .into_iter()
        .map(|(counted, count)| Ok((counted, checked_count(count)?)))
        .collect()
}

fn checked_count<E: Error>(count: usize) -> Result<usize, E> {
    if count > MAX_COUNT {
        return Err(E::custom(format!(
            "the count is {count}; it must be at most {MAX_COUNT}"
        )));
    }
    Ok(count)
}

/// A name of a scenario, a log or a scenario type.
pub(super) fn name<'de, D: Deserializer<'de>>(source: D) -> Result<String, D::Error> {
    let name = String::deserialize(source)?;
    if name.len() > MAX_NAME_BYTES {
        let begin: String = name.chars().take(SHOWN_CHARS).collect();
        return Err(D::Error::custom(format!(
            "the name '{begin}…' has {} bytes; it may have {MAX_NAME_BYTES}",
            name.len()
        )));
    }
    Ok(name)
}

/// A time.
pub(super) fn time<'de, D: Deserializer<'de>>(source: D) -> Result<f64, D::Error> {
    checked_time(f64::deserialize(source)?)
}

/// Times.
pub(super) fn times<'de, D: Deserializer<'de>>(source: D) -> Result<Vec<f64>, D::Error> {
    Vec::<f64>::deserialize(source)?
        .into_iter()
        .map(checked_time)
        .collect()
}

fn checked_time<E: Error>(time: f64) -> Result<f64, E> {
    // Also true for NaN.
    if !(-MAX_TIME..=MAX_TIME).contains(&time) {
        return Err(E::custom(format!(
            "the time is {time:e}; it must be at most {MAX_TIME:e}"
        )));
    }
    Ok(time)
}

#[cfg(test)]
mod tests {
    use crate::report::SimulationRow;
    use planagent_agent::simulation::Challenge;

    /// A row whose number at `field` is `wild`, as `record.toml` has it.
    fn read(field: &str, wild: &str) -> Result<SimulationRow, toml::de::Error> {
        let row = SimulationRow::example("turn", 3, "idm", Challenge::Reactive, Some(0.5));
        let text = toml::to_string(&row).unwrap();
        let (key, _) = field.split_once(" =").unwrap_or((field, ""));
        assert!(text.contains(&format!("{key} = ")), "no {key} in {text}");
        let line = |line: &str| {
            if line.starts_with(&format!("{key} = ")) {
                format!("{key} = {wild}\n")
            } else {
                format!("{line}\n")
            }
        };
        toml::from_str(&text.lines().map(line).collect::<String>())
    }

    #[test]
    fn a_wild_number_of_a_record_is_refused_by_its_value() {
        for field in ["score", "rethinks", "planning_calls", "parse_errors"] {
            assert!(read(field, if field == "score" { "0.75" } else { "7" }).is_ok());
        }
        for wild in ["nan", "inf", "-inf", "1e308", "-1e308", "1.0000001", "-0.5"] {
            let error = read("score", wild).unwrap_err().to_string();
            assert!(error.contains("it must be from 0 to 1"), "{wild}: {error}");
        }
        for field in ["planning_calls", "refused_calls", "rethinks", "deadlines"] {
            let error = read(field, "9223372036854775807").unwrap_err().to_string();
            assert!(error.contains("9223372036854775807"), "{field}: {error}");
        }
        let long = format!("\"{}\"", "x".repeat(10_000));
        for field in ["source", "scenario", "scenario_type", "log_name"] {
            let error = read(field, &long).unwrap_err().to_string();
            assert!(error.contains("has 10000 bytes"), "{field}: {error}");
            assert!(error.lines().last().is_some_and(|line| line.len() < 500));
        }
        for wild in ["nan", "1e308", "-inf"] {
            for field in ["started_s", "ended_s"] {
                let error = read(field, wild).unwrap_err().to_string();
                assert!(error.contains("the time is"), "{field}: {error}");
            }
            let error = read("planner_s", &format!("[0.1, {wild}]")).unwrap_err();
            assert!(error.to_string().contains("the time is"), "{error}");
        }
    }
}
