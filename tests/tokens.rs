//! The tokens of scene descriptions, on generated and recorded scenarios.

use crate::womd::recordings;
use planagent::internals::experiment::tokens::{SceneText, TokenCounter, TokenRow, TokenTable, count};
use planagent::internals::mllm::{HubAccess, Mllm, ModelRegistry};
use planagent::internals::report::token_markdown;
use planagent::internals::scenario::Scenario;
use planagent::internals::scenario::generator::{self, Spec, types};
use std::path::Path;

/// Iterations between planning calls.
const INTERVAL: usize = 20;
/// What our text may take on average; the paper's takes 141.32.
const AIM: f64 = 100.0;

fn rows(scenarios: impl IntoIterator<Item = Scenario>, counter: &TokenCounter<'_>) -> Vec<TokenRow> {
    let counted = scenarios.into_iter().flat_map(|scenario| count(&scenario, INTERVAL, 20.0, counter));
    counted.collect::<Result<_, _>>().unwrap()
}

fn mean(table: &TokenTable, text: SceneText) -> f64 {
    table.rows.iter().find(|row| row.text == text).and_then(|row| row.cl100k).unwrap().mean
}

/// Ours takes less than the aim and than what coordinates take.
fn check(table: &TokenTable) {
    let shown = token_markdown(table);
    let ours = mean(table, SceneText::Paper);
    assert!(ours > 30.0 && ours <= AIM, "{shown}");
    assert!(ours < mean(table, SceneText::GptDriver) && ours < mean(table, SceneText::LlmAssist), "{shown}");
}

fn nano() -> Box<dyn Mllm> {
    let models = Path::new(env!("CARGO_MANIFEST_DIR")).join("models");
    let registry = ModelRegistry::new(models, HubAccess { offline: true, ..HubAccess::default() });
    registry.open(&registry.find("nano").unwrap()).unwrap()
}

#[test]
fn generated_scenes_take_few_tokens() {
    let scenarios: Vec<_> = types::in_suites().map(|kind| generator::generate(&Spec::new(kind, 1)).unwrap()).collect();
    let model = nano();
    let counter = TokenCounter::new(Some(&*model));
    let rows = rows(scenarios, &counter);
    assert!(rows.len() >= 8 * types::in_suites().count(), "{} states", rows.len());
    let table = TokenTable::new(&rows, counter.model_name());
    check(&table);
    assert!(table.rows.iter().all(|row| row.model.is_some()));
    let shown = token_markdown(&table);
    assert!(shown.contains("| nano mean |"), "{shown}");
}

#[test]
fn recorded_scenes_take_few_tokens() {
    if recordings().is_empty() {
        return;
    }
    let counter = TokenCounter::new(None);
    let rows = rows(recordings().iter().cloned(), &counter);
    check(&TokenTable::new(&rows, None));
}
