//! Names keep their scenes: results, suites and labels refer to scenes by name.

use super::CORPUS;
use crate::scenario::Scenario;

/// BLAKE3 of the scenes of the tests, a line each: name, length of the expert's path in centimetres, objects at the start.
const CORPUS_DIGEST: &str = "680c75eaa0c18188d1b27b4be5541b1e16d2f4c073ff5baeed7e01fe0bb996eb";

fn line(scenario: &Scenario) -> String {
    let steps = scenario.expert().zip(scenario.expert().skip(1));
    let length: f64 = steps.map(|(a, b)| a.rear_axle.distance(&b.rear_axle)).sum();
    let objects = scenario.frame(0).map_or(0, |frame| frame.objects.len());
    format!("{} {:.0} {objects}\n", scenario.id, length * 100.0)
}

#[test]
fn the_scenes_of_the_tests_stay() {
    let lines: String = CORPUS.iter().map(|generated| line(&generated.scenario)).collect();
    assert_eq!(blake3::hash(lines.as_bytes()).to_hex().as_str(), CORPUS_DIGEST, "{lines}");
}
