//! The shuffled-BEV ablation: the model gets the BEV image of an unrelated scene, to measure what
//! the image is worth.

use image::RgbImage;
use planagent_agent::environment::{BevView, bev};
use planagent_agent::planner::BevSource;
use planagent_scenario::generator::{self, GeneratorError, Spec, types};
use planagent_world::History;
use std::sync::Arc;

/// First seed of the scenes; no training or test scene has such a seed.
const FIRST_SEED: u64 = 900_000_000;
/// Number of seeds from the first on.
const SEEDS: u64 = 1_000_000;
/// Maximum number of seeds that are tried: the generator finds no scene for some.
const MAX_TRIES: u64 = 20;

/// Images of generated scenes for an agent.
pub(super) fn source() -> BevSource {
    Arc::new(|draw, view| Ok(render(draw, view)?))
}

/// The BEV image of a generated scene at some time of its log; the same one for the same draw.
fn render(draw: u64, view: &BevView) -> Result<RgbImage, GeneratorError> {
    let kinds = types::nuplan14().count() as u64;
    let kind = types::nuplan14()
        .nth((draw % kinds) as usize)
        .unwrap_or(generator::DEFAULT.scenario_type);
    let generated = |tries: u64| {
        generator::generate(&Spec::new(
            kind,
            FIRST_SEED + draw.wrapping_add(tries) % SEEDS,
        ))
    };
    let mut scenario = generated(0);
    for tries in 1..MAX_TRIES {
        if scenario.is_ok() {
            break;
        }
        scenario = generated(tries);
    }
    let scenario = scenario?;
    let frame = &scenario.frames[scenario.start + (draw / SEEDS) as usize % scenario.iterations()];
    let history = History::default();
    let scene = scenario.scene(frame, &history);
    Ok(bev::render(&scene, view))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_same_draw_shows_the_same_scene_and_another_another() {
        let view = BevView::new(64, 64.0).unwrap();
        let [one, same, other] = [7, 7, u64::MAX].map(|draw| render(draw, &view).unwrap());
        assert_eq!(one, same);
        assert_ne!(one, other);
    }
}
