//! `planagent scenarios list|show|generate`; `export` has a file of its own.

use super::plan::scenario;
use crate::cli::args::ScenariosCommand;
use crate::cli::{Exit, Printer};
use crate::environment::{BevView, bev};
use crate::experiment::nuplan_data::NuPlanData;
use crate::experiment::source::{ScenarioSource, SourceError, recordings_in};
use crate::experiment::split::split;
use crate::scenario::generator::{ScenarioType, Spec, generate};
use crate::scenario::{Scenario, argoverse2, womd};
use crate::world::{History, HistorySample, LaneKind, STEP_S, Scene, SignalStatus};
use anyhow::{Context, anyhow, bail};
use serde_json::json;
use std::path::{Path, PathBuf};

/// Side of the pictures that `show` writes, pixels.
const PICTURE: u32 = 1024;

/// Runs one of the subcommands.
///
/// # Errors
/// When a source cannot be read or a picture cannot be written.
pub(in crate::cli) fn run(command: &ScenariosCommand, printer: Printer) -> anyhow::Result<Exit> {
    match command {
        ScenariosCommand::List { sources, split } if sources.is_empty() && split.splits.is_empty() => {
            list_types(printer)
        }
        ScenariosCommand::List { sources, split } => {
            let data = split.data.data();
            let complete = list_splits(&split.splits, &data, printer)?;
            let readable = list(sources, &data, printer)?;
            for note in data.take_notes() {
                printer.note(note);
            }
            Ok(if complete && readable { Exit::Success } else { Exit::SomeFailed })
        }
        ScenariosCommand::Show { scenario: word, data, at, image, view } => {
            show(&scenario(Some(word), &data.data())?, *at, image.as_deref(), *view, printer)
        }
        ScenariosCommand::Generate { types, from, count } => generated(types, *from, *count, printer),
        ScenariosCommand::Export(arguments) => super::export::run(arguments, printer),
    }
}

fn list_types(printer: Printer) -> anyhow::Result<Exit> {
    printer.note("types of generated scenarios; name one as generated/TYPE/SEED");
    for &kind in &ScenarioType::ALL {
        let id = Spec { scenario_type: kind, seed: 0 }.to_string();
        printer.line(&id);
        if printer.is_json() {
            printer.json(&json!({"id": id, "scenario_type": kind.to_string()}))?;
        }
    }
    Ok(Exit::Success)
}

/// A line a scenario: the word that names it. Says whether all scenarios of the splits are there.
fn list_splits(names: &[String], data: &NuPlanData, printer: Printer) -> anyhow::Result<bool> {
    let mut complete = true;
    for name in names {
        let found = split(name, data, &|_, _| {})?;
        for source in found.sources {
            complete &= list_source(&source, Some(name), printer)?;
        }
        for note in found.notes {
            printer.note(format!("{name}: {note}"));
        }
        if !found.missing.is_empty() {
            printer.error(&anyhow!("{}", found.missing));
            complete = false;
        }
    }
    Ok(complete)
}

/// Says whether it can be read.
fn list_source(source: &ScenarioSource, split: Option<&str>, printer: Printer) -> anyhow::Result<bool> {
    if let ScenarioSource::Unreadable { cause, .. } = source {
        printer.error(&anyhow!("{cause}"));
        return Ok(false);
    }
    let scenario_type = source.scenario_type();
    match scenario_type {
        Some(scenario_type) => printer.line(format!("{source}  {scenario_type}")),
        None => printer.line(source.to_string()),
    }
    if printer.is_json() {
        printer.json(&json!({"id": source.to_string(), "split": split, "scenario_type": scenario_type}))?;
    }
    Ok(true)
}

/// Says whether all of nuPlan's logs can be read.
fn list(sources: &[PathBuf], data: &NuPlanData, printer: Printer) -> anyhow::Result<bool> {
    let mut readable = true;
    for source in sources {
        let of_nuplan = ScenarioSource::of_nuplan(&source.to_string_lossy(), data)?;
        for found in &of_nuplan {
            readable &= list_source(found, None, printer)?;
        }
        if NuPlanData::names_log(&source.to_string_lossy()) {
            continue;
        }
        if argoverse2::is_log(source) {
            list_log(source, printer)?;
            continue;
        }
        let logs = if source.is_dir() { argoverse2::logs_in(source)? } else { Vec::new() };
        for log in &logs {
            list_log(log, printer)?;
        }
        let files = if source.is_dir() { recordings_in(source)? } else { vec![source.clone()] };
        if files.is_empty() && logs.is_empty() && of_nuplan.is_empty() {
            bail!(SourceError::Empty(source.clone()));
        }
        for file in files {
            for summary in womd::summaries(&file)? {
                let found = summary?;
                let counts = [found.steps, found.iterations, found.tracks, found.lanes];
                list_one(&found.id, counts, &file, Some(found.record), printer)?;
            }
        }
    }
    Ok(readable)
}

fn list_log(folder: &Path, printer: Printer) -> anyhow::Result<()> {
    let found = argoverse2::summary(folder)?;
    list_one(&found.id, [found.steps, found.iterations, found.tracks, found.lanes], folder, None, printer)
}

/// A line for a recording; `record` is its place in a file of several.
fn list_one(
    id: &str,
    [steps, iterations, tracks, lanes]: [usize; 4],
    place: &Path,
    record: Option<usize>,
    printer: Printer,
) -> anyhow::Result<()> {
    let driven = (iterations.saturating_sub(1)) as f64 * STEP_S;
    let place_name = place.display();
    printer.line(format!(
        "{id:<20} {steps:>4} steps {driven:>5.1} s driven {tracks:>4} tracks {lanes:>4} lanes  {place_name}"
    ));
    if printer.is_json() {
        printer.json(&json!({
            "id": id, "file": place, "record": record, "steps": steps,
            "iterations": iterations, "tracks": tracks, "lanes": lanes,
        }))?;
    }
    Ok(())
}

fn show(scenario: &Scenario, at: f64, image: Option<&Path>, view: f64, printer: Printer) -> anyhow::Result<Exit> {
    let iteration = (at / STEP_S).round().max(0.0) as usize;
    let end = scenario.iterations().saturating_sub(1) as f64 * STEP_S;
    let Some(frame) = scenario.frame(iteration).filter(|_| at >= 0.0) else {
        bail!("--at {at} lies outside the window of {}, which ends at {end:.1} s", scenario.id);
    };
    let map = &scenario.map;
    let lanes = |kind: LaneKind| map.lanes().iter().filter(|lane| lane.kind == kind).count();
    let lights = |status: SignalStatus| frame.lights.iter().filter(|&(_, s)| s == status).count();
    let route: Vec<i64> = scenario.route.roadblocks.iter().map(|&block| map[block].source_id).collect();
    if printer.is_json() {
        printer.json(&json!({
            "id": scenario.id, "scenario_type": scenario.scenario_type, "log_name": scenario.log_name,
            "iterations": scenario.iterations(), "history": scenario.start,
            "map": {
                "name": map.name(), "lanes": lanes(LaneKind::Lane), "connectors": lanes(LaneKind::Connector),
                "roadblocks": map.roadblocks().len(), "intersections": map.intersections().len(),
                "crosswalks": map.crosswalks().len(), "stop_lines": map.stop_lines().len(),
            },
            "route": route, "at_s": at, "ego": frame.ego, "objects": &*frame.objects,
            "lights": frame.lights.iter().map(|(id, s)| json!({"lane": map[id].source_id, "status": s})).collect::<Vec<_>>(),
        }))?;
    }
    printer.line(format!("{} ({}), log {}", scenario.id, scenario.scenario_type, scenario.log_name));
    printer.line(format!(
        "window      {end:.1} s, {} iterations, {} frames of history",
        scenario.iterations(),
        scenario.start
    ));
    printer.line(format!(
        "map         {} lanes, {} connectors, {} roadblocks,\n            {} intersections, {} crosswalks, {} stop lines",
        lanes(LaneKind::Lane),
        lanes(LaneKind::Connector),
        map.roadblocks().len(),
        map.intersections().len(),
        map.crosswalks().len(),
        map.stop_lines().len()
    ));
    printer.line(format!(
        "route       {} roadblocks: {}",
        route.len(),
        route.iter().map(ToString::to_string).collect::<Vec<_>>().join(" ")
    ));
    printer.line(format!("at {at:>5.1} s  ego {:.1} m/s, {} objects", frame.ego.speed(), frame.objects.len()));
    printer.line(format!(
        "lights      {} green, {} yellow, {} red, {} unknown",
        lights(SignalStatus::Green),
        lights(SignalStatus::Yellow),
        lights(SignalStatus::Red),
        lights(SignalStatus::Unknown)
    ));
    if let Some(path) = image {
        let mut history = History::default();
        history.push(HistorySample { ego: frame.ego, objects: frame.objects.clone() });
        let scene = Scene {
            map,
            route: &scenario.route,
            ego: &frame.ego,
            objects: &frame.objects,
            lights: &frame.lights,
            history: &history,
        };
        let picture = bev::render(&scene, &BevView::new(PICTURE, view)?);
        picture.save(path).with_context(|| format!("cannot write {}", path.display()))?;
        printer.note(format!("picture in {}", path.display()));
    }
    Ok(Exit::Success)
}

fn generated(types: &[String], from: u64, count: u64, printer: Printer) -> anyhow::Result<Exit> {
    let kinds = if types.is_empty() {
        ScenarioType::ALL.to_vec()
    } else {
        types.iter().map(|name| name.parse()).collect::<Result<Vec<ScenarioType>, _>>()?
    };
    let mut failed = false;
    for kind in kinds {
        for seed in from..from.saturating_add(count) {
            let spec = Spec { scenario_type: kind, seed };
            match generate(&spec) {
                Ok(scenario) => {
                    let way: f64 = scenario
                        .expert()
                        .zip(scenario.expert().skip(1))
                        .map(|(a, b)| a.rear_axle.distance(&b.rear_axle))
                        .sum();
                    let objects = scenario.frame(0).map_or(0, |frame| frame.objects.len());
                    printer.line(format!("{:<60} expert drives {way:6.1} m, {objects:>3} objects", scenario.id));
                    if printer.is_json() {
                        printer.json(&json!({"id": scenario.id, "expert_m": way, "objects": objects}))?;
                    }
                }
                Err(error) => {
                    failed = true;
                    printer.note(format!("failed: {spec}: {error}"));
                }
            }
        }
    }
    Ok(if failed { Exit::SomeFailed } else { Exit::Success })
}
