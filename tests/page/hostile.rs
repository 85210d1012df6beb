//! The page of a run whose names and numbers a stranger wrote, in a browser.

use super::chromium::Chromium;
use super::{scenes, simulate};
use crate::cli::run;
use crate::outside::Needy;
use crate::runner::simulations;
use regex::Regex;
use std::fs;
use std::path::Path;
use tempfile::TempDir;

/// What a browser would obey.
const NAME: &str =
    "turn\u{202e}tfel\u{2066}\u{61c}\u{e0041}<img src=x onerror='document.body.innerHTML=1'>";

/// Replaces names of a record, and each statistic of its metrics by a wild number.
fn make_hostile(simulation: &Path, wild: &str) {
    let record = simulation.join("record.toml");
    let text = fs::read_to_string(&record).unwrap();
    let name = toml::Value::String(NAME.to_owned());
    let named = Regex::new(r"(?m)^(scenario|scenario_type|log_name) = .*$").unwrap();
    let text = named.replace_all(&text, |found: &regex::Captures<'_>| {
        format!("{} = {name}", &found[1])
    });
    // The digests of the other files are those of before.
    let files = Regex::new(r"(?ms)^\[files\]\n.*?(\n\[|\z)").unwrap();
    fs::write(&record, files.replace(&text, "$1").as_bytes()).unwrap();
    let metrics = simulation.join("metrics.toml");
    let text = fs::read_to_string(&metrics).unwrap();
    let numbers = Regex::new(r"(?m)^value = [-0-9.e+]+$").unwrap();
    assert!(numbers.is_match(&text), "{text}");
    fs::write(
        &metrics,
        numbers
            .replace_all(&text, format!("value = {wild}"))
            .as_bytes(),
    )
    .unwrap();
}

#[test]
fn names_are_shown_and_wild_numbers_leave_the_page_whole() -> Needy {
    let program = Chromium::program()?;
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("run");
    simulate(&out, &scenes(4), "log-replay,idm");
    let all = simulations(&out);
    for (simulation, wild) in all.iter().zip(["1e308", "nan", "-inf", "-1e308"]) {
        make_hostile(simulation, wild);
    }
    let (code, _, stderr) = run(&["report", out.to_str().unwrap()]);
    assert_eq!(code, 0, "{stderr}");
    let page = out.join("report.html");
    let mut browser = Chromium::start(&program);
    for fragment in [
        "overview",
        "histograms",
        "scenarios",
        "scenarios/0/0",
        "scenarios/0/1",
    ] {
        browser.open(&page, fragment);
        assert_eq!(
            browser.value("document.getElementById('trouble').hidden"),
            true,
            "{fragment}"
        );
        let obeyed = "/[\\u061c\\u200e\\u200f\\u202a-\\u202e\\u2066-\\u2069]|\\p{Cf}/u.test(document.body.innerText)";
        assert_eq!(browser.value(obeyed), false, "{fragment}");
        let titles = "[...document.querySelectorAll('[title], [aria-label]')].some((node) => \
                      /[\\u061c\\u202a-\\u202e\\u2066-\\u2069]/.test(node.title + node.ariaLabel))";
        assert_eq!(browser.value(titles), false, "{fragment}");
        assert_eq!(
            browser.value("document.querySelectorAll('img[src=x]').length"),
            0
        );
    }
    let shown = browser.value("document.body.innerText.includes('turn\\\\u202etfel\\\\u2066')");
    assert_eq!(shown, true);
    assert_eq!(browser.errors(), [""; 0]);
    assert_eq!(browser.requests(), [""; 0]);
    Ok(())
}
