//! Every frame of recorded and generated drives as prompts: a graph, two texts that parse back,
//! facts, an image.

#[path = "scene_text/mod.rs"]
mod scene_text;

use crate::outside::Needy;
use crate::womd::recordings;
use planagent_agent::environment;
use planagent_agent::environment::facts::Question;
use planagent_agent::environment::{
    BevView, DEFAULT_NODE_LENGTH, Description, GraphedScene, LaneGraph, SceneFacts, TextForm, bev,
    text,
};
use planagent_scenario::generator::{self, Spec, types};
use planagent_scenario::{Frame, Scenario};
use planagent_world as world;
use planagent_world::History;
use scene_text::{COMPACT_WORDS, parse};
use std::collections::BTreeSet;

/// Frames between those that are looked at.
const STRIDE: usize = 15;

fn facts_of(scenario: &Scenario, frame: &Frame, history: &History) -> SceneFacts {
    let scene = scenario.scene(frame, history);
    let place = format!("{} at {} us", scenario.id, frame.ego.time_us);
    let graph =
        LaneGraph::build(&scene, DEFAULT_NODE_LENGTH).unwrap_or_else(|e| panic!("{place}: {e}"));
    let description = Description::from_graph(&graph);
    let paper = text::write(&description, TextForm::Paper);
    assert_eq!(
        parse(&paper, TextForm::Paper),
        Ok(description.clone()),
        "{place}: {paper}"
    );
    let brief = text::write(&description, TextForm::Brief);
    assert_eq!(
        parse(&brief, TextForm::Brief),
        Ok(description.nearest()),
        "{place}: {brief}"
    );
    let compact = text::write(&description, TextForm::Compact);
    assert_eq!(compact.split_whitespace().count(), COMPACT_WORDS);
    assert_eq!(
        parse(&compact, TextForm::Compact),
        Ok(description.reduced()),
        "{place}: {compact}"
    );
    let second = text::write(&description, TextForm::Compact2);
    assert_eq!(
        parse(&second, TextForm::Compact2),
        Ok(description.reduced_with_estimate()),
        "{place}: {second}"
    );
    for agent in &graph.agents {
        assert!(
            paper.contains(&agent.name.to_string()),
            "{place}: {} is missing in {paper}",
            agent.name
        );
    }
    let image = bev::render(&scene, &BevView::default());
    assert!(
        image.pixels().any(|p| p.0 != bev::BACKGROUND),
        "{place}: an empty image"
    );
    SceneFacts::from_scene(GraphedScene::new(&scene, &graph))
}

#[test]
fn every_recording_becomes_prompts() -> Needy {
    let history = History::default();
    let mut looked_at = 0;
    for scenario in recordings()? {
        for frame in scenario.frames.iter().step_by(STRIDE) {
            facts_of(scenario, frame, &history);
            looked_at += 1;
        }
    }
    assert!(looked_at > 50, "only {looked_at} frames");
    Ok(())
}

#[test]
fn generated_drives_become_prompts_with_varied_facts() {
    let history = History::default();
    let mut answers: BTreeSet<(&str, &str)> = BTreeSet::new();
    for scenario_type in types::in_suites() {
        let scenario = generator::generate(&Spec::new(scenario_type, 1)).unwrap();
        for frame in scenario.frames.iter().step_by(STRIDE) {
            let facts = facts_of(&scenario, frame, &history);
            answers.extend(
                Question::ALL
                    .iter()
                    .map(|&question| (question.as_str(), facts.answer(question))),
            );
        }
    }
    for &question in Question::ALL {
        let given = answers
            .iter()
            .filter(|(key, _)| *key == question.as_str())
            .count();
        assert!(given >= 2, "{question} always has the same answer");
    }
}
