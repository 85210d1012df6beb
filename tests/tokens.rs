//! The tokens of scene descriptions, on generated and recorded scenarios.

use crate::outside::Needy;
use crate::womd::recordings;
use planagent_agent::environment::bev::Palette;
use planagent_agent::environment::{DEFAULT_NODE_LENGTH, Description, LaneGraph, TextForm, text};
use planagent_agent::reasoning::{
    Feedback, Names, PromptSet, Round, feedback_text, round_prompt, system_prompt,
};
use planagent_lab::report::token_markdown;
use planagent_lab::tokens::{TokenCounter, TokenRow, TokenTable, count};
use planagent_mllm::{HubAccess, Mllm, ModelRegistry};
use planagent_scenario::Scenario;
use planagent_scenario::generator::{self, Spec, types};
use planagent_world::History;
use std::path::Path;

/// Iterations between planning calls.
const INTERVAL: usize = 20;
/// What our text may take on average; the paper's takes 141.32.
const AIM: f64 = 100.0;

fn rows(
    scenarios: impl IntoIterator<Item = Scenario>,
    counter: &TokenCounter<'_>,
) -> Vec<TokenRow> {
    let counted = scenarios
        .into_iter()
        .flat_map(|scenario| count(&scenario, INTERVAL, 20.0, counter));
    counted.collect::<Result<_, _>>().unwrap()
}

fn mean(table: &TokenTable, key: &str) -> f64 {
    table
        .rows
        .iter()
        .find(|row| row.text.key() == key)
        .and_then(|row| row.cl100k)
        .unwrap()
        .mean
}

/// Ours takes less than the aim and than what coordinates take.
fn check(table: &TokenTable) {
    let shown = token_markdown(table);
    let ours = mean(table, "paper");
    assert!(ours > 30.0 && ours <= AIM, "{shown}");
    assert!(
        ours < mean(table, "gpt_driver") && ours < mean(table, "llm_assist"),
        "{shown}"
    );
}

fn nano() -> Box<dyn Mllm> {
    let models = Path::new(env!("CARGO_MANIFEST_DIR")).join("models");
    let registry = ModelRegistry::new(
        models,
        HubAccess {
            offline: true,
            ..HubAccess::default()
        },
    );
    registry.open(&registry.find("nano").unwrap()).unwrap()
}

#[test]
fn generated_scenes_take_few_tokens() {
    let scenarios: Vec<_> = types::in_suites()
        .map(|kind| generator::generate(&Spec::new(kind, 1)).unwrap())
        .collect();
    let model = nano();
    let counter = TokenCounter::new(Some(&*model));
    let rows = rows(scenarios, &counter);
    assert!(
        rows.len() >= 8 * types::in_suites().count(),
        "{} states",
        rows.len()
    );
    let table = TokenTable::new(&rows, counter.model_name());
    check(&table);
    assert!(table.rows.iter().all(|row| row.model.is_some()));
    let shown = token_markdown(&table);
    assert!(shown.contains("| nano mean |"), "{shown}");
}

#[test]
fn recorded_scenes_take_few_tokens() -> Needy {
    let counter = TokenCounter::new(None);
    let rows = rows(recordings()?.iter().cloned(), &counter);
    check(&TokenTable::new(&rows, None));
    Ok(())
}

/// Maximum text tokens of a `brief` attempt behind the image, in prompts without the tokens of a
/// chat template.
const BRIEF_TEXT: usize = 250;
/// Maximum tokens that a model samples in a `brief` attempt.
const BRIEF_SAMPLED: usize = 60;

/// The prompts of an attempt, joined.
fn brief_prompts(
    set: &PromptSet,
    names: &Names,
    scene: &str,
    feedback: Option<&Feedback>,
) -> String {
    let feedback = feedback.map(|feedback| feedback_text(set, feedback).unwrap());
    let first = round_prompt(
        set,
        Round::Understanding,
        names,
        Some(scene),
        feedback.as_deref(),
    )
    .unwrap();
    let others = [Round::Instruction, Round::Code]
        .map(|round| round_prompt(set, round, names, None, None).unwrap());
    format!("{first}\n{}", others.join("\n"))
}

#[test]
fn brief_prompts_take_few_tokens_in_every_generated_scene() {
    let (set, counter) = (PromptSet::open("brief").unwrap(), TokenCounter::new(None));
    let parts = [
        "collision",
        "area",
        "direction",
        "progress",
        "ttc",
        "comfort",
    ]
    .map(|part| (part.to_owned(), 0.25));
    let code = Some(
        "Generate_IDM_Planner(c=right_lane, la=pedestrian12, v0=13, acc=1.5, dec=3)".to_owned(),
    );
    let refused = Feedback {
        code,
        score: Some(0.41),
        threshold: 0.75,
        parts: parts.into(),
        is_slow: false,
        errors: Vec::new(),
    };
    let (mut first, mut again, mut scenes) = (Vec::new(), Vec::new(), Vec::new());
    for kind in types::in_suites() {
        for seed in 1..=3 {
            let scenario = generator::generate(&Spec::new(kind, seed)).unwrap();
            for iteration in (0..scenario.iterations()).step_by(INTERVAL) {
                let frame = &scenario.frames[scenario.start + iteration];
                let history = History::default();
                let graph = LaneGraph::build(&scenario.scene(frame, &history), DEFAULT_NODE_LENGTH)
                    .unwrap();
                let scene = text::write(&Description::from_graph(&graph), TextForm::Brief);
                let count = |feedback| {
                    counter
                        .count(&brief_prompts(
                            &set,
                            &Names::from_graph(&graph),
                            &scene,
                            feedback,
                        ))
                        .cl100k
                };
                first.push(count(None));
                again.push(count(Some(&refused)));
                scenes.push(counter.count(&scene).cl100k);
            }
        }
    }
    let mean = |counts: &[usize]| counts.iter().sum::<usize>() as f64 / counts.len() as f64;
    let count = |text: String| counter.count(&text).cl100k;
    let questions = Round::ALL
        .iter()
        .map(|&round| count(round_prompt(&set, round, &Names::default(), None, None).unwrap()));
    println!(
        "brief: {} states; system {}, scene {:.1}, questions {:?}, feedback {}; first attempt {:.1}, at most {:?}; later {:.1}, at most {:?}",
        first.len(),
        count(system_prompt(&set, &Palette::legend()).unwrap()),
        mean(&scenes),
        questions.collect::<Vec<_>>(),
        count(feedback_text(&set, &refused).unwrap()),
        mean(&first),
        first.iter().max(),
        mean(&again),
        again.iter().max()
    );
    assert!(first.len() > 300, "{}", first.len());
    assert!(
        first.iter().all(|&tokens| tokens <= BRIEF_TEXT),
        "{:?}",
        first.iter().max()
    );
    assert!(
        again.iter().all(|&tokens| tokens <= BRIEF_TEXT),
        "{:?}",
        again.iter().max()
    );
    assert!(mean(&first) < 150.0, "{}", mean(&first));
}

#[test]
fn a_brief_attempt_samples_few_tokens() {
    let (forms, counter) = (
        *PromptSet::open("brief").unwrap().forms(),
        TokenCounter::new(None),
    );
    let count = |text: &str| counter.count(text).cl100k;
    // Bounds of the set count the keys, which the grammar fast-forwards.
    let keys = [
        &[
            "Ahead: ",
            "\nLight: ",
            "\nLeft lane: ",
            "\nRight lane: ",
            "\nNote: ",
        ][..],
        &["Speed: ", "\nLane: ", "\nReason: "],
    ];
    let limits = [
        forms.max_tokens.understanding.unwrap(),
        forms.max_tokens.instruction.unwrap(),
    ];
    let sampled: usize = limits
        .iter()
        .zip(keys)
        .map(|(limit, keys)| limit - keys.iter().map(|key| count(key)).sum::<usize>())
        .sum();
    let code = ["right_lane", "pedestrian12", "13", "1.5", "3"]
        .map(count)
        .into_iter()
        .sum::<usize>();
    println!("brief: at most {sampled} tokens sampled in the first rounds, {code} in the last");
    assert!(sampled + code <= BRIEF_SAMPLED, "{sampled} + {code}");
    // The bounds leave room for the words that matter and a reason of some words.
    let longest =
        "Ahead: pedestrian\nLight: yellow\nLeft lane: occupied\nRight lane: occupied\nNote: ";
    assert!(count(longest) + 8 <= limits[0], "{}", count(longest));
    assert!(count("Speed: accelerate\nLane: change_right\nReason: ") + 8 <= limits[1]);
}
