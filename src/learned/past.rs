//! The recent past as the feature builders read it.

use planagent_world::{HistorySample, STEP_US, SceneView};
use std::sync::Arc;

/// The last `count` samples, oldest first; the last is the present. nuPlan's buffer always holds
/// enough. Where ours holds fewer, its oldest sample stands for each earlier one, a step apart.
pub(super) fn samples(scene: &SceneView<'_>, count: usize) -> Vec<HistorySample> {
    let known = scene.history.samples().rev().take(count).cloned();
    let mut samples: Vec<HistorySample> = known.collect();
    if samples.is_empty() {
        samples.push(HistorySample {
            ego: *scene.ego,
            objects: Arc::from(scene.objects),
        });
    }
    while samples.len() < count
        && let Some(oldest) = samples.last().cloned()
    {
        let mut earlier = oldest;
        earlier.ego.time_us -= STEP_US;
        samples.push(earlier);
    }
    samples.reverse();
    samples
}
