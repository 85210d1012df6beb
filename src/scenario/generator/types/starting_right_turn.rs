//! The ego turns right at a crossing.

use crate::scenario::generator::road::Turn;
use crate::scenario::generator::scenario_type::{ScenarioType, TypeDefinition, TypeGroup};
use crate::scenario::generator::scene::crossing;

/// `starting_right_turn`.
pub const TYPE: ScenarioType = ScenarioType::new(&TypeDefinition {
    name: "starting_right_turn",
    seed: 2_000,
    group: TypeGroup::Nuplan14,
    setting: |rng| crossing::turn(rng, Turn::Right, 0.6),
    populate: crossing::populate,
    shows: |log| log.turns(-0.9),
});
