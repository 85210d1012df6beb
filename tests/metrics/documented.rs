//! The tables of `docs/metrics.md` are measured: they are computed again and compared with the
//! file.

use super::{comfort, devkit};
use crate::outside::{Missing, Needy};
use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::{Path, PathBuf};

/// Set to `1`, this variable has the tables written into the file instead of compared with it.
const UPDATE: &str = "PLANAGENT_UPDATE_DOCS";
const BEGIN: &str = "<!-- measured: begin -->\n";
const END: &str = "<!-- measured: end -->\n";

/// A bound that holds on any machine: the next power of ten above.
fn power_of_ten(deviation: f64) -> String {
    if deviation > 0.0 {
        format!("< 1e{}", deviation.log10().floor() as i32 + 1)
    } else {
        "0".to_owned()
    }
}

/// The deviations from the devkit's vectors, measured.
fn of_vectors() -> Result<String, Missing> {
    let mut by_metric: BTreeMap<String, (usize, f64)> = BTreeMap::new();
    for vector in devkit::all()? {
        let (count, worst) = by_metric.entry(vector.metric).or_default();
        *count += 1;
        *worst = worst.max(vector.worst);
    }
    let mut text =
        "| metric | devkit vectors | tolerance | worst deviation |\n|---|---|---|---|\n".to_owned();
    for (metric, (count, worst)) in by_metric {
        writeln!(
            text,
            "| `{metric}` | {count} | {} | {worst:.4} |",
            devkit::TOLERANCE
        )
        .unwrap();
    }
    Ok(text)
}

/// The deviations of signals, measured.
fn of_signals() -> String {
    let mut text =
        "\n| signal | reference | tolerance | worst deviation |\n|---|---|---|---|\n".to_owned();
    let tolerance = "1e-8";
    assert!((comfort::TOLERANCE - 1e-8).abs() < 1e-20);
    for (filter, sequences, worst) in comfort::filters() {
        let reference = format!("`savgol.json`, {sequences} sequences");
        writeln!(
            text,
            "| filter `{filter}` | {reference} | {tolerance} | {} |",
            power_of_ten(worst)
        )
        .unwrap();
    }
    for (metric, worst) in comfort::extractors() {
        let reference = "`comfort_extractors.json`, 149 states";
        writeln!(
            text,
            "| `{metric}` | {reference} | {tolerance} | {} |",
            power_of_ten(worst)
        )
        .unwrap();
    }
    text
}

fn page() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/metrics.md")
}

#[test]
fn the_deviations_in_the_documentation_are_those_measured() -> Needy {
    let measured = of_vectors()? + &of_signals();
    let text = std::fs::read_to_string(page()).unwrap();
    let (before, rest) = text.split_once(BEGIN).unwrap();
    let (committed, after) = rest.split_once(END).unwrap();
    if std::env::var_os(UPDATE).is_some_and(|value| value == "1") {
        std::fs::write(page(), format!("{before}{BEGIN}{measured}{END}{after}")).unwrap();
        return Ok(());
    }
    assert_eq!(
        committed, measured,
        "docs/metrics.md is out of date: {UPDATE}=1 cargo test --test tests metrics::documented"
    );
    Ok(())
}

/// The second table needs no vectors of the devkit.
#[test]
fn the_deviations_of_signals_in_the_documentation_are_those_measured() {
    let text = std::fs::read_to_string(page()).unwrap();
    let measured = of_signals() + END;
    assert!(
        text.contains(&measured),
        "docs/metrics.md lacks:\n{measured}"
    );
}

/// The tests that the second table of the file names exist.
#[test]
fn the_worked_cases_that_the_documentation_names_exist() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let text = std::fs::read_to_string(root.join("docs/metrics.md")).unwrap();
    let mut named = 0;
    for word in text
        .split('`')
        .filter(|word| word.starts_with("tests/") && word.contains("::"))
    {
        let (file, test) = word.split_once("::").unwrap();
        let source = std::fs::read_to_string(root.join(file))
            .unwrap_or_else(|error| panic!("{file}: {error}"));
        assert!(source.contains(&format!("fn {test}()")), "{word}");
        named += 1;
    }
    assert!(named > 20, "{named}");
}
