//! The ego goes straight on at a crossing without traffic lights.

use crate::generator::prelude::*;

/// `traversing_intersection`.
pub const TYPE: ScenarioType = ScenarioType::new(&TypeDefinition {
    name: "traversing_intersection",
    seed: 15_000,
    group: TypeGroup::Additional,
    setting: |rng| crossing::turn(rng, Turn::Straight, 0.0),
    populate: crossing::populate,
    shows: |log| log.in_intersection(),
});
