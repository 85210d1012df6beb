//! `planagent scenarios show`.

use super::{About, Details};
use crate::args::ShowArguments;
use crate::commands::plan::{instant, scenario};
use crate::{Exit, Printer};
use image::RgbImage;
use planagent_agent::environment::{BevView, bev};
use planagent_runs::report::fill;
use planagent_scenario::{Frame, Scenario};
use planagent_world::{History, HistorySample, LaneKind, STEP_S, SignalStatus};
use serde_json::{Value, json};

/// Side of the picture, pixels.
const PICTURE: u32 = 1024;
/// Width of the first column.
const INDENT: usize = 10;

/// Shows a scenario at an instant.
pub(super) fn run(arguments: &ShowArguments, printer: Printer) -> anyhow::Result<Exit> {
    let view = BevView::new(PICTURE, arguments.view)?;
    let scenario = scenario(Some(&arguments.scenario), &arguments.data)?;
    let (iteration, frame) = instant(&scenario, arguments.at)?;
    let about = About::scenario(&scenario, &arguments.scenario);
    let at_s = iteration as f64 * STEP_S;
    if printer.is_json() {
        printer.json(&Details {
            about,
            more: contents(&scenario, frame, at_s),
        })?;
    } else {
        print(&scenario, frame, at_s, printer);
    }
    if let Some(file) = &arguments.image {
        file.save(&draw(&scenario, frame, &view))?;
        printer.note(format!("picture in {}", file.path().display()));
    }
    Ok(Exit::Success)
}

/// Source ids of the route's roadblocks.
fn route(scenario: &Scenario) -> Vec<i64> {
    scenario
        .route
        .roadblocks
        .iter()
        .map(|&block| scenario.map[block].source_id)
        .collect()
}

/// Number of lanes that are connectors.
fn connectors(scenario: &Scenario) -> usize {
    scenario
        .map
        .lanes()
        .iter()
        .filter(|lane| lane.kind == LaneKind::Connector)
        .count()
}

/// Fields of `show` alone.
fn contents(scenario: &Scenario, frame: &Frame, at_s: f64) -> Value {
    let map = &scenario.map;
    let lights = frame
        .lights
        .iter()
        .map(|(id, status)| json!({"lane": map[id].source_id, "status": status}));
    json!({
        "history": scenario.start,
        "map": {
            "name": map.name(), "connectors": connectors(scenario), "roadblocks": map.roadblocks().len(),
            "intersections": map.intersections().len(), "crosswalks": map.crosswalks().len(),
            "stop_lines": map.stop_lines().len(),
        },
        "route": route(scenario), "at_s": at_s, "ego": frame.ego, "objects": &*frame.objects,
        "lights": lights.collect::<Vec<Value>>(),
    })
}

/// The same as text.
fn print(scenario: &Scenario, frame: &Frame, at_s: f64, printer: Printer) {
    let map = &scenario.map;
    // Names stand in a column of their own, so that wrapped words are not taken for them.
    let section = |name: &str, words: Vec<String>| {
        let width = usize::from(printer.width()).saturating_sub(INDENT);
        for (i, line) in fill(words, width).iter().enumerate() {
            printer.line(format!("{:<INDENT$}{line}", if i == 0 { name } else { "" }));
        }
    };
    printer.line(&scenario.id);
    section("type", vec![scenario.scenario_type.clone()]);
    section("log", vec![scenario.log_name.clone()]);
    let end = (scenario.iterations() - 1) as f64 * STEP_S;
    let iterations = format!("{} iterations", scenario.iterations());
    section(
        "window",
        vec![
            format!("{end:.1} s"),
            iterations,
            format!("{} frames of history", scenario.start),
        ],
    );
    let lanes = format!(
        "{} lanes, {} of them connectors",
        map.lanes().len(),
        connectors(scenario)
    );
    let counts = [
        (map.roadblocks().len(), "roadblocks"),
        (map.intersections().len(), "intersections"),
        (map.crosswalks().len(), "crosswalks"),
        (map.stop_lines().len(), "stop lines"),
    ];
    section("map", [vec![lanes], counted(&counts)].concat());
    let route = route(scenario);
    let blocks = route.iter().map(ToString::to_string);
    section(
        "route",
        [format!("{} roadblocks:", route.len())]
            .into_iter()
            .chain(blocks)
            .collect(),
    );
    let speed = format!("ego {:.1} m/s", frame.ego.speed());
    section(
        "at",
        vec![
            format!("{at_s:.1} s"),
            speed,
            format!("{} objects", frame.objects.len()),
        ],
    );
    let lights = |status: SignalStatus| frame.lights.iter().filter(|&(_, s)| s == status).count();
    let counts = [
        (lights(SignalStatus::Green), "green"),
        (lights(SignalStatus::Yellow), "yellow"),
        (lights(SignalStatus::Red), "red"),
        (lights(SignalStatus::Unknown), "unknown"),
    ];
    section("lights", counted(&counts));
}

fn counted(counts: &[(usize, &str)]) -> Vec<String> {
    counts
        .iter()
        .map(|(count, what)| format!("{count} {what}"))
        .collect()
}

/// A BEV picture of the scene.
fn draw(scenario: &Scenario, frame: &Frame, view: &BevView) -> RgbImage {
    let mut history = History::default();
    history.push(HistorySample {
        ego: frame.ego,
        objects: frame.objects.clone(),
    });
    bev::render(&scenario.scene(frame, &history), view)
}
