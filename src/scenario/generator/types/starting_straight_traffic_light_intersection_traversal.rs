//! The ego goes straight on at a crossing with traffic lights.

use crate::generator::prelude::*;

/// `starting_straight_traffic_light_intersection_traversal`.
pub const TYPE: ScenarioType = ScenarioType::new(&TypeDefinition {
    name: "starting_straight_traffic_light_intersection_traversal",
    seed: 3_000,
    group: TypeGroup::Nuplan14,
    setting: |rng| crossing::turn(rng, Turn::Straight, 1.0),
    populate: crossing::populate,
    shows: |log| log.crosses_a_light(),
});
