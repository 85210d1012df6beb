//! The page in a browser.

use super::chromium::Chromium;
use super::{scenes, simulate};
use crate::cli::run;
use crate::outside::Needy;
use serde_json::{Value, json};
use std::fs;
use std::path::Path;
use tempfile::TempDir;

/// Number of scenarios of the run.
const SCENARIOS: usize = 20;
/// Maximum size of its page, bytes.
const MAX_BYTES: u64 = 15_000_000;
/// The time of the page's player.
const NOW: &str = "scenarios.player.time";

#[test]
fn the_page_of_a_run_plays_scrubs_and_shows_the_last_call() -> Needy {
    let program = Chromium::program()?;
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("run");
    simulate(&out, &scenes(SCENARIOS), "plan-agent,log-replay");
    let (code, stdout, stderr) = run(&["report", out.to_str().unwrap()]);
    assert_eq!(code, 0, "{stderr}");
    let page = out.join("report.html");
    assert_eq!(stdout.trim(), page.to_str().unwrap());
    let bytes = fs::metadata(&page).unwrap().len();
    assert!(bytes <= MAX_BYTES, "{bytes} bytes");

    let mut browser = Chromium::start(&program);
    tables(&mut browser, &page);
    replay(&mut browser, &page, &out);
    keys(&mut browser);
    browser.press("d");
    browser.picture("scenarios_dark");
    assert_eq!(browser.errors(), [""; 0]);
    assert_eq!(browser.requests(), [""; 0]);
    Ok(())
}

/// interPlan's metrics of a modified scene, beside nuPlan's of another one.
#[test]
fn a_modified_scene_shows_the_metrics_of_its_kind() -> Needy {
    let program = Chromium::program()?;
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("run");
    let modified = "generated/changing_lane/0~nudge_around_parked_vehicle";
    let scenes = [modified, "generated/changing_lane/0"].map(str::to_owned);
    simulate(&out, &scenes, "idm");
    let (code, _, stderr) = run(&["report", out.to_str().unwrap()]);
    assert_eq!(code, 0, "{stderr}");
    let mut browser = Chromium::start(&program);
    browser.open(&out.join("report.html"), "overview");
    let weights = "Object.fromEntries([...document.querySelectorAll('.tinted tbody tr')] \
                   .map((row) => [row.querySelector('th').title, row.querySelector('td').textContent]))";
    let weights = browser.value(weights);
    assert_eq!(weights["driving_direction_compliance"], "× or 1");
    assert_eq!(weights["no_ego_at_fault_collisions"], "×");
    assert_eq!(weights["ego_sorts_stopped_vehicle"], "×");
    assert_eq!(weights["lane_changes_to_goal"], "4");
    let text = browser.value("document.getElementById('overview').textContent");
    assert!(text.as_str().unwrap().contains("or interPlan's"), "{text}");
    browser.press("2");
    // The score, nuPlan's eight metrics and two of the kind.
    browser.wait_for("document.querySelectorAll('.card').length === 11");
    browser.open(&out.join("report.html"), "scenarios/0/0");
    browser.wait_for("document.querySelector('.chip[title^=ego_sorts_stopped_vehicle]') !== null");
    assert_eq!(browser.errors(), [""; 0]);
    Ok(())
}

/// Overview and Histograms show every planner and every metric.
fn tables(browser: &mut Chromium, page: &Path) {
    browser.open(page, "overview");
    browser.picture("overview");
    let rows = browser.value("document.querySelectorAll('.figures tbody tr').length");
    assert_eq!(rows, 2);
    let score = browser
        .value("document.querySelector('.score-row:nth-child(3) .score-value output').textContent");
    assert!(
        score.as_str().unwrap().parse::<f64>().unwrap() > 50.0,
        "{score}"
    );
    assert_eq!(
        browser.value("document.querySelectorAll('.view:not([hidden])').length"),
        1
    );
    // Bold numbers are differences whose interval does not contain 0, and nothing else.
    let bold = "[...document.querySelectorAll('#overview td, #overview output, #overview small')] \
                .filter((n) => Number(getComputedStyle(n).fontWeight) > 400 && !n.closest('.difference.clear')).length";
    assert_eq!(browser.value(bold), 0);
    let text = browser.value("document.getElementById('overview').textContent");
    let text = text.as_str().unwrap();
    assert!(
        text.contains("No simulation failed.") && text.contains("Lowest scores"),
        "{text}"
    );
    browser.press("2");
    // The score and its eight metrics.
    browser.wait_for("document.querySelectorAll('.card').length === 9");
    browser.picture("histograms");
    browser.value("document.querySelector('#histograms [data-value=Dynamics]').click()");
    browser.wait_for("document.querySelectorAll('.card').length > 20");
}

/// A replay plays and can be scrubbed, and its transcript follows.
fn replay(browser: &mut Chromium, page: &Path, run: &Path) {
    let folders = fs::read_dir(run.join("simulations")).unwrap();
    let first = folders
        .map(|entry| entry.unwrap().path())
        .find(|d| d.to_str().unwrap().contains("000000-"))
        .unwrap();
    let calls: Vec<Value> = fs::read_to_string(first.join("calls.jsonl"))
        .unwrap()
        .lines()
        .map(|line| serde_json::from_str(line).unwrap())
        .collect();
    browser.open(page, "scenarios/0/0");
    browser.wait_for("scenarios.replay !== null && document.querySelector('.transcript').dataset.iteration === '0'");
    let scene = "document.querySelector('.bev canvas').toDataURL().length + document.querySelector('.bev canvas').toDataURL()";
    let before = browser.value(scene);
    assert!(before.as_str().unwrap().len() > 5_000, "the scene is empty");

    browser.press(" ");
    browser.wait_for(&format!("{NOW} > 0.5"));
    assert_eq!(
        browser.value("document.querySelector('.play').getAttribute('aria-label')"),
        "Stop"
    );
    browser.press(" ");
    let stopped = browser.value(NOW);
    std::thread::sleep(std::time::Duration::from_millis(200));
    assert_eq!(browser.value(NOW), stopped, "it plays on");
    assert_ne!(browser.value(scene), before, "the scene stands still");
    assert!(
        browser
            .value("location.hash")
            .as_str()
            .unwrap()
            .starts_with("#scenarios/0/0/")
    );

    for call in &calls {
        // Half a second after each call, by the slider.
        let at = call["at_s"].as_f64().unwrap() + 0.5;
        browser.value(&format!(
            "{{ const slider = document.querySelector('.track input'); slider.value = {at}; slider.dispatchEvent(new Event('input')); }}"
        ));
        assert!((browser.value(NOW).as_f64().unwrap() - at).abs() < 0.06);
        let shown = browser.value("document.querySelector('.transcript').dataset.iteration");
        assert_eq!(shown, call["iteration"].to_string());
        let text = browser
            .value("document.querySelector('.transcript').textContent")
            .as_str()
            .unwrap()
            .to_owned();
        let attempts = call["attempts"].as_array().unwrap();
        for attempt in attempts {
            let code = attempt["code"]["text"].as_str().unwrap();
            let score = format!("{:.2}", attempt["reflection"]["score"].as_f64().unwrap());
            assert!(
                text.contains(code) && text.contains(&score),
                "no {code} with {score} in {text}"
            );
            for round in attempt["rounds"].as_array().unwrap() {
                let (asked, answered) = (
                    round["prompt"].as_str().unwrap(),
                    round["answer"].as_str().unwrap(),
                );
                assert!(
                    text.contains(asked) && text.contains(answered),
                    "no {asked}: {answered} in {text}"
                );
            }
        }
        assert_eq!(
            browser.value("document.querySelectorAll('.attempt').length"),
            attempts.len()
        );
        assert_eq!(
            browser.value("document.querySelectorAll('.attempt.executed').length"),
            1
        );
        // A row for the environment, then rounds and reflection of each attempt.
        assert_eq!(
            browser.value("document.querySelectorAll('.waterfall > div').length"),
            1 + 4 * attempts.len()
        );
    }
    assert!(
        browser.value("document.querySelectorAll('.thumb img').length") == 1,
        "no image of the prompt"
    );
    // The page has the key to nano's texts that the transcript begins with.
    let transcript = fs::read_to_string(first.join("transcript.md")).unwrap();
    let cells = "[...document.querySelectorAll('.text-key tbody tr')].map((row) => [...row.cells].map((cell) => cell.textContent))";
    let shown = browser.value(cells);
    let shown = shown.as_array().unwrap();
    assert!(shown.len() > 30, "only {} rows in the key", shown.len());
    let plain = transcript.replace('`', "");
    for row in shown {
        let line = format!(
            "| {} | {} |",
            row[0].as_str().unwrap(),
            row[1].as_str().unwrap()
        );
        assert!(plain.contains(&line), "the transcript has no {line}");
    }
    let key = plain
        .split("## Key to the compact texts")
        .nth(1)
        .unwrap()
        .split("\n## ")
        .next()
        .unwrap();
    let (rows, titles) = (
        key.matches("\n| ").count(),
        key.matches("| meaning |").count(),
    );
    assert_eq!(
        shown.len(),
        rows - titles,
        "the page and the transcript have different keys"
    );
    let series = browser
        .value("document.querySelectorAll('.series').length")
        .as_u64()
        .unwrap();
    assert!(series >= 12, "only {series} time series");
    assert!(
        browser
            .value("document.querySelectorAll('.series .limit').length")
            .as_u64()
            .unwrap()
            >= 10
    );
    browser.picture("scenarios");
}

/// The keys.
fn keys(browser: &mut Chromium) {
    browser.press("Home");
    assert_eq!(browser.value(NOW), 0);
    browser.press("ArrowRight");
    browser.press("]");
    assert_eq!(browser.value("Math.round(10 * scenarios.player.time)"), 20);
    browser.press("[");
    assert_eq!(browser.value("scenarios.player.iteration"), 0);
    let zoom = browser.value("scenarios.bev.zoom").as_f64().unwrap();
    browser.press("+");
    assert!(browser.value("scenarios.bev.zoom").as_f64().unwrap() > zoom);
    browser.press("?");
    assert_eq!(browser.value("document.getElementById('help').open"), true);
    browser.value("document.getElementById('help').close()");
    // The list has the worst scenes first.
    let scores = browser.value("scenarios.list.entries.map(({ own }) => own.score)");
    let scores: Vec<f64> = serde_json::from_value(scores).unwrap();
    assert!(
        scores.len() == SCENARIOS && scores.is_sorted(),
        "{scores:?}"
    );
    browser.value("{ location.hash = hashOf(scenarios.list.entries[0].own, 0); }");
    browser.wait_for(
        "scenarios.simulation === scenarios.list.entries[0].own && scenarios.replay !== null",
    );
    browser.press("ArrowDown");
    browser.wait_for(
        "scenarios.simulation === scenarios.list.entries[1].own && scenarios.replay !== null",
    );
    // All replays of the page unpack.
    let broken = "(async () => { let broken = 0; for (const simulation of INDEX.simulations) \
                  if ((await readReplay(simulation)).plans.length < 100) broken += 1; return broken; })()";
    assert_eq!(browser.value(broken), json!(0));
}
