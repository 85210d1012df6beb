//! The ego turns right at a crossing.

use crate::generator::prelude::*;

/// `starting_right_turn`.
pub const TYPE: ScenarioType = ScenarioType::new(&TypeDefinition {
    name: "starting_right_turn",
    seed: 2_000,
    group: TypeGroup::Nuplan14,
    setting: |rng| crossing::turn(rng, Turn::Right, 0.6),
    populate: crossing::populate,
    shows: |log| log.turns(-0.9),
});
