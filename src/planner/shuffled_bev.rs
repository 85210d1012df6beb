//! The BEV map of another scene: what a model is shown instead of its own, to see what looking is worth to it.

use crate::environment::{BevView, bev};
use crate::scenario::generator::{self, GeneratorError, Spec, types};
use crate::world::History;
use image::RgbImage;

/// Seeds of the scenes that are shown: none that is trained on or driven.
const FIRST_SEED: u64 = 900_000_000;
const SEEDS: u64 = 1_000_000;
/// Seeds that are tried one after another: the generator finds no scene for some.
const MAX_TRIES: u64 = 20;

/// The BEV map of a generated scene at some moment of its log; the same draw gives the same.
///
/// # Errors
/// When the generator finds no scene for many seeds on end.
pub(super) fn render(draw: u64, view: &BevView) -> Result<RgbImage, GeneratorError> {
    let kinds = types::nuplan14().count() as u64;
    let kind = types::nuplan14().nth((draw % kinds) as usize).unwrap_or(generator::DEFAULT.scenario_type);
    let generated = |tries: u64| generator::generate(&Spec::new(kind, FIRST_SEED + draw.wrapping_add(tries) % SEEDS));
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
