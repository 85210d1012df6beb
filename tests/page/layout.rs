//! The page at the widths of phones, tablets and desktops, in light and dark.

use super::chromium::Chromium;
use super::{scenes, simulate};
use crate::cli::run;
use crate::outside::Needy;
use serde_json::{Value, json};
use std::path::Path;
use tempfile::TempDir;

/// Sizes of the window, pixels.
const WINDOWS: [(u32, u32); 4] = [(400, 860), (800, 1000), (1024, 768), (1400, 900)];
/// Minimum width of the scene, pixels.
const MIN_SCENE: f64 = 300.0;

#[test]
fn the_page_of_two_runs_fits_every_width() -> Needy {
    let program = Chromium::program()?;
    let work = TempDir::new().unwrap();
    let [one, other, page] = ["one", "other", "page.html"].map(|name| work.path().join(name));
    simulate(&one, &scenes(3), "plan-agent,log-replay");
    simulate(&other, &scenes(2), "idm");
    let runs = [one.to_str().unwrap(), other.to_str().unwrap()];
    let (code, _, stderr) = run(&["report", runs[0], runs[1], "--out", page.to_str().unwrap()]);
    assert_eq!(code, 0, "{stderr}");
    let mut browser = Chromium::start(&program);
    for (width, height) in WINDOWS {
        for theme in ["light", "dark"] {
            browser.show_at(width, height, theme);
            fits(&mut browser, &page, &format!("{width}_{theme}"));
        }
    }
    comparison(&mut browser, &page);
    scene(&mut browser, &page);
    decisions(&mut browser);
    assert_eq!(browser.errors(), [""; 0]);
    Ok(())
}

/// No view is wider than the window, and the scene is wide enough.
fn fits(browser: &mut Chromium, page: &Path, name: &str) {
    for view in ["overview", "histograms", "scenarios"] {
        let place = if view == "scenarios" {
            "scenarios/0/0/3.0"
        } else {
            view
        };
        browser.open(page, place);
        browser.wait_for(&format!("document.body.dataset.view === '{view}'"));
        if view == "histograms" {
            browser.wait_for("document.querySelector('.histogram-row') !== null");
        }
        if view == "scenarios" {
            browser.wait_for("scenarios.replay !== null && scenarios.bev.canvas.clientWidth > 0");
            let scene = browser
                .value("scenarios.bev.canvas.getBoundingClientRect().width")
                .as_f64()
                .unwrap();
            assert!(
                scene >= MIN_SCENE,
                "{name}: the scene is {scene} pixels wide"
            );
        }
        // Both at once: a view that grows between two questions gets a scrollbar, and the window is
        // narrower.
        let widths = browser
            .value("[document.documentElement.scrollWidth, document.documentElement.clientWidth]");
        let [wide, window] = [0, 1].map(|i| widths[i].as_u64().unwrap());
        assert!(
            wide <= window,
            "{name}, {view}: {wide} pixels in a window of {window}"
        );
        browser.picture(&format!("{view}_{name}"));
    }
}

/// Scores have intervals; runs are compared on the scenes that they share, and the page says how
/// many.
fn comparison(browser: &mut Chromium, page: &Path) {
    browser.open(page, "overview");
    browser.wait_for("document.body.dataset.view === 'overview'");
    let text = |browser: &mut Chromium, selector: &str| -> String {
        let found = browser.value(&format!(
            "document.querySelector('{selector}')?.textContent"
        ));
        found
            .as_str()
            .unwrap_or_else(|| panic!("no {selector}"))
            .to_owned()
    };
    let note = text(browser, ".scope-note");
    assert!(
        note.contains("All 3 planners completed 2 of 3 scenes") && note.contains("common scenes"),
        "{note}"
    );
    let shown = |browser: &mut Chromium| {
        browser.value(
            "[...document.querySelectorAll('.score-value output')].map((n) => n.textContent)",
        )
    };
    let common = shown(browser);
    browser.value("document.querySelector('.final-scores [data-value=all]').click()");
    assert_ne!(
        shown(browser),
        common,
        "the score on three scenes is that on two"
    );
    let interval = text(browser, ".score-value small");
    assert!(
        interval.split_once(" to ").is_some_and(|(low, high)| low
            .parse::<f64>()
            .is_ok_and(|low| low <= high.parse().unwrap())),
        "{interval}"
    );
    let difference = text(browser, ".score-row:nth-child(3) .difference small");
    assert!(difference.contains(" to "), "{difference}");
    assert_eq!(
        browser.value("document.querySelectorAll('.type-row:not(.axis-row)').length"),
        3
    );
}

/// The address follows the moment; the legend is complete; series have axes, and no limit is 0.
fn scene(browser: &mut Chromium, page: &Path) {
    browser.open(page, "scenarios/0/0");
    browser.wait_for("scenarios.replay !== null");
    browser.value("scenarios.player.seek(4.2)");
    browser.wait_for("location.hash === '#scenarios/0/0/4.2'");
    let legend = browser
        .value("document.querySelector('.scene-legend').textContent")
        .to_string();
    for entry in [
        "active plan",
        "trail",
        "recorded ego",
        "route",
        "lane",
        "vehicle",
    ] {
        assert!(legend.contains(entry), "no {entry} in {legend}");
    }
    let before = browser.value("scenarios.bev.show.trail");
    browser.value(
        "[...document.querySelectorAll('.scene-legend button')].find((b) => b.textContent.includes('trail')).click()",
    );
    assert_ne!(browser.value("scenarios.bev.show.trail"), before);
    let struck = "[...document.querySelectorAll('.scene-legend button')].filter((b) => getComputedStyle(b).textDecorationLine !== 'none').length";
    assert_eq!(
        browser.value(struck),
        0,
        "a layer that is off is struck out"
    );
    let series =
        browser.value("[...document.querySelectorAll('.series')].map((n) => n.querySelector('.name').textContent)");
    let names = series.as_array().unwrap();
    assert!(names.contains(&json!("over the speed limit")), "{series}");
    let axes = "[...document.querySelectorAll('.series')].every((n) => n.querySelectorAll('.x-axis span').length > 1 && n.querySelectorAll('.y-axis span').length > 0)";
    assert_eq!(browser.value(axes), true);
    // The numbers of an axis do not touch.
    let touching = "[...document.querySelectorAll('.y-axis')].filter((axis) => { \
                    const tops = [...axis.children].map((n) => n.getBoundingClientRect().top).sort((a, b) => a - b); \
                    return tops.some((top, i) => i > 0 && top - tops[i - 1] < 11); }).length";
    assert_eq!(browser.value(touching), 0);
    let limits = browser.value("scenarios.series.rows.length === document.querySelectorAll('.series').length && [...document.querySelectorAll('.series .plot')].map((n) => n.title)");
    assert!(!limits.to_string().contains("threshold 0 m/s"), "{limits}");
    // The thumbnails of the list are drawn.
    browser.value("scenarios.openList(true)");
    let drawn = "[...document.querySelectorAll('.thumbnail')].every((canvas) => new Set(canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data).size > 3)";
    browser.wait_for(drawn);
}

/// A call whose attempts were all refused says what is executed and why.
fn decisions(browser: &mut Chromium) {
    let words = |browser: &mut Chromium, call: Value| -> String {
        let run = json!({"monitoring": true, "after_max_exec": "best"});
        browser
            .value(&format!("decisionWords({call}, {run})"))
            .as_str()
            .unwrap()
            .to_owned()
    };
    let attempts = json!([{"reflection": {"score": 0.0}}, {"reflection": {"score": 0.41}}]);
    let refused = json!({"iteration": 20, "attempts": attempts, "decision": {"kind": "exhausted", "attempt": 1}, "emergency_brakes": 0});
    let said = words(browser, refused);
    assert!(
        said.contains(
            "Attempt 2, with 0.41, is executed all the same, because no other attempt scores more."
        ),
        "{said}"
    );
    let of_equals = |expected: f64| json!({"reflection": {"score": 0.0, "behaviors": {"yields": 0.0, "insists": 0.0, "expected": expected}}});
    let by_mean = json!({"iteration": 20, "attempts": [of_equals(0.1), of_equals(0.2)], "decision": {"kind": "exhausted", "attempt": 1}, "emergency_brakes": 0});
    let said = words(browser, by_mean);
    assert!(
        said.contains("because it scores most over what crossing traffic may do."),
        "{said}"
    );
    let evaded = json!({"iteration": 20, "attempts": attempts, "decision": {"kind": "execute", "attempt": 0}, "evasion": 23, "emergency_brakes": 0});
    let said = words(browser, evaded);
    assert!(
        said.ends_with("The ego swerved into a lane beside for a person or a bicycle at 2.3 s."),
        "{said}"
    );
    let kept = json!({"iteration": 20, "attempts": attempts, "decision": {"kind": "keep_active_plan", "cause": "worse", "why": ""}, "emergency_brakes": 0});
    assert_eq!(browser.value(&format!("outcomeOf({kept})")), "exhausted");
    let said = words(browser, kept);
    assert!(
        said.starts_with("The active plan is kept, because it is better"),
        "{said}"
    );

    // The model wrote the same code three times, the third time after other answers.
    let attempt = |answer: &str| json!({"code": {"text": "code"}, "rounds": [{"answer": answer}], "reflection": {"score": 0.2}});
    let attempts = json!([attempt("one"), attempt("one"), attempt("two")]);
    let repeats = browser.value(&format!("[0, 1, 2].map((i) => repeatOf({attempts}, i))"));
    assert_eq!(
        repeats,
        json!([null, {"of": 0, "whole": true}, {"of": 0, "whole": false}])
    );
    let same = json!({"iteration": 20, "attempts": attempts, "decision": {"kind": "exhausted", "attempt": 0}, "emergency_brakes": 0});
    let said = words(browser, same);
    assert!(
        said.contains("All 3 attempts have the same code.")
            && said.contains("there is no better plan"),
        "{said}"
    );

    // A score stands beside a box, and inside the picture.
    let place = "(() => { const box = { left: 105, right: 155, top: 88, bottom: 113 }; const area = labelPlace({ x: 100, y: 100 }, [40, 18], [box], 400, 300); \
                 const far = labelPlace({ x: -500, y: 900 }, [40, 18], [], 400, 300); \
                 return [overlap(area, box), far.left >= 0 && far.bottom <= 300]; })()";
    assert_eq!(browser.value(place), json!([0, true]));
}
