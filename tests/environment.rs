//! Every frame of recorded and generated drives as prompts: a graph, two texts that parse back, facts, an image.

use planagent::environment::facts::Question;
use planagent::environment::{BevView, DEFAULT_NODE_LENGTH, Description, LaneGraph, SceneFacts, TextForm, bev, text};
use planagent::scenario::generator::{self, ScenarioType, Spec};
use planagent::scenario::{Frame, Scenario, womd};
use planagent::world::{History, Scene};
use std::collections::BTreeSet;
use std::path::PathBuf;

/// Frames between those that are looked at.
const STRIDE: usize = 15;

fn recordings() -> Option<PathBuf> {
    let root = std::env::var_os("PLANAGENT_DATA")
        .map_or_else(|| PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../shared/data")), PathBuf::from);
    let folder = root.join("womd");
    folder.is_dir().then_some(folder)
}

fn facts_of(scenario: &Scenario, frame: &Frame, history: &History) -> SceneFacts {
    let scene = Scene {
        map: &scenario.map,
        route: &scenario.route,
        ego: &frame.ego,
        objects: &frame.objects,
        lights: &frame.lights,
        history,
    };
    let place = format!("{} at {} us", scenario.id, frame.ego.time_us);
    let graph = LaneGraph::build(&scene, DEFAULT_NODE_LENGTH).unwrap_or_else(|e| panic!("{place}: {e}"));
    let description = Description::of(&graph);
    let paper = text::write(&description, TextForm::Paper);
    assert_eq!(text::parse(&paper, TextForm::Paper), Ok(description.clone()), "{place}: {paper}");
    let compact = text::write(&description, TextForm::Compact);
    assert_eq!(compact.split_whitespace().count(), text::COMPACT_WORDS);
    assert_eq!(text::parse(&compact, TextForm::Compact), Ok(description.reduced()), "{place}: {compact}");
    for agent in &graph.agents {
        assert!(paper.contains(&agent.name.to_string()), "{place}: {} is missing in {paper}", agent.name);
    }
    let image = bev::render(&scene, &BevView::default());
    assert!(image.pixels().any(|p| p.0 != bev::BACKGROUND), "{place}: an empty image");
    SceneFacts::of(&scene, &graph)
}

#[test]
fn every_recording_becomes_prompts() {
    let Some(folder) = recordings() else {
        eprintln!("SKIPPED: no recordings (set PLANAGENT_DATA)");
        return;
    };
    let mut files: Vec<PathBuf> = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.sort();
    let history = History::default();
    let mut looked_at = 0;
    for scenario in files.iter().flat_map(|file| womd::open(file).unwrap()) {
        for frame in scenario.frames.iter().step_by(STRIDE) {
            facts_of(&scenario, frame, &history);
            looked_at += 1;
        }
    }
    assert!(looked_at > 50, "only {looked_at} frames");
}

#[test]
fn generated_drives_become_prompts_with_varied_facts() {
    let history = History::default();
    let mut answers: BTreeSet<(&str, &str)> = BTreeSet::new();
    for scenario_type in ScenarioType::ALL {
        let scenario = generator::generate(&Spec::new(scenario_type, 1)).unwrap();
        for frame in scenario.frames.iter().step_by(STRIDE) {
            answers.extend(facts_of(&scenario, frame, &history).answers());
        }
    }
    for &question in Question::ALL {
        let given = answers.iter().filter(|(key, _)| *key == question.as_str()).count();
        assert!(given >= 2, "{question} always has the same answer");
    }
}
