//! Compares two sets of scenes, for example generated and recorded ones: statistics of each, and
//! how often a classifier tells one from the other.

mod agents;
mod classifier;
mod distribution;
mod feature;
mod roads;

pub use classifier::Accuracy;
pub(crate) use classifier::FOLDS;
pub use distribution::Distribution;
pub use feature::Feature;

use classifier::{Sample, cross_validated, fitted};
use distribution::distribution;
use feature::FEATURES;
use planagent_scenario::{Scenario, without_start};
use serde::Serialize;

/// The features of a scene.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MeasuredScene {
    /// Id of the scenario.
    pub id: String,
    /// In the order of the features; `None` where the scene has none.
    pub values: Vec<Option<f64>>,
}

impl MeasuredScene {
    /// Measures a scene in its first seven seconds, the length of the shortest recordings.
    pub fn from_scenario(scenario: &Scenario) -> Self {
        let (roads, agents) = (roads::figures(scenario), agents::figures(scenario));
        let values = FEATURES
            .iter()
            .map(|(_, value)| value(&roads, &agents).filter(|value| value.is_finite()));
        Self {
            id: scenario.id.clone(),
            values: values.collect(),
        }
    }

    /// The recording; scenes of the same one are never split between training and test.
    fn group(&self) -> &str {
        without_start(&self.id)
    }
}

/// A feature in both sets.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ComparedFeature {
    #[serde(flatten)]
    pub feature: Feature,
    pub a: Option<Distribution>,
    pub b: Option<Distribution>,
    /// Mean of A minus mean of B, in standard deviations of all scenes.
    pub difference: Option<f64>,
    /// Coefficient of the classifier for a standard deviation, fitted to all scenes: positive
    /// speaks for A.
    pub coefficient: Option<f64>,
}

/// Two sets of scenes.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SceneComparison {
    pub features: Vec<ComparedFeature>,
    /// `None` with fewer than [`FOLDS`] recordings on a side.
    pub classifier: Option<Accuracy>,
    /// The measured scenes of A and B.
    pub scenes: [Vec<MeasuredScene>; 2],
}

impl SceneComparison {
    /// Compares measured scenes; the same scenes in the same order give the same numbers.
    pub fn from_sets(a: Vec<MeasuredScene>, b: Vec<MeasuredScene>) -> Self {
        let sample = |scene: &MeasuredScene, is_a| Sample {
            group: scene.group().to_owned(),
            values: scene.values.clone(),
            is_a,
        };
        let samples: Vec<Sample> = a
            .iter()
            .map(|scene| sample(scene, true))
            .chain(b.iter().map(|scene| sample(scene, false)))
            .collect();
        let classifier = cross_validated(&samples);
        // Sets that are too small to validate a classifier are too small to read its coefficients.
        let coefficients = classifier.is_some().then(|| fitted(&samples).coefficients);
        let features = FEATURES.iter().enumerate().map(|(place, (feature, _))| {
            let values = |scenes: &[MeasuredScene]| -> Vec<f64> {
                scenes
                    .iter()
                    .filter_map(|scene| scene.values.get(place).copied().flatten())
                    .collect()
            };
            let (of_a, of_b) = (values(&a), values(&b));
            let (a, b) = (distribution(&of_a), distribution(&of_b));
            let all = distribution(&[of_a, of_b].concat());
            let difference = match (a, b, all) {
                (Some(a), Some(b), Some(all)) if all.deviation > 0.0 => {
                    Some((a.mean - b.mean) / all.deviation)
                }
                _ => None,
            };
            let coefficient = coefficients
                .as_ref()
                .and_then(|all| all.get(place).copied());
            ComparedFeature {
                feature: *feature,
                a,
                b,
                difference,
                coefficient,
            }
        });
        Self {
            features: features.collect(),
            classifier,
            scenes: [a, b],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use planagent_scenario::generator::{Spec, generate, types};

    fn scene(id: &str, value: f64) -> MeasuredScene {
        MeasuredScene {
            id: id.to_owned(),
            values: vec![Some(value); FEATURES.len()],
        }
    }

    #[test]
    fn a_generated_scene_has_what_its_map_says() {
        let scenario = generate(&Spec::new(types::changing_lane::TYPE, 3)).unwrap();
        let measured = MeasuredScene::from_scenario(&scenario);
        let value = |key: &str| {
            let place = FEATURES
                .iter()
                .position(|(feature, _)| feature.key == key)
                .unwrap();
            measured.values[place]
        };
        assert!(
            (3.2..3.8).contains(&value("lane_width").unwrap()),
            "{measured:?}"
        );
        assert_eq!(value("unknown_limits"), Some(0.0));
        assert!(value("vertex_spacing").unwrap() <= 0.5);
        assert!(
            value("heading_deviation").is_none_or(|angle| angle < 10.0),
            "{measured:?}"
        );
        assert!(
            (4.2..13.0).contains(&value("box_length").unwrap()),
            "{measured:?}"
        );
    }

    #[test]
    fn starts_of_one_recording_belong_together() {
        assert_eq!(scene("recording@3", 1.0).group(), "recording");
        let few = SceneComparison::from_sets(vec![scene("a", 1.0)], vec![scene("b", 0.0)]);
        assert_eq!(few.classifier, None);
        assert!(
            few.features
                .iter()
                .all(|feature| feature.coefficient.is_none() && feature.difference == Some(2.0))
        );
    }
}
