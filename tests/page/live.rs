//! A live page in a browser: it follows its run, and leaves the reader where they are.

use super::chromium::Chromium;
use super::serve::{Served, begun, complete, simulations};
use super::{scenes, simulate};
use crate::outside::Needy;
use serde_json::json;
use tempfile::TempDir;

#[test]
fn an_open_page_follows_its_run() -> Needy {
    let program = Chromium::program()?;
    let work = TempDir::new().unwrap();
    let [whole, run] = ["whole", "run"].map(|name| work.path().join(name));
    simulate(&whole, &scenes(2), "plan-agent,log-replay");
    begun(&whole, &run);
    std::fs::create_dir(run.join("simulations")).unwrap();
    let folders = simulations(&whole);
    // A process that works on the run holds its lock.
    let lock = std::fs::File::create(run.join(".lock")).unwrap();
    lock.lock().unwrap();
    let mut served = Served::start(&[&run]);
    let mut browser = Chromium::start(&program);
    browser.visit(&format!("http://{}/", served.address));
    browser.wait_for("document.querySelector('.waiting') !== null");
    browser.wait_for("document.getElementById('live-state').textContent === 'live · 0 of 4'");
    browser.picture("live_waiting");

    // The second planner's simulation is complete first; its color stays when that of the first one
    // comes.
    complete(&folders[1], &run);
    browser.wait_for("document.querySelectorAll('.score-row:not(.axis-row)').length === 1");
    let color = browser.value("colorOf(INDEX.entrants[0])");
    browser.value("{ location.hash = 'scenarios/0/1/3.0'; }");
    browser.wait_for("scenarios.replay !== null && scenarios.player.time === 3");
    complete(&folders[0], &run);
    browser
        .wait_for("INDEX.simulations.length === 2 && document.querySelectorAll('.planner-choice option').length === 2");
    assert_eq!(
        browser.value("INDEX.entrants.map((entrant) => entrant.planner)"),
        json!(["plan-agent", "log-replay"])
    );
    assert_eq!(browser.value("colorOf(INDEX.entrants[1])"), color);
    let place = "[scenarios.simulation.number, scenarios.player.time, scenarios.replay.simulation === scenarios.simulation]";
    assert_eq!(browser.value(place), json!([1, 3, true]));
    browser.value("{ location.hash = 'scenarios/0/0'; }");
    browser.wait_for(
        "scenarios.replay?.calls.length > 5 && document.querySelector('.thumb img') !== null",
    );
    browser.picture("live_scenarios");

    browser.value("{ location.hash = 'histograms'; }");
    browser.wait_for("document.querySelectorAll('.card').length === 9");
    complete(&folders[2], &run);
    lock.unlock().unwrap();
    browser.wait_for("document.getElementById('live-state').textContent === 'stopped · 3 of 4'");
    complete(&folders[3], &run);
    browser.wait_for("document.getElementById('live-state').textContent === 'complete · all 4'");
    browser
        .wait_for("document.querySelector('#about').textContent === '2 scenarios, 4 simulations'");
    browser.value("{ location.hash = 'overview'; }");
    browser.wait_for("document.querySelector('.scope-note').textContent.includes('all 2 scenes')");
    browser.picture("live_overview");
    assert_eq!(browser.errors(), [""; 0]);
    let requests = browser.requests();
    assert!(
        requests
            .iter()
            .all(|url| url.starts_with(&format!("http://{}/", served.address))),
        "{requests:?}"
    );

    served.stop();
    browser.wait_for("document.getElementById('live-state').dataset.state === 'lost'");
    assert_eq!(
        browser.value("document.getElementById('live-state').textContent"),
        "not live"
    );
    assert_eq!(
        browser.value("document.querySelector('.view:not([hidden])').id"),
        "overview"
    );
    Ok(())
}
