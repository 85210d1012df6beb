//! The aggregation over scenarios: the devkit's own test
//! (`test_weighted_average_metric_aggregator.py`).

use planagent_score::metrics::{AggregateRow, FINAL_SCORE, ScenarioRow, Weighting, aggregate};

fn row(
    planner: &str,
    scenario: &str,
    scenario_type: &str,
    dummy: f64,
    second: Option<f64>,
) -> ScenarioRow {
    ScenarioRow {
        scenario: scenario.to_owned(),
        log_name: "log".to_owned(),
        scenario_type: scenario_type.to_owned(),
        planner: planner.to_owned(),
        metrics: vec![
            ("dummy_metric".to_owned(), Some(dummy)),
            ("second".to_owned(), second),
        ],
    }
}

fn column(rows: &[&AggregateRow], name: &str) -> Vec<Option<f64>> {
    rows.iter()
        .map(|r| {
            r.metrics
                .iter()
                .find(|(n, _)| n == name)
                .and_then(|&(_, v)| v)
        })
        .collect()
}

fn assert_close(found: &[Option<f64>], expected: &[Option<f64>]) {
    assert_eq!(found.len(), expected.len());
    for (f, e) in found.iter().zip(expected) {
        match (f, e) {
            (Some(f), Some(e)) => assert!((f - e).abs() < 1e-9, "{found:?} {expected:?}"),
            _ => assert_eq!(f, e),
        }
    }
}

#[test]
fn type_columns_are_sums_and_a_missing_value_counts_in_the_final_denominator() {
    let weighting = Weighting {
        multipliers: vec![],
        weights: vec![("dummy_metric".to_owned(), 0.5)],
        default_weight: 1.0,
    };
    let table = aggregate(
        &[
            row("simple_planner", "test_1", "unknown", 1.0, Some(0.1)),
            row(
                "dummy_planner",
                "test_2",
                "ego_stop_at_stop_line",
                0.5,
                None,
            ),
            row("dummy_planner", "test_3", "unknown", 0.8, Some(0.2)),
        ],
        &weighting,
    );
    let of = |planner: &str| {
        table
            .iter()
            .filter(|r| r.planner == planner)
            .collect::<Vec<_>>()
    };
    let scores = |rows: &[&AggregateRow]| rows.iter().map(|r| Some(r.score)).collect::<Vec<_>>();

    let dummy = of("dummy_planner");
    assert_close(
        &column(&dummy, "dummy_metric"),
        &[0.5, 0.8, 0.5, 0.8, 0.65].map(Some),
    );
    assert_close(
        &column(&dummy, "second"),
        &[None, Some(0.2), None, Some(0.2), Some(0.1)],
    );
    assert_close(&scores(&dummy), &[0.5, 0.4, 0.5, 0.4, 0.45].map(Some));
    assert_eq!(
        (dummy[4].scenario.as_str(), dummy[4].scenarios),
        (FINAL_SCORE, Some(2))
    );

    let simple = of("simple_planner");
    assert_close(&column(&simple, "dummy_metric"), &[1.0; 3].map(Some));
    assert_close(&column(&simple, "second"), &[0.1; 3].map(Some));
    assert_close(&scores(&simple), &[0.4; 3].map(Some));
}

#[test]
fn two_scenarios_of_a_type_sum_their_columns_but_average_their_score() {
    let weighting = Weighting {
        multipliers: vec![],
        weights: vec![],
        default_weight: 1.0,
    };
    let table = aggregate(
        &[
            row("p", "a", "t", 0.6, Some(0.6)),
            row("p", "b", "t", 1.0, Some(1.0)),
        ],
        &weighting,
    );
    assert_eq!(
        (table[2].scenario_type.as_str(), table[2].scenarios),
        ("t", Some(2))
    );
    assert_close(&column(&[&table[2]], "dummy_metric"), &[Some(1.6)]);
    assert!((table[2].score - 0.8).abs() < 1e-12);
    assert_close(&column(&[&table[3]], "dummy_metric"), &[Some(0.8)]);
}
