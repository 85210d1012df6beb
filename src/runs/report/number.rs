//! Numbers in results: zero has no sign.

use planagent_score::metrics::MetricResult;
use serde::Serialize;
use serde_json::Value;

/// A number with this many decimals; a value that rounds to zero has no minus.
pub fn fixed(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    match text.strip_prefix('-') {
        Some(size) if size.chars().all(|c| matches!(c, '0' | '.')) => size.to_owned(),
        _ => text,
    }
}

/// A value as JSON without negative zeros.
pub fn json_value(value: &impl Serialize) -> serde_json::Result<Value> {
    let mut value = serde_json::to_value(value)?;
    remove_negative_zeros(&mut value);
    Ok(value)
}

/// Replaces −0 by 0 at any depth.
pub(super) fn remove_negative_zeros(value: &mut Value) {
    match value {
        Value::Array(values) => values.iter_mut().for_each(remove_negative_zeros),
        Value::Object(fields) => fields.values_mut().for_each(remove_negative_zeros),
        Value::Number(number) => {
            if let Some(float) = number.as_f64().filter(|_| number.is_f64()) {
                *value = positive_zero(float).into();
            }
        }
        Value::Null | Value::Bool(_) | Value::String(_) => {}
    }
}

/// A metric without negative zeros.
pub(super) fn without_negative_zeros(metric: &MetricResult) -> MetricResult {
    let mut metric = metric.clone();
    let series = metric
        .time_series
        .iter_mut()
        .flat_map(|series| &mut series.values);
    let statistics = metric
        .statistics
        .iter_mut()
        .map(|statistic| &mut statistic.value);
    for value in series.chain(statistics).chain(&mut metric.score) {
        *value = positive_zero(*value);
    }
    metric
}

/// The number itself, but 0 for −0.
pub(super) fn positive_zero(value: f64) -> f64 {
    // IEEE 754: −0 + 0 = +0; every other number stays.
    value + 0.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use planagent_score::metrics::{MetricSpec, Statistic, StatisticKind, TimeSeries};
    use serde_json::json;

    #[test]
    fn a_value_that_rounds_to_zero_has_no_minus() {
        let texts = [-0.0, -0.004, 0.004, -0.006, -10.0, 1.5].map(|value| fixed(value, 2));
        assert_eq!(texts, ["0.00", "0.00", "0.00", "-0.01", "-10.00", "1.50"]);
        assert_eq!(
            (fixed(-0.4, 0), fixed(f64::NAN, 1)),
            ("0".to_owned(), "NaN".to_owned())
        );
    }

    #[test]
    fn a_metric_has_no_negative_zero() {
        let series = TimeSeries {
            unit: "m".to_owned(),
            time_stamps: vec![0, 1],
            values: vec![-0.0, -1.0],
            selected_frames: None,
        };
        let statistics = vec![Statistic::new(StatisticKind::Min, "min", "m", -0.0)];
        let metric = MetricSpec::new("a", |_| Ok(None))
            .scored(-0.0, statistics)
            .with_series(series);
        let metric = without_negative_zeros(&metric);
        let values = metric
            .time_series
            .map(|series| series.values)
            .unwrap_or_default();
        let all: Vec<f64> = values
            .into_iter()
            .chain(metric.score)
            .chain(metric.statistics.iter().map(|s| s.value))
            .collect();
        assert_eq!(
            all.iter().map(f64::to_string).collect::<Vec<_>>(),
            ["0", "-1", "0", "0"]
        );
    }

    #[test]
    fn json_has_no_negative_zero_at_any_depth() {
        let value = json!({"a": -0.0, "b": [{"c": [-0.0, -1.5]}], "n": 0, "s": "-0.0"});
        assert_eq!(
            json_value(&value).unwrap().to_string(),
            r#"{"a":0.0,"b":[{"c":[0.0,-1.5]}],"n":0,"s":"-0.0"}"#
        );
    }
}
