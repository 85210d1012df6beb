//! The ego drives through a roundabout; nuPlan has no type for it.

use crate::generator::prelude::*;

/// `traversing_roundabout`.
pub const TYPE: ScenarioType = ScenarioType::new(&TypeDefinition {
    name: "traversing_roundabout",
    seed: 16_000,
    group: TypeGroup::Additional,
    setting,
    populate: crossing::populate,
    shows: |log| log.in_intersection(),
});

fn setting(rng: &mut SeededRng) -> Result<Setting, GeometryError> {
    let lanes = rng.range(1, 2);
    let style = setting::style(rng, [lanes, lanes], [lanes, lanes], &LIMITS[..3]);
    let before = rng.uniform(25.0, 70.0);
    let (layout, start) = setting::roundabout(rng, &style, before)?;
    Ok(Setting::new(layout, start - 4.1, rng.uniform(0.5, 0.95)))
}
