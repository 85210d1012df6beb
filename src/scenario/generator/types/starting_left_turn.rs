//! The ego turns left at a crossing.

use crate::generator::prelude::*;

/// `starting_left_turn`.
pub const TYPE: ScenarioType = ScenarioType::new(&TypeDefinition {
    name: "starting_left_turn",
    seed: 1_000,
    group: TypeGroup::Nuplan14,
    setting: |rng| crossing::turn(rng, Turn::Left, 0.65),
    populate: crossing::populate,
    shows: |log| log.turns(0.9),
});
